#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <opencv2/core.hpp>

#include "tally.h"
#include "xray_tracking_core/image/image_inspector.h"
#include "xray_tracking_registration/usable_pixels.h"

namespace xray_tracking
{
/// Looks at one detector's images, one after the other.
class ImageExamination
{
public:
  /// @param thing what findings name
  /// @param target where the target is seen [px]; empty: all of the image counts
  ImageExamination(std::string thing, const IntensityModel& intensity, const cv::Rect& target)
    : thing_(std::move(thing)), intensity_(intensity), target_(target)
  {
  }

  /// @return whether the image shows something of the patient
  bool add(const cv::Mat& image, std::int64_t stamp_ns, Tally& tally);

private:
  void judge(const ImageReport& report, std::int64_t stamp_ns, Tally& tally) const;

  std::string thing_;
  IntensityModel intensity_;
  cv::Rect target_;
  DetectorPixels pixels_;
  ImageInspector inspector_;
};
}  // namespace xray_tracking
