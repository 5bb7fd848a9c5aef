#include "xray_tracking_core/image/image_inspector.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iomanip>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "faulty_lines.h"
#include "lettering.h"
#include "pixel_type.h"
#include "stuck_pixels.h"
#include "xray_tracking_core/image/xray_field.h"

namespace xray_tracking
{
namespace
{
// Values at an end of the range are a plateau if so many pixels are there, and so many times as many as next to it.
constexpr double kPlateau = 1e-3;
constexpr double kPile = 2.0;
constexpr double kNext = 1.0 / 64.0;  // of the range

/// Whether a value is the largest of a detector of 8 to 16 bit.
bool allOnes(double value)
{
  return value == 255.0 || value == 1023.0 || value == 4095.0 || value == 16383.0 || value == 65535.0;
}

/// Whether pixels pile up at an end of the range rather than thin out towards it.
template <typename Pixel>
bool isPlateau(const cv::Mat& image, double end, double range)
{
  constexpr int kEvery = 3;
  const auto at = static_cast<float>(end);
  const auto width = static_cast<float>(std::max(range * kNext, image.depth() == CV_32F ? 0.0 : 1.0));
  std::size_t all = 0, there = 0, next = 0;
  for (int y = 0; y < image.rows; y += kEvery)
  {
    const Pixel* row = image.ptr<Pixel>(y);
    for (int x = 0; x < image.cols; x += kEvery)
    {
      const float apart = std::abs(static_cast<float>(row[x]) - at);
      ++all;
      there += apart == 0.f;
      next += apart > 0.f && apart <= width;
    }
  }
  return static_cast<double>(there) > kPlateau * static_cast<double>(all) &&
         static_cast<double>(there) > kPile * static_cast<double>(next);
}

/// Values that are only bounds: from `low` down and from `high` up.
struct Bounds
{
  double low = -std::numeric_limits<double>::infinity();
  double high = std::numeric_limits<double>::infinity();
};

template <typename Pixel>
Bounds boundsOf(const cv::Mat& image, const IntensityModel& intensity, const XrayField& field)
{
  Bounds bounds;
  double smallest = 0.0, largest = 0.0;
  cv::minMaxLoc(image, &smallest, &largest);
  const double range = field.largest() - field.smallest();
  if (allOnes(largest))
  {
    bounds.high = largest;
  }
  // The bins' ends, as stuck pixels may be beyond.
  if (isPlateau<Pixel>(image, field.largest(), range))
  {
    bounds.high = std::min(bounds.high, field.largest());
  }
  if (smallest == 0.0 && image.depth() != CV_32F)
  {
    bounds.low = 0.0;
  }
  if (isPlateau<Pixel>(image, field.smallest(), range))
  {
    bounds.low = std::max(bounds.low, field.smallest());
  }
  if (intensity.kind == IntensityModel::Kind::COUNTS)
  {
    bounds.low = std::max(bounds.low, intensity.offset);
  }
  return bounds;
}

}  // namespace

struct ImageInspector::Implementation
{
  ImageReport report;
  XrayField field;
  StuckPixels stuck;
  FaultyLines lines;
  Lettering lettering;

  template <typename Pixel>
  void markSaturation(const cv::Mat& image, const IntensityModel& intensity)
  {
    const Bounds bounds = boundsOf<Pixel>(image, intensity, field);
    const bool counts = intensity.kind == IntensityModel::Kind::COUNTS;
    const std::uint8_t above = counts ? SATURATED_BRIGHT : SATURATED_DARK;
    const std::uint8_t below = counts ? SATURATED_DARK : SATURATED_BRIGHT;
    const auto low = static_cast<float>(bounds.low), high = static_cast<float>(bounds.high);
    const cv::Rect& part = report.part;
    for (int y = 0; y < part.height; ++y)
    {
      const Pixel* values = image.ptr<Pixel>(part.y + y) + part.x;
      std::uint8_t* flaws = report.flaws.ptr(y);
      for (int x = 0; x < part.width; ++x)
      {
        const auto value = static_cast<float>(values[x]);
        flaws[x] = static_cast<std::uint8_t>((value >= high ? above : 0) | (value <= low ? below : 0));
      }
    }
  }

  void count()
  {
    std::size_t counts[16] = {};
    for (int y = 0; y < report.flaws.rows; ++y)
    {
      const std::uint8_t* flaws = report.flaws.ptr(y);
      for (int x = 0; x < report.flaws.cols; ++x)
      {
        ++counts[flaws[x]];
      }
    }
    std::size_t bright = 0, dark = 0, border = 0, stuck = 0;
    for (std::size_t f = 0; f < 16; ++f)
    {
      const bool inside = (f & BORDER) == 0;
      bright += inside && (f & SATURATED_BRIGHT) != 0 ? counts[f] : 0;
      dark += inside && (f & SATURATED_DARK) != 0 ? counts[f] : 0;
      border += !inside ? counts[f] : 0;
      stuck += (f & STUCK) != 0 ? counts[f] : 0;
    }
    const auto all = static_cast<double>(report.flaws.total());
    report.bright = static_cast<double>(bright) / all;
    report.dark = static_cast<double>(dark) / all;
    report.border = static_cast<double>(border) / all;
    report.stuck = static_cast<double>(stuck) / all;
  }
};

ImageInspector::ImageInspector() : implementation_(std::make_unique<Implementation>()) {}
ImageInspector::~ImageInspector() = default;
ImageInspector::ImageInspector(ImageInspector&&) noexcept = default;
ImageInspector& ImageInspector::operator=(ImageInspector&&) noexcept = default;

const ImageReport& ImageInspector::report() const
{
  return implementation_->report;
}

const ImageReport& ImageInspector::inspect(const cv::Mat& image, const IntensityModel& intensity, const cv::Rect& part)
{
  const cv::Rect whole(cv::Point(), image.size());
  if ((part & whole) != part)
  {
    throw std::invalid_argument("part: is " + std::to_string(part.width) + " x " + std::to_string(part.height) +
                                " at (" + std::to_string(part.x) + ", " + std::to_string(part.y) +
                                "), expected inside an image of " + std::to_string(image.cols) + " x " +
                                std::to_string(image.rows));
  }
  Implementation& i = *implementation_;
  i.field.forget();
  i.field.update(image, intensity);
  i.report.part = part.empty() ? whole : part;
  i.report.flaws.create(i.report.part.size(), CV_8UC1);
  i.report.nothing = i.field.nothing();
  if (!i.report.nothing.empty())
  {
    i.report.flaws.setTo(BORDER);
    i.count();
    return i.report;
  }
  withPixelType(image, [&](auto pixel) { i.markSaturation<decltype(pixel)>(image, intensity); });
  i.field.mark(i.report.part, BORDER, i.report.flaws);
  i.lettering.mark(image, i.report.part,
                   intensity.kind == IntensityModel::Kind::COUNTS ? SATURATED_BRIGHT : SATURATED_DARK, i.report.flaws);
  i.stuck.mark(image, i.report.part, i.report.flaws);
  i.lines.mark(image, i.report.part, i.report.flaws);
  i.count();
  return i.report;
}

std::string ImageReport::describe() const
{
  if (!nothing.empty())
  {
    return nothing;
  }
  std::ostringstream text;
  const char* separator = "";
  const auto tell = [&](double share, const char* what)
  {
    if (share > 0.0)
    {
      text << separator << std::setprecision(share < 0.995 ? 2 : 3) << 100.0 * share << " % " << what;
      separator = ", ";
    }
  };
  tell(border, "outside the field");
  tell(stuck, "stuck");
  tell(bright, "saturated bright");
  tell(dark, "saturated dark");
  return text.str();
}

void ImageReport::usable(cv::Mat& mask, std::uint8_t flaws_to_leave_out) const
{
  mask.create(flaws.size(), CV_8UC1);
  for (int row = 0; row < flaws.rows; ++row)
  {
    const std::uint8_t* from = flaws.ptr(row);
    std::transform(from, from + flaws.cols, mask.ptr(row),
                   [flaws_to_leave_out](std::uint8_t f)
                   { return static_cast<std::uint8_t>((f & flaws_to_leave_out) == 0 ? 255 : 0); });
  }
}
}  // namespace xray_tracking
