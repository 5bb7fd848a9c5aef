#include "xray_tracking_core/projection/shear_warp_renderer.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>
#include <vector>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include "shear_warp_kernel.h"
#include "shear_warp_view.h"
#include "shear_warp_volume.h"

namespace xray_tracking
{
namespace
{
using namespace shear_warp;

/// Rows of points that a task warps.
constexpr int kWarpRowsPerTask = 8;
/// Rays must run by at least this share of the central ray's advance along its main axis; else the grid is divided.
constexpr double kMinAdvance = 0.25;

const Kernels& kernelsFor(SimdLevel level)
{
  if (level > bestSimdLevel())
  {
    throw std::invalid_argument("DRR renderer: the processor lacks the vector instructions asked for");
  }
#ifdef __x86_64__
  if (level == SimdLevel::AVX512)
  {
    return kAvx512Kernels;
  }
  if (level == SimdLevel::AVX2)
  {
    return kAvx2Kernels;
  }
#endif
  return kGenericKernels;
}

/// Where the image goes.
struct Output
{
  cv::Mat line_integrals;
  cv::Mat derivatives;  ///< empty if not wanted
  Eigen::Vector3d room_centre;

  Output part(int axis, int first, int count) const
  {
    const auto cut = [&](const cv::Mat& image)
    {
      return image.empty() ? image
                           : (axis == 0 ? image.colRange(first, first + count) : image.rowRange(first, first + count));
    };
    return { cut(line_integrals), cut(derivatives), room_centre };
  }

  void setZero()
  {
    line_integrals.setTo(0.0f);
    for (int row = 0; row < derivatives.rows; ++row)
    {
      std::fill_n(derivatives.ptr<float>(row), derivatives.cols * derivatives.channels(), 0.0f);
    }
  }
};

/// Buffers of the calling thread, kept for its next rendering.
struct Workspace
{
  std::vector<float> sum;
  std::vector<float> moment;
  std::vector<float> filtered_sum;
  std::vector<float> filtered_moment;
  std::vector<SliceView> views;
  std::vector<FilterTap> taps;
};
}  // namespace

class ShearWarpRenderer::Implementation
{
public:
  Implementation(const ScalarVolume& volume, SimdLevel level) : kernels_(kernelsFor(level)), volume_(volume) {}

  std::size_t memory() const { return volume_.memory(); }

  void render(const ProjectionGeometry& geometry, const PixelGrid& pixels, const RigidTransform& room_from_patient,
              Output output) const
  {
    if (volume_.empty())
    {
      output.setZero();
      return;
    }
    // Without isolation a thread that waits for its rendering could start another one, in the same workspace.
    tbb::this_task_arena::isolate(
        [&]
        {
          renderBundle(RayBundle(geometry, pixels), volume_.indexFromPatient() * room_from_patient.inverse(),
                       std::move(output));
        });
  }

private:
  void renderBundle(const RayBundle& rays, const Eigen::Affine3d& index_from_room, Output output) const
  {
    const Eigen::Vector3d central = index_from_room.linear() * rays.direction(0.5 * rays.last());
    int main = 0;
    const double advance = central.cwiseAbs().maxCoeff(&main);
    bool narrow = true;
    rays.forCorners(
        [&](const Eigen::Vector3d& ray)
        {
          const double along = index_from_room.linear().row(main).dot(ray) * (central[main] > 0.0 ? 1.0 : -1.0);
          narrow = narrow && along > kMinAdvance * advance;
        });
    if (narrow)
    {
      renderNarrow(rays, index_from_room, main, output);
      return;
    }
    const int axis = rays.size.x() >= rays.size.y() ? 0 : 1;
    const int half = rays.size[axis] / 2;
    const int rest = rays.size[axis] - half;
    renderBundle(rays.part(axis, 0, half), index_from_room, output.part(axis, 0, half));
    renderBundle(rays.part(axis, half, rest), index_from_room, output.part(axis, half, rest));
  }

  void renderNarrow(const RayBundle& rays, const Eigen::Affine3d& index_from_room, int main, Output& output) const
  {
    const StackedVolume::Axes axes = StackedVolume::axes(main);
    const BundleView view(rays, index_from_room, { axes.column, axes.row, axes.main }, volume_.size());
    if (view.empty)
    {
      output.setZero();
      return;
    }
    const auto round_up = [](int value, int granule) { return (value + granule - 1) / granule * granule; };
    const int base_rows = view.points.y();
    BasePlane base;
    base.columns = round_up(view.points.x(), kBaseColumnGranule);
    const std::size_t base_size = static_cast<std::size_t>(base.columns) * base_rows;
    const bool with_derivatives = !output.derivatives.empty();
    thread_local Workspace workspace;
    base.sum = grown(workspace.sum, base_size);
    base.moment = with_derivatives ? grown(workspace.moment, base_size) : nullptr;
    sumSlices(view, main, base, base_rows, workspace);
    if (!view.filter.taps().empty())
    {
      BasePlane filtered = base;
      filtered.sum = grown(workspace.filtered_sum, base_size);
      filtered.moment = with_derivatives ? grown(workspace.filtered_moment, base_size) : nullptr;
      filterBase(view, base, filtered, workspace);
      base = filtered;
    }
    warpToPanel(rays, view, base, output);
  }

  void sumSlices(const BundleView& view, int main, const BasePlane& base, int base_rows, Workspace& workspace) const
  {
    SliceStack stack = volume_.stack(main);
    stack.voxels += view.first_slice * stack.slice_stride;
    stack.extents += static_cast<std::ptrdiff_t>(view.first_slice) * stack.extents_per_slice;
    stack.slices = view.last_slice - view.first_slice + 1;
    workspace.views.resize(stack.slices);
    for (int n = 0; n < stack.slices; ++n)
    {
      const double scale = view.scale(view.first_slice + n);
      const Eigen::Vector2f at_zero = (view.source.head<2>() * (1.0 - scale) + view.origin * scale).cast<float>();
      const Eigen::Vector2f step = (view.pitch * scale).cast<float>();
      workspace.views[n] = { at_zero.x(), step.x(), at_zero.y(), step.y(), static_cast<float>(1.0 - 1.0 / scale) };
    }
    stack.views = workspace.views.data();
    // Between the first and the last row that interpolation needs lie as many steps as fit between the others.
    const int rows_per_call =
        std::min(kBaseRowsPerCall, static_cast<int>((kVoxelRowsPerCall - 2) / view.pitch.y()) + 1);
    const int calls = (base_rows + rows_per_call - 1) / rows_per_call;
    tbb::parallel_for(0, calls,
                      [&](int call)
                      {
                        const int first = base_rows * call / calls;
                        kernels_.accumulate(stack, base, first, base_rows * (call + 1) / calls - first);
                      });
  }

  void filterBase(const BundleView& view, const BasePlane& from, const BasePlane& to, Workspace& workspace) const
  {
    std::vector<FilterTap>& taps = workspace.taps;
    taps.clear();
    for (const SlopeFilter::Tap& tap : view.filter.taps())
    {
      taps.push_back({ static_cast<std::ptrdiff_t>(tap.at.y()) * from.columns + tap.at.x(), tap.weight });
    }
    const int reach = view.filter.reach().y();
    tbb::parallel_for(tbb::blocked_range<int>(reach, view.points.y() - reach, kBaseRowsPerCall),
                      [&](const tbb::blocked_range<int>& range)
                      {
                        for (int row = range.begin(); row != range.end(); ++row)
                        {
                          kernels_.filter(from, taps.data(), static_cast<int>(taps.size()), to, row);
                        }
                      });
  }

  void warpToPanel(const RayBundle& rays, const BundleView& view, const BasePlane& base, Output& output) const
  {
    // Homogeneous coordinates on the base plane, linear in the ray; w is 1 for the central ray.
    const double advance = view.index_from_room.row(2).dot(rays.direction(0.5 * rays.last()));
    const Eigen::RowVector3d w = view.index_from_room.row(2) / advance;
    const auto homogeneous = [&](int axis) -> Eigen::RowVector3d
    {
      return ((view.source[axis] - view.origin[axis]) * w + view.depth / advance * view.index_from_room.row(axis)) /
             view.pitch[axis];
    };
    const Eigen::RowVector3d to_column = homogeneous(0);
    const Eigen::RowVector3d to_row = homogeneous(1);
    // Length of a ray between two slices, in the volume's values.
    const double length_scale = volume_.scale() / advance;
    // One point inside of the outermost ones that are valid, for cubic convolution.
    const Eigen::Vector2f low = (view.filter.reach().array() + 1).cast<float>();
    const Eigen::Vector2f high = (view.points - view.filter.reach()).cast<float>().array() - (kCubicReach + 1);
    const WarpLimits limits{ low.x(), high.x(), low.y(), high.y() };

    const bool with_derivatives = !output.derivatives.empty();
    WarpDerivatives common = {};
    if (with_derivatives)
    {
      for (int n = 0; n < 3; ++n)
      {
        Eigen::Map<Eigen::RowVector3f>(common.index_from_room[n]) = view.index_from_room.row(n).cast<float>();
      }
      Eigen::Map<Eigen::Vector3f>(common.ray_n) = rays.by_u.cast<float>();
      Eigen::Map<Eigen::Vector3f>(common.from_centre) = (rays.source - output.room_centre).cast<float>();
      common.depth = static_cast<float>(view.depth);
      common.points_per_column = static_cast<float>(1.0 / view.pitch.x());
      common.points_per_row = static_cast<float>(1.0 / view.pitch.y());
    }
    const auto warp_rows = [&](const tbb::blocked_range<int>& range)
    {
      for (int v = range.begin(); v != range.end(); ++v)
      {
        const Eigen::Vector3d ray = rays.at_zero + v * rays.by_v;
        const auto value = [&](const Eigen::RowVector3d& form) { return static_cast<float>(form.dot(ray)); };
        const auto step = [&](const Eigen::RowVector3d& form) { return static_cast<float>(form.dot(rays.by_u)); };
        const auto squared = [&](double dot) { return static_cast<float>(length_scale * length_scale * dot); };
        const WarpRow row{ value(to_column),
                           step(to_column),
                           value(to_row),
                           step(to_row),
                           value(w),
                           step(w),
                           squared(ray.dot(ray)),
                           squared(2.0 * ray.dot(rays.by_u)),
                           squared(rays.by_u.dot(rays.by_u)),
                           rays.size.x(),
                           output.line_integrals.ptr<float>(v) };
        if (with_derivatives)
        {
          WarpDerivatives derivatives = common;
          Eigen::Map<Eigen::Vector3f>(derivatives.ray_0) = ray.cast<float>();
          derivatives.output = output.derivatives.ptr<float>(v);
          kernels_.warpWithDerivatives(base, limits, row, derivatives);
        }
        else
        {
          kernels_.warp(base, limits, row);
        }
      }
    };
    tbb::parallel_for(tbb::blocked_range<int>(0, rays.size.y(), kWarpRowsPerTask), warp_rows);
  }

  /// Room for `size` values, and around them for what filters read in vain at the ends of the outermost rows.
  static float* grown(std::vector<float>& buffer, std::size_t size)
  {
    constexpr std::size_t kPadding = 64;
    if (buffer.size() < size + 2 * kPadding)
    {
      buffer.resize(size + 2 * kPadding);
    }
    return buffer.data() + kPadding;
  }

  const Kernels& kernels_;
  StackedVolume volume_;
};

SimdLevel bestSimdLevel()
{
#if defined(__x86_64__) && !defined(XRAY_TRACKING_PLAIN_KERNELS)
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw"))
  {
    return SimdLevel::AVX512;
  }
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
  {
    return SimdLevel::AVX2;
  }
#endif
  return SimdLevel::GENERIC;
}

ShearWarpRenderer::ShearWarpRenderer(const ScalarVolume& volume, SimdLevel level)
  : implementation_(std::make_unique<Implementation>(volume, level))
{
}

ShearWarpRenderer::~ShearWarpRenderer() = default;

std::size_t ShearWarpRenderer::memory() const
{
  return implementation_->memory();
}

namespace
{
void check(const PixelGrid& pixels, const RigidTransform& room_from_patient)
{
  if (!isRigid(room_from_patient))
  {
    throw std::invalid_argument("DRR renderer: room_from_patient is not a finite rigid transform");
  }
  if (!pixels.first.allFinite() || !pixels.step.allFinite() || !(pixels.step.minCoeff() > 0.0) ||
      pixels.size.minCoeff() < 1)
  {
    std::ostringstream message;
    message << "DRR renderer: pixel grid from [" << pixels.first.transpose() << "] px in steps of ["
            << pixels.step.transpose() << "] px, [" << pixels.size.transpose()
            << "] points: expected finite numbers, positive steps and at least one point";
    throw std::invalid_argument(message.str());
  }
}
}  // namespace

void ShearWarpRenderer::render(const ProjectionGeometry& geometry, const RigidTransform& room_from_patient,
                               cv::Mat& line_integrals) const
{
  render(geometry, PixelGrid::wholePanel(geometry), room_from_patient, line_integrals);
}

void ShearWarpRenderer::render(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                               const RigidTransform& room_from_patient, cv::Mat& line_integrals) const
{
  check(pixels, room_from_patient);
  line_integrals.create(pixels.size.y(), pixels.size.x(), CV_32FC1);
  implementation_->render(geometry, pixels, room_from_patient, { line_integrals, cv::Mat(), Eigen::Vector3d::Zero() });
}

void ShearWarpRenderer::renderWithDerivatives(const ProjectionGeometry& geometry, const PixelGrid& pixels,
                                              const RigidTransform& room_from_patient,
                                              const Eigen::Vector3d& room_centre, cv::Mat& line_integrals,
                                              cv::Mat& derivatives) const
{
  check(pixels, room_from_patient);
  line_integrals.create(pixels.size.y(), pixels.size.x(), CV_32FC1);
  derivatives.create(pixels.size.y(), pixels.size.x(), CV_32FC(kParameters));
  implementation_->render(geometry, pixels, room_from_patient, { line_integrals, derivatives, room_centre });
}
}  // namespace xray_tracking
