#include "xray_tracking_motion_estimation/track.h"

#include <cmath>
#include <stdexcept>

#include <Eigen/LU>

namespace xray_tracking
{
TrackModel trackModelFromName(const std::string& name)
{
  if (name == "translation")
  {
    return TrackModel::TRANSLATION;
  }
  if (name == "euclidean")
  {
    return TrackModel::EUCLIDEAN;
  }
  if (name == "similarity")
  {
    return TrackModel::SIMILARITY;
  }
  if (name == "affine")
  {
    return TrackModel::AFFINE;
  }
  throw std::invalid_argument("model is '" + name + "', expected translation, euclidean, similarity or affine");
}

Vector6d Track::warp() const
{
  Vector6d result;
  result << displacement, linear(0, 0), linear(0, 1), linear(1, 0), linear(1, 1);
  return result;
}

Track Track::since(const Track& anchor) const
{
  Track track = *this;
  track.centre = anchor.centre + anchor.displacement;
  track.displacement = displacement - anchor.displacement;
  track.linear = linear * anchor.linear.inverse();
  track.covariance = covariance + anchor.covariance;
  if (model == TrackModel::TRANSLATION || anchor.model == TrackModel::TRANSLATION)
  {
    // One of the two linear parts was not measured, so their ratio is not known.
    track.model = TrackModel::TRANSLATION;
    track.linear.setIdentity();
    track.covariance.rightCols<4>().setZero();
    track.covariance.bottomRows<4>().setZero();
  }
  return track;
}

TrackParameters nearestParameters(TrackModel model, const Vector6d& warp, const Eigen::Matrix2d& moments,
                                  TrackParametersJacobian& jacobian)
{
  const int count = static_cast<int>(model);
  jacobian.setIdentity(count, 6);
  if (model == TrackModel::TRANSLATION || model == TrackModel::AFFINE)
  {
    return warp.head(count);
  }
  // Of all [a -b; b a], the one nearest to L over points x with moments S = sum x x^T: a = tr(L S) / tr S,
  // b = ((L S)_21 - (L S)_12) / tr S.
  const Eigen::Matrix2d s = moments / moments.trace();
  Eigen::RowVector4d a_by_linear(s(0, 0), s(0, 1), s(0, 1), s(1, 1));
  Eigen::RowVector4d b_by_linear(-s(0, 1), -s(1, 1), s(0, 0), s(0, 1));
  const double a = a_by_linear.dot(warp.tail<4>());
  const double b = b_by_linear.dot(warp.tail<4>());
  TrackParameters parameters(count);
  parameters.head<2>() = warp.head<2>();
  if (model == TrackModel::SIMILARITY)
  {
    parameters.tail<2>() << a, b;
    jacobian.block<1, 4>(2, 2) = a_by_linear;
    jacobian.block<1, 4>(3, 2) = b_by_linear;
  }
  else
  {
    // The nearest rotation has the same direction (Procrustes).
    parameters(2) = std::atan2(b, a);
    jacobian.block<1, 4>(2, 2) = (a * b_by_linear - b * a_by_linear) / (a * a + b * b);
  }
  return parameters;
}

TrackParameters difference(TrackModel model, const TrackParameters& a, const TrackParameters& b)
{
  TrackParameters result = a - b;
  if (model == TrackModel::EUCLIDEAN)
  {
    result(2) = std::remainder(result(2), 2.0 * M_PI);
  }
  return result;
}
}  // namespace xray_tracking
