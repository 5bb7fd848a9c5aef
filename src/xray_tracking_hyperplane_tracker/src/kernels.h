#pragma once

#include <cstddef>
#include <cstdint>

namespace xray_tracking
{
/// Loops over template points, in the processor's widest instructions (chosen when the program runs).

/// Affine map of template points to image coordinates: x' = xx x + xy y + x0, y' = yx x + yy y + y0.
struct PixelMap
{
  float xx, xy, x0, yx, yy, y0;
};

/// Bilinear samples of a 16-bit image at mapped points, none of which may lie outside it or on its last row or column.
/// @param pixels of the image's first row; @param row_length distance of rows [pixels]
void sampleBilinear(const std::uint16_t* pixels, std::size_t row_length, const float* x, const float* y,
                    std::ptrdiff_t count, const PixelMap& map, float* values);

/// Samples by the cubic B-spline's kernel: values of the image blurred by it, by as much wherever the points lie
/// between the pixels. (Bilinear samples are blurred by what depends on that, which moves what is measured by them.)
/// Points have to be a pixel farther from the border than for bilinear samples.
void sampleSpline(const std::uint16_t* pixels, std::size_t row_length, const float* x, const float* y,
                  std::ptrdiff_t count, const PixelMap& map, float* values);

/// Weights of the pixels from one left of the place to two right of it. @param part of a pixel from the second one,
/// 0..1
void splineWeights(float part, float* weights);

/// values = -log(max(values - offset, 1)), relative error below 1e-6.
void attenuate(float* values, std::ptrdiff_t count, float offset);

/// sum a_i b_i
float dot(const float* a, const float* b, std::ptrdiff_t count);

/// The same of each of a number of columns that lie one after the other, `count` values in one.
void dots(const float* columns, std::ptrdiff_t number, const float* b, std::ptrdiff_t count, float* sums);
}  // namespace xray_tracking
