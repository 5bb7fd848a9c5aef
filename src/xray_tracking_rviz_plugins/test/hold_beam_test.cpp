// The operator's panel and motion estimation, each as it is: a click holds the beam, a lost panel does.
#include "rviz_window.h"

#include <csignal>
#include <cstdlib>

#include <std_msgs/Header.h>
#include <std_srvs/SetBool.h>
#include <xray_tracking_msgs/BeamGate.h>
#include <QProcess>
#include <QPushButton>

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::BeamGate;
constexpr const char* kPanel = "xray_tracking_rviz_plugins/TreatmentPanel";

class HoldBeamTest : public RvizWindow
{
protected:
  void SetUp() override
  {
    ros::NodeHandle nh;
    gate_subscriber_ = nh.subscribe<BeamGate>("beam_gate", 10,
                                              [this](const BeamGate::ConstPtr& gate)
                                              {
                                                reason_ = gate->reason;
                                                opened_ = opened_ || gate->open;
                                              });
    beat_subscriber_ = nh.subscribe<std_msgs::Header>(
        "operator_present", 10, [this](const std_msgs::Header::ConstPtr& beat) { last_panel_ = beat->frame_id; });
    ASSERT_TRUE(spinUntil([&] { return reason_ >= 0; }));
  }

  bool held() const { return reason_ == BeamGate::HELD; }

  /// With the mouse, where the button is on the screen.
  static void click(const QWidget* button)
  {
    const QPoint at = button->mapToGlobal(button->rect().center());
    const std::string command =
        "xdotool mousemove " + std::to_string(at.x()) + " " + std::to_string(at.y()) + " click 1";
    ASSERT_EQ(std::system(command.c_str()), 0);
  }

  int reason_ = -1;
  bool opened_ = false;
  std::string last_panel_;
  ros::Subscriber gate_subscriber_, beat_subscriber_;
};

TEST_F(HoldBeamTest, AClickHoldsAndAnotherReleases)
{
  rviz::Panel* panel = addPanel(kPanel);
  ASSERT_NE(panel, nullptr);
  const auto* hold = panel->findChild<QPushButton*>("hold");
  const auto* release = panel->findChild<QPushButton*>("release");
  ASSERT_TRUE(hold != nullptr && release != nullptr);
  // Not before the panel is heard, so that what holds is the click.
  ASSERT_TRUE(spinUntil([&] { return !last_panel_.empty(); }));
  spin(0.5);
  EXPECT_FALSE(held());
  click(hold);
  EXPECT_TRUE(spinUntil([&] { return held(); }, 3.0));
  spin(2.0);
  EXPECT_TRUE(held());
  ASSERT_TRUE(spinUntil([&] { return release->isEnabled(); }));
  click(release);
  EXPECT_TRUE(spinUntil([&] { return !held(); }, 3.0));
  spin(1.5);
  EXPECT_FALSE(held());
  EXPECT_FALSE(opened_);  // there was no exposure
}

TEST_F(HoldBeamTest, KillingRVizHoldsUntilAnotherPanelReleases)
{
  last_panel_.clear();
  QProcess rviz;
  rviz.setProcessChannelMode(QProcess::ForwardedChannels);
  rviz.start("rosrun", { "rviz", "rviz", "-d", XRAY_TRACKING_TEST_FOLDER "/operator.rviz", "__name:=operators_rviz" });
  ASSERT_TRUE(rviz.waitForStarted());
  ASSERT_TRUE(spinUntil([&] { return last_panel_ == "/operators_rviz"; }, 60.0));
  // A panel of a test before is gone, which held the beam already.
  ros::ServiceClient hold = ros::NodeHandle().serviceClient<std_srvs::SetBool>("motion_estimation/hold_beam");
  std_srvs::SetBool release;
  release.request.data = 0U;
  ASSERT_TRUE(hold.call(release));
  ASSERT_TRUE(release.response.success) << release.response.message;
  ASSERT_TRUE(spinUntil([&] { return !held(); }, 3.0));
  spin(2.5);
  EXPECT_FALSE(held());

  ASSERT_GT(rviz.processId(), 0);
  ::kill(static_cast<pid_t>(rviz.processId()), SIGKILL);
  const ros::SteadyTime killed = ros::SteadyTime::now();
  EXPECT_TRUE(spinUntil([&] { return held(); }, 5.0));
  // The silence that is let pass, the time between two beats, and a busy machine's.
  EXPECT_LT((ros::SteadyTime::now() - killed).toSec(), 2.5);
  rviz.waitForFinished();
  ASSERT_TRUE(hold.call(release));
  EXPECT_FALSE(release.response.success);  // there is no panel

  rviz::Panel* panel = addPanel(kPanel);
  ASSERT_NE(panel, nullptr);
  const auto* button = panel->findChild<QPushButton*>("release");
  ASSERT_TRUE(spinUntil([&] { return button->isEnabled() && last_panel_ != "/operators_rviz"; }));
  spin(0.5);
  EXPECT_TRUE(held());
  click(button);
  EXPECT_TRUE(spinUntil([&] { return !held(); }, 3.0));
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  return xray_tracking::RvizWindow::runTests(argc, argv, "hold_beam_test");
}
