#pragma once

#include <random>
#include <vector>

#include <boost/math/constants/constants.hpp>

#include "subject.h"

namespace xray_tracking
{
constexpr double kDegree = boost::math::constants::degree<double>();

Eigen::Vector3d randomDirection(std::mt19937& random);

/// A motion of these sizes [rad, mm] about the target's centre, along and about any axis.
Twist randomTwist(std::mt19937& random, double angle, double translation);

/// Starts whose root mean square distance over the target's box lies in [low, high] [mm], turned by 0 to `max_angle`
/// [rad] as far as that allows. About the box's centre, rotation and translation add as squares.
std::vector<Twist> startsOfBand(const Subject& subject, double low, double high, double max_angle, int count,
                                std::mt19937& random);
}  // namespace xray_tracking
