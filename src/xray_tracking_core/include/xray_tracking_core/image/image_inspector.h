#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// What is wrong with a pixel; bits, as one may have several.
enum PixelFlaw : std::uint8_t
{
  SATURATED_BRIGHT = 1,  ///< at the largest value that the detector tells: only a bound of what came through
  SATURATED_DARK = 2,    ///< at the smallest one, or not above the intensity's offset: only a bound, too
  BORDER = 4,            ///< outside the field: collimator blades, an intensifier's rim, a frame; with the penumbra
  STUCK = 8              ///< far from its neighbours beyond noise: dead or hot pixels, small clusters, rows, columns
};

/// Pixels that say nothing at all of the patient; those that are saturated still say that much came through, or little.
constexpr std::uint8_t kUnusable = BORDER | STUCK;

/// What ImageInspector sees in an image.
struct ImageReport
{
  cv::Rect part;        ///< of the image that was looked at [px]
  cv::Mat flaws;        ///< CV_8UC1 of the part's size: bits of PixelFlaw; valid until the inspector's next image
  double bright = 0.0;  ///< shares of the part, 0..1: SATURATED_BRIGHT inside the field,
  double dark = 0.0;    ///< SATURATED_DARK inside the field,
  double border = 0.0;  ///< BORDER,
  double stuck = 0.0;   ///< STUCK
  /// Why the image as a whole shows nothing (black, constant, noise alone); empty where it shows something. Then all of
  /// its pixels are BORDER.
  std::string nothing;

  /// The shares in words, "12 % outside the field, 0.3 % stuck", without those that are zero; or `nothing`; "" where
  /// all is well.
  std::string describe() const;
  /// The pixels without any of some flaws: CV_8UC1 of the part's size, 255 where usable.
  void usable(cv::Mat& mask, std::uint8_t flaws_to_leave_out = kUnusable) const;
};

/// Tells from an image and the meaning of its values alone which pixels are of use.
///
/// - Saturation: the largest value, if it is all ones in 8, 10, 12, 14 or 16 bit, or if more pixels pile up at it than
///   right below; the smallest one likewise, and whatever is not above the offset.
/// - The field's border, and whether there is any: XrayField.
/// - Stuck: apart from the ring of 16 pixels around it by many times their spread and the image's noise, while all of
///   what is connected to it ends as steeply within the ring: a detector's blur lets nothing of the patient do so. And
///   rows and columns, or halves of them, of another gain: nearly all of their pixels brighter than those on both
///   sides. And white letters that were written into the image, with what lies between them.
///
/// Not thread-safe. No allocation after the first image of a size, but for words if an image shows nothing.
class ImageInspector
{
public:
  ImageInspector();
  ~ImageInspector();
  ImageInspector(ImageInspector&&) noexcept;
  ImageInspector& operator=(ImageInspector&&) noexcept;

  /// @param image CV_8UC1, CV_16UC1 or CV_32FC1 (all finite), 16 x 16 or more
  /// @param part where pixels are looked at [px], inside the image; empty: all. Border and "nothing" are judged by the
  ///        whole image, stuck pixels by the part alone
  /// @return valid until the next call
  /// @throws std::invalid_argument naming type or size of an image of another kind, or a part that is not inside
  const ImageReport& inspect(const cv::Mat& image, const IntensityModel& intensity, const cv::Rect& part = {});
  const ImageReport& report() const;

private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};
}  // namespace xray_tracking
