// What an operator is told, and what becomes of what he asks, when others are late, gone, or fail. Without RViz.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <QApplication>
#include <QDialog>
#include <QDockWidget>
#include <QMainWindow>
#include <QMessageBox>
#include <QProcess>
#include <QPushButton>
#include <QTimer>

#include <gtest/gtest.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <std_msgs/Header.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>
#include <xray_tracking_msgs/BeamGate.h>
#include <xray_tracking_msgs/PatientMotion.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "spin_until.h"
#include "treatment_panel.h"
#include "treatment_widgets.h"

namespace xray_tracking
{
namespace
{
using std_srvs::SetBool;
using std_srvs::Trigger;
using xray_tracking_msgs::BeamGate;
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::TrackedRegion;

BeamGate gateOf(std::uint8_t reason, const ros::Time& exposure, double millimetres)
{
  BeamGate gate;
  gate.header.stamp = ros::Time::now();
  gate.valid_until = gate.header.stamp + ros::Duration(0.4);  // far more than in a room, for a busy machine
  gate.open = static_cast<std::uint8_t>(reason == BeamGate::NONE);
  gate.reason = reason;
  gate.text = QString::number(millimetres, 'f', 2).toStdString();
  gate.exposure = exposure;
  gate.max_age = ros::Duration(0.5);
  gate.displacement.x = 1e-3 * millimetres;
  gate.rotation = 0.01;
  return gate;
}

constexpr const char* kSecondGate = "--second-gate";

/// What a second process of this program does: it publishes on beam_gate, too.
int sendAnotherGate(int argc, char** argv)
{
  ros::init(argc, argv, "second_gate");
  const ros::Publisher publisher = ros::NodeHandle().advertise<BeamGate>("beam_gate", 1);
  while (ros::ok())
  {
    publisher.publish(gateOf(BeamGate::DISPLACED, ros::Time(), 0.0));
    ros::WallDuration(0.02).sleep();
  }
  return 0;
}

/// In place of motion estimation and trackers. Its services are answered in threads of their own, as other nodes' are.
class TreatmentFaultsTest : public testing::Test
{
protected:
  TreatmentFaultsTest() { others_.setCallbackQueue(&queue_); }

  void SetUp() override
  {
    gates_ = nh_.advertise<BeamGate>("beam_gate", 1);
    motions_ = nh_.advertise<PatientMotion>("patient_motion", 10);
    spinner_.start();
  }

  void TearDown() override { spinner_.stop(); }

  /// One exposure as motion estimation says it.
  void say(std::uint8_t state, std::uint8_t reason, double millimetres)
  {
    PatientMotion motion;
    motion.header.stamp = ros::Time::now();
    motion.state = state;
    motion.source = PatientMotion::TRACKED;
    motions_.publish(motion);
    gates_.publish(gateOf(reason, motion.header.stamp, millimetres));
  }

  template <typename Service>
  void offer(const std::string& name,
             std::function<void(const typename Service::Request&, typename Service::Response&)> answer)
  {
    const boost::function<bool(typename Service::Request&, typename Service::Response&)> callback =
        [answer](typename Service::Request& request, typename Service::Response& response)
    {
      response.success = 1U;
      answer(request, response);
      return true;
    };
    servers_.push_back(others_.advertiseService(name, callback));
  }

  static void waitFor(const std::atomic<bool>& flag)
  {
    for (int i = 0; i < 1000 && !flag; ++i)
    {
      ros::WallDuration(0.01).sleep();
    }
  }

  ros::NodeHandle nh_, others_;
  ros::Publisher gates_, motions_;
  ros::CallbackQueue queue_;
  std::vector<ros::ServiceServer> servers_;
  ros::AsyncSpinner spinner_{ 6, &queue_ };
};

class Panel
{
public:
  Panel()
  {
    panel.initialize(nullptr);
    panel.show();
  }
  std::optional<double> distance() const { return bars->value(3); }

  TreatmentPanel panel;
  GateBanner* banner = panel.findChild<GateBanner*>("gate_banner");
  ToleranceBars* bars = panel.findChild<ToleranceBars*>("tolerance_bars");
};

TEST_F(TreatmentFaultsTest, BannerAndBarsShowTheSameExposure)
{
  Panel shown;
  std::atomic<bool> stop{ false };
  std::thread sender(
      [&]
      {
        for (double millimetres = 3.0; !stop; millimetres += 0.5)
        {
          say(PatientMotion::OK, BeamGate::DISPLACED, millimetres);
          ros::WallDuration(0.02).sleep();
        }
      });
  EXPECT_TRUE(spinUntil([&] { return shown.distance().has_value(); }));
  int compared = 0;
  std::string last;
  spinUntil(
      [&]
      {
        const std::string& reason = shown.banner->shown().reason;
        if (reason != last)
        {
          last = reason;
          ++compared;
          EXPECT_EQ(reason.substr(reason.find(": ") + 2),
                    QString::number(shown.distance().value_or(NAN), 'f', 2).toStdString());
        }
        return compared >= 8;
      },
      5.0);
  stop = true;
  sender.join();
  EXPECT_GE(compared, 8);
}

TEST_F(TreatmentFaultsTest, NoFiguresOfAnExposureThatHasNoPose)
{
  Panel shown;
  const auto repeat = [&](std::uint8_t state, std::uint8_t reason, const std::function<bool()>& done)
  {
    return spinUntil(
        [&]
        {
          say(state, reason, 1.25);
          spin(0.03);
          return done();
        },
        3.0);
  };
  EXPECT_TRUE(repeat(PatientMotion::OK, BeamGate::NONE, [&] { return shown.distance() == 1.25; }));
  // The gate's message goes on with what was measured last.
  EXPECT_TRUE(repeat(PatientMotion::LOST, BeamGate::NOT_MEASURED, [&] { return !shown.distance(); }));
  EXPECT_TRUE(repeat(PatientMotion::OK, BeamGate::HELD, [&] { return shown.distance() == 1.25; }));
  EXPECT_TRUE(repeat(PatientMotion::INCONSISTENT, BeamGate::HELD, [&] { return !shown.distance(); }));
  EXPECT_TRUE(repeat(PatientMotion::OK, BeamGate::NONE, [&] { return shown.distance() == 1.25; }));
  EXPECT_FALSE(shown.bars->stale());
  // Exposures stop, while the gate goes on.
  const ros::Time last = ros::Time::now();
  EXPECT_TRUE(spinUntil(
      [&]
      {
        BeamGate gate = gateOf(BeamGate::STALE, last, 1.25);
        gate.age = gate.header.stamp - last;
        gates_.publish(gate);
        spin(0.03);
        return shown.bars->stale();
      },
      3.0));
  EXPECT_EQ(shown.distance(), 1.25);
}

TEST_F(TreatmentFaultsTest, TheRotationsChartHasAGapWhereThereIsNoPose)
{
  TreatmentFeed feed(nh_, [](const BeamGate&) {});
  const auto rotations = [&]
  {
    const TreatmentFeed::Charts charts = feed.charts();
    const auto& entries = charts[static_cast<std::size_t>(Quantity::ROTATION)].entries();
    return std::count_if(entries.begin(), entries.end(), [](const auto& e) { return std::isfinite(e.value); });
  };
  const auto sayTen = [&](std::uint8_t state)
  {
    for (int i = 0; i < 10; ++i)
    {
      say(state, BeamGate::NOT_MEASURED, 1.0);
      ros::WallDuration(0.01).sleep();
      ros::spinOnce();
    }
  };
  ASSERT_TRUE(spinUntil(
      [&]
      {
        sayTen(PatientMotion::OK);
        return rotations() > 5;
      }));
  const auto before = rotations();
  sayTen(PatientMotion::LOST);
  EXPECT_LE(rotations(), before + 1);
  const TreatmentFeed::Charts charts = feed.charts();
  EXPECT_TRUE(std::isnan(charts[static_cast<std::size_t>(Quantity::ROTATION)].entries().back().value));
}

TEST_F(TreatmentFaultsTest, OfTwoNodesGatesNoneIsShown)
{
  Panel shown;
  const auto becomes = [&](GateLight light)
  {
    return spinUntil(
        [&]
        {
          say(PatientMotion::OK, BeamGate::NONE, 1.0);
          spin(0.02);
          return shown.banner->shown().light == light;
        });
  };
  ASSERT_TRUE(becomes(GateLight::OPEN));
  QProcess other;
  other.start(QCoreApplication::applicationFilePath(), { kSecondGate });
  EXPECT_TRUE(becomes(GateLight::SILENT));
  EXPECT_EQ(shown.banner->shown().headline, "NOT ONE GATE");
  other.kill();
  EXPECT_TRUE(becomes(GateLight::OPEN));
  other.waitForFinished();
}

TEST_F(TreatmentFaultsTest, AHiddenPanelDoesNotSayThatTheOperatorIsThere)
{
  std::atomic<int> beats{ 0 };
  const ros::Subscriber subscriber =
      nh_.subscribe<std_msgs::Header>("operator_present", 10, [&](const std_msgs::Header::ConstPtr&) { ++beats; });
  Panel shown;
  ASSERT_TRUE(spinUntil([&] { return beats > 3; }));
  shown.panel.hide();
  spin(0.3);
  beats = 0;
  spin(0.7);
  EXPECT_EQ(beats, 0);
  shown.panel.show();
  EXPECT_TRUE(spinUntil([&] { return beats > 3; }));

  // Behind another tab.
  QMainWindow window;
  QDockWidget dock, front;
  dock.setWidget(&shown.panel);
  front.setWidget(new QWidget);
  for (QDockWidget* one : { &dock, &front })
  {
    window.addDockWidget(Qt::RightDockWidgetArea, one);
  }
  window.tabifyDockWidget(&dock, &front);
  window.show();
  front.raise();
  spin(0.3);
  beats = 0;
  spin(0.7);
  EXPECT_EQ(beats, 0);
  dock.raise();
  EXPECT_TRUE(spinUntil([&] { return beats > 3; }));
  shown.panel.setParent(nullptr);
}

/// The panel's own leave the button free; where another one does not, the panel does not say that the operator is
/// there.
TEST_F(TreatmentFaultsTest, NoDialogStandsUnnoticedBetweenTheOperatorAndTheBeam)
{
  offer<Trigger>("motion_estimation/restart", [](const Trigger::Request&, Trigger::Response&) {});
  std::atomic<int> beats{ 0 };
  const ros::Subscriber subscriber =
      nh_.subscribe<std_msgs::Header>("operator_present", 10, [&](const std_msgs::Header::ConstPtr&) { ++beats; });
  Panel shown;
  auto* reset = shown.panel.findChild<QPushButton*>("reset");
  ASSERT_TRUE(spinUntil([&] { return beats > 3 && reset->isEnabled(); }));
  reset->click();
  EXPECT_EQ(QApplication::activeModalWidget(), nullptr);
  reset->click();
  const auto boxes = shown.panel.findChildren<QMessageBox*>();
  EXPECT_EQ(boxes.size(), 1);
  EXPECT_TRUE(boxes.first()->isVisible());
  beats = 0;
  EXPECT_TRUE(spinUntil([&] { return beats > 3; }, 3.0));
  for (QMessageBox* box : boxes)
  {
    box->close();
  }

  QDialog other;
  other.setModal(true);
  other.show();
  spin(0.3);
  beats = 0;
  spin(0.7);
  EXPECT_EQ(beats, 0);
  other.close();
  EXPECT_TRUE(spinUntil([&] { return beats > 3; }));
}

TEST_F(TreatmentFaultsTest, AHoldThatIsAskedForWhileAReleaseIsUnderWayIsTheLastWord)
{
  std::atomic<bool> held{ true }, answer{ false };
  std::atomic<int> calls{ 0 };
  offer<SetBool>("motion_estimation/hold_beam",
                 [&](const SetBool::Request& request, SetBool::Response&)
                 {
                   ++calls;
                   waitFor(answer);
                   held = request.data != 0U;
                 });
  TreatmentLink link(nh_);
  ASSERT_TRUE(spinUntil([&] { return link.view().commands[static_cast<std::size_t>(Command::HOLD)].offered; }));
  link.commands().hold(false);
  ASSERT_TRUE(spinUntil([&] { return calls == 1; }));
  link.commands().hold(true);
  const auto goOn = [&](const std::function<bool()>& done, double seconds)
  {
    return spinUntil(
        [&]
        {
          gates_.publish(gateOf(held ? BeamGate::HELD : BeamGate::DISPLACED, ros::Time(), 0.0));
          link.beat(true);
          spin(0.02);
          return done();
        },
        seconds);
  };
  goOn([] { return false; }, 0.5);  // the gate is still held, by what is to be released
  answer = true;
  EXPECT_TRUE(goOn([&] { return !held; }, 3.0));
  EXPECT_TRUE(goOn([&] { return held.load(); }, 3.0));
}

TEST_F(TreatmentFaultsTest, AResetBesideATrainingKeepsItsOwnCount)
{
  std::atomic<bool> trained{ false }, reset_a{ false }, reset_b{ false };
  std::atomic<int> asked{ 0 }, restarts{ 0 };
  std::vector<ros::Publisher> regions;
  for (const char* name : { "detector_a", "detector_b" })
  {
    regions.push_back(nh_.advertise<TrackedRegion>(std::string(name) + "/tracked_region", 1));
    offer<Trigger>(std::string(name) + "/retrain",
                   [&](const Trigger::Request&, Trigger::Response&)
                   {
                     ++asked;
                     waitFor(trained);
                   });
  }
  offer<Trigger>("detector_a/reset",
                 [&](const Trigger::Request&, Trigger::Response&)
                 {
                   ++asked;
                   waitFor(reset_a);
                 });
  offer<Trigger>("detector_b/reset",
                 [&](const Trigger::Request&, Trigger::Response& response)
                 {
                   ++asked;
                   waitFor(reset_b);
                   response.success = 0U;
                   response.message = "as the test wants it";
                 });
  offer<Trigger>("motion_estimation/restart", [&](const Trigger::Request&, Trigger::Response&) { ++restarts; });
  TreatmentLink link(nh_);
  const auto state = [&](Command which) { return link.view().commands[static_cast<std::size_t>(which)]; };
  ASSERT_TRUE(spinUntil([&] { return state(Command::TRAIN).offered && state(Command::RESET).offered; }));
  link.commands().train();
  ASSERT_TRUE(spinUntil([&] { return asked == 2; }));
  link.commands().reset();
  ASSERT_TRUE(spinUntil([&] { return asked == 4; }));
  trained = true;
  EXPECT_TRUE(spinUntil([&] { return !state(Command::TRAIN).busy; }));
  spin(0.3);
  reset_a = true;
  spin(0.5);
  EXPECT_EQ(restarts, 0) << "before every tracker was reset";
  reset_b = true;
  EXPECT_TRUE(spinUntil([&] { return !state(Command::RESET).busy; }));
  spin(0.3);
  EXPECT_EQ(restarts, 0);
  EXPECT_FALSE(state(Command::TRAIN).failed) << state(Command::TRAIN).text;
  EXPECT_TRUE(state(Command::RESET).failed) << state(Command::RESET).text;
  EXPECT_EQ(state(Command::RESET).text, "detector_b: as the test wants it");
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  if (argc > 1 && std::string(argv[1]) == xray_tracking::kSecondGate)
  {
    return xray_tracking::sendAnotherGate(argc, argv);
  }
  testing::InitGoogleTest(&argc, argv);
  qputenv("QT_QPA_PLATFORM", "offscreen");
  ros::init(argc, argv, "treatment_faults_test");
  const ros::NodeHandle keeps_ros_running;
  QApplication application(argc, argv);
  // Others' messages come to this thread as they would to RViz's.
  QTimer timer;
  QObject::connect(&timer, &QTimer::timeout, [] { ros::spinOnce(); });
  timer.start(5);
  return RUN_ALL_TESTS();
}
