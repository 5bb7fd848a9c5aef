#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <vector>

#include <xray_tracking_msgs/PatientMotion.h>
#include <xray_tracking_msgs/RefinedPose.h>

#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
/// What a bag tells of a run, by the exposure's stamp [ns].
struct TrackingRecord
{
  std::set<std::int64_t> exposures;                                       ///< every stamp that occurs
  std::map<std::int64_t, xray_tracking_msgs::PatientMotion> motions;      ///< `patient_motion`
  std::map<std::int64_t, RigidTransform> poses;                           ///< `patient_pose`
  std::map<std::int64_t, xray_tracking_msgs::RefinedPose> refined_poses;  ///< `refined_pose`
  std::map<std::int64_t, RigidTransform> ground_truth;                    ///< `patient_ground_truth`
  std::set<std::int64_t> verified;                                        ///< exposures with `verified` on `beam_gate`
  std::set<std::int64_t> gate_open;                                       ///< exposures with `open` on it
  std::string unverified;  ///< why nothing is verified, as it said last; empty if there is no `beam_gate`
};

/// Reads a recorded bag; topics count by the last part of their name. Exposures are known from `patient_motion`,
/// `patient_ground_truth` and the detectors' `camera_info`.
/// @param epoch_ns subtracted from every stamp: kPlaybackEpochNs for a played sequence, 0 for a live run
/// @throws std::runtime_error naming bag, topic and stamp: no bag, not closed, a pose that is none, a stamp answered
/// twice, a state that the message does not define, motions of two methods
TrackingRecord readTrackingRecord(const std::string& bag_path, std::int64_t epoch_ns);

/// Both judge the poses that were published, by the run's method, with the times of all that led to them; and, of
/// tracking_and_registration, as `registration`, what the registration said by itself.
///
/// Judges a live run: exposures and gold standard are those of the record.
/// @throws std::runtime_error if there is no exposure, or a gold standard that lacks some of them
Evaluation evaluateRecord(const TrackingRecord& record, const std::string& name, const Eigen::AlignedBox3d& target_box);

/// Judges a played sequence: exposures, gold standard and target box are the sequence's.
/// @throws std::runtime_error if the record has an exposure that the sequence has not
Evaluation evaluateRecord(const TrackingRecord& record, const std::string& name, const Sequence& sequence);

/// What the gate said of the evaluation's exposures.
GateCounts gateCounts(const Evaluation& evaluation, const TrackingRecord& record);

/// One line for every exposure of the evaluation that is lost or failed: frame, stamp, status and the reason given.
std::vector<std::string> unansweredExposures(const Evaluation& evaluation, const TrackingRecord& record);
}  // namespace xray_tracking
