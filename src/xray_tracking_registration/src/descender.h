#pragma once

#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "gauss_newton.h"
#include "run_control.h"
#include "xray_tracking_registration/registration.h"
#include "xray_tracking_registration/similarity.h"

namespace xray_tracking
{
constexpr Resolution kCoarse{ 2.2, 11.0 };
constexpr Resolution kFine{ 1.1, 1.1, 25.0 };

/// Which levels a descent goes through before the finest one.
enum class Path
{
  COARSE,  ///< the coarse level, as one body and then as two: reaches farthest, but what most of the images show leads
  MEDIUM,  ///< a medium one, as two bodies at once: where the start is better than where the rest leads
  SHIFT    ///< a shift of up to 8 mm along each axis by correlation: from one exposure to the next
};

/// Where one descent ended.
struct Outcome
{
  PosePair poses;
  std::vector<ViewResidual> views;
  double similarity = -1.0;
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  BeliefFigures figures;
  double probability = 0.0;  ///< as RegistrationResult's
  bool rest_sought = false;  ///< whether Descender::seekRest has been tried
  std::string doubt;         ///< why it is not to be believed; empty if it is
};

/// Doubts an outcome for a reason that its probability does not know of: then it is as likely wrong as right, at best.
void doubtFor(std::string reason, Outcome& outcome);

/// The finest level from a pose, and what it says there.
struct FineLevel
{
  std::vector<ViewLevel> views;
  Linearisation at;
};

/// One run of a registration.
struct Run
{
  const RegistrationRequest& request;
  std::vector<AttenuationImage> attenuation;  ///< one a view
  RunControl& control;
};

/// Whether a pose is so near a start that is verified that no other vertebra lies between.
bool nearVerifiedStart(const Run& run, const RigidTransform& room_from_patient);

/// Descends from one start to the pose that is most alike, and judges it.
class Descender
{
public:
  /// Keeps the bodies' address.
  /// @param voxel_edge of the CT, geometric mean [mm]
  Descender(const Bodies& bodies, const Eigen::AlignedBox3d& target_box, double voxel_edge,
            const RegistrationOptions& options);

  /// Along a path to the finest level, and then judged. Derivative-free optimisers have a path of their own.
  Outcome descend(const Run& run, const PosePair& start, Path path) const;
  /// From the finest level at the start on, and then judged.
  Outcome descend(const Run& run, const PosePair& start, FineLevel fine) const;

  /// Tries other postures of the rest, as descents get stuck in them: once, and takes what is more alike.
  void seekRest(const Run& run, Outcome& outcome) const;

  /// @throws std::invalid_argument as makeViews
  FineLevel fineLevel(const Run& run, const PosePair& poses) const;

  /// Of a resolution in mm at the target, so that nothing hangs on the panel's pitch or the magnification. Neither bins
  /// below half of a CT's voxel nor a high-pass finer than it: there is only noise to compare.
  /// @throws std::invalid_argument naming the view that does not see the target, or as ViewLevel
  std::vector<ViewLevel> makeViews(const Run& run, const PosePair& poses, const Resolution& resolution) const;

  Moving moving() const { return moving_; }
  /// What moves while both bodies move as one.
  Moving together() const { return moving_ == Moving::TARGET ? moving_ : Moving::TOGETHER; }

private:
  cv::Rect region(const RegistrationView& view, const RigidTransform& room_from_patient) const;
  void follow(const Run& run, Path path, PosePair& poses) const;
  void descendDerivativeFree(const Run& run, PosePair& poses) const;
  /// BeliefFigures::loss_aside. @param tiles PoseSpread::tiles
  double lossAside(const FineLevel& fine, const Eigen::Matrix<double, 6, 6>& tiles, const Outcome& outcome) const;
  void judge(const Run& run, const FineLevel& fine, Outcome& outcome) const;
  static RestPrior priorOf(const Run& run);

  const Bodies& bodies_;
  Eigen::AlignedBox3d box_;
  double voxel_edge_;
  RegistrationOptions options_;
  std::unique_ptr<const Similarity> similarity_;
  Moving moving_;
};
}  // namespace xray_tracking
