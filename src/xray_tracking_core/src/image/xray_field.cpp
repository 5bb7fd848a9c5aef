#include "xray_tracking_core/image/xray_field.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "field_border.h"
#include "image_bins.h"

namespace xray_tracking
{
namespace
{
constexpr int kLeastSize = 16;  // of an image [px]
constexpr double kLeastField = 0.01;
/// Bins of a real image go together by 0.9 and more along rows and columns; of noise alone, even if it is correlated
/// over pixels, hardly, and of the column or row pattern of a dark frame along one of them only.
constexpr double kLeastCorrelation = 0.3;
constexpr float kLeastLevel = 2.f;  // of the brightest bins, in standard deviations of a pixel
/// Of the light before: a panel's lag is about 3 % in the first image after it and 0.5 % in the fiftieth (Starman et
/// al. 2011); blades leave some bins as they were.
constexpr double kLag = 1.0 / 16.0;
/// Of the first dark image's contrast: lag has 0.7 of it in the second one, the dose of a panel that lags a little
/// more.
constexpr double kStays = 0.85;
/// Of what the noise grew by with light before: what comes out of traps has next to none of that, an exposure all of
/// it.
constexpr float kAsNoisy = 0.5f;
constexpr float kSure = 3.f;        // standard deviations
constexpr int kDarkImages = 4;      // that it takes at least
constexpr double kForgets = 0.98;   // an image, where noise does not tell: a thirtieth is a dose after 36 of them
constexpr double kByNoise = 3.0;    // standard deviations: where little came through before
constexpr double kBrighter = 0.01;  // of the bins

std::string nothingIn(const ImageBins& bins, const IntensityModel& intensity)
{
  const auto nothing = [](const auto&... words)
  {
    std::ostringstream text;
    text << "the image shows nothing";
    (text << ... << words);
    return text.str();
  };
  if (bins.largest() == bins.smallest())
  {
    return nothing(": it is ", bins.largest(), " everywhere");
  }
  if (intensity.kind == IntensityModel::Kind::COUNTS && bins.brightest() <= kLeastLevel * bins.noise())
  {
    return nothing(": its brightest part is ", bins.brightest(), " counts above the offset of ", intensity.offset,
                   ", with noise of ", bins.noise());
  }
  return bins.correlation() < kLeastCorrelation ? nothing(" but noise or stripes") : std::string();
}
}  // namespace

struct XrayField::Implementation
{
  explicit Implementation(int number_of_bins) : bins(number_of_bins) {}

  ImageBins bins;
  FieldBorder border;
  std::string nothing;
  cv::Mat light_before;       ///< of the last image that showed something
  float growth_before = 0.f;  ///< of the noise, as that of the dark images together
  float growth = 0.f, variance_of_growth = 0.f;
  int type_before = -1;
  cv::Mat first_dark;  ///< light of the first image after it that had little of its light
  int dark = 0;        ///< number of those images, up to now

  /// Whether nearly everywhere there is less than a share of the light before.
  bool isBelow(double share) const
  {
    const cv::Mat& light = bins.light();
    const double noise = kByNoise * bins.noise() + 0.5 * bins.step();
    int brighter = 0;
    for (int y = 0; y < light.rows; ++y)
    {
      const float* before = light_before.ptr<float>(y);
      const float* now = light.ptr<float>(y);
      for (int x = 0; x < light.cols; ++x)
      {
        brighter += now[x] > share * before[x] + noise;
      }
    }
    return brighter < kBrighter * static_cast<double>(light.total());
  }

  /// What is left of the first dark image's contrast: its own noise makes it seem less.
  double contrastLeft() const
  {
    const cv::Mat& light = bins.light();
    const double mean = cv::mean(first_dark)[0], mean_now = cv::mean(light)[0];
    const auto count = static_cast<double>(light.total());
    return (first_dark.dot(light) - count * mean * mean_now) / (first_dark.dot(first_dark) - count * mean * mean);
  }

  /// Whether so little light is not an exposure's, but that of the last one that a panel remembers: a dose stays, lag
  /// falls.
  bool isLag()
  {
    const cv::Mat& light = bins.light();
    if (light_before.size() != light.size() || !isBelow(kLag))
    {
      dark = 0;
      return false;
    }
    if (++dark == 1)
    {
      light.copyTo(first_dark);
      growth = variance_of_growth = 0.f;
    }
    growth += bins.growth();
    variance_of_growth += bins.growthError() * bins.growthError();
    // A panel that is black but for rounding has no noise to tell by.
    if (growth_before > 0.f && bins.quantum() > 0.f)
    {
      const float usual = kAsNoisy * growth_before * static_cast<float>(dark);
      const float error = kSure * std::sqrt(variance_of_growth);
      if (growth + error < usual)
      {
        return true;
      }
      if (dark >= kDarkImages && growth - error > usual && contrastLeft() > kStays)
      {
        return false;
      }
    }
    return isBelow(kLag * std::pow(kForgets, dark));
  }

  /// The bins that a part of the image touches.
  cv::Rect binsOf(const cv::Rect& part) const
  {
    const int edge = bins.edge();
    const cv::Point first(part.x / edge, part.y / edge);
    return { first, cv::Point((part.x + part.width - 1) / edge + 1, (part.y + part.height - 1) / edge + 1) };
  }
  cv::Rect pixelsOf(const cv::Rect& of_bins) const
  {
    const int edge = bins.edge();
    return { of_bins.x * edge, of_bins.y * edge, of_bins.width * edge, of_bins.height * edge };
  }
};

XrayField::XrayField(int bins) : implementation_(std::make_unique<Implementation>(bins)) {}
XrayField::~XrayField() = default;
XrayField::XrayField(XrayField&&) noexcept = default;
XrayField& XrayField::operator=(XrayField&&) noexcept = default;

void XrayField::update(const cv::Mat& image, const IntensityModel& intensity)
{
  if (image.dims != 2 || image.cols < kLeastSize || image.rows < kLeastSize ||
      (image.type() != CV_8UC1 && image.type() != CV_16UC1 && image.type() != CV_32FC1))
  {
    throw std::invalid_argument("image: is " + std::to_string(image.cols) + " x " + std::to_string(image.rows) +
                                " of OpenCV type " + std::to_string(image.type()) +
                                ", expected one channel of 8 or 16 bit or float, 16 x 16 pixels or more");
  }
  Implementation& i = *implementation_;
  i.bins.update(image, intensity);
  i.nothing = nothingIn(i.bins, intensity);
  if (!i.nothing.empty())
  {
    i.border.close(i.bins);
    return;
  }
  i.border.update(i.bins);
  if (i.border.any() &&
      cv::countNonZero(i.border.outside()) > (1.0 - kLeastField) * static_cast<double>(i.border.outside().total()))
  {
    i.nothing = "the image shows nothing: all of it is outside the field";
    i.border.close(i.bins);
    return;
  }
  if (i.type_before == image.type() && i.isLag())
  {
    i.nothing =
        "the image shows nothing: it has less than a sixteenth of the light of those before, as what is left of "
        "them in a panel when X-rays are off";
    i.border.close(i.bins);
    return;
  }
  i.bins.light().copyTo(i.light_before);
  i.first_dark.create(i.light_before.size(), CV_32FC1);
  i.growth_before = i.bins.growth();
  i.dark = 0;
  i.type_before = image.type();
}

void XrayField::forget()
{
  implementation_->light_before.release();
}

const std::string& XrayField::nothing() const
{
  return implementation_->nothing;
}

double XrayField::largest() const
{
  return implementation_->bins.largest();
}

double XrayField::smallest() const
{
  return implementation_->bins.smallest();
}

double XrayField::outside(const cv::Rect& part) const
{
  const Implementation& i = *implementation_;
  const cv::Mat& outside = i.border.outside();
  const cv::Rect all = i.binsOf(part);
  const cv::Rect seen = all & cv::Rect(cv::Point(), outside.size());
  if (seen.empty())
  {
    return 1.0;
  }
  const int inside = i.border.any() ? seen.area() - cv::countNonZero(outside(seen)) : seen.area();
  return 1.0 - inside / static_cast<double>(all.area());
}

cv::Rect XrayField::inside(const cv::Rect& part) const
{
  const Implementation& i = *implementation_;
  const cv::Mat& outside = i.border.outside();
  if (!i.border.any())
  {
    return part;
  }
  // Of every row, the columns of free bins that end there are a histogram; its largest rectangle.
  const cv::Rect bins = i.binsOf(part) & cv::Rect(cv::Point(), outside.size());
  std::vector<int> heights(static_cast<std::size_t>(bins.width), 0);
  cv::Rect largest;
  for (int y = bins.y; y < bins.br().y; ++y)
  {
    for (int x = 0; x < bins.width; ++x)
    {
      int& height = heights[static_cast<std::size_t>(x)];
      height = outside.at<std::uint8_t>(y, bins.x + x) == 0 ? height + 1 : 0;
    }
    for (int first = 0; first < bins.width; ++first)
    {
      int height = bins.height;
      for (int last = first; last < bins.width; ++last)
      {
        height = std::min(height, heights[static_cast<std::size_t>(last)]);
        const cv::Rect pixels = i.pixelsOf({ bins.x + first, y - height + 1, last - first + 1, height }) & part;
        largest = pixels.area() > largest.area() ? pixels : largest;
      }
    }
  }
  return largest;
}

void XrayField::mark(const cv::Rect& part, std::uint8_t bits, cv::Mat& pixels) const
{
  const Implementation& i = *implementation_;
  if (!i.border.any())
  {
    return;
  }
  const int edge = i.bins.edge();
  const int width = part.width;  // not read again after every byte that is written
  cv::AutoBuffer<std::uint8_t, 4096> buffer(width);
  std::uint8_t* const marks = buffer.data();  // of all rows of one row of bins
  for (int y = 0; y < part.height; ++y)
  {
    if (y == 0 || (part.y + y) % edge == 0)
    {
      const std::uint8_t* outside = i.border.outside().ptr((part.y + y) / edge);
      for (int x = 0; x < width;)
      {
        const int bin = (part.x + x) / edge;
        const int end = std::min(width, (bin + 1) * edge - part.x);
        std::fill(marks + x, marks + end, outside[bin] != 0 ? bits : 0);
        x = end;
      }
    }
    std::uint8_t* row = pixels.ptr(y);
    for (int x = 0; x < width; ++x)
    {
      row[x] |= marks[x];
    }
  }
}
}  // namespace xray_tracking
