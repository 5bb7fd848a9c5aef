#include "import_words.h"
#include "xray_tracking_core/geometry/geometry_import.h"

namespace xray_tracking
{
namespace
{
// mm. From the source to the patient, to the panel, and the panel's sides: a bench for hands to a room of its own.
constexpr double kNearest = 200.0;
constexpr double kFarthest = 10000.0;
constexpr double kFarthestPanel = 15000.0;
constexpr double kSmallest = 10.0;
constexpr double kLargest = 2000.0;

std::string unitInWords(double distance)
{
  const auto is_room = [&](double factor) { return distance * factor >= 300.0 && distance * factor <= 6000.0; };
  return is_room(1000.0) ? "; are coordinates in metres?" : is_room(10.0) ? "; are coordinates in centimetres?" : "";
}
}  // namespace

std::string implausibility(const ProjectionGeometry& detector)
{
  const double sdd = detector.sourceToDetector();
  const Eigen::Array2d sides = detector.imageSize().cast<double>().cwiseProduct(detector.pixelPitch());
  if (sdd >= kNearest && sdd <= kFarthestPanel && sides.minCoeff() >= kSmallest && sides.maxCoeff() <= kLargest)
  {
    return "";
  }
  const std::string what =
      sentence("the panel is ", sides.x(), " x ", sides.y(), " mm, ", sdd, " mm from the source: expected sides of ",
               kSmallest, " to ", kLargest, " mm, ", kNearest, " to ", kFarthestPanel, " mm from it", unitInWords(sdd));
  return what + (sdd > kFarthestPanel || sides.maxCoeff() > kLargest ? "; is the pitch in mm?" : "");
}

std::string implausibility(const ProjectionGeometry& detector, const Eigen::Vector3d& patient)
{
  if (const std::string panel = implausibility(detector); !panel.empty())
  {
    return panel;
  }
  const double depth = detector.depth(patient);
  const double sdd = detector.sourceToDetector();
  if (!(depth > 0.0))
  {
    return sentence("the source, at ", placeOf(detector.source()), " mm, is ", -depth,
                    " mm beyond the patient, as the panel has it: expected it to face him; are source and panel "
                    "swapped, or is the patient elsewhere?");
  }
  if (!(depth >= kNearest && depth <= kFarthest))
  {
    return sentence("the source, at ", placeOf(detector.source()), " mm, is ", depth, " mm from the patient: expected ",
                    kNearest, " to ", kFarthest, " mm", unitInWords(depth));
  }
  if (!(sdd > depth))
  {
    return sentence("the panel is ", sdd, " mm from the source, nearer than the patient, at ", depth,
                    " mm: expected it beyond him; are source and panel swapped? Or is the pitch too small: with these "
                    "focal lengths more than ",
                    depth / detector.focalLength().x(), " mm?");
  }
  return "";
}
}  // namespace xray_tracking
