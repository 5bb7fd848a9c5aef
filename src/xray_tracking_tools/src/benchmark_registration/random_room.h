#pragma once

#include <random>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_detector_simulator/image_formation.h"

namespace xray_tracking
{
double between(std::mt19937& random, double low, double high);
/// Uniform in its logarithm.
double betweenLog(std::mt19937& random, double low, double high);
bool withProbability(std::mt19937& random, double probability);

/// What a random room may have.
struct RoomLimits
{
  int least_views = 1;     ///< to 3
  int most_pixels = 2048;  ///< a side, from 256 on
};

/// One to three detectors around the room's origin, whose central rays are 20 to 90 degrees apart about an axis near
/// `long_axis`; magnifications of 1.05 to 3, images of 256 to 2048 pixels a side, panels off-centre, turned and tilted.
/// @param field_mm what they see at the origin [mm]
std::vector<ProjectionGeometry> randomRoom(std::mt19937& random, const Eigen::Vector3d& long_axis, double field_mm,
                                           const RoomLimits& limits = {});

/// One make of detector with its beam, at random: kV of one or five energies, or MV; scatter, dose, blur, correlated
/// noise, fixed pattern; collimated or not; counts as they are, or brought to 8, 12 or 16 bit by a tone curve, with
/// saturated air and clipped dark.
class RandomDetectors
{
public:
  /// @param regions where the target is seen, of which blades hide little
  RandomDetectors(std::mt19937& random, const std::vector<ProjectionGeometry>& geometries,
                  const std::vector<cv::Rect>& regions);

  /// What the images' values are said to mean, which ignores the tone curve as users do.
  const IntensityModel& intensity() const { return intensity_; }

  /// @param soft, bone lengths of the materials [mm], changed
  cv::Mat expose(cv::Mat& soft, cv::Mat& bone, int detector, int exposure);

private:
  IntensityModel intensity_;
  double mega_volt_;  ///< attenuation in units of that at 70 keV, 0: kV
  std::vector<ImageFormation> formations_;
  std::vector<cv::Mat> fields_;  ///< share of the beam that blades and pattern leave, CV_32FC1
  bool plain_;
  double gamma_;
  double level_;  ///< that the target's brightest parts are brought to, of full scale, before the tone curve
  double dark_;   ///< of full scale, what becomes 0
  double most_;   ///< full scale [counts]
  std::vector<cv::Rect> regions_;
  std::vector<double> gains_;  ///< of every detector, 0 until its first exposure
};
}  // namespace xray_tracking
