#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include "xray_tracking_core/projection/shear_warp_renderer.h"
#include "xray_tracking_core/volume/attenuation.h"
#include "xray_tracking_detector_simulator/anatomy.h"

namespace xray_tracking
{
namespace
{
/// Voxel indices first..last, both included.
struct IndexBox
{
  Eigen::Vector3i first;
  Eigen::Vector3i last;

  bool empty() const { return (first.array() > last.array()).any(); }
  Eigen::Vector3i size() const { return last - first + Eigen::Vector3i::Ones(); }
};

Eigen::AlignedBox3d grownBox(const Eigen::AlignedBox3d& box, double margin)
{
  return { box.min().array() - margin, box.max().array() + margin };
}

/// The voxels that may lie in a box of the patient frame, and one more on each side where the grid has one: there the
/// target's share is zero, so that interpolation fades out instead of breaking off.
IndexBox indexBox(const VolumeGrid& grid, const Eigen::AlignedBox3d& patient_box)
{
  const Eigen::Affine3d index_from_patient = grid.patient_from_index.inverse();
  Eigen::AlignedBox3d box;
  for (int corner = 0; corner < 8; ++corner)
  {
    box.extend(index_from_patient * patient_box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner)));
  }
  // Clamped before the cast: a far-away box must not overflow an int.
  const Eigen::Array3d highest = grid.size.cast<double>().array();
  const Eigen::Array3d first = (box.min().array().floor() - 1.0).max(0.0).min(highest);
  const Eigen::Array3d last = (box.max().array().ceil() + 1.0).max(-1.0).min(highest - 1.0);
  return { first.cast<int>(), last.cast<int>() };
}

ScalarVolume makeVolume(const VolumeGrid& grid, const IndexBox& box)
{
  ScalarVolume volume;
  volume.grid.size = box.size();
  volume.grid.patient_from_index = grid.patient_from_index;
  volume.grid.patient_from_index.translate(box.first.cast<double>());
  volume.values.assign(volume.grid.voxelCount(), 0.0F);
  return volume;
}

/// The materials of every HU there is, by HU less the lowest int16.
std::vector<Materials> materialTable()
{
  constexpr int kLowest = std::numeric_limits<std::int16_t>::min();
  std::vector<Materials> table(std::numeric_limits<std::uint16_t>::max() + 1);
  for (std::size_t i = 0; i < table.size(); ++i)
  {
    table[i] = materialsFromHu(static_cast<double>(i) + kLowest);
  }
  return table;
}

float targetShare(const Eigen::AlignedBox3d& box, const Eigen::Vector3d& point)
{
  const double distance = box.exteriorDistance(point);
  if (distance >= CtAnatomy::kSoftEdge)
  {
    return 0.0F;
  }
  return static_cast<float>(0.5 + 0.5 * std::cos(EIGEN_PI * distance / CtAnatomy::kSoftEdge));
}

/// Moves the target's share of every voxel from the whole body's volume to the target's.
void splitOff(const Eigen::AlignedBox3d& target_box, const IndexBox& box, ScalarVolume& body, ScalarVolume& target)
{
  tbb::parallel_for(
      0, target.grid.size.z(),
      [&](int k)
      {
        for (int j = 0; j < target.grid.size.y(); ++j)
        {
          for (int i = 0; i < target.grid.size.x(); ++i)
          {
            const float share = targetShare(target_box, target.grid.patient_from_index * Eigen::Vector3d(i, j, k));
            float& whole = body.values[body.grid.offset(i + box.first.x(), j + box.first.y(), k + box.first.z())];
            target.values[target.grid.offset(i, j, k)] = share * whole;
            whole -= share * whole;
          }
        }
      });
}

std::string text(const Eigen::AlignedBox3d& box)
{
  const Eigen::IOFormat format(6, Eigen::DontAlignCols, ", ", ", ", "", "", "[", "]");
  std::ostringstream out;
  out << box.min().format(format) << " to " << box.max().format(format) << " mm";
  return out.str();
}

void addRendering(const DrrRenderer& renderer, const ProjectionGeometry& geometry, const RigidTransform& pose,
                  cv::Mat& buffer, cv::Mat& sum)
{
  renderer.render(geometry, pose, buffer);
  sum += buffer;
}
}  // namespace

CtAnatomy::CtAnatomy(const CtVolume& ct, const Eigen::AlignedBox3d& target_box)
{
  const IndexBox whole_box{ Eigen::Vector3i::Zero(), ct.grid.size - Eigen::Vector3i::Ones() };
  const IndexBox target_indices = indexBox(ct.grid, grownBox(target_box, kSoftEdge));
  if (indexBox(ct.grid, target_box).empty() || target_indices.empty())
  {
    Eigen::AlignedBox3d extent;
    for (int corner = 0; corner < 8; ++corner)
    {
      const Eigen::Vector3i last((corner & 1) != 0, (corner & 2) != 0, (corner & 4) != 0);
      extent.extend(ct.grid.patient_from_index * last.cwiseProduct(whole_box.last).cast<double>());
    }
    throw std::invalid_argument("target_box_mm: " + text(target_box) + " lies outside the CT, which covers " +
                                text(extent));
  }

  const std::vector<Materials> table = materialTable();
  const auto build = [&](double Materials::*material)
  {
    ScalarVolume body = makeVolume(ct.grid, whole_box);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, ct.hu.size()),
                      [&](const auto& range)
                      {
                        for (std::size_t i = range.begin(); i != range.end(); ++i)
                        {
                          const int row = ct.hu[i] - std::numeric_limits<std::int16_t>::min();
                          body.values[i] = static_cast<float>(table[static_cast<std::size_t>(row)].*material);
                        }
                      });
    ScalarVolume target = makeVolume(ct.grid, target_indices);
    splitOff(target_box, target_indices, body, target);
    return std::make_pair(std::make_unique<ShearWarpRenderer>(target), std::make_unique<ShearWarpRenderer>(body));
  };
  std::tie(target_.soft, rest_.soft) = build(&Materials::soft);
  std::tie(target_.bone, rest_.bone) = build(&Materials::bone);
}

void CtAnatomy::materials(const ProjectionGeometry& geometry, const BodyPoses& poses, cv::Mat& soft,
                          cv::Mat& bone) const
{
  const cv::Size size(geometry.imageSize().x(), geometry.imageSize().y());
  cv::Mat buffer;
  for (cv::Mat* sum : { &soft, &bone })
  {
    sum->create(size, CV_32FC1);
    sum->setTo(0.0);
  }
  addRendering(*target_.soft, geometry, poses.room_from_target, buffer, soft);
  addRendering(*rest_.soft, geometry, poses.room_from_rest, buffer, soft);
  addRendering(*target_.bone, geometry, poses.room_from_target, buffer, bone);
  addRendering(*rest_.bone, geometry, poses.room_from_rest, buffer, bone);
}
}  // namespace xray_tracking
