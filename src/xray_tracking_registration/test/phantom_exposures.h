#pragma once

#include <cmath>
#include <random>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
/// A vector of the given length in a random direction.
inline Eigen::Vector3d randomVector(std::mt19937& random, double length)
{
  std::normal_distribution<double> normal;
  Eigen::Vector3d v;
  v << normal(random), normal(random), normal(random);
  return length * v.normalized();
}

/// A random motion of the given size [deg, mm].
inline Twist randomTwist(std::mt19937& random, double degrees, double mm)
{
  Twist twist;
  twist << randomVector(random, degrees * M_PI / 180.0), randomVector(random, mm);
  return twist;
}

/// Exact X-rays of the closed-form neck phantom in two views at right angles, with quantum noise and scatter, and a
/// scanned CT of it; made once for all tests.
class PhantomExposures
{
public:
  static const PhantomExposures& instance()
  {
    static const PhantomExposures exposures;
    return exposures;
  }

  const CtVolume& ct() const { return ct_; }
  const Eigen::AlignedBox3d& targetBox() const { return phantom_.targetBox(); }
  Eigen::Vector3d centre() const { return targetBox().center(); }
  const std::vector<ProjectionGeometry>& views() const { return views_; }
  /// Supine, the phantom's origin in the isocentre.
  const RigidTransform& roomFromPatient() const { return room_from_patient_; }
  BodyModel bodies() const { return splitBodies(ct_, targetMaskFromBone(ct_, targetBox())); }

  /// Counts of all views; the start is the target's true pose.
  RegistrationRequest expose(const RigidTransform& room_from_target, const RigidTransform& room_from_rest,
                             std::mt19937& random) const
  {
    constexpr double kOffset = 100.0;
    constexpr double kAir = 60000.0;
    RegistrationRequest request;
    request.intensity.offset = kOffset;
    request.intensity.air_counts = kAir;
    request.room_from_patient = room_from_target;
    // Those that wait on a busy machine are not what is tested.
    request.time_budget = std::chrono::duration<double>(60.0);
    std::normal_distribution<float> normal;
    for (const ProjectionGeometry& view : views_)
    {
      cv::Mat soft;
      cv::Mat bone;
      phantom_.lineIntegrals(view, room_from_target, room_from_rest, soft, bone);
      cv::Mat signal = -(soft * kWaterAttenuation + bone * kBoneAttenuation);
      cv::exp(signal, signal);
      cv::Mat scatter;
      cv::GaussianBlur(signal.mul(1.0 - signal), scatter, cv::Size(), 40.0);
      signal += 0.2 * scatter;
      cv::Mat counts(signal.size(), CV_16UC1);
      for (int row = 0; row < signal.rows; ++row)
      {
        for (int column = 0; column < signal.cols; ++column)
        {
          const float mean = signal.at<float>(row, column) * static_cast<float>(kAir - kOffset);
          counts.at<std::uint16_t>(row, column) =
              cv::saturate_cast<std::uint16_t>(kOffset + mean + std::sqrt(mean) * normal(random));
        }
      }
      request.views.push_back({ view, counts });
    }
    return request;
  }

private:
  PhantomExposures()
  {
    ct_ = phantom_.sampleCt(PhantomCtOptions());
    room_from_patient_ = makeRigidTransform(Eigen::Vector3d::Zero(), Eigen::Quaterniond(-0.5, 0.5, -0.5, 0.5));
    for (const double side : { -1.0, 1.0 })
    {
      const Eigen::Vector3d central = Eigen::Vector3d(0.0, side, -1.0).normalized();
      DetectorDescription panel;
      panel.name = side < 0.0 ? "detector_a" : "detector_b";
      panel.image_size = { 512, 512 };
      panel.pixel_pitch = { 0.4, 0.4 };
      panel.source = -2600.0 * central;
      panel.x_direction = Eigen::Vector3d::UnitX();
      panel.y_direction = central.cross(panel.x_direction);
      panel.origin = 1200.0 * central - 102.2 * (panel.x_direction + panel.y_direction);
      views_.push_back(ProjectionGeometry::fromDescription(panel));
    }
  }

  NeckPhantom phantom_;
  CtVolume ct_;
  RigidTransform room_from_patient_;
  std::vector<ProjectionGeometry> views_;
};
}  // namespace xray_tracking
