#include "xray_tracking_motion_estimation/pose_predictor.h"

#include <cmath>
#include <sstream>
#include <stdexcept>

namespace xray_tracking
{
namespace
{
using Vector6d = Eigen::Matrix<double, 6, 1>;

/// Makes millimetres of a rotation: that of a point on the surface of a vertebra, for which a degree is a millimetre.
constexpr double kArm = 57.3;

/// Up to here a rotation vector's components are as good as angles about the fixed axes.
constexpr double kMaxRotation = 0.5;

Vector6d scaling(double rotation)
{
  Vector6d scale = Vector6d::Ones();
  scale.tail<3>().fill(rotation);
  return scale;
}
}  // namespace

void PosePredictorOptions::validate() const
{
  const auto require = [](bool valid, const char* key, double value, const char* expected)
  {
    if (!valid)
    {
      std::ostringstream message;
      message << key << " is " << value << ", expected " << expected;
      throw std::invalid_argument(message.str());
    }
  };
  require(latency > 0.0 && latency <= 1.0, "latency", latency, "a number in (0, 1] s");
  require(max_gap > latency && std::isfinite(max_gap), "max_gap", max_gap, "a number > latency, in s");
}

PosePredictor::PosePredictor(const PosePredictorOptions& options, const Eigen::Vector3d& target_centre)
  : options_(options), target_centre_(target_centre), axes_{ AxisPredictor(options.latency),
                                                             AxisPredictor(options.latency),
                                                             AxisPredictor(options.latency),
                                                             AxisPredictor(options.latency),
                                                             AxisPredictor(options.latency),
                                                             AxisPredictor(options.latency) }
{
  options_.validate();
}

Vector6d PosePredictor::coordinates(const RigidTransform& room_from_patient) const
{
  Vector6d result;
  result << room_from_patient * target_centre_,
      kArm * vectorFromRotation(room_from_patient.linear() * first_rotation_.transpose());
  return result;
}

bool PosePredictor::add(std::int64_t stamp, const RigidTransform& room_from_patient, const PoseCovariance& covariance,
                        double tissue_variance)
{
  if (!isRigid(room_from_patient) || !covariance.allFinite() || (last_stamp_ && stamp <= *last_stamp_))
  {
    return false;
  }
  const PoseCovariance target_covariance = scaling(kArm).asDiagonal() *
                                           covarianceAt(target_centre_, room_from_patient, covariance) *
                                           scaling(kArm).asDiagonal();
  if (!(target_covariance.diagonal().minCoeff() > 0.0))
  {
    return false;
  }

  const double elapsed = last_stamp_ ? 1e-9 * static_cast<double>(stamp - *last_stamp_) : 0.0;
  Vector6d values = coordinates(room_from_patient);
  const bool start = !last_stamp_ || elapsed > options_.max_gap || values.tail<3>().norm() > kArm * kMaxRotation;
  if (start)
  {
    first_rotation_ = room_from_patient.linear();
    values = coordinates(room_from_patient);
  }
  Vector6d lasting_share;
  for (int i = 0; i < 6; ++i)
  {
    const double variance = target_covariance(i, i);
    const double lasting = i < 3 ? tissue_variance : 0.0;
    const double most_noise = variance > lasting ? variance - lasting : variance;
    if (start)
    {
      axes_[i].reset(values[i], most_noise);
    }
    else
    {
      axes_[i].add(elapsed, values[i], most_noise);
    }
    lasting_share[i] = std::sqrt(1.0 - axes_[i].noiseVariance() / variance);
  }
  lasting_covariance_ = lasting_share.asDiagonal() * target_covariance * lasting_share.asDiagonal();
  last_stamp_ = stamp;
  return true;
}

std::optional<PosePrediction> PosePredictor::predict(std::int64_t stamp) const
{
  const double horizon = last_stamp_ ? 1e-9 * static_cast<double>(stamp - *last_stamp_) : -1.0;
  if (horizon < 0.0 || horizon > options_.max_gap)
  {
    return std::nullopt;
  }
  Vector6d values;
  PoseCovariance covariance = lasting_covariance_;
  for (int i = 0; i < 6; ++i)
  {
    const Forecast forecast = axes_[i].predict(horizon);
    values[i] = forecast.value;
    covariance(i, i) += forecast.variance;
  }

  PosePrediction prediction;
  prediction.stamp = stamp;
  prediction.room_from_patient.linear() = rotationFromVector(values.tail<3>() / kArm) * first_rotation_;
  const Eigen::Vector3d arm = prediction.room_from_patient.linear() * target_centre_;
  prediction.room_from_patient.translation() = values.head<3>() - arm;
  prediction.room_from_patient.makeAffine();
  const PoseCovariance jacobian = pointFromOriginJacobian(-arm) * scaling(1.0 / kArm).asDiagonal();
  prediction.covariance = jacobian * covariance * jacobian.transpose();
  return prediction;
}

void PosePredictor::correct(const RigidTransform& before, const RigidTransform& after)
{
  if (!last_stamp_)
  {
    return;
  }
  const Vector6d change = coordinates(after) - coordinates(before);
  for (int i = 0; i < 6; ++i)
  {
    axes_[i].shift(change[i]);
  }
}
}  // namespace xray_tracking
