#pragma once

#include <string>

#include <Eigen/Core>

namespace xray_tracking
{
using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

/// What a tracker let vary; the value is the number of parameters.
enum class TrackModel
{
  TRANSLATION = 2,  ///< dx, dy
  EUCLIDEAN = 3,    ///< and the rotation angle, from the columns' axis to the rows'
  SIMILARITY = 4,   ///< and a, b of the linear part [a -b; b a]
  AFFINE = 6        ///< and all four numbers of the linear part
};

/// @throws std::invalid_argument if `name` is none of translation, euclidean, similarity, affine
TrackModel trackModelFromName(const std::string& name);

/// How a region of an image lies relative to where it was: a point x is now at
/// centre + displacement + linear (x - centre).
struct Track
{
  TrackModel model = TrackModel::TRANSLATION;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();        ///< of the region in the reference exposure [px]
  Eigen::Vector2d displacement = Eigen::Vector2d::Zero();  ///< of the centre [px]
  Eigen::Matrix2d linear = Eigen::Matrix2d::Identity();    ///< of the model's form
  /// Of (dx, dy, l11, l12, l21, l22), positive semidefinite: only the model's own parameters vary.
  Matrix6d covariance = Matrix6d::Zero();

  /// (dx, dy, l11, l12, l21, l22)
  Vector6d warp() const;

  /// The region's warp since another exposure in which the same template was tracked. Covariances add: between the two
  /// linear parts, which are near the identity, the errors are taken to be the same numbers.
  /// Of TRANSLATION if either is: the linear part of the other alone is none since the anchor.
  /// @param anchor that exposure's, of the same centre and model, or one of the two of TRANSLATION
  Track since(const Track& anchor) const;
};

/// A model's own parameters, as many as it has; no heap.
using TrackParameters = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 6, 1>;
using TrackParametersJacobian = Eigen::Matrix<double, Eigen::Dynamic, 6, 0, 6, 6>;

/// The parameters with which a model comes nearest to a warp that need not be of its form, in least squares over points
/// around the centre with the given second moments (symmetric, positive definite; only their ratios count).
/// @param warp (dx, dy, l11, l12, l21, l22)
/// @param jacobian out: derivative with respect to the warp
TrackParameters nearestParameters(TrackModel model, const Vector6d& warp, const Eigen::Matrix2d& moments,
                                  TrackParametersJacobian& jacobian);

/// a - b of two sets of parameters; angles in [-pi, pi].
TrackParameters difference(TrackModel model, const TrackParameters& a, const TrackParameters& b);
}  // namespace xray_tracking
