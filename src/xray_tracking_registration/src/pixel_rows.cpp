#include "pixel_rows.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "xray_tracking_core/several_processors.h"

#define INLINE inline __attribute__((always_inline))
// How vectors would be passed to functions that are not inlined: here all are.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace xray_tracking
{
namespace pixel_rows
{
constexpr int kPasses = 3;
constexpr int kStrip = 64;            // columns that are blurred together
constexpr Eigen::Index kChunk = 256;  // pixels that are summed in single precision

/// Weights of a running mean.
struct Box
{
  int reach;
  float edge;
  float weight;
};

/// A pixel's numbers in registers, however many of them the processor needs.
using Row = float __attribute__((vector_size(kPixelRow * sizeof(float))));

INLINE Row load(const float* from)
{
  Row row;
  __builtin_memcpy(&row, from, sizeof(row));
  return row;
}

INLINE void store(const Row& row, float* to)
{
  __builtin_memcpy(to, &row, sizeof(row));
}

/// One running mean over `count` groups of `Rows` rows. Before and after `from` lie reach + 1 groups of zeros.
template <int Rows>
INLINE void run(const float* __restrict from, int count, const Box& box, float* __restrict to)
{
  constexpr int kSize = Rows * kPixelRow;
  Row sum[Rows] = {};
  for (int n = -box.reach; n < box.reach; ++n)
  {
    for (int k = 0; k < Rows; ++k)
    {
      sum[k] += load(from + n * kSize + k * kPixelRow);
    }
  }
  const float* leaves = from - (box.reach + 1) * kSize;
  const float* enters = from + box.reach * kSize;
  for (int n = 0; n < count; ++n, leaves += kSize, enters += kSize, to += kSize)
  {
    for (int k = 0; k < Rows; ++k)
    {
      const int at = k * kPixelRow;
      sum[k] += load(enters + at);
      store(box.weight * sum[k] + box.edge * (load(leaves + at) + load(enters + kSize + at)), to + at);
      sum[k] -= load(leaves + kSize + at);
    }
  }
}

/// All passes over `count` groups. `fill` writes them to where it is told, `take` reads the result from where it is
/// told. @param buffers of count + 2 * reach + 2 groups each
template <int Rows, typename Fill, typename Take>
INLINE void runAll(float* first, float* second, int count, const Box& box, const Fill& fill, const Take& take)
{
  const int begin = (box.reach + 1) * Rows * kPixelRow;
  const int end = begin + count * Rows * kPixelRow;
  for (float* buffer : { first, second })
  {
    std::fill_n(buffer, begin, 0.0f);
    std::fill_n(buffer + end, begin, 0.0f);
  }
  fill(first + begin);
  static_assert(kPasses == 3, "the result is in the second buffer");
  run<Rows>(first + begin, count, box, second + begin);
  run<Rows>(second + begin, count, box, first + begin);
  run<Rows>(first + begin, count, box, second + begin);
  take(second + begin);
}

/// Down the columns of an image.
INLINE void blurDown(float* image, int width, int height, const Box& box, float* first, float* second)
{
  for (int column = 0; column < width; column += kStrip)
  {
    const int columns = std::min(kStrip, width - column);
    runAll<kStrip / kPixelRow>(
        first, second, height, box,
        [&](float* to)
        {
          for (int row = 0; row < height; ++row)
          {
            std::copy_n(image + row * width + column, columns, to + row * kStrip);
          }
        },
        [&](const float* from)
        {
          for (int row = 0; row < height; ++row)
          {
            std::copy_n(from + row * kStrip, columns, image + row * width + column);
          }
        });
  }
}

/// Along the rows of an image of single numbers: as many rows at once as a pixel has numbers.
INLINE void blurAlong(float* image, int width, int height, const Box& box, float* first, float* second)
{
  for (int row = 0; row < height; row += kPixelRow)
  {
    const int rows = std::min(kPixelRow, height - row);
    float* band = image + row * width;
    runAll<1>(
        first, second, width, box,
        [&](float* to)
        {
          for (int n = 0; n < rows; ++n)
          {
            for (int column = 0; column < width; ++column)
            {
              to[column * kPixelRow + n] = band[n * width + column];
            }
          }
        },
        [&](const float* from)
        {
          for (int n = 0; n < rows; ++n)
          {
            for (int column = 0; column < width; ++column)
            {
              band[n * width + column] = from[column * kPixelRow + n];
            }
          }
        });
  }
}

FOR_SEVERAL_PROCESSORS void blurOne(float* image, int width, int height, Box box, float* first, float* second)
{
  blurAlong(image, width, height, box, first, second);
  blurDown(image, width, height, box, first, second);
}

FOR_SEVERAL_PROCESSORS void blurRows(float* image, int width, int height, Box box, float* first, float* second)
{
  const int length = width * kPixelRow;
  for (int row = 0; row < height; ++row)
  {
    runAll<1>(
        first, second, width, box, [&](float* to) { std::copy_n(image + row * length, length, to); },
        [&](const float* from) { std::copy_n(from, length, image + row * length); });
  }
  blurDown(image, length, height, box, first, second);
}

FOR_SEVERAL_PROCESSORS void subtract(const float* rows, const float* means, const float* factors, int count, float* to)
{
  for (int n = 0; n < count; ++n)
  {
    const int at = n * kPixelRow;
    store(load(rows + at) - factors[n] * load(means + at), to + at);
  }
}

/// Sums of the rows, and of the rows times the image.
FOR_SEVERAL_PROCESSORS void sums(const float* rows, const float* image, int count, float* of_rows, float* of_products)
{
  Row plain = {};
  Row products = {};
  for (int n = 0; n < count; ++n)
  {
    const Row row = load(rows + n * kPixelRow);
    plain += row;
    products += row * image[n];
  }
  store(plain, of_rows);
  store(products, of_products);
}

FOR_SEVERAL_PROCESSORS void project(float* rows, const float* image, const float* valid, int count, const float* mean,
                                    const float* along, float scale)
{
  const Row means = load(mean);
  const Row projections = load(along);
  for (int n = 0; n < count; ++n, rows += kPixelRow)
  {
    store(scale * (load(rows) - valid[n] * means - image[n] * projections), rows);
  }
}

FOR_SEVERAL_PROCESSORS void square(const float* rows, const float* weights, const float* differences, int count,
                                   float* squares, float* products)
{
  Row sum[kPixelRow] = {};
  Row product = {};
  for (int n = 0; n < count; ++n, rows += kPixelRow)
  {
    const Row row = load(rows);
    const Row weighed = weights[n] * row;
    product += differences[n] * weighed;
    for (int m = 0; m < kPixelRow; ++m)
    {
      sum[m] += rows[m] * weighed;
    }
  }
  for (int m = 0; m < kPixelRow; ++m)
  {
    store(sum[m], squares + m * kPixelRow);
  }
  store(product, products);
}
}  // namespace pixel_rows

RunningBlur::RunningBlur(double sigma)
{
  const double variance = sigma * sigma / pixel_rows::kPasses;
  reach_ = static_cast<int>(std::floor(0.5 * std::sqrt(12.0 * variance + 1.0) - 0.5));
  const double width = 2.0 * reach_ + 1.0;
  const double edge =
      width * (reach_ * (reach_ + 1.0) - 3.0 * variance) / (6.0 * (variance - (reach_ + 1.0) * (reach_ + 1.0)));
  weight_ = static_cast<float>(1.0 / (width + 2.0 * edge));
  edge_ = static_cast<float>(edge) * weight_;
}

std::size_t RunningBlur::bufferSize(int width, int height) const
{
  const int ends = 2 * reach_ + 2;
  return std::max((width + ends) * kPixelRow, (height + ends) * pixel_rows::kStrip);
}

void RunningBlur::operator()(cv::Mat& image) const
{
  const std::size_t size = bufferSize(image.cols, image.rows);
  std::vector<float> buffers(2 * size);
  pixel_rows::blurOne(image.ptr<float>(), image.cols, image.rows, { reach_, edge_, weight_ }, buffers.data(),
                      buffers.data() + size);
}

void RunningBlur::operator()(PixelRows& rows, const cv::Size& image) const
{
  const std::size_t size = bufferSize(image.width, image.height);
  std::vector<float> buffers(2 * size);
  pixel_rows::blurRows(rows.data(), image.width, image.height, { reach_, edge_, weight_ }, buffers.data(),
                       buffers.data() + size);
}

PixelRows withoutMeans(const PixelRows& rows, const PixelRows& means, const cv::Mat& factors, const cv::Rect& inner)
{
  PixelRows result(inner.area(), kPixelRow);
  for (int row = 0; row < inner.height; ++row)
  {
    const Eigen::Index first = static_cast<Eigen::Index>(inner.y + row) * factors.cols + inner.x;
    pixel_rows::subtract(rows.row(first).data(), means.row(first).data(), factors.ptr<float>(inner.y + row) + inner.x,
                         inner.width, result.row(row * inner.width).data());
  }
  return result;
}

void projectOut(const Eigen::VectorXf& image, const Eigen::VectorXf& valid, float scale, PixelRows& rows)
{
  Eigen::Array<float, kPixelRow, 1> mean;
  Eigen::Array<float, kPixelRow, 1> along;
  const auto count = static_cast<int>(rows.rows());
  pixel_rows::sums(rows.data(), image.data(), count, mean.data(), along.data());
  mean /= valid.sum();
  pixel_rows::project(rows.data(), image.data(), valid.data(), count, mean.data(), along.data(), scale);
}

WeighedSums weighedSums(const PixelRows& rows, const Eigen::VectorXf& weights, const Eigen::VectorXf& differences)
{
  WeighedSums sums;
  Eigen::Matrix<float, kPixelRow, kPixelRow> squares;
  Eigen::Matrix<float, kPixelRow, 1> products;
  for (Eigen::Index first = 0; first < rows.rows(); first += pixel_rows::kChunk)
  {
    const auto count = static_cast<int>(std::min(pixel_rows::kChunk, rows.rows() - first));
    pixel_rows::square(rows.row(first).data(), weights.data() + first, differences.data() + first, count,
                       squares.data(), products.data());
    sums.squares += squares.cast<double>();
    sums.products += products.cast<double>();
  }
  return sums;
}
}  // namespace xray_tracking
