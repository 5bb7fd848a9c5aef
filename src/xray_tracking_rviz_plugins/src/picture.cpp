#include "picture.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
const cv::Scalar kBackground(0x1a, 0x15, 0x12, 0xff);  // blue first: look::kBackground
const cv::Vec3b kEdgeColour(0x40, 0xa0, 0xff);         // look::kOverlay
constexpr int kSquare = 72;                            // of the checkerboard, screen pixels
constexpr double kMagnified = 6.0;                     // from this scale on pixels are squares

/// Pixel coordinates of a picture's pixels, as warpAffine takes them: of a grid of points `first + step * i`.
cv::Matx23d gridFromPicture(const ViewMapping& mapping, const Eigen::Vector2d& first, double step)
{
  const Eigen::Vector2d origin = (mapping.toPixel({ 0.5, 0.5 }) - first) / step;
  const double scale = 1.0 / (mapping.scale * step);
  return { scale, 0.0, origin.x(), 0.0, scale, origin.y() };
}

/// Of the radiograph as the picture shows it, still in pixel values.
cv::Mat seenPixels(cv::Mat pixels, const PictureRequest& request)
{
  double step = 1.0;
  while (request.mapping.scale * step <= 0.5 && std::min(pixels.rows, pixels.cols) > 1)
  {
    // warpAffine takes the nearest pixels alone, and would show their noise.
    cv::Mat half;
    cv::resize(pixels(cv::Rect(0, 0, pixels.cols & ~1, pixels.rows & ~1)), half, cv::Size(), 0.5, 0.5, cv::INTER_AREA);
    pixels = half;
    step *= 2.0;
  }
  const Eigen::Vector2d first = Eigen::Vector2d::Constant(0.5 * (step - 1.0));
  cv::Mat seen;
  cv::warpAffine(pixels, seen, gridFromPicture(request.mapping, first, step), request.size,
                 cv::WARP_INVERSE_MAP | (request.mapping.scale >= kMagnified ? cv::INTER_NEAREST : cv::INTER_LINEAR),
                 cv::BORDER_REPLICATE);
  return seen;
}

/// The part of the picture that the image covers.
cv::Rect coveredPart(const PictureRequest& request, const cv::Size& image)
{
  const Eigen::Vector2d low = request.mapping.toWidget({ -0.5, -0.5 });
  const Eigen::Vector2d high = request.mapping.toWidget({ image.width - 0.5, image.height - 0.5 });
  const auto within = [](double value, int size)
  { return static_cast<int>(std::lround(std::clamp(value, 0.0, static_cast<double>(size)))); };
  return { cv::Point(within(low.x(), request.size.width), within(low.y(), request.size.height)),
           cv::Point(within(high.x(), request.size.width), within(high.y(), request.size.height)) };
}

/// The rendering as grey as the radiograph would be: 8 bit, dark bone or bright; `seen` is where it has a value at all.
cv::Mat greyRendering(const PictureRequest& request, cv::Mat& seen)
{
  const Rendering& rendering = *request.rendering;
  const auto grid = gridFromPicture(request.mapping, rendering.first, rendering.step);
  cv::Mat integrals;
  // Beyond its border as at it, so that the border is no edge.
  cv::warpAffine(rendering.line_integrals, integrals, grid, request.size, cv::WARP_INVERSE_MAP | cv::INTER_LINEAR,
                 cv::BORDER_REPLICATE);
  // Over all of the rendering, so that it does not change with the zoom.
  std::vector<float> values;
  for (int row = 0; row < rendering.line_integrals.rows; row += 2)
  {
    const float* from = rendering.line_integrals.ptr<float>(row);
    std::copy_if(from, from + rendering.line_integrals.cols, std::back_inserter(values),
                 [](float value) { return value > 0.0F; });
  }
  double low = 0.0, high = 1.0;
  if (!values.empty())
  {
    std::sort(values.begin(), values.end());
    low = values[values.size() / 50];
    high = std::max<double>(values[values.size() - 1 - values.size() / 200], low + 1e-6);
  }
  const bool dark = request.counts != request.inverted;
  const double scale = (dark ? -255.0 : 255.0) / (high - low);
  cv::Mat grey;
  integrals.convertTo(grey, CV_8U, scale, (dark ? 255.0 : 0.0) - scale * low);
  seen = integrals > 0.0F;
  return grey;
}
}  // namespace

cv::Mat PictureMaker::overlaid(const PictureRequest& request, const cv::Mat& grey) const
{
  cv::Mat seen;
  cv::Mat rendering = greyRendering(request, seen);
  cv::Mat result;
  switch (request.overlay)
  {
    case Overlay::BLEND:
      cv::addWeighted(grey, 1.0 - request.share, rendering, request.share, 0.0, result);
      break;
    case Overlay::CHECKERBOARD:
      result = grey.clone();
      for (int y = 0; y < result.rows; y += kSquare)
      {
        for (int x = 0; x < result.cols; x += kSquare)
        {
          if ((x / kSquare + y / kSquare) % 2 == 1)
          {
            const cv::Rect square = cv::Rect(x, y, kSquare, kSquare) & cv::Rect(cv::Point(), result.size());
            rendering(square).copyTo(result(square));
          }
        }
      }
      break;
    case Overlay::DIFFERENCE:
    {
      cv::Scalar mean, deviation, rendered_mean, rendered_deviation;
      cv::meanStdDev(grey, mean, deviation, seen);
      cv::meanStdDev(rendering, rendered_mean, rendered_deviation, seen);
      const double contrast = deviation[0] / std::max(rendered_deviation[0], 1.0);
      cv::addWeighted(grey, 1.0, rendering, -contrast, 128.0 - mean[0] + contrast * rendered_mean[0], result);
      result.setTo(128, ~seen);
      break;
    }
    default:
      result = grey;
      break;
  }
  cv::Mat colours;
  cv::cvtColor(result, colours, cv::COLOR_GRAY2BGRA);
  if (request.overlay == Overlay::EDGES)
  {
    cv::Mat edges;
    cv::GaussianBlur(rendering, rendering, cv::Size(), 2.0);
    cv::Canny(rendering, edges, 12, 36);
    const double share = std::clamp(2.0 * request.share, 0.0, 1.0);
    for (int row = 0; row < edges.rows; ++row)
    {
      const std::uint8_t* edge = edges.ptr<std::uint8_t>(row);
      cv::Vec4b* to = colours.ptr<cv::Vec4b>(row);
      for (int column = 0; column < edges.cols; ++column)
      {
        for (int channel = 0; edge[column] != 0 && channel < 3; ++channel)
        {
          to[column][channel] =
              cv::saturate_cast<std::uint8_t>((1.0 - share) * to[column][channel] + share * kEdgeColour[channel]);
        }
      }
    }
  }
  return colours;
}

Picture PictureMaker::make(const PictureRequest& request)
{
  Picture picture;
  picture.request = request;
  if (!request.image || request.size.width < 1 || request.size.height < 1)
  {
    picture.fault = "no image so far";
    return picture;
  }
  try
  {
    picture.pixels = pixelsOf(request.image);
    if (last_ != request.image || last_window_.logarithmic != request.counts)
    {
      last_ = request.image;
      last_window_ = follower_.follow(automaticWindow(picture.pixels, request.counts));
      cv::minMaxLoc(picture.pixels, nullptr, &last_largest_);
    }
    picture.largest = last_largest_;
    picture.window = request.automatic ? last_window_ : request.window;
    picture.window.logarithmic = request.counts;
    cv::Mat grey;
    scale_.convert(seenPixels(picture.pixels, request), picture.window, request.inverted, grey);
    if (request.overlay != Overlay::NONE && request.rendering)
    {
      picture.colours = overlaid(request, grey);
    }
    else
    {
      cv::cvtColor(grey, picture.colours, cv::COLOR_GRAY2BGRA);
    }
    const cv::Rect covered = coveredPart(request, picture.pixels.size());
    const cv::Size& size = request.size;
    for (const cv::Rect& bare :
         { cv::Rect(0, 0, size.width, covered.y), cv::Rect(cv::Point(0, covered.br().y), cv::Point(size)),
           cv::Rect(0, 0, covered.x, size.height), cv::Rect(cv::Point(covered.br().x, 0), cv::Point(size)) })
    {
      picture.colours(bare).setTo(kBackground);
    }
  }
  catch (const std::exception& error)
  {
    picture.fault = error.what();
    picture.colours.release();
  }
  return picture;
}
}  // namespace xray_tracking
