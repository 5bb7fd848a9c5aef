#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <ros/time.h>
#include <xray_tracking_msgs/PatientMotion.h>
#include <xray_tracking_msgs/RefinedPose.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "gate_light.h"

namespace xray_tracking
{
/// What a person asks of the graph.
enum class Command
{
  HOLD,    ///< or release
  TRAIN,   ///< every tracker learns its template anew; the references stay
  REFINE,  ///< the latest exposure is registered, and motion estimation is asked to have the next one registered
  RESET,   ///< trackers forget their templates, motion estimation starts over at the initial pose
  LOAD_CT
};
constexpr std::size_t kCommands = 5;

struct CommandState
{
  bool offered = false;  ///< all that it needs is there
  bool busy = false;
  bool failed = false;
  std::string text;  ///< what is missing, or how far it is, or what came of it; may be empty
};

/// Of one tracker, as its last message says.
struct TrackerView
{
  std::string detector;
  std::uint8_t state = xray_tracking_msgs::TrackedRegion::UNTRAINED;
  std::string fault;
  double correlation = 0.0;
  std::int64_t arrival = 0;  ///< monotonic clock [ns]; 0 if nothing came so far
};

/// Out of what motion estimation publishes, for a chart each.
enum class Quantity
{
  DISPLACEMENT,  ///< [mm]
  ROTATION,      ///< [degrees]
  SIGMA,         ///< of the displacement in its worst direction [mm]
  DISAGREEMENT,  ///< [px]
  SIMILARITY,
  LATENCY  ///< [ms]
};
constexpr std::size_t kQuantities = 6;

/// Everything at one time.
struct TreatmentView
{
  std::optional<HeardGate> gate;
  GateView gate_view;
  std::optional<xray_tracking_msgs::PatientMotion> motion;
  std::optional<xray_tracking_msgs::RefinedPose> refined;
  std::int64_t motion_arrival = 0, refined_arrival = 0;  ///< monotonic clock [ns]
  bool registration = false;                             ///< the node is there
  double rate = 0.0;                                     ///< exposures a second, over the last five
  /// What the gate says of the target is of its latest exposure: that has a pose. Otherwise it is of an earlier one.
  bool measured = false;
  std::optional<double> exposure_age;  ///< of the gate's latest exposure [s]; none: there is none
  bool stale = false;                  ///< it is older than the gate lets it be
  std::vector<TrackerView> trackers;
  double max_displacement = 3.0, max_rotation = 3.0, max_sigma = 1.5;  ///< the gate's tolerances [mm, degrees, mm]
  std::array<CommandState, kCommands> commands;
  std::string frozen_clock;  ///< what is wrong with time; empty if nothing is
};

/// By the monotonic clock [ns].
inline std::int64_t steadyNanoseconds()
{
  return static_cast<std::int64_t>(ros::SteadyTime::now().toNSec());
}
}  // namespace xray_tracking
