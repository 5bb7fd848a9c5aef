#include "rviz_window.h"

#include <csignal>

#include <atomic>
#include <clocale>
#include <cmath>
#include <limits>
#include <thread>

#include <XmlRpcClient.h>
#include <actionlib/server/action_server.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <rosgraph_msgs/Clock.h>
#include <rviz/yaml_config_reader.h>
#include <rviz/yaml_config_writer.h>
#include <std_msgs/Header.h>
#include <std_srvs/SetBool.h>
#include <xray_tracking_msgs/BeamGate.h>
#include <xray_tracking_msgs/LoadVolume.h>
#include <xray_tracking_msgs/PatientMotion.h>
#include <xray_tracking_msgs/RefinePoseAction.h>
#include <xray_tracking_msgs/RefinedPose.h>
#include <xray_tracking_msgs/TrackedRegion.h>
#include <QAbstractSpinBox>
#include <QComboBox>
#include <QDir>
#include <QFile>
#include <QFileDialog>
#include <QLabel>
#include <QLocale>
#include <QPixmap>
#include <QProcess>
#include <QPushButton>
#include <QRegularExpression>
#include <QTemporaryDir>

#include "treatment_panel.h"
#include "treatment_widgets.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::BeamGate;
using xray_tracking_msgs::PatientMotion;
constexpr const char* kPanel = "xray_tracking_rviz_plugins/TreatmentPanel";

/// In place of motion estimation: sends a gate fifty times a second, from a thread of its own.
class GateSender
{
public:
  GateSender() : publisher_(ros::NodeHandle().advertise<BeamGate>("beam_gate", 1)), thread_([this] { work(); }) {}
  ~GateSender()
  {
    stop_ = true;
    thread_.join();
  }
  void say(bool open, std::uint8_t reason)
  {
    open_ = open;
    reason_ = reason;
    silent_ = false;
  }
  void fallSilent() { silent_ = true; }

private:
  void work()
  {
    while (!stop_)
    {
      if (!silent_)
      {
        BeamGate gate;
        gate.header.stamp = ros::Time::now();
        // Far more than in a room, for a busy machine.
        gate.valid_until = gate.header.stamp + ros::Duration(0.4);
        gate.open = static_cast<std::uint8_t>(open_);
        gate.reason = reason_;
        gate.text = "why";
        gate.exposure = gate.header.stamp;
        gate.displacement.x = 0.00123;
        publisher_.publish(gate);
      }
      ros::WallDuration(0.02).sleep();
    }
  }

  ros::Publisher publisher_;
  std::atomic<bool> stop_{ false }, silent_{ true }, open_{ false };
  std::atomic<std::uint8_t> reason_{ 0 };
  std::thread thread_;
};

class TreatmentTest : public RvizWindow
{
protected:
  void SetUp() override
  {
    panel_ = addPanel(kPanel);
    ASSERT_NE(panel_, nullptr);
    banner_ = panel_->findChild<GateBanner*>("gate_banner");
    ASSERT_NE(banner_, nullptr);
    spin(0.3);
  }

  /// Of the banner's ground, beside its text, as the window has it on the screen.
  QColor colour() const
  {
    const QPoint corner = banner_->mapTo(frame_, QPoint(banner_->width() - 12, banner_->height() / 2));
    return frame_->grab(QRect(corner, QSize(1, 1))).toImage().pixelColor(0, 0);
  }

  ::testing::AssertionResult becomes(GateLight light)
  {
    const QColor wanted = colourOf(light);
    return spinUntil([&] { return banner_->shown().light == light && colour() == wanted; }, 5.0)
               ? ::testing::AssertionSuccess()
               : ::testing::AssertionFailure()
                     << "is " << colour().name().toStdString() << ", expected " << wanted.name().toStdString();
  }

  rviz::Panel* panel_ = nullptr;
  GateBanner* banner_ = nullptr;
  GateSender gate_;
};

TEST_F(TreatmentTest, ColourFollowsTheGate)
{
  EXPECT_EQ(banner_->shown().light, GateLight::SILENT);
  for (int round = 0; round < 2; ++round)
  {
    gate_.say(true, BeamGate::NONE);
    EXPECT_TRUE(becomes(GateLight::OPEN));
    EXPECT_GT(colour().green(), 2 * colour().red());
    gate_.say(false, BeamGate::DISPLACED);
    EXPECT_TRUE(becomes(GateLight::CLOSED));
    EXPECT_GT(colour().red(), 2 * colour().green());
    gate_.say(false, BeamGate::HELD);
    EXPECT_TRUE(becomes(GateLight::HELD));
    gate_.say(true, BeamGate::NONE);
    EXPECT_TRUE(becomes(GateLight::OPEN));
    // What was open is not shown as open once it is void.
    gate_.fallSilent();
    ASSERT_TRUE(spinUntil([&] { return banner_->shown().light == GateLight::SILENT; }, 2.0));
    spin(0.2);
    EXPECT_LT(colour().green(), 1.3 * colour().red());
  }
}

TEST_F(TreatmentTest, ReleaseIsOfferedOnlyWhileTheBeamIsHeld)
{
  auto* release = panel_->findChild<QPushButton*>("release");
  auto* hold = panel_->findChild<QPushButton*>("hold");
  ASSERT_TRUE(release != nullptr && hold != nullptr);
  EXPECT_FALSE(release->isEnabled());
  EXPECT_TRUE(hold->isEnabled());
  gate_.say(false, BeamGate::HELD);
  EXPECT_TRUE(spinUntil([&] { return release->isEnabled(); }));
  gate_.say(false, BeamGate::DISPLACED);
  EXPECT_TRUE(spinUntil([&] { return !release->isEnabled(); }));
  EXPECT_TRUE(hold->isEnabled());
}

// A hold that nobody confirms is asked for again, and takes the heartbeat away, which holds the beam by its silence.
TEST_F(TreatmentTest, AnUnansweredHoldEndsTheHeartbeat)
{
  std::atomic<int> beats{ 0 };
  ros::NodeHandle nh;
  const ros::Subscriber subscriber =
      nh.subscribe<std_msgs::Header>("operator_present", 10, [&](const std_msgs::Header::ConstPtr&) { ++beats; });
  gate_.say(true, BeamGate::NONE);
  ASSERT_TRUE(spinUntil([&] { return beats > 5; }));
  panel_->findChild<QPushButton*>("hold")->click();
  spin(0.5);
  beats = 0;
  spin(1.5);
  EXPECT_EQ(beats, 0);
  // Motion estimation that comes only now is asked, too.
  bool held = false;
  const boost::function<bool(std_srvs::SetBool::Request&, std_srvs::SetBool::Response&)> answer =
      [&](std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response)
  {
    held = request.data != 0U;
    response.success = 1U;
    return true;
  };
  const ros::ServiceServer server = nh.advertiseService("motion_estimation/hold_beam", answer);
  EXPECT_TRUE(spinUntil([&] { return held; }));
  EXPECT_EQ(beats, 0);
  gate_.say(false, BeamGate::HELD);
  EXPECT_TRUE(spinUntil([&] { return beats > 5; }));
}

TEST_F(TreatmentTest, LivesThroughWhateverComes)
{
  ros::NodeHandle nh;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  ros::Publisher motions = nh.advertise<PatientMotion>("patient_motion", 10);
  ros::Publisher refined = nh.advertise<xray_tracking_msgs::RefinedPose>("refined_pose", 10);
  ros::Publisher region = nh.advertise<xray_tracking_msgs::TrackedRegion>("some/odd_name/tracked_region", 10);
  ros::Publisher gates = nh.advertise<BeamGate>("beam_gate", 10);
  spin(1.5);  // until the detector is found
  for (int i = 0; i < 60; ++i)
  {
    PatientMotion motion;
    motion.state = static_cast<std::uint8_t>(i % 9);  // some of which there are not
    motion.source = static_cast<std::uint8_t>(i % 4);
    motion.header.stamp = ros::Time(1000.0 - 10.0 * i);
    motion.translation.x = i % 3 == 0 ? nan : 1e300;
    motion.covariance[4] = i % 2 == 0 ? nan : -1.0;
    motion.disagreement = std::numeric_limits<double>::infinity();
    motions.publish(motion);
    xray_tracking_msgs::RefinedPose pose;
    pose.result.status = static_cast<std::uint8_t>(i % 12);
    pose.result.similarity_after = nan;
    pose.result.probability = nan;
    refined.publish(pose);
    xray_tracking_msgs::TrackedRegion tracked;
    tracked.state = static_cast<std::uint8_t>(i % 10);
    tracked.fault = "<b>&";
    tracked.correlation = nan;
    region.publish(tracked);
    BeamGate gate;
    gate.open = static_cast<std::uint8_t>(i % 2);
    gate.reason = static_cast<std::uint8_t>(7 * i);
    gate.valid_until = ros::Time(static_cast<std::uint32_t>(50 * i), 0);
    gate.displacement.y = nan;
    gate.rotation = nan;
    gate.text = std::string(static_cast<std::size_t>(20 * i), 'x');
    gates.publish(gate);
    spin(0.03);
  }
  EXPECT_FALSE(banner_->shown().light == GateLight::OPEN);
  gate_.say(true, BeamGate::NONE);
  EXPECT_TRUE(becomes(GateLight::OPEN));
}

/// Of a tracked pose less uncertainty than of a registered one, unless nobody registers.
TEST_F(TreatmentTest, TheBarIsWhatTheGateAsksOfThePose)
{
  const ros::NodeHandle nh("another_room");
  TreatmentFeed feed(nh, [](const BeamGate&) {});
  ros::Publisher motions = ros::NodeHandle(nh).advertise<PatientMotion>("patient_motion", 10);
  const auto asked = [&](std::uint8_t source)
  {
    PatientMotion motion;
    motion.source = source;
    motion.header.stamp = ros::Time::now();
    motions.publish(motion);
    TreatmentView view;
    EXPECT_TRUE(spinUntil(
        [&]
        {
          feed.show(view);
          return view.motion && view.motion->header.stamp == motion.header.stamp;
        }));
    return view.max_sigma;
  };
  ASSERT_TRUE(spinUntil([&] { return motions.getNumSubscribers() > 0; }));
  nh.setParam("motion_estimation/refinement/mode", "every_n");
  nh.setParam("motion_estimation/gate/max_sigma", 1.2);
  nh.setParam("motion_estimation/gate/max_tracked_sigma", 0.4);
  feed.look();
  EXPECT_EQ(asked(PatientMotion::REGISTERED), 1.2);
  EXPECT_EQ(asked(PatientMotion::TRACKED), 0.4);
  nh.setParam("motion_estimation/gate/max_sigma", 0.3);
  feed.look();
  EXPECT_EQ(asked(PatientMotion::TRACKED), 0.3);
  nh.setParam("motion_estimation/refinement/mode", "never");
  nh.setParam("motion_estimation/gate/max_sigma", -1.0);  // which the gate does not take
  feed.look();
  EXPECT_EQ(asked(PatientMotion::REGISTERED), 1.5);
  EXPECT_EQ(asked(PatientMotion::TRACKED), 1.5);
}

TEST_F(TreatmentTest, IsNeverBusyForLong)
{
  gate_.say(true, BeamGate::NONE);
  ros::NodeHandle nh;
  ros::Publisher motions = nh.advertise<PatientMotion>("patient_motion", 10);
  double longest = 0.0;
  for (int i = 0; i < 200; ++i)
  {
    PatientMotion motion;
    motion.translation.x = 1e-3 * std::sin(0.1 * i);
    motion.wall_time = ros::Duration(0.02);
    motions.publish(motion);
    spin(0.002);
    const ros::SteadyTime before = ros::SteadyTime::now();
    panel_->repaint();
    longest = std::max(longest, (ros::SteadyTime::now() - before).toSec());
  }
  RecordProperty("longest_repaint_ms", static_cast<int>(1e3 * longest));
  // 50 ms in a room; ten times as much for a machine that does other things at the same time.
  EXPECT_LT(longest, 0.5);
}

/// Whether some label of the panel says so.
bool says(const QWidget* panel, const QString& words)
{
  const QList<QLabel*> labels = panel->findChildren<QLabel*>();
  return std::any_of(labels.begin(), labels.end(), [&](const QLabel* label) { return label->text().contains(words); });
}

TEST_F(TreatmentTest, LoadsTheCtThatIsChosen)
{
  ros::NodeHandle nh;
  std::vector<std::string> paths;
  const boost::function<bool(xray_tracking_msgs::LoadVolume::Request&, xray_tracking_msgs::LoadVolume::Response&)>
      load = [&](xray_tracking_msgs::LoadVolume::Request& request, xray_tracking_msgs::LoadVolume::Response& response)
  {
    paths.push_back(request.path);
    response.success = static_cast<std::uint8_t>(paths.size() == 2);
    response.message = response.success ? "loaded" : "not as the test wants it";
    return true;
  };
  const ros::ServiceServer server = nh.advertiseService("registration/load_volume", load);
  auto* button = panel_->findChild<QPushButton*>("load");
  ASSERT_TRUE(spinUntil([&] { return button->isEnabled(); }));
  QTemporaryDir folder;
  for (const char* name : { "a.nrrd", "0001.dcm" })
  {
    QFile file(folder.filePath(name));
    ASSERT_TRUE(file.open(QIODevice::WriteOnly));
  }
  const auto choose = [&](const char* name)
  {
    button->click();
    auto* dialog = panel_->findChild<QFileDialog*>();
    ASSERT_NE(dialog, nullptr);
    Q_EMIT dialog->fileSelected(folder.filePath(name));
    dialog->close();
    spin(0.5);
  };
  choose("a.nrrd");
  EXPECT_TRUE(spinUntil([&] { return says(panel_, "not as the test wants it"); }));
  ASSERT_TRUE(spinUntil([&] { return button->isEnabled(); }));
  choose("0001.dcm");  // of a series its folder
  EXPECT_TRUE(spinUntil([&] { return says(panel_, "CT: loaded"); }));
  EXPECT_EQ(paths, (std::vector<std::string>{ folder.filePath("a.nrrd").toStdString(), folder.path().toStdString() }));
}

TEST_F(TreatmentTest, ARefinementShowsItsProgressAndIsCancelled)
{
  using Server = actionlib::ActionServer<xray_tracking_msgs::RefinePoseAction>;
  ros::NodeHandle nh;
  const boost::function<bool(xray_tracking_msgs::LoadVolume::Request&, xray_tracking_msgs::LoadVolume::Response&)>
      load = [](xray_tracking_msgs::LoadVolume::Request&, xray_tracking_msgs::LoadVolume::Response&) { return true; };
  const ros::ServiceServer loader = nh.advertiseService("registration/load_volume", load);  // says that it is there
  ros::Publisher poses = nh.advertise<geometry_msgs::PoseWithCovarianceStamped>("patient_pose", 1, true);
  geometry_msgs::PoseWithCovarianceStamped pose;
  pose.pose.pose.position.x = 0.25;
  pose.pose.pose.orientation.w = 1.0;
  poses.publish(pose);
  std::optional<Server::GoalHandle> goal;
  Server server(
      nh, "registration/refine_pose",
      [&](Server::GoalHandle asked)
      {
        asked.setAccepted();
        goal = asked;
      },
      [](Server::GoalHandle cancelled)
      {
        xray_tracking_msgs::RefinePoseResult result;
        result.result.status = xray_tracking_msgs::RefinementResult::CANCELLED;
        result.result.reason = "as it was asked to";
        cancelled.setCanceled(result, result.result.reason);
      },
      false);
  server.start();
  auto* refine = panel_->findChild<QPushButton*>("refine");
  ASSERT_TRUE(spinUntil([&] { return refine->isEnabled(); }));
  spin(0.5);
  refine->click();
  ASSERT_TRUE(spinUntil([&] { return goal.has_value(); }));
  EXPECT_EQ(goal->getGoal()->request.seed.position.x, 0.25);
  xray_tracking_msgs::RefinePoseFeedback feedback;
  feedback.level = 1;
  feedback.iteration = 17;
  feedback.similarity = 0.625;
  goal->publishFeedback(feedback);
  EXPECT_TRUE(spinUntil([&] { return says(panel_, "level 2, step 17, similarity 0.6"); }));
  ASSERT_TRUE(spinUntil([&] { return refine->text() == "Cancel"; }));
  refine->click();
  EXPECT_TRUE(spinUntil([&] { return says(panel_, "as it was asked to"); }));
  EXPECT_TRUE(spinUntil([&] { return refine->text() == "Refine now"; }));
}

TEST_F(TreatmentTest, ARecordingIsClosedWhenItIsStopped)
{
  QTemporaryDir folder;
  const QByteArray before = qgetenv("ROS_HOME");
  qputenv("ROS_HOME", folder.path().toLocal8Bit());
  gate_.say(true, BeamGate::NONE);
  auto* record = panel_->findChild<QPushButton*>("record");
  record->click();
  const QDir recordings(folder.path() + "/xray_tracking/recordings");
  const auto bag = [&](const char* name)
  {
    const QStringList runs = recordings.entryList(QDir::Dirs | QDir::NoDotAndDotDot);
    return runs.isEmpty() ? 0 : QFileInfo(recordings.filePath(runs.first() + "/" + name)).size();
  };
  ASSERT_TRUE(spinUntil([&] { return bag("recorded.bag.active") > 0; }, 20.0));
  EXPECT_EQ(record->text(), "Stop recording");
  spin(1.0);
  record->click();
  ASSERT_TRUE(spinUntil([&] { return bag("recorded.bag") > 5000; }, 20.0)) << bag("recorded.bag");  // with messages
  EXPECT_TRUE(spinUntil([&] { return record->text() == "Record" && says(panel_, "recorded "); }));
  qputenv("ROS_HOME", before);
}

/// Where numbers have a comma, by Qt's locale and by C's if the machine has such a one.
TEST_F(TreatmentTest, DecimalCommasChangeNoNumber)
{
  std::setlocale(LC_NUMERIC, "de_DE.UTF-8");
  QLocale::setDefault(QLocale(QLocale::German));
  std::vector<rviz::Panel*> panels;
  for (const char* name : { "TreatmentPanel", "AlignmentPanel", "RadiographPanel", "PlaybackPanel" })
  {
    panels.push_back(addPanel(std::string("xray_tracking_rviz_plugins/") + name));
    ASSERT_NE(panels.back(), nullptr);
  }
  gate_.say(true, BeamGate::NONE);
  ros::Publisher motions = ros::NodeHandle().advertise<PatientMotion>("patient_motion", 10);
  spin(0.5);
  motions.publish(PatientMotion());
  ASSERT_TRUE(spinUntil([&] { return says(panels[0], " a second"); }));
  const QRegularExpression comma("[0-9],[0-9]");
  for (const rviz::Panel* panel : panels)
  {
    for (const QLabel* label : panel->findChildren<QLabel*>())
    {
      EXPECT_FALSE(label->text().contains(comma)) << label->text().toStdString();
    }
  }
  const auto* steps = panels[1]->findChild<QComboBox*>("shift_step");
  EXPECT_EQ(steps->itemText(0), "0.1 mm");
  rviz::Config config;
  const_cast<QComboBox*>(steps)->setCurrentIndex(0);
  panels[1]->save(config);
  rviz::YamlConfigWriter writer;
  const QString text = writer.writeString(config);
  const_cast<QComboBox*>(steps)->setCurrentIndex(3);
  rviz::Config read;
  rviz::YamlConfigReader reader;
  reader.readString(read, text);
  panels[1]->load(read);
  EXPECT_EQ(steps->currentIndex(), 0) << text.toStdString();
  QLocale::setDefault(QLocale::c());
  std::setlocale(LC_NUMERIC, "C");
}

/// A window whose master has gone goes on, and can be closed.
TEST_F(TreatmentTest, TheMastersDeathIsNotOurs)
{
  constexpr int kPort = 11393;
  QProcessEnvironment environment = QProcessEnvironment::systemEnvironment();
  environment.insert("ROS_MASTER_URI", "http://127.0.0.1:" + QString::number(kPort));
  environment.insert("ROS_HOSTNAME", "127.0.0.1");
  QProcess master, rviz;
  master.setProcessEnvironment(environment);
  rviz.setProcessEnvironment(environment);
  master.start("rosmaster", { "--core", "-p", QString::number(kPort) });
  ASSERT_TRUE(master.waitForStarted());
  rviz.start("rosrun", { "rviz", "rviz", "-d", XRAY_TRACKING_TEST_FOLDER "/operator.rviz" });
  ASSERT_TRUE(rviz.waitForStarted());
  const auto panelIsThere = [&]
  {
    XmlRpc::XmlRpcClient client("127.0.0.1", kPort, "/");
    XmlRpc::XmlRpcValue arguments, result;
    arguments[0] = "/treatment_test";
    arguments[1] = "";
    if (!client.execute("getPublishedTopics", arguments, result) || client.isFault())
    {
      return false;
    }
    return result.toXml().find("operator_present") != std::string::npos;
  };
  ASSERT_TRUE(spinUntil(panelIsThere, 60.0));
  spin(1.0);
  master.kill();
  ASSERT_TRUE(master.waitForFinished());
  spin(2.5);  // each of its threads asks once a second
  ASSERT_EQ(rviz.state(), QProcess::Running);
  // By RViz's window, in its own thread.
  ::kill(static_cast<pid_t>(rviz.processId()), SIGINT);
  EXPECT_TRUE(rviz.waitForFinished(10000));
  EXPECT_EQ(rviz.exitStatus(), QProcess::NormalExit);
}

/// With /use_sim_time (playback.test).
class SimTimeTest : public RvizWindow
{
protected:
  /// Lets the clock go so fast, the window beside it, until something holds.
  bool play(double speed, const std::function<bool()>& done, double seconds = 5.0)
  {
    const ros::WallTime start = ros::WallTime::now();
    const ros::Time from = time_;
    return spinUntil(
        [&]
        {
          rosgraph_msgs::Clock clock;
          clock.clock = time_ = from + ros::Duration(speed * (ros::WallTime::now() - start).toSec());
          clock_.publish(clock);
          return done();
        },
        seconds);
  }

  ros::Publisher clock_ = ros::NodeHandle().advertise<rosgraph_msgs::Clock>("/clock", 10);
  ros::Time time_{ 1000.0 };
};

TEST_F(SimTimeTest, SaysThatThereIsNoClockAndPlaysOneExposureAfterTheOther)
{
  const rviz::Panel* treatment = addPanel(kPanel);
  const rviz::Panel* playback = addPanel("xray_tracking_rviz_plugins/PlaybackPanel");
  ASSERT_TRUE(treatment != nullptr && playback != nullptr);
  EXPECT_TRUE(spinUntil([&] { return says(treatment, "nothing on /clock"); }));
  EXPECT_TRUE(spinUntil([&] { return says(playback, "nothing on /clock"); }));

  ros::NodeHandle nh;
  std::vector<bool> paused;
  const boost::function<bool(std_srvs::SetBool::Request&, std_srvs::SetBool::Response&)> answer =
      [&](std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response)
  {
    paused.push_back(request.data != 0U);
    response.success = 1U;
    return true;
  };
  const ros::ServiceServer player = nh.advertiseService("player/pause_playback", answer);
  ros::Publisher motions = nh.advertise<PatientMotion>("patient_motion", 10);
  auto* button = playback->findChild<QPushButton*>("play");
  auto* step = playback->findChild<QPushButton*>("step");
  ASSERT_TRUE(button != nullptr && step != nullptr);
  // Its speed, to a fifth on a busy machine.
  EXPECT_TRUE(play(2.0, [&] { return says(playback, "x 1.9") || says(playback, "x 2.") || says(playback, "x 1.8"); }));
  EXPECT_FALSE(says(treatment, "nothing on /clock"));
  EXPECT_EQ(button->text(), "Pause");
  EXPECT_FALSE(step->isEnabled());
  button->click();
  EXPECT_TRUE(play(2.0, [&] { return paused == std::vector<bool>{ true }; }));
  EXPECT_TRUE(spinUntil([&] { return says(playback, "stands") && button->text() == "Play" && step->isEnabled(); }));
  step->click();
  EXPECT_TRUE(spinUntil([&] { return paused == std::vector<bool>({ true, false }); }));
  EXPECT_FALSE(play(
      1.0, [&] { return paused.size() > 2; }, 0.5));  // no exposure so far
  motions.publish(PatientMotion());
  EXPECT_TRUE(play(1.0, [&] { return paused == std::vector<bool>({ true, false, true }); }));
  spin(0.3);
  motions.publish(PatientMotion());
  spin(0.3);
  EXPECT_EQ(paused.size(), 3U);  // one exposure a step
}

TEST_F(SimTimeTest, AStepEndsHoweverSoonItsExposureIsDecidedAndAlsoWhereOneIsBrokenOff)
{
  const rviz::Panel* playback = addPanel("xray_tracking_rviz_plugins/PlaybackPanel");
  ASSERT_NE(playback, nullptr);
  ros::NodeHandle nh;
  ros::Publisher motions = nh.advertise<PatientMotion>("patient_motion", 10);
  std::vector<bool> paused;
  bool quick = true;
  const boost::function<bool(std_srvs::SetBool::Request&, std_srvs::SetBool::Response&)> answer =
      [&](std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response)
  {
    paused.push_back(request.data != 0U);
    if (quick && !paused.back())
    {
      motions.publish(PatientMotion());
      ros::WallDuration(0.3).sleep();  // what it answers comes later than what it has played
    }
    response.success = 1U;
    return true;
  };
  const ros::ServiceServer player = nh.advertiseService("player/pause_playback", answer);
  auto* button = playback->findChild<QPushButton*>("play");
  auto* step = playback->findChild<QPushButton*>("step");
  ASSERT_TRUE(button != nullptr && step != nullptr);
  ASSERT_TRUE(spinUntil([&] { return motions.getNumSubscribers() > 0 && step->isEnabled(); }));
  step->click();
  EXPECT_TRUE(spinUntil([&] { return paused == std::vector<bool>({ false, true }); }, 3.0));
  spin(0.3);

  // Paused before its exposure comes, a step is over.
  quick = false;
  paused.clear();
  step->click();
  EXPECT_TRUE(play(1.0, [&] { return paused == std::vector<bool>{ false } && button->text() == "Pause"; }));
  button->click();
  EXPECT_TRUE(spinUntil([&] { return paused.size() == 2 && button->text() == "Play"; }));
  button->click();
  EXPECT_TRUE(spinUntil([&] { return paused == std::vector<bool>({ false, true, false }); }));
  motions.publish(PatientMotion());
  spin(0.5);
  EXPECT_EQ(paused.size(), 3U);
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  return xray_tracking::RvizWindow::runTests(argc, argv, "treatment_test");
}
