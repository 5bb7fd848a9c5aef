#pragma once

#include <cstdint>
#include <string>

#include <opencv2/core.hpp>

#include "xray_tracking_core/image/image_inspector.h"
#include "xray_tracking_core/image/mixed_rows.h"
#include "xray_tracking_core/image/pixel_repair.h"
#include "xray_tracking_core/image/repeated_image.h"
#include "xray_tracking_core/image/xray_field.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// What of a detector's exposures a tracker may look at: what does not move with the patient (collimator blades, stuck
/// pixels, an image that stands still) would hold the region in its place.
class ExposureCheck
{
public:
  explicit ExposureCheck(const IntensityModel& intensity) : intensity_(intensity) {}

  /// Takes in the next exposure. @param image as RegionTracker takes it
  /// @return why there is nothing new to be seen in it: it shows nothing, or was there before; empty: there is
  const std::string& look(const cv::Mat& image, std::int64_t stamp_ns);

  /// What of a region a template may be learnt from: the largest rectangle in it inside the field. Learns the image's
  /// stuck pixels, too. @param image the last one that was looked at
  /// @throws std::invalid_argument saying how much of the region is outside, if that is more than three quarters
  cv::Rect learn(const cv::Mat& image, const cv::Rect& region);

  /// Learns further stuck pixels. @return whether there are any
  bool learnStuck(const cv::Mat& image);

  /// Share of a rectangle of the last image's that is outside the field, 0..1.
  double outside(const cv::Rect& part) const { return field_.outside(part); }

  /// The image without its stuck pixels as far as they are known: the image itself where there are none; valid until
  /// the next call. No allocation after the first one.
  const cv::Mat& repaired(const cv::Mat& image);

  /// Why a part of a repaired image is of two exposures; empty: it is not. Valid until the next call.
  const std::string& mixed(const cv::Mat& repaired, const cv::Rect& part) { return mixed_.look(repaired, part); }

  /// Forgets all exposures and the stuck pixels.
  void reset();

private:
  static constexpr int kBins = 64;  ///< of every exposure; templates are cut with more

  IntensityModel intensity_;
  RepeatedImageCheck repeated_;
  XrayField field_{ kBins };
  ImageInspector inspector_;
  PixelRepair repair_;
  MixedRows mixed_;
  cv::Mat repaired_;
  std::string fault_;
};
}  // namespace xray_tracking
