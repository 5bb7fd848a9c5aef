#include "deforming_ct.h"

#include <algorithm>
#include <cmath>

#include <tbb/parallel_for.h>
#include <Eigen/Geometry>

#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
constexpr double kWaveLength = 150.0;  // [mm]
constexpr double kLongest = 1000.0;    // way through the body [mm]
constexpr double kAir = -1000.0;       // [HU]

/// Trilinear; `outside` beyond the outermost voxel centres.
template <typename Value>
double valueAt(const VolumeGrid& grid, const std::vector<Value>& values, const Eigen::Vector3d& index, double outside)
{
  const Eigen::Vector3d low = index.array().floor();
  if (!((low.array() >= 0.0).all() && (low.array() + 1.0 < grid.size.array().cast<double>()).all()))
  {
    return outside;
  }
  const Eigen::Vector3d part = index - low;
  const std::size_t row = static_cast<std::size_t>(grid.size.x());
  const std::size_t slice = row * static_cast<std::size_t>(grid.size.y());
  const Value* at = values.data() + grid.offset(int(low.x()), int(low.y()), int(low.z()));
  const auto along_x = [&](const Value* two) { return two[0] + part.x() * (two[1] - two[0]); };
  const double near = along_x(at) + part.y() * (along_x(at + row) - along_x(at));
  const double far = along_x(at + slice) + part.y() * (along_x(at + slice + row) - along_x(at + slice));
  return near + part.z() * (far - near);
}

/// Extends [first, last] by where the ray of indices runs through the grid's slices, which go on beyond its ends.
void extendBy(const VolumeGrid& grid, const Eigen::Vector3d& source, const Eigen::Vector3d& direction, double& first,
              double& last)
{
  const Eigen::Array2d size = grid.size.head<2>().cast<double>().array() - 1.0;
  const Eigen::Array2d a = -source.head<2>().array() / direction.head<2>().array();
  const Eigen::Array2d b = (size - source.head<2>().array()) / direction.head<2>().array();
  const double enter = std::max(0.0, a.min(b).maxCoeff());
  const double exit = std::min(a.max(b).minCoeff(), enter + kLongest);
  if (exit > enter)
  {
    first = std::min(first, enter);
    last = std::max(last, exit);
  }
}
}  // namespace

DeformingCt::DeformingCt(std::shared_ptr<const CtVolume> ct, TargetMask target, double wave_mm, double step)
  : ct_(std::move(ct)),
    target_(std::move(target)),
    index_from_patient_(ct_->grid.patient_from_index.inverse()),
    mask_from_patient_(target_.grid.patient_from_index.inverse()),
    wave_mm_(wave_mm),
    step_(step)
{
}

Materials DeformingCt::along(const Ray& ray, const BodyPoses& poses) const
{
  // Where the ray's points were in the CT if all moved as the target, or as the rest does.
  const Eigen::Affine3d by_target = index_from_patient_ * Eigen::Affine3d(poses.room_from_target.inverse());
  const Eigen::Affine3d by_rest = index_from_patient_ * Eigen::Affine3d(poses.room_from_rest.inverse());
  const Eigen::Affine3d in_mask = mask_from_patient_ * Eigen::Affine3d(poses.room_from_target.inverse());
  const Eigen::Vector3d target_source = by_target * ray.source, target_direction = by_target.linear() * ray.direction;
  const Eigen::Vector3d rest_source = by_rest * ray.source, rest_direction = by_rest.linear() * ray.direction;
  const Eigen::Vector3d mask_source = in_mask * ray.source, mask_direction = in_mask.linear() * ray.direction;
  // Waves along the patient's long axis.
  const Eigen::Vector3d wave = index_from_patient_.linear() * Eigen::Vector3d(0.3, -0.8, 0.5) * wave_mm_;
  const RigidTransform patient_from_room = poses.room_from_rest.inverse();
  const double phase_source = 2.0 * EIGEN_PI / kWaveLength * (patient_from_room * ray.source).z();
  const double phase_direction = 2.0 * EIGEN_PI / kWaveLength * (patient_from_room.linear() * ray.direction).z();

  double first = std::numeric_limits<double>::infinity();
  double last = 0.0;
  extendBy(ct_->grid, target_source, target_direction, first, last);
  extendBy(ct_->grid, rest_source, rest_direction, first, last);
  Materials sum;
  for (double length = first + 0.5 * step_; length < last; length += step_)
  {
    const double weight = valueAt(target_.grid, target_.values, mask_source + length * mask_direction, 0.0);
    Eigen::Vector3d index = target_source + length * target_direction;
    if (weight < 1.0)
    {
      index = weight * index + (1.0 - weight) * (rest_source + length * rest_direction +
                                                 std::sin(phase_source + length * phase_direction) * wave);
    }
    // A body does not end with its scan: the last slices go on.
    index.z() = std::clamp(index.z(), 0.0, ct_->grid.size.z() - 1.001);
    const double hu = valueAt(ct_->grid, ct_->hu, index, kAir);
    if (hu > kAir)
    {
      const Materials here = materialsFromHu(hu);
      sum.soft += here.soft;
      sum.bone += here.bone;
    }
  }
  return { step_ * sum.soft, step_ * sum.bone };
}

void DeformingCt::materials(const ProjectionGeometry& geometry, const BodyPoses& poses, cv::Mat& soft,
                            cv::Mat& bone) const
{
  const cv::Size size(geometry.imageSize().x(), geometry.imageSize().y());
  soft.create(size, CV_32FC1);
  bone.create(size, CV_32FC1);
  tbb::parallel_for(0, size.height,
                    [&](int row)
                    {
                      for (int column = 0; column < size.width; ++column)
                      {
                        const Materials crossed = along(geometry.backProject(Eigen::Vector2d(column, row)), poses);
                        soft.at<float>(row, column) = static_cast<float>(crossed.soft);
                        bone.at<float>(row, column) = static_cast<float>(crossed.bone);
                      }
                    });
}

CtVolume resampled(const CtVolume& ct, double voxel, double slice, const Eigen::AlignedBox3d& region)
{
  const Eigen::AlignedBox3d extent = ct.grid.extent().intersection(region);
  const Eigen::Vector3d spacing(voxel, voxel, slice);
  CtVolume out;
  out.grid.size = extent.sizes().cwiseQuotient(spacing).array().floor().cast<int>();
  out.grid.patient_from_index = Eigen::Translation3d(extent.min() + 0.5 * spacing) * Eigen::Scaling(spacing);
  out.hu.resize(out.grid.voxelCount());
  const Eigen::Affine3d index = ct.grid.patient_from_index.inverse() * out.grid.patient_from_index;
  const Eigen::Vector3i parts = spacing.cwiseQuotient(ct.grid.spacing()).array().round().cast<int>().max(1);
  tbb::parallel_for(0, out.grid.size.z(),
                    [&](int k)
                    {
                      for (int j = 0; j < out.grid.size.y(); ++j)
                      {
                        for (int i = 0; i < out.grid.size.x(); ++i)
                        {
                          double sum = 0.0;
                          for (int part = 0; part < parts.prod(); ++part)
                          {
                            const Eigen::Vector3d at(part % parts.x(), part / parts.x() % parts.y(),
                                                     part / (parts.x() * parts.y()));
                            const Eigen::Vector3d shift = (at.array() + 0.5) / parts.array().cast<double>() - 0.5;
                            sum += valueAt(ct.grid, ct.hu, index * (Eigen::Vector3d(i, j, k) + shift), kAir);
                          }
                          out.hu[out.grid.offset(i, j, k)] = static_cast<std::int16_t>(std::lround(sum / parts.prod()));
                        }
                      }
                    });
  return out;
}
}  // namespace xray_tracking
