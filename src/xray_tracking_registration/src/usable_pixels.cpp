#include "xray_tracking_registration/usable_pixels.h"

#include <algorithm>
#include <exception>
#include <optional>
#include <stdexcept>

#include "message.h"
#include "xray_tracking_core/image/image_inspector.h"

namespace xray_tracking
{
namespace
{
constexpr int kLooked = 256;  // edge of what is looked at for mixed rows [px]
}  // namespace

UsableImage DetectorPixels::look(const cv::Mat& image, const IntensityModel& intensity, std::int64_t stamp_ns)
{
  UsableImage seen;
  seen.image = image;
  try
  {
    seen.fault = examine(image, intensity, stamp_ns, seen);
  }
  catch (const std::exception& error)
  {
    seen.kind = ImageFault::NO_IMAGE;
    seen.fault = error.what();
  }
  return seen;
}

std::string DetectorPixels::examine(const cv::Mat& image, const IntensityModel& intensity, std::int64_t stamp_ns,
                                    UsableImage& seen)
{
  field_.update(image, intensity);
  if (!field_.nothing().empty())
  {
    seen.kind = ImageFault::NOTHING;
    return field_.nothing();
  }
  const std::optional<std::int64_t> before = repeated_.add(image, stamp_ns);
  if (before && *before < stamp_ns)
  {
    seen.kind = ImageFault::REPEATED;
    return message("the image, or a good part of its rows, is bit for bit that of ",
                   1e-9 * static_cast<double>(stamp_ns - *before), " s before");
  }
  if (inspected_ != image.size())
  {
    repair_.add(ImageInspector().inspect(image, intensity), image.size());
    inspected_ = image.size();
  }
  const cv::Rect whole(cv::Point(), image.size());
  if (field_.outside(whole) > 0.0)
  {
    seen.usable = cv::Mat::zeros(image.size(), CV_8UC1);
    field_.mark(whole, 255, seen.usable);
    cv::bitwise_not(seen.usable, seen.usable);
  }
  if (!repair_.empty())
  {
    seen.image = cv::Mat();  // not into the pixels that were given
    repair_.apply(image, seen.image);
  }
  // In the middle of the image: if rows are mixed, they are in all of it.
  const cv::Size looked(std::min(whole.width / 2, kLooked), std::min(whole.height / 2, kLooked));
  const cv::Rect middle(cv::Point((whole.width - looked.width) / 2, (whole.height - looked.height) / 2), looked);
  const std::string& mixed = mixed_.look(seen.image, middle);
  seen.kind = mixed.empty() ? ImageFault::NONE : ImageFault::MIXED_ROWS;
  return mixed;
}

void UsablePixels::apply(std::int64_t stamp_ns, RegistrationRequest& request)
{
  for (RegistrationView& view : request.views)
  {
    UsableImage seen = detectors_[view.geometry.name()].look(view.image, request.intensity, stamp_ns);
    if (!seen.fault.empty())
    {
      throw std::invalid_argument(message("view ", view.geometry.name(), ": ", seen.fault));
    }
    view.image = seen.image;
    view.usable = seen.usable;
  }
}
}  // namespace xray_tracking
