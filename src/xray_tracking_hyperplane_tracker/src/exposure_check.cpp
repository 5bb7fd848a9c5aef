#include "xray_tracking_hyperplane_tracker/exposure_check.h"

#include <cmath>
#include <iomanip>
#include <optional>
#include <sstream>
#include <stdexcept>

#include "contrast.h"
#include "image_check.h"
#include "point_sampler.h"

namespace xray_tracking
{
namespace
{
constexpr double kLeastInside = 0.25;  // of a region, in one rectangle
}  // namespace

const std::string& ExposureCheck::look(const cv::Mat& image, std::int64_t stamp_ns)
{
  checkImage(image);
  field_.update(image, intensity_);
  fault_ = field_.nothing();
  if (const std::optional<std::int64_t> before = repeated_.add(image, stamp_ns); before && fault_.empty())
  {
    std::ostringstream text;
    text << "the image, or a good part of its rows, is bit for bit that of " << std::fixed << std::setprecision(3)
         << 1e-9 * static_cast<double>(*before) << ", under a new stamp: the panel or its driver repeats itself";
    fault_ = text.str();
  }
  return fault_;
}

cv::Rect ExposureCheck::learn(const cv::Mat& image, const cv::Rect& region)
{
  requireRegionInside(region, image.size());
  repair_.add(inspector_.inspect(image, intensity_), image.size());
  XrayField field;
  field.update(image, intensity_);
  const cv::Rect inside = field.inside(region);
  if (inside.area() < kLeastInside * region.area())
  {
    std::ostringstream text;
    text << "region: " << describe(region) << " has only " << describe(inside)
         << " inside the field (collimator blades, the image's rim), expected a quarter of it or more";
    throw std::invalid_argument(text.str());
  }
  requireRegionInside(inside, image.size());
  return inside;
}

bool ExposureCheck::learnStuck(const cv::Mat& image)
{
  const std::size_t before = repair_.count();
  repair_.add(inspector_.inspect(image, intensity_), image.size());
  return repair_.count() > before;
}

const cv::Mat& ExposureCheck::repaired(const cv::Mat& image)
{
  if (repair_.empty())
  {
    return image;
  }
  repair_.apply(image, repaired_);
  return repaired_;
}

void ExposureCheck::reset()
{
  repeated_.reset();
  repair_.clear();
  field_.forget();
}
}  // namespace xray_tracking
