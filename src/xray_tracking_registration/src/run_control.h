#pragma once

#include <algorithm>
#include <chrono>
#include <limits>
#include <string>

#include "image_level.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
/// Watches over one run: budget, cancelling, bounds, and counts.
class RunControl
{
public:
  enum class Stop
  {
    NONE,
    TIMED_OUT,
    CANCELLED
  };

  RunControl(const RegistrationRequest& request, const Eigen::Vector3d& centre)
    : request_(request), centre_(centre), start_(std::chrono::steady_clock::now())
  {
  }

  std::chrono::duration<double> elapsed() const { return std::chrono::steady_clock::now() - start_; }

  /// To be asked before every rendering. @return whether to go on; once false, always false
  bool mayRender(const RigidTransform& room_from_patient, double similarity)
  {
    if (stop_ == Stop::NONE && elapsed() > request_.time_budget)
    {
      stop_ = Stop::TIMED_OUT;
    }
    if (stop_ == Stop::NONE && request_.progress &&
        !request_.progress({ level, iterations, similarity, room_from_patient }))
    {
      stop_ = Stop::CANCELLED;
    }
    renderings += stop_ == Stop::NONE ? 1 : 0;
    return stop_ == Stop::NONE;
  }

  /// Of the target's centre from the start [mm].
  double distance(const RigidTransform& room_from_patient) const
  {
    return (room_from_patient * centre_ - request_.room_from_patient * centre_).norm();
  }

  bool inBounds(const RigidTransform& room_from_patient) const
  {
    const RigidTransform motion = request_.room_from_patient.inverse() * room_from_patient;
    return distance(room_from_patient) <= request_.max_translation_mm &&
           rotationAngle(motion) <= request_.max_rotation_rad;
  }

  /// Whether a pose may be where the bounds held it up, as steps beyond are not taken.
  bool atBounds(const RigidTransform& room_from_patient) const
  {
    // Of small bounds a share, lest a pose well inside be taken for one.
    constexpr double kNear = 0.95;
    constexpr double kNearMm = 0.5;
    constexpr double kNearRad = 0.01;
    const RigidTransform motion = request_.room_from_patient.inverse() * room_from_patient;
    const double reach = std::max(kNear * request_.max_translation_mm, request_.max_translation_mm - kNearMm);
    const double turn = std::max(kNear * request_.max_rotation_rad, request_.max_rotation_rad - kNearRad);
    return distance(room_from_patient) > reach || rotationAngle(motion) > turn;
  }

  Stop stop() const { return stop_; }

  int level = 0;
  int iterations = 0;
  int renderings = 0;

private:
  const RegistrationRequest& request_;
  Eigen::Vector3d centre_;
  std::chrono::steady_clock::time_point start_;
  Stop stop_ = Stop::NONE;
};
}  // namespace xray_tracking
