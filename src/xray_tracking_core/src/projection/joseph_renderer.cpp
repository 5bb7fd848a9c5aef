#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include "xray_tracking_core/projection/drr_renderer.h"

namespace xray_tracking
{
namespace
{
/// Neighbouring rows cross the same voxels, so a task takes a few of them.
constexpr int kRowsPerTask = 8;

/// A coordinate across the main axis [voxel], linear in the number of the plane that is crossed.
struct Crossing
{
  double at_plane_zero;
  double slope;

  double operator()(int plane) const { return at_plane_zero + slope * plane; }
};

/// Planes first to last, both included.
struct PlaneRange
{
  int first;
  int last;

  bool empty() const { return last < first; }

  /// Keeps the planes in which `crossing` lies in [lowest, highest].
  PlaneRange where(const Crossing& crossing, double lowest, double highest) const
  {
    if (lowest > highest)
    {
      return { first, first - 1 };
    }
    constexpr double kNegligible = 1e-12;
    if (std::abs(crossing.slope) < kNegligible)
    {
      const bool inside = crossing.at_plane_zero >= lowest && crossing.at_plane_zero <= highest;
      return inside ? *this : PlaneRange{ first, first - 1 };
    }
    double from = (lowest - crossing.at_plane_zero) / crossing.slope;
    double to = (highest - crossing.at_plane_zero) / crossing.slope;
    if (from > to)
    {
      std::swap(from, to);
    }
    return between(from, to);
  }

  /// Keeps the planes whose number lies in [from, to].
  PlaneRange between(double from, double to) const
  {
    // Clamped before the conversion, which is undefined for numbers that no int can hold.
    return { static_cast<int>(std::ceil(std::clamp<double>(from, first, last + 1.0))),
             static_cast<int>(std::floor(std::clamp<double>(to, first - 1.0, last))) };
  }
};

class JosephRenderer final : public DrrRenderer
{
public:
  explicit JosephRenderer(std::shared_ptr<const ScalarVolume> volume) : volume_(std::move(volume))
  {
    if (!volume_ || volume_->grid.size.minCoeff() < 1 || volume_->values.size() != volume_->grid.voxelCount())
    {
      throw std::invalid_argument("DRR renderer: the volume is missing, empty or not of its grid's size");
    }
    const VolumeGrid& grid = volume_->grid;
    index_from_patient_ = grid.patient_from_index.inverse();
    if (!index_from_patient_.matrix().allFinite())
    {
      throw std::invalid_argument("DRR renderer: the volume's axes do not span space");
    }
    strides_ = { 1, grid.size.x(), static_cast<std::ptrdiff_t>(grid.size.x()) * grid.size.y() };
  }

  void render(const ProjectionGeometry& geometry, const RigidTransform& room_from_patient,
              cv::Mat& line_integrals) const override
  {
    if (!isRigid(room_from_patient))
    {
      throw std::invalid_argument("DRR renderer: room_from_patient is not a finite rigid transform");
    }
    const Eigen::Affine3d index_from_room = index_from_patient_ * room_from_patient.inverse();
    const Eigen::Vector3d source = index_from_room * geometry.source();
    const Eigen::Vector3d to_first_pixel = geometry.origin() - geometry.source();
    const Eigen::Vector3d column_step = geometry.pixelPitch().x() * geometry.xDirection();
    const Eigen::Vector3d row_step = geometry.pixelPitch().y() * geometry.yDirection();

    line_integrals.create(geometry.imageSize().y(), geometry.imageSize().x(), CV_32FC1);
    tbb::parallel_for(tbb::blocked_range<int>(0, line_integrals.rows, kRowsPerTask),
                      [&](const tbb::blocked_range<int>& rows)
                      {
                        for (int v = rows.begin(); v != rows.end(); ++v)
                        {
                          float* row = line_integrals.ptr<float>(v);
                          for (int u = 0; u < line_integrals.cols; ++u)
                          {
                            const Eigen::Vector3d ray = to_first_pixel + u * column_step + v * row_step;
                            row[u] = integrate(source, index_from_room.linear() * ray, ray.norm());
                          }
                        }
                      });
  }

private:
  /// @param source, ray [voxel]; @param length the ray's length [mm]
  float integrate(const Eigen::Vector3d& source, const Eigen::Vector3d& ray, double length) const
  {
    // Along the axis on which the ray advances most in voxels, so that one step never passes over a voxel.
    int main = 0;
    ray.cwiseAbs().maxCoeff(&main);
    const int axis_a = (main + 1) % 3;
    const int axis_b = (main + 2) % 3;
    const auto crossing = [&](int axis)
    {
      const double slope = ray[axis] / ray[main];
      return Crossing{ source[axis] - source[main] * slope, slope };
    };
    const Crossing a = crossing(axis_a);
    const Crossing b = crossing(axis_b);
    const double last_a = volume_->grid.size[axis_a] - 1.0;
    const double last_b = volume_->grid.size[axis_b] - 1.0;

    PlaneRange planes{ 0, volume_->grid.size[main] - 1 };
    planes = ray[main] > 0.0 ? planes.between(source[main], planes.last) : planes.between(0, source[main]);
    // Up to one voxel outside, where the interpolated value has fallen to zero.
    planes = planes.where(a, -1.0, last_a + 1.0).where(b, -1.0, last_b + 1.0);
    if (planes.empty())
    {
      return 0.0f;
    }
    // Where all four neighbours exist, whatever the rounding to float.
    constexpr double kMargin = 1e-3;
    const PlaneRange inner = planes.where(a, kMargin, last_a - kMargin).where(b, kMargin, last_b - kMargin);

    float sum;
    if (inner.empty())
    {
      sum = sumAtBorder(main, a, b, planes);
    }
    else
    {
      sum = sumAtBorder(main, a, b, { planes.first, inner.first - 1 }) + sumInside(main, a, b, inner) +
            sumAtBorder(main, a, b, { inner.last + 1, planes.last });
    }
    return sum * static_cast<float>(length / std::abs(ray[main]));
  }

  float sumInside(int main, const Crossing& a, const Crossing& b, const PlaneRange& planes) const
  {
    const std::ptrdiff_t stride = strides_[main];
    const std::ptrdiff_t stride_a = strides_[(main + 1) % 3];
    const std::ptrdiff_t stride_b = strides_[(main + 2) % 3];
    const float first_a = static_cast<float>(a(planes.first));
    const float first_b = static_cast<float>(b(planes.first));
    const float slope_a = static_cast<float>(a.slope);
    const float slope_b = static_cast<float>(b.slope);
    const float* plane = volume_->values.data() + planes.first * stride;
    const int count = planes.last - planes.first + 1;

    float sum = 0.0f;
    for (int n = 0; n < count; ++n, plane += stride)
    {
      const float at_a = first_a + static_cast<float>(n) * slope_a;
      const float at_b = first_b + static_cast<float>(n) * slope_b;
      const int low_a = static_cast<int>(at_a);
      const int low_b = static_cast<int>(at_b);
      const float share_a = at_a - static_cast<float>(low_a);
      const float share_b = at_b - static_cast<float>(low_b);
      const float* voxel = plane + low_a * stride_a + low_b * stride_b;
      const float below = voxel[0] + share_b * (voxel[stride_b] - voxel[0]);
      const float above = voxel[stride_a] + share_b * (voxel[stride_a + stride_b] - voxel[stride_a]);
      sum += below + share_a * (above - below);
    }
    return sum;
  }

  /// The same where neighbours may lie outside the grid and count as zero.
  float sumAtBorder(int main, const Crossing& a, const Crossing& b, const PlaneRange& planes) const
  {
    const int size_a = volume_->grid.size[(main + 1) % 3];
    const int size_b = volume_->grid.size[(main + 2) % 3];
    const std::ptrdiff_t stride_a = strides_[(main + 1) % 3];
    const std::ptrdiff_t stride_b = strides_[(main + 2) % 3];

    double sum = 0.0;
    for (int plane = planes.first; plane <= planes.last; ++plane)
    {
      const int low_a = static_cast<int>(std::floor(a(plane)));
      const int low_b = static_cast<int>(std::floor(b(plane)));
      const float* voxels = volume_->values.data() + plane * strides_[main];
      for (int n_a = std::max(low_a, 0); n_a <= std::min(low_a + 1, size_a - 1); ++n_a)
      {
        for (int n_b = std::max(low_b, 0); n_b <= std::min(low_b + 1, size_b - 1); ++n_b)
        {
          sum += (1.0 - std::abs(a(plane) - n_a)) * (1.0 - std::abs(b(plane) - n_b)) *
                 voxels[n_a * stride_a + n_b * stride_b];
        }
      }
    }
    return static_cast<float>(sum);
  }

  std::shared_ptr<const ScalarVolume> volume_;
  Eigen::Affine3d index_from_patient_;
  std::array<std::ptrdiff_t, 3> strides_;  ///< between neighbours along i, j, k [values]
};
}  // namespace

std::unique_ptr<DrrRenderer> makeJosephRenderer(std::shared_ptr<const ScalarVolume> volume)
{
  return std::make_unique<JosephRenderer>(std::move(volume));
}
}  // namespace xray_tracking
