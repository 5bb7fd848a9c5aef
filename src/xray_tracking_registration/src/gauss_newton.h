#pragma once

#include <vector>

#include "image_level.h"
#include "run_control.h"

namespace xray_tracking
{
/// Maximum likelihood of the normalised images of all views, linearised at a pose: what the model, at its best scale,
/// leaves over is noise, whose variance in each view follows from the differences.
struct Linearisation
{
  std::vector<ViewModel> models;  ///< one a view
  /// Inverse variances with Huber's weights, one a pixel: noise and, where both bodies move, what the rest's
  /// deformation makes of its edges.
  std::vector<Eigen::VectorXf> weights;

  double meanSimilarity() const;
  /// Weighted sum of squared differences, with other weights than its own if need be.
  double cost(const std::vector<ViewLevel>& views, const std::vector<Eigen::VectorXf>& by) const;
};

/// What is believed of the rest's pose relative to the target's before the images are seen.
struct RestPrior
{
  RigidTransform target_from_rest = RigidTransform::Identity();
  Twist information = Twist::Zero();  ///< inverse variances of the twist's components [1 / rad^2, 1 / mm^2]

  /// Twist of the rest away from where the prior has it, in the room about the target's centre.
  Twist deviation(const PosePair& poses, const Eigen::Vector3d& centre) const;
};

/// Renders all views at a pose.
/// @param near linearisation at a pose nearby, whose rendering of the rest is followed where that does; may be null
Linearisation linearise(const std::vector<ViewLevel>& views, const Bodies& bodies, const PosePair& poses, Moving moving,
                        const Linearisation* near = nullptr);

/// Correlation coefficient of every view at a pose.
std::vector<double> similarities(const std::vector<ViewLevel>& views, const Bodies& bodies, const PosePair& poses);

/// Of every view: its derivatives' sums and those with what the model leaves over, by the linearisation's weights.
std::vector<WeighedSums> weighedSumsOf(const std::vector<ViewLevel>& views, const Linearisation& at);

/// Normal equations of a linearisation; unknowns are the twists [rad, mm], then the saturation of every view.
struct NormalEquations
{
  Eigen::MatrixXd information;
  Eigen::VectorXd gradient;
};
/// Those of all images and of what is known beforehand: of each view's saturation, and, where both bodies move, of the
/// rest.
NormalEquations normalEquations(const std::vector<ViewLevel>& views, const Linearisation& at, const RestPrior& prior,
                                const PosePair& poses, const Eigen::Vector3d& centre);

/// Moves both bodies by a step of the twists.
PosePair moved(const PosePair& poses, const Eigen::VectorXd& twists, const Eigen::Vector3d& centre, Moving moving);

/// When a descent ends, at the latest.
struct Descent
{
  int max_iterations;
  double min_gain;  ///< relative decrease of the cost that is worth a further iteration
};

/// Levenberg-Marquardt from `poses`, which holds the best poses afterwards.
/// @param start linearisation at `poses`
/// @return the one at the best poses
Linearisation gaussNewton(const std::vector<ViewLevel>& views, const Bodies& bodies, Moving moving,
                          const RestPrior& prior, const Descent& descent, Linearisation start, RunControl& control,
                          PosePair& poses);
}  // namespace xray_tracking
