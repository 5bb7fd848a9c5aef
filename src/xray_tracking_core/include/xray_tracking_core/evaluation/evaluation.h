#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "xray_tracking_core/geometry/rigid_transform.h"
#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
/// Target registration error, eq. (9): the root mean square distance [mm] of where two poses put the points of a box.
/// Exact integral over the box (the distance is quadratic in the point), not a sum over samples.
double targetRegistrationError(const RigidTransform& estimate, const RigidTransform& gold,
                               const Eigen::AlignedBox3d& target_box);

/// Quantile by linear interpolation between order statistics (numpy's default), q in [0, 1].
/// @throws std::invalid_argument if `values` is empty or holds a NaN, or q is out of range
double quantile(std::vector<double> values, double q);

/// Result of a two-sided paired t-test of equal means.
struct PairedTTest
{
  double t = 0.0;
  double p = 1.0;
  int n = 0;
};

/// @throws std::invalid_argument for unequal lengths, fewer than two pairs or values that are not finite. Identical
/// samples give t = 0, p = 1; differences that are all the same to the last bit give t = +-infinity, p = 0.
PairedTTest pairedTTest(const std::vector<double>& a, const std::vector<double>& b);

enum class FrameStatus
{
  OK,
  LOST,   ///< the method said that it has no pose
  FAILED  ///< no answer for the frame
};

/// One frame of one method.
struct FrameResult
{
  FrameStatus status = FrameStatus::FAILED;
  RigidTransform room_from_patient = RigidTransform::Identity();  ///< valid if status is OK
  double cpu_s = 0.0;                                             ///< processor time spent on the frame
  double wall_s = 0.0;                                            ///< time spent on the frame
};

/// All frames of one method, one for each frame of the evaluation.
struct MethodResult
{
  std::string method;
  std::vector<FrameResult> frames;
};

/// What a run's beam gate said of the frames.
struct GateCounts
{
  int verified = 0;  ///< the pose was verified: by a registration, or by who stated that the initial one is
  int open = 0;      ///< the beam need not have been held
};

/// What an evaluation judges. Without a gold standard there are poses and times but no errors, and no `uncorrected`.
struct Evaluation
{
  std::string sequence;                       ///< its name
  std::vector<std::int64_t> stamps_ns;        ///< one for each frame
  std::vector<RigidTransform> gold_standard;  ///< room_from_patient, one for each frame; empty if it is not known
  Eigen::AlignedBox3d target_box;
  std::optional<GateCounts> gate;     ///< if there was one
  std::vector<MethodResult> methods;  ///< without `uncorrected`, which follows from the gold standard, eq. (10)
};

/// Times of one method [s]: its first frame (training and loading included), then all further frames that it answered,
/// lost ones too. NaN where there is no such frame.
struct TimeSummary
{
  double first = 0.0;
  double median = 0.0;
  double mean = 0.0;
  double max = 0.0;
};

/// Summary figures of one method over all frames after the first; quantiles over the frames that have a pose.
struct MethodSummary
{
  std::string method;
  std::vector<double> tre_mm;  ///< of the frames with a pose, in order
  int frames = 0;              ///< judged, i.e. all but the first
  int lost = 0;
  int failed = 0;
  double within_1_2_mm = 0.0;  ///< share of all judged frames, 0..1; NaN without a gold standard or judged frames
  double within_2_4_mm = 0.0;
  TimeSummary cpu_s;
  TimeSummary wall_s;
};

/// One summary a method, `uncorrected` first. A frame whose status is OK but whose pose is not a finite rigid transform
/// counts as failed.
/// @throws std::invalid_argument if the numbers of frames disagree, stamps do not grow, or a method's name is taken
std::vector<MethodSummary> summarize(const Evaluation& evaluation);

/// Writes tre.csv, poses.csv and summary.json (docs/evaluation.md) into a folder, which is made if need be. What is not
/// known is an empty field or null, never NaN; translation_error_mm is the distance at the target box's centre.
/// @throws std::runtime_error if a file cannot be written; as summarize()
void writeEvaluation(const Evaluation& evaluation, const std::string& directory);

/// The summary as a table for a terminal.
std::string formatTable(const Evaluation& evaluation);
}  // namespace xray_tracking
