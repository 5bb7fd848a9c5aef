#pragma once

#include <vector>

#include "image_level.h"
#include "run_control.h"

namespace xray_tracking
{
/// Least squares of the normalised images of all views, linearised at a pose.
struct Linearisation
{
  std::vector<ViewModel> models;         ///< one a view
  std::vector<Eigen::VectorXf> weights;  ///< Huber's, one a pixel
  std::vector<double> similarity;        ///< correlation coefficient of every view

  double meanSimilarity() const;
  /// Weighted sum of squared differences, with other weights than its own if need be.
  double cost(const std::vector<ViewLevel>& views, const std::vector<Eigen::VectorXf>& by) const;
};

/// Renders all views at a pose.
Linearisation linearise(const std::vector<ViewLevel>& views, const Bodies& bodies, const PosePair& poses,
                        Moving moving);

/// Normal equations of a linearisation; unknowns in rad and mm.
struct NormalEquations
{
  Eigen::MatrixXd information;
  Eigen::VectorXd gradient;
};
NormalEquations normalEquations(const std::vector<ViewLevel>& views, const Linearisation& at);

/// Moves both bodies by a step of the unknowns.
PosePair moved(const PosePair& poses, const Eigen::VectorXd& step, const Eigen::Vector3d& centre, Moving moving);

/// When a descent ends, at the latest.
struct Descent
{
  int max_iterations;
  double min_gain;  ///< relative decrease of the cost that is worth a further iteration
};

/// Levenberg-Marquardt from `poses`, which holds the best poses afterwards. @return the linearisation there
Linearisation gaussNewton(const std::vector<ViewLevel>& views, const Bodies& bodies, Moving moving,
                          const Descent& descent, RunControl& control, PosePair& poses);
}  // namespace xray_tracking
