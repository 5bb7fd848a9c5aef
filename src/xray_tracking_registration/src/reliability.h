#pragma once

#include <string>

#include "gauss_newton.h"

namespace xray_tracking
{
/// Covariance of the target's twist from the spread over tiles of the images: what noise, and what the model does not
/// know of, do to the pose. About the target's centre in the room [rad, mm].
Eigen::Matrix<double, 6, 6> poseCovariance(const std::vector<ViewLevel>& views, const Linearisation& at,
                                           const RestPrior& prior, const PosePair& poses, const Bodies& bodies);

/// Figures of each view but its coarse similarity. @param room_centre the target's centre in the room
std::vector<ViewResidual> viewResiduals(const std::vector<ViewLevel>& views, const Linearisation& at,
                                        const Eigen::Vector3d& room_centre);

/// The least of all views' geometric means of similarity and coarse similarity, 0 to 1.
double leastSimilarity(const std::vector<ViewResidual>& views);

/// Why a pose with these figures is not to be believed; empty if nothing speaks against it.
std::string doubt(const std::vector<ViewResidual>& views, const Eigen::Matrix<double, 6, 6>& covariance,
                  const RegistrationOptions& options);
}  // namespace xray_tracking
