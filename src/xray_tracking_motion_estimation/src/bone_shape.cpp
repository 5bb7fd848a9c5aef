#include "xray_tracking_motion_estimation/bone_shape.h"

#include <functional>
#include <sstream>
#include <stdexcept>

#include "xray_tracking_core/volume/attenuation.h"
#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_core/volume/neck_phantom.h"

namespace xray_tracking
{
namespace
{
constexpr double kBoneHu = 200.0;
constexpr double kStep = 1.0;  // mm

/// @param hu of a point; above `bone` it is one
std::vector<Eigen::Vector3d> bonePoints(const Eigen::AlignedBox3d& box, double bone,
                                        const std::function<double(const Eigen::Vector3d&)>& hu)
{
  std::vector<Eigen::Vector3d> points;
  for (double z = box.min().z() + 0.5 * kStep; z < box.max().z(); z += kStep)
  {
    for (double y = box.min().y() + 0.5 * kStep; y < box.max().y(); y += kStep)
    {
      for (double x = box.min().x() + 0.5 * kStep; x < box.max().x(); x += kStep)
      {
        const Eigen::Vector3d point(x, y, z);
        if (hu(point) > bone)
        {
          points.push_back(point);
        }
      }
    }
  }
  return points;
}

std::vector<Eigen::Vector3d> bonePoints(const TreatmentSetup& setup)
{
  if (setup.ct_path.empty())
  {
    const NeckPhantom phantom;
    return bonePoints(setup.target_box, kBoneHu,
                      [&](const Eigen::Vector3d& point) { return huFromMaterials(phantom.at(point)); });
  }
  const PatientCt read = readPatientCt(setup.ct_path, setup.ct_content, setup.ct_choice);
  const CtVolume& ct = read.volume;
  const Eigen::Affine3d index_from_patient = ct.grid.patient_from_index.inverse();
  const auto nearest = [&](const Eigen::Vector3d& point)
  {
    const Eigen::Vector3i index = (index_from_patient * point).array().round().cast<int>();
    const bool inside = index.minCoeff() >= 0 && (ct.grid.size - index).minCoeff() > 0;
    return inside ? static_cast<double>(ct.hu[ct.grid.offset(index.x(), index.y(), index.z())]) : -1000.0;
  };
  return bonePoints(setup.target_box, read.content == CtContent::LABELS ? 0.0 : kBoneHu, nearest);
}
}  // namespace

TargetShape boneShape(const TreatmentSetup& setup)
{
  const std::vector<Eigen::Vector3d> points = bonePoints(setup);
  if (points.empty())
  {
    std::ostringstream message;
    message << "the target box from [" << setup.target_box.min().transpose() << "] to ["
            << setup.target_box.max().transpose() << "] mm has no bone in "
            << (setup.ct_path.empty() ? "the neck phantom" : setup.ct_path);
    throw std::runtime_error(message.str());
  }
  return TargetShape::fromPoints(points);
}
}  // namespace xray_tracking
