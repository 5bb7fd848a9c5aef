#pragma once

#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "scene.h"
#include "xray_tracking_motion_estimation/motion_memory.h"
#include "xray_tracking_motion_estimation/motion_monitor.h"

namespace xray_tracking
{
constexpr std::int64_t kMillisecond = 1000000;
constexpr std::int64_t kInterval = 200 * kMillisecond;
constexpr double kExact = 1e-6;  ///< of what is computed without error, rounding aside [mm]

/// Exposures 200 ms apart, tracked exactly, and a registration that answers when the test says so. Motions are
/// translations from the initial pose, room axes [mm].
class MonitorTest : public testing::Test
{
protected:
  MonitorTest()
  {
    options.method = PoseMethod::TRACKING_AND_REGISTRATION;
    options.tracks.views = { "detector_a", "detector_b" };
    options.refinement.mode = RefinementMode::EVERY_FRAME;
    options.gate.max_displacement = 200.0;
  }

  void start()
  {
    options.derive();
    monitor.emplace(options, initialPose(), targetBox());
    monitor->tracks().setGeometry(geometriesOf(scene.views), TargetShape::isotropic(scene.targetCentre()));
    trained.assign(2, { stamp + kInterval, Eigen::Vector3d::Zero() });
  }

  /// A cube of 20 mm, which regions cover with the patient at the initial pose.
  Eigen::AlignedBox3d targetBox() const
  {
    const Eigen::Vector3d half = Eigen::Vector3d::Constant(10.0);
    return { scene.targetCentre() - half, scene.targetCentre() + half };
  }

  /// Tracks of a view as they count from the exposure that its template was trained on.
  TrackedView tracked(std::size_t view, const Eigen::Vector3d& motion) const
  {
    const RigidTransform then = moved(initialPose(), trained[view].second);
    TrackedView result;
    result.state = RegionState::TRACKING;
    result.track = scene.exactTrack(view, TrackModel::TRANSLATION,
                                    RigidTransform(Eigen::Translation3d(motion - trained[view].second)), then);
    result.region = cv::Rect(static_cast<int>(result.track.centre.x()) - 50,
                             static_cast<int>(result.track.centre.y()) - 50, 101, 101);
    result.reference_stamp = trained[view].first;
    return result;
  }

  using Alter = std::function<void(std::vector<std::optional<TrackedView>>&)>;

  /// The next exposure, complete at once.
  void expose(const Eigen::Vector3d& motion, const Alter& alter = {})
  {
    stamp += kInterval;
    now += kInterval;
    TrackedExposure exposure;
    exposure.stamp = stamp;
    exposure.arrival = now;
    exposure.age = 10 * kMillisecond;
    exposure.views = { tracked(0, motion), tracked(1, motion) };
    if (alter)
    {
      alter(exposure.views);
    }
    monitor->onExposure(std::move(exposure), now);
  }

  RefinementRequest request()
  {
    const std::optional<RefinementRequest> request = monitor->takeRequest();
    EXPECT_TRUE(request) << "nothing was asked";
    return request.value_or(RefinementRequest{ 0, 0, RigidTransform::Identity(), false });
  }

  RefinementReply believed(std::uint64_t id, const Eigen::Vector3d& motion) const
  {
    RefinementReply reply;
    reply.id = id;
    reply.success = true;
    reply.room_from_patient = moved(initialPose(), motion);
    // Of the origin: the target's is as small, as nothing is known of the rotation's part.
    reply.covariance = 1e-4 * PoseCovariance::Identity();
    reply.covariance.bottomRightCorner<3, 3>() *= 1e-4;
    reply.seed_similarity = 0.8;
    reply.similarity = 0.9;
    return reply;
  }

  static RefinementReply doubted(std::uint64_t id)
  {
    RefinementReply reply;
    reply.id = id;
    reply.text = "the probability is 0.4";
    return reply;
  }

  MotionDecision decision()
  {
    const std::optional<MotionDecision> decision = monitor->takeDecision();
    EXPECT_TRUE(decision) << "nothing was decided";
    return decision.value_or(MotionDecision());
  }

  /// An exposure that is registered `off` from the truth, before its deadline.
  MotionDecision registered(const Eigen::Vector3d& motion, const Eigen::Vector3d& off = Eigen::Vector3d::Zero(),
                            const Alter& alter = {})
  {
    expose(motion, alter);
    monitor->onReply(believed(request().id, motion + off), now + 20 * kMillisecond);
    return decision();
  }

  /// Another monitor goes on in this one's place, from the text that is kept of it. @return what it knew
  MotionMemory die()
  {
    RunMemory run;
    run.detectors = scene.views;
    run.motion = monitor->memory();
    EXPECT_TRUE(run.motion);
    const MotionMemory memory = *runMemoryFrom(textOf(run)).motion;
    monitor.emplace(options, initialPose(), targetBox());
    monitor->tracks().setGeometry(geometriesOf(scene.views), TargetShape::isotropic(scene.targetCentre()));
    monitor->takeUp(memory);
    now = 7 * kMillisecond;  // another process's clock
    return memory;
  }

  void expectPose(const MotionDecision& decision, PoseSource source, const Eigen::Vector3d& motion, double tolerance)
  {
    EXPECT_EQ(decision.state, MotionState::OK) << decision.reason;
    EXPECT_EQ(decision.source, source) << decision.not_registered;
    EXPECT_EQ(decision.not_registered.empty(), source == PoseSource::REGISTERED) << decision.not_registered;
    EXPECT_LT((decision.displacement - motion).norm(), tolerance);
    const Eigen::Vector3d target = decision.room_from_patient * scene.targetCentre();
    EXPECT_LT((target - scene.target - motion).norm(), tolerance);
    EXPECT_FALSE(monitor->takeDecision());
  }

  void expectNone(const MotionDecision& decision, MotionState state, const std::string& words)
  {
    EXPECT_EQ(decision.state, state) << decision.reason;
    EXPECT_EQ(decision.source, PoseSource::NONE);
    EXPECT_NE(decision.reason.find(words), std::string::npos) << decision.reason;
    EXPECT_FALSE(monitor->takeDecision());
  }

  static void loseAll(std::vector<std::optional<TrackedView>>& views)
  {
    for (std::optional<TrackedView>& view : views)
    {
      view->state = RegionState::LOST;
    }
  }

  static void loseFirst(std::vector<std::optional<TrackedView>>& views) { views[0]->state = RegionState::LOST; }

  Scene scene{ cyberknife(), { 5.0, -8.0, 3.0 } };
  MotionMonitorOptions options;
  std::optional<MotionMonitor> monitor;
  std::vector<std::pair<std::int64_t, Eigen::Vector3d>> trained;  ///< of each view's template: stamp, motion
  std::int64_t stamp = 1700000000000000000;
  std::int64_t now = 5000 * kMillisecond;
};
}  // namespace xray_tracking
