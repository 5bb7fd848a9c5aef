#include "starts.h"

#include <cmath>

#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
Eigen::Vector3d randomDirection(std::mt19937& random)
{
  std::normal_distribution<double> normal;
  Eigen::Vector3d direction;
  for (double& component : direction)
  {
    component = normal(random);
  }
  return direction.normalized();
}

Twist randomTwist(std::mt19937& random, double angle, double translation)
{
  Twist twist;
  twist << angle * randomDirection(random), translation * randomDirection(random);
  return twist;
}

std::vector<Twist> startsOfBand(const Subject& subject, double low, double high, double max_angle, int count,
                                std::mt19937& random)
{
  std::uniform_real_distribution<double> share;
  std::vector<Twist> starts;
  while (static_cast<int>(starts.size()) < count)
  {
    const double distance = low + (high - low) * share(random);
    const double angle = max_angle * share(random);
    Twist twist = randomTwist(random, angle, 0.0);
    const RigidTransform identity = RigidTransform::Identity();
    const double turned = targetRegistrationError(subject.moved(twist, identity), identity, subject.box());
    if (turned <= distance)
    {
      twist.tail<3>() = std::sqrt(distance * distance - turned * turned) * randomDirection(random);
      starts.push_back(twist);
    }
  }
  return starts;
}
}  // namespace xray_tracking
