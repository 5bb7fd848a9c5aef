#pragma once

#include <memory>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/projection/drr_renderer.h"
#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_detector_simulator/body_poses.h"

namespace xray_tracking
{
/// What the X-rays cross.
class Anatomy
{
public:
  virtual ~Anatomy() = default;

  /// Lengths of nominal soft tissue (water) and cortical bone along every pixel's ray.
  /// @param soft, bone out, CV_32FC1, rows x columns of the geometry [mm]; re-used if they have that size and type
  virtual void materials(const ProjectionGeometry& geometry, const BodyPoses& poses, cv::Mat& soft,
                         cv::Mat& bone) const = 0;
};

/// The neck phantom's closed-form solids: exact.
class PhantomAnatomy : public Anatomy
{
public:
  void materials(const ProjectionGeometry& geometry, const BodyPoses& poses, cv::Mat& soft,
                 cv::Mat& bone) const override;

private:
  NeckPhantom phantom_;
};

/// Any CT: every voxel is split into soft tissue and bone (materialsFromHu), and by the target box into target and
/// rest. The target's share is 1 in the box and falls to 0 at `kSoftEdge` from it (raised cosine), so that no edge
/// appears where the bodies part. Four volumes, the target's two cropped to their box, are rendered and added up.
/// Memory: at most 8 bytes a voxel of the CT, and as much again a voxel of the target's box.
class CtAnatomy : public Anatomy
{
public:
  static constexpr double kSoftEdge = 10.0;  ///< [mm]

  /// @param target_box patient frame [mm]
  /// @throws std::invalid_argument naming the box and the CT's extent if they do not overlap
  CtAnatomy(const CtVolume& ct, const Eigen::AlignedBox3d& target_box);

  void materials(const ProjectionGeometry& geometry, const BodyPoses& poses, cv::Mat& soft,
                 cv::Mat& bone) const override;

private:
  struct Body
  {
    std::unique_ptr<DrrRenderer> soft;
    std::unique_ptr<DrrRenderer> bone;
  };

  Body target_;
  Body rest_;
};
}  // namespace xray_tracking
