#pragma once

#include <cstdint>

#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Letters that a program wrote into the image, over the patient: strokes at the end of the range in surroundings that
/// are far from it. They stay where they are while the patient moves, and digits change.
class Lettering
{
public:
  /// Sets STUCK in the flaws of a part of an image, for letters and for what lies between them.
  /// @param bright bit that flaws have where a pixel is at the upper end of the range
  void mark(const cv::Mat& image, const cv::Rect& part, std::uint8_t bright, cv::Mat& flaws);

private:
  cv::Mat strokes_, wide_, dim_, weights_, surroundings_, letters_, numbers_, figures_, centres_;
};
}  // namespace xray_tracking
