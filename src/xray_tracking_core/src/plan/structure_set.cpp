#include "structure_set.h"

#include <algorithm>
#include <sstream>
#include <utility>

#include "rt_file.h"

namespace xray_tracking
{
namespace
{
const gdcm::Tag kPatientId(0x0010, 0x0020);
const gdcm::Tag kSopInstance(0x0008, 0x0018);
const gdcm::Tag kFrameOfReference(0x0020, 0x0052);
const gdcm::Tag kReferencedFrames(0x3006, 0x0010);
const gdcm::Tag kRois(0x3006, 0x0020);
const gdcm::Tag kRoiNumber(0x3006, 0x0022);
const gdcm::Tag kReferencedFrame(0x3006, 0x0024);
const gdcm::Tag kRoiName(0x3006, 0x0026);
const gdcm::Tag kRoiContours(0x3006, 0x0039);
const gdcm::Tag kContours(0x3006, 0x0040);
const gdcm::Tag kGeometricType(0x3006, 0x0042);
const gdcm::Tag kSlabThickness(0x3006, 0x0044);
const gdcm::Tag kOffsetVector(0x3006, 0x0045);
const gdcm::Tag kPointCount(0x3006, 0x0046);
const gdcm::Tag kContourData(0x3006, 0x0050);
const gdcm::Tag kReferencedRoi(0x3006, 0x0084);

/// No patient is larger [mm].
constexpr double kFarthest = 1e4;
constexpr std::size_t kMostPoints = 20000;  // of a contour; a real one has hundreds

/// The ROI's item of StructureSetROISequence.
DicomData chosenRoi(const DicomData& file, const StructureChoice& choice)
{
  constexpr std::size_t kMostListed = 200;
  const std::vector<DicomData> rois = file.items(kRois);
  if (rois.empty())
  {
    failRt(choice.file, "StructureSetROISequence (3006,0020) is absent or empty, expected structures");
  }
  std::vector<DicomData> found;
  std::string names;
  for (std::size_t n = 0; n < rois.size(); ++n)
  {
    const std::string name = rtName(file, rois[n], kRoiName);
    if (!choice.roi.empty() && name == choice.roi)
    {
      found.push_back(rois[n]);
    }
    if (n < kMostListed)
    {
      names += (n == 0 ? "'" : ", '") + name + "'";
    }
  }
  if (found.empty())
  {
    failRt(choice.file, "no structure has the ROIName (3006,0026) '" + choice.roi + "', expected one of " + names +
                            (rois.size() > kMostListed ? " and more" : ""));
  }
  if (found.size() > 1)
  {
    failRt(choice.file, std::to_string(found.size()) + " structures have the ROIName (3006,0026) '" + choice.roi +
                            "', ROINumber " + found[0].text(kRoiNumber) + " and " + found[1].text(kRoiNumber) +
                            ": expected one; rename the others and export again");
  }
  return found.front();
}

/// The item of ROIContourSequence that has the ROI's contours.
DicomData contoursOf(const DicomData& file, const DicomData& roi, const std::string& where)
{
  const std::string number = roi.text(kRoiNumber);
  std::vector<DicomData> found;
  for (const DicomData& item : file.items(kRoiContours))
  {
    if (roi.number(kRoiNumber) && item.number(kReferencedRoi) == roi.number(kRoiNumber))
    {
      found.push_back(item);
    }
  }
  if (found.size() > 1)
  {
    failRt(where, "ROINumber " + number + " has " + std::to_string(found.size()) +
                      " items in ROIContourSequence (3006,0039), expected 1");
  }
  if (found.empty() || found.front().items(kContours).empty())
  {
    failRt(where, "ROINumber " + number +
                      " has no contours (ContourSequence (3006,0040) is absent or empty), expected "
                      "a structure that is drawn");
  }
  return found.front();
}

std::vector<Eigen::Vector3d> pointsOf(const DicomData& contour, const std::string& where)
{
  const std::string type = contour.text(kGeometricType);
  if (type != "CLOSED_PLANAR" && type != "CLOSEDPLANAR_XOR")
  {
    failRt(where, "ContourGeometricType (3006,0042) is " + (type.empty() ? "absent" : type) +
                      ", expected CLOSED_PLANAR or CLOSEDPLANAR_XOR: " +
                      (type == "POINT" ? "a point has no extent" : "only closed contours enclose a target"));
  }
  const std::vector<double> offset = contour.numbers(kOffsetVector);
  if (std::any_of(offset.begin(), offset.end(), [](double value) { return value != 0.0; }))
  {
    failRt(where, "ContourOffsetVector (3006,0045) is " + numbersText(offset) + ", expected none or 0\\0\\0");
  }
  const std::vector<double> values = contour.numbers(kContourData);
  if (values.empty())
  {
    const std::string text = contour.text(kContourData);
    failRt(where, "ContourData (3006,0050) is " +
                      (text.empty() ? "absent or empty" : "'" + text.substr(0, 60) + "...'") +
                      ", expected numbers x\\y\\z of each point");
  }
  if (values.size() > 3 * kMostPoints)
  {
    failRt(where, "ContourData (3006,0050) has " + std::to_string(values.size() / 3) + " points, expected at most " +
                      std::to_string(kMostPoints));
  }
  const std::vector<double> count = contour.numbers(kPointCount);
  if (values.size() % 3 != 0 || (!count.empty() && count.front() != static_cast<double>(values.size()) / 3.0))
  {
    failRt(where, "ContourData (3006,0050) has " + std::to_string(values.size()) +
                      " numbers, expected three for each of " +
                      (count.empty() ? "its points" : "NumberOfContourPoints (3006,0046) " + numbersText(count)));
  }
  std::vector<Eigen::Vector3d> points;
  for (std::size_t n = 0; n < values.size(); n += 3)
  {
    const Eigen::Vector3d point(values[n], values[n + 1], values[n + 2]);
    // Negated so that NaN fails, too.
    if (!(point.cwiseAbs().maxCoeff() <= kFarthest))
    {
      failRt(where, "ContourData (3006,0050) has the point " + numbersText({ point.x(), point.y(), point.z() }) +
                        ", expected mm within " + numbersText({ kFarthest }) + " of the origin");
    }
    points.push_back(point);
  }
  return points;
}
}  // namespace

std::string numbersText(const std::vector<double>& values)
{
  std::ostringstream text;
  for (std::size_t n = 0; n < values.size(); ++n)
  {
    text << (n == 0 ? "" : "\\") << values[n];
  }
  return text.str();
}

DrawnStructure readDrawnStructure(const StructureChoice& choice)
{
  const DicomData file = readRtFile(choice.file, "RTSTRUCT");
  const DicomData roi = chosenRoi(file, choice);
  const std::string where = choice.file + ": ROI '" + choice.roi + "'";
  DrawnStructure structure;
  structure.uid = file.text(kSopInstance);
  structure.patient_id = file.text(kPatientId);
  structure.frame_of_reference = roi.text(kReferencedFrame);
  if (const std::vector<DicomData> frames = file.items(kReferencedFrames);
      structure.frame_of_reference.empty() && frames.size() == 1)
  {
    structure.frame_of_reference = frames.front().text(kFrameOfReference);
  }
  if (structure.frame_of_reference.empty())
  {
    failRt(where, "ReferencedFrameOfReferenceUID (3006,0024) is absent, expected that of the CT it is drawn on");
  }
  int number = 0;
  for (const DicomData& contour : contoursOf(file, roi, where).items(kContours))
  {
    ++number;
    DrawnContour drawn{ number, pointsOf(contour, where + ", contour " + std::to_string(number)) };
    structure.slab_thickness = std::max(structure.slab_thickness, contour.number(kSlabThickness).value_or(0.0));
    if (drawn.points.size() > 2)
    {
      structure.contours.push_back(std::move(drawn));
    }
  }
  return structure;
}
}  // namespace xray_tracking
