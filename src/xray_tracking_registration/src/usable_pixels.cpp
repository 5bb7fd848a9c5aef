#include "xray_tracking_registration/usable_pixels.h"

#include <algorithm>
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

void UsablePixels::apply(std::int64_t stamp_ns, RegistrationRequest& request)
{
  for (RegistrationView& view : request.views)
  {
    Detector& detector = detectors_[view.geometry.name()];
    detector.field.update(view.image, request.intensity);
    if (!detector.field.nothing().empty())
    {
      throw std::invalid_argument(message("view ", view.geometry.name(), ": ", detector.field.nothing()));
    }
    const std::optional<std::int64_t> before = detector.repeated.add(view.image, stamp_ns);
    if (before && *before < stamp_ns)
    {
      throw std::invalid_argument(message("view ", view.geometry.name(),
                                          ": the image, or a good part of its rows, is bit for bit that of ",
                                          1e-9 * static_cast<double>(stamp_ns - *before), " s before"));
    }
    if (detector.inspected != view.image.size())
    {
      detector.repair.add(ImageInspector().inspect(view.image, request.intensity), view.image.size());
      detector.inspected = view.image.size();
    }
    const cv::Rect whole(cv::Point(), view.image.size());
    if (detector.field.outside(whole) > 0.0)
    {
      cv::Mat outside = cv::Mat::zeros(view.image.size(), CV_8UC1);
      detector.field.mark(whole, 1, outside);
      view.usable = outside == 0;
    }
    if (!detector.repair.empty())
    {
      cv::Mat repaired;
      detector.repair.apply(view.image, repaired);
      view.image = repaired;
    }
    // In the middle of the image: if rows are mixed, they are in all of it.
    const cv::Size looked(std::min(whole.width / 2, kLooked), std::min(whole.height / 2, kLooked));
    const cv::Rect middle(cv::Point((whole.width - looked.width) / 2, (whole.height - looked.height) / 2), looked);
    if (const std::string& mixed = detector.mixed.look(view.image, middle); !mixed.empty())
    {
      throw std::invalid_argument(message("view ", view.geometry.name(), ": ", mixed));
    }
  }
}
}  // namespace xray_tracking
