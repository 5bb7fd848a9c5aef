#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_motion_estimation/track.h"

namespace xray_tracking
{
/// How a target moves: (its centre's displacement [mm], rotation vector about it [rad]) over time [s].
using MotionTrace = std::function<Vector6d(double)>;

constexpr double kExposureInterval = 1.0 / 30.0;

/// A random walk of the given step deviation a second, linear between knots.
inline std::function<double(double)> randomWalk(std::mt19937& random, double sigma, double duration)
{
  constexpr double kKnots = 60.0;  // 1/s
  std::normal_distribution<double> normal;
  std::vector<double> values{ 0.0 };
  while (static_cast<double>(values.size()) < duration * kKnots + 2.0)
  {
    values.push_back(values.back() + sigma / std::sqrt(kKnots) * normal(random));
  }
  return [values](double time)
  {
    const std::size_t i = std::min(static_cast<std::size_t>(time * kKnots), values.size() - 2);
    const double share = time * kKnots - static_cast<double>(i);
    return (1.0 - share) * values[i] + share * values[i + 1];
  };
}

/// Breathing after Lujan et al. 1999: at rest while breathed out, an excursion of cos^4 with each breath; every breath
/// has its own depth (10 mm on average along room x) and length (4 s). The other axes follow in part and late, and a
/// slow random walk is on it all.
inline MotionTrace breathing(unsigned seed, double duration)
{
  struct Breath
  {
    double start, length, depth;
  };
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Breath> breaths{ { -4.0 * std::uniform_real_distribution<double>()(random), 4.0, 10.0 } };
  while (breaths.back().start < duration + 1.0)
  {
    const Breath& last = breaths.back();
    breaths.push_back({ last.start + last.length, std::clamp(4.0 + 0.5 * normal(random), 2.5, 6.0),
                        std::clamp(10.0 + 1.5 * normal(random), 4.0, 16.0) });
  }
  const auto excursion = [breaths](double time)
  {
    const auto after = std::upper_bound(breaths.begin(), breaths.end(), time,
                                        [](double t, const Breath& breath) { return t < breath.start; });
    const Breath& breath = after == breaths.begin() ? breaths.front() : *std::prev(after);
    const double sine = std::sin(M_PI * std::clamp((time - breath.start) / breath.length, 0.0, 1.0));
    return breath.depth * sine * sine * sine * sine;
  };
  const auto x = randomWalk(random, 0.05, duration + 1.0);
  const auto y = randomWalk(random, 0.05, duration + 1.0);
  const auto z = randomWalk(random, 0.05, duration + 1.0);
  return [=](double time)
  {
    const double now = excursion(time);
    const double late = excursion(time - 0.2);
    Vector6d motion;
    motion << now + x(time), 0.2 * now + y(time), 0.4 * late + z(time), 0.0, 0.00175 * late, 0.0005 * now;
    return motion;
  };
}

/// 0.1 mm/s along room x that waxes and wanes, a third of it along the others, 0.01 degrees/s of rotation.
inline MotionTrace drift(unsigned, double)
{
  return [](double time)
  {
    const double way = 0.1 * time + 0.3 * std::sin(time / 20.0);
    Vector6d motion;
    motion << way, 0.3 * way, -0.3 * way, 0.0, 0.0017 * way, 0.0;
    return motion;
  };
}

/// At rest but for a jerk to another place every 15 s, within 0.2 s.
inline MotionTrace steps(unsigned seed, double duration)
{
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Vector6d> places{ Vector6d::Zero() };
  while (static_cast<double>(places.size()) < duration / 15.0 + 2.0)
  {
    Vector6d place;
    place << 2.0 * normal(random), normal(random), normal(random), 0.0, 0.01 * normal(random), 0.0;
    places.push_back(place);
  }
  return [places](double time) -> Vector6d
  {
    const std::size_t i = static_cast<std::size_t>(time / 15.0);
    const double share = std::min((time - 15.0 * static_cast<double>(i)) / 0.2, 1.0);
    const double smooth = share * share * (3.0 - 2.0 * share);
    return (1.0 - smooth) * places[i] + smooth * places[i + 1];
  };
}

/// Moves 0.3 mm and 0.1 degrees in a second, at random, along and about every axis.
inline MotionTrace wander(unsigned seed, double duration)
{
  std::mt19937 random(seed);
  std::vector<std::function<double(double)>> walks;
  for (int i = 0; i < 6; ++i)
  {
    walks.push_back(randomWalk(random, i < 3 ? 0.3 : 0.00175, duration + 1.0));
  }
  return [walks](double time)
  {
    Vector6d motion;
    for (int i = 0; i < 6; ++i)
    {
      motion[i] = walks[i](time);
    }
    return motion;
  };
}

struct NamedMotion
{
  std::string name;
  std::function<MotionTrace(unsigned seed, double duration)> make;
};

inline std::vector<NamedMotion> allMotions()
{
  return { { "breathing", breathing }, { "drift", drift }, { "steps", steps }, { "random walk", wander } };
}

/// A target off the patient's origin, and the pose it is counted from, as in the setup files.
inline Eigen::Vector3d traceTarget()
{
  return { 12.0, -220.0, 550.0 };
}

inline RigidTransform tracePose(const Vector6d& motion)
{
  RigidTransform reference = RigidTransform::Identity();
  reference.linear() = Eigen::Quaterniond(-0.5, 0.5, -0.5, 0.5).toRotationMatrix();
  reference.translation() = -(reference.linear() * traceTarget());
  Twist twist;
  twist << motion.tail<3>(), motion.head<3>();
  return motionAbout(Eigen::Vector3d::Zero(), twist) * reference;
}

/// Covariance of (origin's translation, rotation vector) of a pose whose error at the target's centre is this.
inline Matrix6d covarianceAtOrigin(const RigidTransform& pose, const Matrix6d& at_target)
{
  Matrix6d jacobian = Matrix6d::Identity();
  jacobian.topRightCorner<3, 3>() = skew(pose.linear() * traceTarget());
  return jacobian * at_target * jacobian.transpose();
}
}  // namespace xray_tracking
