#pragma once

#include <vector>

#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Pixels that are apart from all around them as nothing is that a detector's blur has passed.
class StuckPixels
{
public:
  /// Sets STUCK in the flaws of a part of an image; what is BORDER there is not looked at.
  void mark(const cv::Mat& image, const cv::Rect& part, cv::Mat& flaws);

  struct Sample
  {
    float level;
    float deviation;  ///< from the median around it, > 0
  };

private:
  struct Candidate
  {
    cv::Point place;  ///< in the part
    float centre;     ///< of the ring around it
    float by_noise;   ///< deviation that its neighbours may have by noise
  };

  template <typename Pixel>
  void find(const cv::Mat& image, const cv::Mat& flaws, const cv::Rect& part);

  cv::Mat smooth_;
  std::vector<Sample> samples_;
  std::vector<Candidate> candidates_;
};
}  // namespace xray_tracking
