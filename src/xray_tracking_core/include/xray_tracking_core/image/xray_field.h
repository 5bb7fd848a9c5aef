#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// The part of an image that X-rays reach, and whether there is any: cheap enough for every exposure.
///
/// On medians of a few pixels of square bins. Outside is what a row or a column passes from the image's border on, if
/// it is dark up to a steep rise, by a factor of 3.3 within two bins: collimator blades, an intensifier's rim, a frame;
/// and what these cut off. Anatomy is not so steep against what is behind it: the chord of a round body grows as a root
/// from its edge, and scatter lies over it. What protrudes from the image's border but is thin (a rod, an instrument)
/// is no border. With the penumbra, a bin.
///
/// An image with less than a sixteenth of the light of the one before, nearly everywhere, is what a panel remembers of
/// that one while X-rays are off. It is a dose, from the fourth one on, if its contrast stays and its noise grows with
/// light as before; where noise does not tell, after tens of images.
///
/// Not thread-safe. No allocation after the first image of a size, but for words about an image that shows nothing.
class XrayField
{
public:
  /// @param bins along the image's longer side: it is as exact as these
  explicit XrayField(int bins = 128);
  ~XrayField();
  XrayField(XrayField&&) noexcept;
  XrayField& operator=(XrayField&&) noexcept;

  /// @param image CV_8UC1, CV_16UC1 or CV_32FC1 (all finite), 16 x 16 or more
  /// @throws std::invalid_argument naming the type or the size of another one
  void update(const cv::Mat& image, const IntensityModel& intensity);
  /// Of the images before: the next is judged alone.
  void forget();

  /// Why the last image as a whole shows nothing: it is the same everywhere, not above the offset, noise or stripes
  /// alone, what is left of the image before, or there is no field; empty where it shows something. Then all of it is
  /// outside.
  const std::string& nothing() const;
  /// Share of a rectangle of the image's that is outside the field, what is beyond the image included, 0..1.
  double outside(const cv::Rect& part) const;
  /// The largest rectangle in a part of the image that lies in the field; empty if there is none.
  cv::Rect inside(const cv::Rect& part) const;
  /// Sets bits in the pixels of a part of the image that are outside. @param pixels CV_8UC1 of the part's size
  void mark(const cv::Rect& part, std::uint8_t bits, cv::Mat& pixels) const;

  double largest() const;  ///< of the bins, in the image's values
  double smallest() const;

private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};
}  // namespace xray_tracking
