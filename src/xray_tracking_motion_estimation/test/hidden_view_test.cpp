// What passes in front of a view is not learnt for the target, nor followed.

#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "monitor_test.h"
#include "xray_tracking_motion_estimation/view_clarity.h"

namespace xray_tracking
{
namespace
{
constexpr std::int64_t kSecond = 1000000000;
using Views = std::vector<bool>;

/// Registrations ten times a second.
class ViewClarityTest : public testing::Test
{
protected:
  Views look(double first, double second)
  {
    stamp_ += kSecond / 10;
    return clarity_.hidden({ first, second }, stamp_);
  }

  ViewClarity clarity_;
  std::int64_t stamp_ = 0;
};

TEST_F(ViewClarityTest, JudgesAViewByItsOwnPast)
{
  // A view that is always poor is not hidden.
  for (int i = 0; i < 20; ++i)
  {
    EXPECT_EQ((Views{ false, false }), look(0.3, 0.9));
  }
  EXPECT_EQ((Views{ false, true }), look(0.2, 0.4));
  EXPECT_EQ((Views{ true, false }), look(0.14, 0.5));
  // However long it is hidden, that does not become its usual state.
  for (int i = 0; i < 3000; ++i)
  {
    EXPECT_EQ((Views{ true, false }), look(0.14, 0.9)) << i;
  }
  clarity_.restart();
  EXPECT_EQ((Views{ false, false }), look(0.14, 0.9));
}

TEST_F(ViewClarityTest, WhatComesSlowlyIsSeen)
{
  look(0.9, 0.9);
  bool hidden = false;
  for (int i = 0; i < 200; ++i)  // within 20 s
  {
    hidden = look(0.9 - 0.76 * i / 200.0, 0.9)[0];
  }
  EXPECT_TRUE(hidden);
}

TEST_F(ViewClarityTest, WhatHidTheTargetAtFirstIsSoonTold)
{
  look(0.14, 0.9);
  for (int i = 0; i < 3; ++i)
  {
    EXPECT_EQ((Views{ false, false }), look(0.9, 0.9));
  }
  EXPECT_EQ((Views{ true, false }), look(0.14, 0.9));
}

TEST_F(ViewClarityTest, WhatWasNotComparedStaysAsItWas)
{
  const double blind = std::numeric_limits<double>::quiet_NaN();
  look(0.9, 0.9);
  EXPECT_EQ((Views{ true, false }), look(0.14, 0.9));
  EXPECT_EQ((Views{ true, false }), look(blind, 0.9)) << "what hid it may still be there";
  EXPECT_EQ((Views{ true, false }), clarity_.hidden({}, stamp_));
  EXPECT_EQ((Views{ false, false }), look(0.9, 0.9));
  EXPECT_EQ((Views{ false, false }), look(blind, 0.9));
}

TEST_F(ViewClarityTest, NumbersThatAreNoSimilaritiesTellNothing)
{
  look(0.9, 0.9);
  for (const double wrong : { std::numeric_limits<double>::quiet_NaN(), 1e6, -1e6 })
  {
    EXPECT_EQ((Views{ false, false }), look(wrong, 0.9));
    EXPECT_EQ((Views{ false, false }), clarity_.hidden({}, stamp_));
    EXPECT_EQ((Views{ true, false }), look(0.14, 0.9));
    EXPECT_EQ((Views{ false, false }), look(0.9, 0.9));
  }
  clarity_.restart();
  EXPECT_EQ((Views{ false, false }), look(-0.3, 0.9));
  EXPECT_EQ((Views{ false, false }), look(-0.3, 0.9));
}

TEST(ViewClarity, FiguresStandAtTheirViews)
{
  const std::vector<std::string> views{ "b", "a", "c" };
  const std::vector<double> figures = ofViews({ 0.3, 0.9 }, { "a", "b" }, views);
  ASSERT_EQ(3u, figures.size());
  EXPECT_EQ(0.9, figures[0]);
  EXPECT_EQ(0.3, figures[1]);
  EXPECT_TRUE(std::isnan(figures[2])) << "it was not compared";
  EXPECT_EQ((std::vector<double>{ 0.9 }), ofViews({ 0.3, 0.9 }, { "a", "b" }, { "b" }));
  EXPECT_TRUE(ofViews({ 0.3 }, { "a", "b" }, views).empty()) << "which view it is of is not known";
  EXPECT_TRUE(ofViews({}, { "a", "b" }, views).empty());
}

class HiddenViewTest : public MonitorTest
{
protected:
  /// An exposure that is registered where the target is; the first view's similarity is told.
  void see(const Eigen::Vector3d& motion, double first_similarity, const Alter& alter = {})
  {
    expose(motion, alter);
    RefinementReply reply = believed(request().id, motion);
    reply.view_similarities = { first_similarity, 0.9 };
    monitor->onReply(reply, now + 20 * kMillisecond);
    expectPose(decision(), PoseSource::REGISTERED, motion, kExact);
  }

  /// As see(), after one that was not registered: without tracks it takes a second one to be believed.
  void seeAgain(const Eigen::Vector3d& motion)
  {
    expose(motion);
    monitor->onReply(believed(request().id, motion), now + 20 * kMillisecond);
    expectNone(decision(), MotionState::LOST, "has to confirm");
    see(motion, kClear);
  }

  /// An exposure that nobody knows the pose of.
  void seeNothing(const Eigen::Vector3d& motion)
  {
    expose(motion, loseAll);
    monitor->onReply(doubted(request().id), now);
    expectNone(decision(), MotionState::LOST, "lost");
  }

  /// The first view's next template, learnt where the target is in the latest exposure.
  void learn(const Eigen::Vector3d& motion) { trained[0] = { stamp, motion }; }

  /// The first view learns its template, at the initial pose, while something hides the target.
  void learnWhatHides()
  {
    start();
    see({ 0.0, 0.0, 0.0 }, kClear);
    see({ 0.0, 0.0, 0.0 }, kClear);
    learn({ 0.0, 0.0, 0.0 });
    see({ 0.0, 0.0, 0.0 }, kHidden);
  }

  void expectProposal(const Eigen::Vector3d& motion)
  {
    const std::optional<RegionProposal> proposal = monitor->takeProposal();
    ASSERT_TRUE(proposal);
    EXPECT_EQ(0u, proposal->view);
    // Of the initial pose's template, which all regions are as large as.
    const cv::Rect expected = tracked(0, motion).region;
    const Eigen::Vector2d shift = tracked(0, motion).track.displacement;
    EXPECT_LT(
        (Eigen::Vector2d(proposal->region.x, proposal->region.y) - Eigen::Vector2d(expected.x, expected.y) - shift)
            .norm(),
        1.5);
    EXPECT_EQ(expected.size(), proposal->region.size());
  }

  static constexpr double kClear = 0.9, kHidden = 0.14;
};

TEST_F(HiddenViewTest, IsNotToLearnWhatHidesTheTarget)
{
  start();
  see({ 0.0, 0.0, 0.0 }, kClear);
  see({ 1.0, 0.0, 0.0 }, kClear);
  for (int i = 0; i < 10; ++i)
  {
    see({ 1.0, 0.0, 0.0 }, kHidden, loseFirst);
    EXPECT_FALSE(monitor->takeProposal()) << i;
  }
  see({ 1.0, 0.0, 0.0 }, kClear, loseFirst);
  EXPECT_FALSE(monitor->takeProposal());
  see({ 1.0, 0.0, 0.0 }, kClear, loseFirst);
  expectProposal({ 1.0, 0.0, 0.0 });
}

/// Along the other view's rays nothing tells where the target is.
TEST_F(HiddenViewTest, ClosesTheGateWhereOneOtherViewIsLeft)
{
  start();
  for (int i = 0; i < options.gate.good_exposures; ++i)
  {
    see({ 0.0, 0.0, 0.0 }, kClear);
  }
  ASSERT_TRUE(monitor->gate().open()) << monitor->gate().text();
  for (int i = 0; i < 10; ++i)
  {
    see({ 0.0, 0.0, 0.0 }, kHidden);
    EXPECT_EQ(GateReason::UNCERTAIN, monitor->gate().reason());
    EXPECT_NE(std::string::npos, monitor->gate().text().find("hides it from detector_a")) << monitor->gate().text();
  }
  for (int i = 0; i < options.gate.good_exposures; ++i)
  {
    EXPECT_FALSE(monitor->gate().open());
    see({ 0.0, 0.0, 0.0 }, kClear);
  }
  EXPECT_TRUE(monitor->gate().open()) << monitor->gate().text();
}

/// What the registration does not see, tracks do not either, whatever they say.
TEST_F(HiddenViewTest, CountsForNothingUntilARegistrationSeesTheTarget)
{
  start();
  for (int i = 0; i < options.gate.good_exposures; ++i)
  {
    see({ 0.0, 0.0, 0.0 }, kClear);
  }
  see({ 0.0, 0.0, 0.0 }, kHidden);
  for (int i = 0; i < 2 * options.gate.good_exposures; ++i)
  {
    expose({ 0.1 * i, 0.0, 0.0 });
    monitor->onReply(doubted(request().id), now);
    expectNone(decision(), MotionState::LOST, "something hides the target from detector_a");
    EXPECT_FALSE(monitor->gate().open());
  }
  seeAgain({ 0.0, 0.0, 0.0 });
  expose({ 0.3, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectPose(decision(), PoseSource::TRACKED, { 0.3, 0.0, 0.0 }, 1e-3);
}

TEST_F(HiddenViewTest, ALateRegistrationTellsToo)
{
  start();
  for (int i = 0; i < options.gate.good_exposures; ++i)
  {
    see({ 0.0, 0.0, 0.0 }, kClear);
  }
  ASSERT_TRUE(monitor->gate().open()) << monitor->gate().text();
  expose({ 0.0, 0.0, 0.0 });
  RefinementReply late = believed(request().id, { 0.0, 0.0, 0.0 });
  late.view_similarities = { kHidden, 0.9 };
  now += 150 * kMillisecond;
  monitor->onTime(now);
  expectPose(decision(), PoseSource::TRACKED, { 0.0, 0.0, 0.0 }, 1e-3);
  monitor->onReply(late, now);
  expose({ 0.0, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectNone(decision(), MotionState::LOST, "something hides the target from detector_a");
  EXPECT_FALSE(monitor->gate().open());
}

/// It has come between the proposal and the exposure that is learnt from.
TEST_F(HiddenViewTest, WhatHidTheTargetWhenItWasLearntIsLearntAnew)
{
  start();
  see({ 0.0, 0.0, 0.0 }, kClear);
  see({ 1.0, 0.0, 0.0 }, kClear);
  learn({ 1.0, 0.0, 0.0 });
  for (int i = 0; i < 3; ++i)
  {
    see({ 1.5, 0.0, 0.0 }, kHidden);
    EXPECT_FALSE(monitor->takeProposal()) << i;
  }
  see({ 2.0, 0.0, 0.0 }, kClear);
  EXPECT_FALSE(monitor->takeProposal());
  expose({ 2.0, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectNone(decision(), MotionState::LOST, "while something hid the target");
  seeAgain({ 2.0, 0.0, 0.0 });
  EXPECT_FALSE(monitor->takeProposal());
  see({ 2.0, 0.0, 0.0 }, kClear);
  expectProposal({ 2.0, 0.0, 0.0 });
  learn({ 2.0, 0.0, 0.0 });
  for (int i = 0; i < 10; ++i)
  {
    see({ 2.0, 0.0, 0.0 }, kClear);
    EXPECT_FALSE(monitor->takeProposal()) << "what was learnt of the target stays";
  }
}

/// Such a template is none of a stated pose either, whose region it may cover.
TEST_F(HiddenViewTest, WhatHidTheTargetWhenItWasLearntIsLearntAnewAfterAClaimToo)
{
  learnWhatHides();
  EXPECT_EQ("", monitor->claim(initialPose(), now));
  monitor->onReply(believed(request().id, { 0.0, 0.0, 0.0 }), now);
  EXPECT_EQ("", monitor->takeOutcome().value_or(ClaimOutcome{ "no outcome" }).refusal);
  see({ 0.0, 0.0, 0.0 }, kClear);
  const std::optional<RegionProposal> proposal = monitor->takeProposal();
  ASSERT_TRUE(proposal);
  EXPECT_EQ(0u, proposal->view);
  learn({ 0.0, 0.0, 0.0 });
  for (int i = 0; i < 3; ++i)
  {
    see({ 0.0, 0.0, 0.0 }, kClear);
    EXPECT_FALSE(monitor->takeProposal());
  }
  expose({ 0.3, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectPose(decision(), PoseSource::TRACKED, { 0.3, 0.0, 0.0 }, 1e-3);
}

/// That the patient is at the initial pose makes no target of what was learnt.
TEST_F(HiddenViewTest, WhatHidTheTargetWhenItWasLearntIsLearntAnewAfterARestartToo)
{
  learnWhatHides();
  monitor->restart("");
  expose({ 0.0, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectNone(decision(), MotionState::LOST, "while something hid the target");
  seeAgain({ 0.0, 0.0, 0.0 });
  see({ 0.0, 0.0, 0.0 }, kClear);
  const std::optional<RegionProposal> proposal = monitor->takeProposal();
  ASSERT_TRUE(proposal);
  EXPECT_EQ(0u, proposal->view);
  learn({ 0.0, 0.0, 0.0 });
  see({ 0.0, 0.0, 0.0 }, kClear);
  expose({ 0.3, 0.0, 0.0 });
  monitor->onReply(doubted(request().id), now);
  expectPose(decision(), PoseSource::TRACKED, { 0.3, 0.0, 0.0 }, 1e-3);
}

/// An exposure that a view was left out of tells nothing of what it has learnt.
TEST_F(HiddenViewTest, ATemplateIsJudgedOnceItsViewIsCompared)
{
  scene.views = viewsAround(3);
  options.tracks.views = { "a", "b", "c" };
  start();
  trained.push_back(trained.front());
  const double blind = std::numeric_limits<double>::quiet_NaN();
  const auto look = [&](double first_similarity)
  {
    const auto alter = [&](std::vector<std::optional<TrackedView>>& views)
    {
      views.push_back(tracked(2, { 0.0, 0.0, 0.0 }));
      views[0]->state = std::isnan(first_similarity) ? RegionState::BLIND : RegionState::TRACKING;
    };
    expose({ 0.0, 0.0, 0.0 }, alter);
    RefinementReply reply = believed(request().id, { 0.0, 0.0, 0.0 });
    reply.view_similarities = { first_similarity, 0.9, 0.9 };
    monitor->onReply(reply, now);
    expectPose(decision(), PoseSource::REGISTERED, { 0.0, 0.0, 0.0 }, kExact);
  };
  look(kClear);
  look(kClear);
  learn({ 0.0, 0.0, 0.0 });
  look(blind);
  look(kHidden);
  look(kClear);
  EXPECT_TRUE(monitor->tracks().isSpoilt(0, tracked(0, { 0.0, 0.0, 0.0 })));
  EXPECT_FALSE(monitor->takeProposal());
  look(kClear);
  EXPECT_TRUE(monitor->takeProposal());
}

/// A template of an unknown pose follows an instrument, whose way tells nothing of where the target's region is.
TEST_F(HiddenViewTest, WhatFollowsSomethingElseDoesNotTakeTheRegionAlong)
{
  start();
  see({ 0.0, 0.0, 0.0 }, kClear);
  see({ 1.0, 0.0, 0.0 }, kClear);
  seeNothing({ 1.0, 0.0, 0.0 });
  learn({ 1.0, 0.0, 0.0 });
  seeNothing({ 1.0, 0.0, 0.0 });
  double way = 0.0;
  const auto follow = [&way](std::vector<std::optional<TrackedView>>& views)
  { views[0]->track.displacement.x() += way; };
  std::optional<RegionProposal> proposal;
  for (int i = 0; i < 4 && !proposal; ++i)
  {
    way = 90.0 + 3.0 * i;
    expose({ 1.0, 0.0, 0.0 }, follow);
    RefinementReply reply = believed(request().id, { 1.0, 0.0, 0.0 });
    reply.view_similarities = { kClear, kClear };
    monitor->onReply(reply, now + 20 * kMillisecond);
    decision();
    proposal = monitor->takeProposal();
  }
  ASSERT_TRUE(proposal);
  const cv::Rect there = tracked(0, { 1.0, 0.0, 0.0 }).region;
  EXPECT_LT((Eigen::Vector2d(proposal->region.x, proposal->region.y) - Eigen::Vector2d(there.x, there.y)).norm(), 5.0)
      << proposal->region.x << ", " << proposal->region.y;
}
}  // namespace
}  // namespace xray_tracking
