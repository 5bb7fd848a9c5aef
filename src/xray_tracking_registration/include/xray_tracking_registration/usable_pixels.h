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
/// What is wrong with an image that says nothing of the patient.
enum class ImageFault
{
  NONE,
  NOTHING,     ///< it shows nothing: black, constant, noise alone
  REPEATED,    ///< it, or a good part of its rows, was there before
  MIXED_ROWS,  ///< every other row is of another exposure
  NO_IMAGE     ///< of a type or size that is none
};

/// An image that has been looked at.
struct UsableImage
{
  ImageFault kind = ImageFault::NONE;
  cv::Mat image;      ///< the same pixels, or a copy without those that are stuck
  cv::Mat usable;     ///< as RegistrationView::usable
  std::string fault;  ///< why the image says nothing of the patient; empty: it does
};

/// Looks at one detector's exposures, each once, for what says nothing of the patient: what lies outside the X-ray
/// field, and pixels that are stuck, which are taken from the first exposure of a size. Not thread-safe.
class DetectorPixels
{
public:
  /// Takes in the next exposure. Never throws: what is wrong with an image is its fault.
  /// @param stamp_ns of the exposure; one that comes again by its stamp is the same, not a repetition
  UsableImage look(const cv::Mat& image, const IntensityModel& intensity, std::int64_t stamp_ns);

  /// The next exposure is the first one.
  void reset() { *this = DetectorPixels(); }

private:
  /// @return the fault
  std::string examine(const cv::Mat& image, const IntensityModel& intensity, std::int64_t stamp_ns, UsableImage& seen);

  XrayField field_;
  RepeatedImageCheck repeated_;
  PixelRepair repair_;
  MixedRows mixed_;
  cv::Size inspected_;  ///< size of the image that stuck pixels were taken from
};

/// The same of all views of an exposure at a time.
class UsablePixels
{
public:
  /// Sets RegistrationView::usable of views that have a border, and puts an image of its own in the place of one that
  /// has stuck pixels.
  /// @throws std::invalid_argument naming the view whose image shows nothing, or what an exposure before it showed, in
  /// all or some of its rows
  void apply(std::int64_t stamp_ns, RegistrationRequest& request);

  void reset() { detectors_.clear(); }

private:
  std::map<std::string, DetectorPixels> detectors_;
};
}  // namespace xray_tracking
