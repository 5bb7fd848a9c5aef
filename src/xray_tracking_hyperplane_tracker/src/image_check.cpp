#include "image_check.h"

#include <stdexcept>
#include <string>

#include "contrast.h"
#include "point_sampler.h"

namespace xray_tracking
{
namespace
{
std::string description(const cv::Size& size, int type)
{
  return std::to_string(size.width) + " x " + std::to_string(size.height) + (type == CV_8UC1 ? " mono8" : " mono16");
}
}  // namespace

void requireRegionInside(const cv::Rect& region, const cv::Size& image)
{
  constexpr int kMinRegionSize = 16;
  const cv::Rect inside = region & cv::Rect(cv::Point(), image);
  if (region.width < kMinRegionSize || region.height < kMinRegionSize || inside != region)
  {
    throw std::invalid_argument("region: is " + describe(region) + " in an image of " + std::to_string(image.width) +
                                " x " + std::to_string(image.height) + ", expected inside and " +
                                std::to_string(kMinRegionSize) + " px or more both ways");
  }
}

void requireTemplatesKind(const cv::Mat& image, const cv::Size& size, int type)
{
  if (image.size() != size || image.type() != type)
  {
    checkImage(image);
    throw std::invalid_argument("image: is " + description(image.size(), image.type()) + ", expected " +
                                description(size, type) + " as the template's image");
  }
}
}  // namespace xray_tracking
