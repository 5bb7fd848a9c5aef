#include "pixel_rows.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
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

/// One running mean over `count` groups of `Rows` rows; take(group, k, mean) gets those of the k-th row. Before and
/// after `from` lie reach + 1 groups of zeros.
template <int Rows, typename Take>
INLINE void run(const float* __restrict from, int count, const Box& box, const Take& take)
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
  for (int n = 0; n < count; ++n, leaves += kSize, enters += kSize)
  {
    for (int k = 0; k < Rows; ++k)
    {
      const int at = k * kPixelRow;
      sum[k] += load(enters + at);
      take(n, k, box.weight * sum[k] + box.edge * (load(leaves + at) + load(enters + kSize + at)));
      sum[k] -= load(leaves + kSize + at);
    }
  }
}

/// All passes over `count` groups. `fill` writes them to where it is told, `take` gets the result as run()'s does.
/// @param buffers of count + 2 * reach + 2 groups each
template <int Rows, typename Fill, typename Take>
INLINE void runAll(float* first, float* second, int count, const Box& box, const Fill& fill, const Take& take)
{
  constexpr int kSize = Rows * kPixelRow;
  const int begin = (box.reach + 1) * kSize;
  const int end = begin + count * kSize;
  for (float* buffer : { first, second })
  {
    std::fill_n(buffer, begin, 0.0f);
    std::fill_n(buffer + end, begin, 0.0f);
  }
  first += begin;
  second += begin;
  const auto to = [](float* buffer)
  { return [buffer](int n, int k, const Row& row) { store(row, buffer + n * kSize + k * kPixelRow); }; };
  fill(first);
  static_assert(kPasses == 3, "as many as there are here");
  run<Rows>(first, count, box, to(second));
  run<Rows>(second, count, box, to(first));
  run<Rows>(first, count, box, take);
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
        [&](int row, int k, const Row& mean)
        {
          float* to = image + row * width + column + k * kPixelRow;
          if ((k + 1) * kPixelRow <= columns)
          {
            store(mean, to);
          }
          else
          {
            for (int n = 0; n < columns - k * kPixelRow; ++n)
            {
              to[n] = mean[n];
            }
          }
        });
  }
}

/// Along the rows of an image: as many rows at once as a pixel has numbers.
INLINE void blurAlong(float* image, int width, int height, const Box& box, float* first, float* second)
{
  for (int row = 0; row < height; row += kPixelRow)
  {
    const int rows = std::min(kPixelRow, height - row);
    float* band = image + row * width;
    float* means = second + (box.reach + 1) * kPixelRow;
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
        [&](int column, int, const Row& mean) { store(mean, means + column * kPixelRow); });
    for (int n = 0; n < rows; ++n)
    {
      for (int column = 0; column < width; ++column)
      {
        band[n * width + column] = means[column * kPixelRow + n];
      }
    }
  }
}

FOR_SEVERAL_PROCESSORS void blurOne(float* image, int width, int height, Box box, float* first, float* second)
{
  blurAlong(image, width, height, box, first, second);
  blurDown(image, width, height, box, first, second);
}

/// A part of an image [pixels].
struct Part
{
  int x;
  int y;
  int width;
  int height;
};

/// @param along for what is between both directions: of the inner part's width and the image's height
FOR_SEVERAL_PROCESSORS void subtractMeans(const float* rows, int width, int height, Box box, const float* factors,
                                          Part inner, float* along, float* first, float* second, float* result)
{
  constexpr int kColumns = kStrip / kPixelRow;
  for (int row = 0; row < height; ++row)
  {
    runAll<1>(
        first, second, width, box,
        [&](float* to) { std::copy_n(rows + row * width * kPixelRow, width * kPixelRow, to); },
        [&](int column, int, const Row& mean)
        {
          if (column >= inner.x && column < inner.x + inner.width)
          {
            store(mean, along + (row * inner.width + column - inner.x) * kPixelRow);
          }
        });
  }
  for (int strip = 0; strip < inner.width; strip += kColumns)
  {
    // The last one has columns of the one before.
    const int column = std::min(strip, inner.width - kColumns);
    runAll<kColumns>(
        first, second, height, box,
        [&](float* to)
        {
          for (int row = 0; row < height; ++row)
          {
            for (int k = 0; k < kColumns; ++k)
            {
              store(load(along + (row * inner.width + column + k) * kPixelRow), to + (row * kColumns + k) * kPixelRow);
            }
          }
        },
        [&](int row, int k, const Row& mean)
        {
          if (row >= inner.y && row < inner.y + inner.height)
          {
            const int at = row * width + inner.x + column + k;
            store(load(rows + at * kPixelRow) - factors[at] * mean,
                  result + ((row - inner.y) * inner.width + column + k) * kPixelRow);
          }
        });
  }
}

/// Six numbers and two of the next pixel's.
using Twists = float __attribute__((vector_size(8 * sizeof(float))));

INLINE void makeRow(const RowParts& parts, int n, const float* twists, const float* other_twists, float* row)
{
  constexpr Row kZeros = {};
  const float factor = parts.factors[n] * parts.counts[n];
  store(kZeros, row);
  Twists six;
  __builtin_memcpy(&six, twists, sizeof(six));
  six *= factor;
  __builtin_memcpy(row, &six, sizeof(six));
  int last = 6;
  if (other_twists != nullptr)
  {
    __builtin_memcpy(&six, other_twists, sizeof(six));
    six *= factor;
    __builtin_memcpy(row + last, &six, sizeof(six));
    last += 6;
  }
  row[last] = parts.by_saturation[n] * parts.counts[n];
  row[last + 1] = 0.0f;
  row[kPixelRow - 1] = parts.image[n] * parts.counts[n];
}

FOR_SEVERAL_PROCESSORS void make(const RowParts& parts, int count, float* rows)
{
  const bool both = parts.other_twists != nullptr;
  for (int n = 0; n + 1 < count; ++n)
  {
    makeRow(parts, n, parts.twists + 6 * n, both ? parts.other_twists + 6 * n : nullptr, rows + n * kPixelRow);
  }
  // Behind the last pixel there is nothing to be read.
  float twists[8] = {};
  float other_twists[8] = {};
  std::copy_n(parts.twists + 6 * (count - 1), 6, twists);
  if (both)
  {
    std::copy_n(parts.other_twists + 6 * (count - 1), 6, other_twists);
  }
  makeRow(parts, count - 1, twists, both ? other_twists : nullptr, rows + (count - 1) * kPixelRow);
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

PixelRows RunningBlur::withoutMeans(const PixelRows& rows, const cv::Size& size, const cv::Mat& factors,
                                    const cv::Rect& inner) const
{
  const std::size_t buffer = bufferSize(size.width, size.height);
  const std::size_t along = static_cast<std::size_t>(inner.width * size.height) * kPixelRow;
  const std::unique_ptr<float[]> buffers(new float[2 * buffer + along]);  // of no value until written to
  PixelRows result(inner.area(), kPixelRow);
  pixel_rows::subtractMeans(rows.data(), size.width, size.height, { reach_, edge_, weight_ }, factors.ptr<float>(),
                            { inner.x, inner.y, inner.width, inner.height }, buffers.get() + 2 * buffer, buffers.get(),
                            buffers.get() + buffer, result.data());
  return result;
}

PixelRows makeRows(const RowParts& parts, int count)
{
  PixelRows rows(count, kPixelRow);
  pixel_rows::make(parts, count, rows.data());
  return rows;
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
