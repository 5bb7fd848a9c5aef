#pragma once

#include <memory>
#include <random>
#include <vector>

#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_core/volume/solid.h"
#include "xray_tracking_detector_simulator/anatomy.h"

namespace xray_tracking
{
/// A limb of closed-form solids, at random: soft tissue with the bones of a forearm, or of a knee whose joint is two
/// metal components. The target is one of the bones, or the lower component. Its X-rays are exact.
class Limb : public Anatomy
{
public:
  enum class Kind
  {
    FOREARM,
    IMPLANT
  };

  Limb(Kind kind, std::mt19937& random);

  void materials(const ProjectionGeometry& geometry, const BodyPoses& poses, cv::Mat& soft,
                 cv::Mat& bone) const override;

  /// Around the target, patient frame [mm].
  const Eigen::AlignedBox3d& box() const { return box_; }
  /// The target alone in air, with its counterpart if it is an implant and that is asked for.
  CtVolume segmentedCt(double voxel, double slice, bool counterpart) const;

private:
  void addForearm(std::mt19937& random);
  void addImplant(std::mt19937& random);

  std::vector<Solid> target_;
  std::vector<Solid> counterpart_;  ///< moves with the rest
  std::vector<Solid> rest_;
  Eigen::AlignedBox3d box_;
};
}  // namespace xray_tracking
