#include "lettering.h"

#include <algorithm>

#include <opencv2/imgproc.hpp>

#include "xray_tracking_core/image/image_inspector.h"

namespace xray_tracking
{
namespace
{
constexpr int kStroke = 7;  // widest [px]; odd, as an opening by an even size moves what it leaves
// A letter: larger than stuck clusters, smaller than lines.
constexpr int kLeastArea = 12;
constexpr int kLeastEdge = 5;
constexpr int kMostEdge = 64;
constexpr int kFewest = 3;        // letters: one alone may be a thing
constexpr int kApart = 25;        // between letters, at most
constexpr int kAround = 15;       // edge of what surrounds a stroke
constexpr double kFarFrom = 0.6;  // surroundings, of the end of the range
}  // namespace

void Lettering::mark(const cv::Mat& image, const cv::Rect& part, std::uint8_t bright, cv::Mat& flaws)
{
  cv::bitwise_and(flaws, bright, strokes_);
  if (cv::countNonZero(strokes_) < kFewest * kLeastArea)
  {
    return;
  }
  cv::compare(strokes_, 0, strokes_, cv::CMP_NE);
  cv::morphologyEx(strokes_, wide_, cv::MORPH_OPEN, cv::Mat::ones(kStroke + 2, kStroke + 2, CV_8U));
  double end = 0.0;
  cv::minMaxLoc(image(part), nullptr, &end, nullptr, nullptr, strokes_);
  image(part).convertTo(dim_, CV_32F);
  dim_.setTo(0.0, strokes_);
  cv::blur(dim_, surroundings_, { kAround, kAround });
  strokes_.convertTo(weights_, CV_32F, -1.0 / 255.0, 1.0);
  cv::blur(weights_, weights_, { kAround, kAround });
  // Their mean is below kFarFrom of the end.
  cv::scaleAdd(weights_, -kFarFrom * end, surroundings_, surroundings_);
  cv::compare(surroundings_, 0.0, letters_, cv::CMP_LT);
  cv::bitwise_and(letters_, strokes_, letters_);
  letters_.setTo(0, wide_);

  int count = 0;
  const int labels = cv::connectedComponentsWithStats(letters_, numbers_, figures_, centres_);
  letters_.setTo(0);
  for (int label = 1; label < labels; ++label)
  {
    const int* figure = figures_.ptr<int>(label);
    const cv::Rect box(figure[cv::CC_STAT_LEFT], figure[cv::CC_STAT_TOP], figure[cv::CC_STAT_WIDTH],
                       figure[cv::CC_STAT_HEIGHT]);
    if (figure[cv::CC_STAT_AREA] >= kLeastArea && std::max(box.width, box.height) >= kLeastEdge &&
        std::max(box.width, box.height) <= kMostEdge)
    {
      letters_(box).setTo(255);
      ++count;
    }
  }
  if (count < kFewest)
  {
    return;
  }
  cv::morphologyEx(letters_, letters_, cv::MORPH_CLOSE, cv::Mat::ones(kApart, kApart, CV_8U));
  cv::dilate(letters_, letters_, cv::Mat::ones(5, 5, CV_8U));
  cv::bitwise_or(flaws, STUCK, flaws, letters_);
}
}  // namespace xray_tracking
