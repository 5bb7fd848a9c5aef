// The patient is 12 mm from where the setup says. By mouse and keys the CT is laid over its images, and motion
// estimation and registration, each as it is, do the rest.
#include "rviz_window.h"

#include <cmath>
#include <cstdlib>
#include <limits>
#include <optional>
#include <set>

#include <OgreCamera.h>
#include <actionlib/client/simple_action_client.h>
#include <geometry_msgs/PoseStamped.h>
#include <rviz/render_panel.h>
#include <rviz/tool.h>
#include <rviz/tool_manager.h>
#include <rviz/view_manager.h>
#include <tf2_ros/transform_listener.h>
#include <xray_tracking_msgs/AlignPatientAction.h>
#include <xray_tracking_msgs/BeamGate.h>
#include <xray_tracking_msgs/RefinedPose.h>
#include <xray_tracking_msgs/TrackedRegion.h>
#include <QComboBox>
#include <QLabel>
#include <QPushButton>
#include <QRegularExpression>

#include "radiograph_panel.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::AlignPatientAction;
using xray_tracking_msgs::AlignPatientGoal;
using xray_tracking_msgs::BeamGate;
using xray_tracking_msgs::RefinementResult;

constexpr double kMisplaced = 12.0;  ///< along room x [mm]

class AlignmentTest : public RvizWindow
{
protected:
  void SetUp() override
  {
    ros::NodeHandle nh;
    gate_subscriber_ = nh.subscribe<BeamGate>("beam_gate", 10,
                                              [this](const BeamGate::ConstPtr& gate)
                                              {
                                                gate_ = *gate;
                                                opened_ = opened_ || gate->open;
                                              });
    refined_subscriber_ = nh.subscribe<xray_tracking_msgs::RefinedPose>(
        "refined_pose", 10,
        [this](const xray_tracking_msgs::RefinedPose::ConstPtr& refined)
        { registers_ = registers_ || refined->result.status <= RefinementResult::UNRELIABLE; });
    tried_subscriber_ =
        nh.subscribe<geometry_msgs::PoseStamped>("alignment_pose", 10,
                                                 [this](const geometry_msgs::PoseStamped::ConstPtr& pose)
                                                 {
                                                   tried_ = rigidFromPoseMsg(pose->pose);
                                                   ++shown_;
                                                 });
    radiographs_ = dynamic_cast<RadiographPanel*>(
        addPanel("xray_tracking_rviz_plugins/RadiographPanel", Qt::BottomDockWidgetArea));
    panel_ = addPanel("xray_tracking_rviz_plugins/AlignmentPanel");
    ASSERT_TRUE(panel_ != nullptr && radiographs_ != nullptr);
    ASSERT_TRUE(spinUntil([&] { return button("align")->isEnabled() && registers_; }, 60.0));
    spin(0.5);
    ASSERT_EQ(std::system(("xdotool windowfocus " + std::to_string(frame_->winId())).c_str()), 0);
  }

  QPushButton* button(const char* name) const { return panel_->findChild<QPushButton*>(name); }
  QString message() const { return panel_->findChild<QLabel*>("message")->text(); }

  /// With the mouse, where it is on the screen.
  static void click(const QWidget* widget)
  {
    ASSERT_NE(widget, nullptr);
    const QPoint at = widget->mapToGlobal(widget->rect().center());
    run("xdotool mousemove " + std::to_string(at.x()) + " " + std::to_string(at.y()) + " click 1");
  }
  static void press(const std::string& key, int times = 1)
  {
    run("xdotool key --delay 20 --repeat " + std::to_string(times) + " " + key);
  }
  static void run(const std::string& command) { ASSERT_EQ(std::system(command.c_str()), 0); }

  /// Where a place of the room is seen in the window, on the screen. [mm]
  static QPoint onScreen(const Eigen::Vector3d& place)
  {
    const rviz::RenderPanel* panel = manager_->getRenderPanel();
    const Ogre::Camera* camera = panel->getCamera();
    const Eigen::Vector3f metres = (1e-3 * place).cast<float>();
    const Ogre::Vector3 seen =
        camera->getProjectionMatrix() * (camera->getViewMatrix() * Ogre::Vector3(metres.x(), metres.y(), metres.z()));
    return panel->mapToGlobal(QPoint(static_cast<int>(std::lround(0.5F * (1.0F + seen.x) * panel->width())),
                                     static_cast<int>(std::lround(0.5F * (1.0F - seen.y) * panel->height()))));
  }

  /// With the mouse, slowly enough for RViz to see what is under it.
  static void drag(const QPoint& from, const QPoint& to)
  {
    const auto move = [](const QPoint& at)
    {
      run("xdotool mousemove " + std::to_string(at.x()) + " " + std::to_string(at.y()));
      spin(0.3);
    };
    move(from - QPoint(3, 3));
    move(from);
    run("xdotool mousedown 1");
    spin(0.3);
    move((from + to) / 2);
    move(to);
    run("xdotool mouseup 1");
    spin(0.3);
  }

  void clickStep(const char* name)
  {
    for (QPushButton* step : panel_->findChildren<QPushButton*>("step"))
    {
      if (step->accessibleName() == name)
      {
        click(step);
        return;
      }
    }
    FAIL() << name;
  }

  /// The target's centre on tf, from where it is [mm], and that transform's stamp.
  std::optional<std::pair<Eigen::Vector3d, ros::Time>> patient() const
  {
    try
    {
      const geometry_msgs::TransformStamped transform = buffer_.lookupTransform(kRoomFrame, kPatientFrame, ros::Time());
      const Eigen::Vector3d centre(1.25, 15.25, 1.0);
      RigidTransform truth = RigidTransform::Identity();
      truth.linear() = Eigen::Quaterniond(0.5, -0.5, 0.5, -0.5).toRotationMatrix();
      return std::make_pair(Eigen::Vector3d(rigidFromTransformMsg(transform.transform) * centre - truth * centre),
                            transform.header.stamp);
    }
    catch (const tf2::TransformException&)
    {
      return std::nullopt;
    }
  }

  /// Tracks put the patient where the setup says, or there is no pose, as registration and tracks contradict each
  /// other.
  void expectMisplaced() const
  {
    const auto pose = patient();
    EXPECT_LT(pose ? (pose->first - Eigen::Vector3d(kMisplaced, 0.0, 0.0)).norm() : 0.0, 1.0);
    EXPECT_FALSE(gate_.verified) << gate_.text;
  }

  /// Asks motion estimation, as anybody may. @return what it says
  std::string refusal(const std::function<void(AlignPatientGoal&)>& alter)
  {
    actionlib::SimpleActionClient<AlignPatientAction> client("motion_estimation/align", false);
    EXPECT_TRUE(spinUntil([&] { return client.isServerConnected(); }));
    AlignPatientGoal goal;
    goal.pose.header.stamp = ros::Time::now();
    goal.pose.header.frame_id = kRoomFrame;
    goal.pose.pose.orientation.w = goal.pose.pose.orientation.y = 0.5;
    goal.pose.pose.orientation.x = goal.pose.pose.orientation.z = -0.5;
    alter(goal);
    client.sendGoal(goal);
    EXPECT_TRUE(spinUntil([&] { return client.getState().isDone(); }));
    const auto result = client.getResult();
    EXPECT_TRUE(result && !result->success);
    return result ? result->message : "";
  }

  rviz::Panel* panel_ = nullptr;
  RadiographPanel* radiographs_ = nullptr;
  BeamGate gate_;
  bool opened_ = false, registers_ = false;
  std::optional<RigidTransform> tried_;
  int shown_ = 0;
  ros::Subscriber gate_subscriber_, refined_subscriber_, tried_subscriber_;
  tf2_ros::Buffer buffer_;
  tf2_ros::TransformListener listener_{ buffer_ };
};

TEST_F(AlignmentTest, BadStatementsGetAnAnswerAndChangeNothing)
{
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto says = [](const std::string& text, const char* words)
  { return text.find(words) != std::string::npos ? testing::AssertionSuccess() : testing::AssertionFailure() << text; };
  EXPECT_TRUE(says(refusal([&](AlignPatientGoal& goal) { goal.pose.pose.position.x = nan; }), "finite"));
  EXPECT_TRUE(says(refusal([](AlignPatientGoal& goal) { goal.pose.pose.orientation.w = 0.9; }), "quaternion"));
  EXPECT_TRUE(says(refusal([](AlignPatientGoal& goal) { goal.pose.header.stamp += ros::Duration(3600.0); }), "future"));
  EXPECT_TRUE(says(refusal([](AlignPatientGoal& goal) { goal.pose.header.frame_id = "patient"; }), "treatment_room"));
  // Where nothing of the patient is: the registration's own words.
  EXPECT_FALSE(refusal([](AlignPatientGoal& goal) { goal.pose.pose.position.y = 0.09; }).empty());
  EXPECT_FALSE(refusal([](AlignPatientGoal& goal) { goal.pose.pose.position.y = 1e9; }).empty());
  spin(1.0);
  expectMisplaced();
}

TEST_F(AlignmentTest, CancelledItLeavesEverythingAsItWas)
{
  click(button("align"));
  ASSERT_TRUE(spinUntil([&] { return tried_.has_value(); }));
  const RigidTransform begun = *tried_;
  EXPECT_EQ(manager_->getToolManager()->getCurrentTool()->getClassId(), "rviz/Interact");
  press("Page_Up", 5);
  ASSERT_TRUE(spinUntil([&] { return std::abs(tried_->translation().y() - begun.translation().y() - 5.0) < 1e-6; }))
      << tried_->translation().transpose();
  click(button("align"));
  ASSERT_TRUE(spinUntil([&] { return message().contains("Cancelled"); }));
  spin(0.3);
  shown_ = 0;
  press("Page_Up", 2);
  spin(1.0);
  EXPECT_EQ(shown_, 0);
  expectMisplaced();
  // A panel that is closed meanwhile is as good as a cancel.
  click(button("align"));
  EXPECT_TRUE(spinUntil([&] { return shown_ > 0; }));
}

TEST_F(AlignmentTest, NothingIsTriedOutWhileNobodySeesThePanel)
{
  auto* dock = qobject_cast<QDockWidget*>(panel_->parentWidget());
  ASSERT_NE(dock, nullptr);
  click(button("align"));
  ASSERT_TRUE(spinUntil([&] { return tried_.has_value(); }));
  const RigidTransform begun = *tried_;
  press("Page_Up", 5);
  const auto isAt = [&](double shift)
  { return std::abs(tried_->translation().y() - begun.translation().y() - shift) < 1e-6; };
  ASSERT_TRUE(spinUntil([&] { return isAt(5.0); }));
  rviz::Panel* other = addPanel("rviz/Time");
  ASSERT_NE(other, nullptr);
  auto* front = qobject_cast<QDockWidget*>(other->parentWidget());
  const std::pair<const char*, std::function<void(bool)>> ways[] = {
    { "closed", [&](bool hide) { hide ? dock->close() : (dock->show(), true); } },
    { "behind another tab",
      [&](bool hide)
      {
        frame_->tabifyDockWidget(dock, front);
        (hide ? front : dock)->raise();
      } },
  };
  for (const auto& [way, hidden] : ways)
  {
    SCOPED_TRACE(way);
    hidden(true);
    spin(0.3);
    shown_ = 0;
    run("xdotool windowfocus " + std::to_string(frame_->winId()));
    press("Page_Up", 2);
    spin(0.7);
    EXPECT_EQ(shown_, 0);
    // It goes on where it was.
    hidden(false);
    EXPECT_TRUE(spinUntil([&] { return shown_ > 3; }));
    EXPECT_TRUE(isAt(5.0)) << tried_->translation().transpose();
  }
  click(button("align"));
  EXPECT_TRUE(spinUntil([&] { return message().contains("Cancelled"); }));
}

TEST_F(AlignmentTest, ArrowsAndRingsAreDraggedByWhatTheMouseMoves)
{
  const Eigen::Vector3d centre(1.25, 15.25, 1.0);
  rviz::ViewController* view = manager_->getViewManager()->getCurrent();
  view->subProp("Distance")->setValue(0.6);
  click(button("align"));
  ASSERT_TRUE(spinUntil([&] { return tried_.has_value(); }));
  spin(0.5);
  for (int axis = 0; axis < 3; ++axis)
  {
    for (const double way : { 20.0, -20.0 })
    {
      SCOPED_TRACE(testing::Message() << "arrow "
                                      << "xyz"[axis] << " by " << way);
      const RigidTransform begun = *tried_;
      const Eigen::Vector3d arrow = begun * centre + 120.0 * Eigen::Vector3d::Unit(axis);  // 80 to 144 mm
      const QPoint from = onScreen(arrow), to = onScreen(arrow + way * Eigen::Vector3d::Unit(axis));
      drag(from, to);
      const Eigen::Vector3d moved = *tried_ * centre - begun * centre;
      // Both places are rounded to pixels, and it is the arrow's side that is held, up to 20 mm of 600 nearer.
      const double pixel = 20.0 / std::hypot(to.x() - from.x(), to.y() - from.y());  // [mm]
      EXPECT_NEAR(moved[axis], way, 1.2 * pixel + 0.04 * 20.0);
      EXPECT_LT(pixel, 3.0);
      EXPECT_LT((moved - moved[axis] * Eigen::Vector3d::Unit(axis)).norm(), 1e-3);
      EXPECT_LT(rotationAngle(*tried_ * begun.inverse()), 1e-5);
    }
  }
  for (int axis = 0; axis < 3; ++axis)
  {
    SCOPED_TRACE(testing::Message() << "ring "
                                    << "xyz"[axis]);
    const RigidTransform begun = *tried_;
    // Half way between two arrows, on the side that is seen.
    const auto ring = [&](double angle) -> Eigen::Vector3d
    {
      return begun * centre + 92.0 * (std::cos(angle) * Eigen::Vector3d::Unit((axis + 1) % 3) +
                                      std::sin(angle) * Eigen::Vector3d::Unit((axis + 2) % 3));
    };
    constexpr double kTurn = 10.0 / 180.0 * EIGEN_PI;
    drag(onScreen(ring(0.25 * EIGEN_PI)), onScreen(ring(0.25 * EIGEN_PI + kTurn)));
    const Eigen::AngleAxisd turn((*tried_ * begun.inverse()).linear());
    EXPECT_NEAR(turn.angle(), kTurn, 0.15 * kTurn);
    EXPECT_LT((turn.axis() - Eigen::Vector3d::Unit(axis)).norm(), 1e-3) << turn.axis().transpose();
    EXPECT_LT((*tried_ * centre - begun * centre).norm(), 1e-3);
  }
  click(button("align"));
  ASSERT_TRUE(spinUntil([&] { return message().contains("Cancelled"); }));
  view->subProp("Distance")->setValue(3.0);
}

TEST_F(AlignmentTest, ByMouseAndKeysToARegisteredPoseOnTf)
{
  expectMisplaced();
  click(button("align"));
  ASSERT_TRUE(spinUntil([&] { return tried_.has_value(); }));
  const RigidTransform begun = *tried_;
  auto* steps = panel_->findChild<QComboBox*>("shift_step");
  steps->setCurrentIndex(steps->findData(1.0));
  press("Left", 9);
  press("shift+Down", 3);
  press("ctrl+Up", 1);
  ASSERT_TRUE(
      spinUntil([&] { return std::abs(panel_->findChild<QLabel*>("total")->text().left(3).toDouble() - 9.0) < 0.05; }))
      << panel_->findChild<QLabel*>("total")->text().toStdString();
  clickStep("shift_x-");
  const Eigen::Vector3d centre(1.25, 15.25, 1.0);
  const auto moved = [&] { return Eigen::Vector3d(*tried_ * centre - begun * centre); };
  ASSERT_TRUE(spinUntil([&] { return std::abs(moved().x() + 10.0) < 1e-6; })) << moved().transpose();
  EXPECT_LT((moved() - Eigen::Vector3d(-10.0, 0.0, -0.3)).norm(), 1e-6) << moved().transpose();
  EXPECT_NEAR(rotationAngle(*tried_ * begun.inverse()) * 180.0 / EIGEN_PI, 1.0, 1e-6);

  // Meanwhile both views show the CT there, again and again.
  std::set<std::shared_ptr<const Rendering>> renderings;  // kept, so that none takes another's place
  const auto start = std::chrono::steady_clock::now();
  for (int i = 0; i < 10; ++i)
  {
    clickStep(i % 2 == 0 ? "turn_y+" : "turn_y-");
    spinUntil(
        [&]
        {
          renderings.insert(radiographs_->panes()[0]->view().picture().request.rendering);
          return false;
        },
        0.2);
  }
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::printf("the overlay followed at %.1f Hz\n", static_cast<double>(renderings.size()) / seconds);
  RecordProperty("overlay_hz", std::to_string(static_cast<double>(renderings.size()) / seconds));
  EXPECT_GT(renderings.size(), 4U);  // the registration renders at low priority, whatever else the machine does
  for (DetectorPane* pane : radiographs_->panes())
  {
    EXPECT_NE(pane->view().picture().request.rendering, nullptr) << pane->detector();
  }

  ASSERT_TRUE(spinUntil([&] { return button("register")->isEnabled(); }));
  expectMisplaced();
  const ros::Time asked = ros::Time::now();
  click(button("register"));
  // What is moved while the registration is at it was not asked for: it is told from where that began.
  steps->setCurrentIndex(steps->findData(10.0));
  clickStep("shift_y+");
  ASSERT_TRUE(spinUntil([&] { return message().contains("Registered") || message().contains("Not registered"); }))
      << message().toStdString();
  EXPECT_TRUE(message().contains("Registered")) << message().toStdString();
  EXPECT_LT(QRegularExpression("Registered, ([0-9.]+) mm").match(message()).captured(1).toDouble(), 5.0)
      << message().toStdString();
  ASSERT_TRUE(spinUntil([&] { return patient() && patient()->second > asked && gate_.verified; })) << gate_.text;
  spin(1.0);
  // As good as a registration of the phantom is: 0.2 mm.
  EXPECT_LT(patient()->first.norm(), 0.5) << patient()->first.transpose();
  EXPECT_EQ(gate_.reason, BeamGate::DISPLACED) << gate_.text;  // from where it was planned to be
  EXPECT_FALSE(opened_);
  EXPECT_FALSE(button("register")->isEnabled());
  // The trackers have learnt their regions where the target is: for them it was 12 mm off.
  const TreatmentSetup truth =
      loadTreatmentSetup(XRAY_TRACKING_TEST_FOLDER "/../../xray_tracking_core/config/phantom_neck.yaml");
  for (const ProjectionGeometry& detector : truth.detectors)
  {
    SCOPED_TRACE(detector.name());
    using xray_tracking_msgs::TrackedRegion;
    TrackedRegion region;
    const ros::Subscriber subscriber = ros::NodeHandle().subscribe<TrackedRegion>(
        detector.name() + "/tracked_region", 10, [&](const TrackedRegion::ConstPtr& message) { region = *message; });
    EXPECT_TRUE(spinUntil([&] { return region.reference_stamp > asked; }));
    EXPECT_EQ(region.state, TrackedRegion::TRACKING) << region.fault;
    const cv::Rect learnt = rectFromRegionMsg(region.region);
    const cv::Rect expected = projectedTargetRegion(truth, detector);
    EXPECT_LE(std::abs(learnt.x - expected.x) + std::abs(learnt.y - expected.y), 6);  // 1.6 mm
    EXPECT_LE(std::abs(learnt.width - expected.width) + std::abs(learnt.height - expected.height), 4);
  }
  spin(2.0);
  EXPECT_LT(patient()->first.norm(), 0.5) << patient()->first.transpose();
  EXPECT_TRUE(gate_.verified) << gate_.text;
  EXPECT_LT(TimedApplication::longest, 0.05);  // processor time: what else the machine does is not ours
  std::printf("longest event: %.1f ms of processor, %.1f ms of wall time\n", 1e3 * TimedApplication::longest,
              1e3 * TimedApplication::longest_wall);
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  return xray_tracking::RvizWindow::runTests(argc, argv, "alignment_test");
}
