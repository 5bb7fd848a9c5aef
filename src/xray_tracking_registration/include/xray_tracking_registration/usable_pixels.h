#pragma once

#include <cstdint>
#include <map>
#include <string>

#include "xray_tracking_core/image/mixed_rows.h"
#include "xray_tracking_core/image/pixel_repair.h"
#include "xray_tracking_core/image/repeated_image.h"
#include "xray_tracking_core/image/xray_field.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
/// Leaves out of exposures what says nothing of the patient: what lies outside the X-ray field, and pixels that are
/// stuck, which are taken from a detector's first exposure of a size. Not thread-safe.
class UsablePixels
{
public:
  /// Sets RegistrationView::usable of views that have a border, and puts an image of its own in the place of one that
  /// has stuck pixels.
  /// @param stamp_ns of the exposure; one that comes again by its stamp is the same, not a repetition
  /// @throws std::invalid_argument naming the view whose image shows nothing, or what an exposure before it showed, in
  /// all or some of its rows
  void apply(std::int64_t stamp_ns, RegistrationRequest& request);

  void reset() { detectors_.clear(); }

private:
  struct Detector
  {
    XrayField field;
    RepeatedImageCheck repeated;
    PixelRepair repair;
    MixedRows mixed;
    cv::Size inspected;  ///< size of the image that stuck pixels were taken from
  };

  std::map<std::string, Detector> detectors_;
};
}  // namespace xray_tracking
