#include <cmath>
#include <thread>

#include <QComboBox>
#include <QLabel>
#include <QProcess>
#include <QPushButton>
#include <QSpinBox>

#include <ros/callback_queue.h>
#include <xray_tracking_msgs/RenderViews.h>
#include <xray_tracking_msgs/TrainRegion.h>

#include "radiograph_panel.h"
#include "rviz_window.h"
#include "synthetic_room.h"

namespace xray_tracking
{
namespace
{
const cv::Rect kRegion(200, 150, 80, 100);

/// Services of trackers and registration, in a thread of their own as other nodes' are.
class FakeServices
{
public:
  FakeServices()
  {
    nh_.setCallbackQueue(&queue_);
    for (const char* name : { "left", "right" })
    {
      const boost::function<bool(xray_tracking_msgs::TrainRegion::Request&, xray_tracking_msgs::TrainRegion::Response&)>
          train = [this, name](auto& request, auto& response)
      {
        trained.emplace_back(
            name, cv::Rect(static_cast<int>(request.region.x_offset), static_cast<int>(request.region.y_offset),
                           static_cast<int>(request.region.width), static_cast<int>(request.region.height)));
        response.status = status;
        response.message = "as the test wants it";
        return true;
      };
      servers_.push_back(nh_.advertiseService(std::string(name) + "/train_region", train));
    }
    const boost::function<bool(xray_tracking_msgs::RenderViews::Request&, xray_tracking_msgs::RenderViews::Response&)>
        render = [this](auto& request, auto& response)
    {
      ++rendered;
      for (std::size_t i = 0; i < request.camera_infos.size(); ++i)
      {
        xray_tracking_msgs::RenderedView view;
        view.step = 2.0;
        view.first_x = view.first_y = 0.5;
        view.line_integrals.encoding = "32FC1";
        view.line_integrals.width = view.line_integrals.height = 256;
        view.line_integrals.step = 256 * sizeof(float);
        std::vector<float> values(256 * 256, 0.1F);
        for (std::size_t k = 0; k < values.size() / 2; ++k)
        {
          values[k] = 3.0F;  // the upper half
        }
        view.line_integrals.data.resize(values.size() * sizeof(float));
        std::memcpy(view.line_integrals.data.data(), values.data(), view.line_integrals.data.size());
        response.views.push_back(view);
      }
      response.success = true;
      return true;
    };
    servers_.push_back(nh_.advertiseService("registration/render", render));
    spinner_.start();
  }
  ~FakeServices() { spinner_.stop(); }

  std::vector<std::pair<std::string, cv::Rect>> trained;
  std::atomic<int> status{ 0 };
  std::atomic<int> rendered{ 0 };

private:
  ros::CallbackQueue queue_;
  ros::NodeHandle nh_;
  std::vector<ros::ServiceServer> servers_;
  ros::AsyncSpinner spinner_{ 1, &queue_ };
};

class RadiographPanelTest : public RvizWindow
{
protected:
  void SetUp() override
  {
    panel_ = dynamic_cast<RadiographPanel*>(addPanel("xray_tracking_rviz_plugins/RadiographPanel"));
    ASSERT_NE(panel_, nullptr);
    panel_->setMinimumWidth(1000);
    pose_ = ros::NodeHandle().advertise<geometry_msgs::PoseWithCovarianceStamped>("patient_pose", 2);
    run(2.5);
    ASSERT_EQ(panel_->panes().size(), 2U);
  }

  /// Sends complete exposures for a while.
  void run(
      double seconds, const std::function<bool()>& done = [] { return false; })
  {
    const ros::WallTime end = ros::WallTime::now() + ros::WallDuration(seconds);
    while (ros::WallTime::now() < end && !done())
    {
      sendAll();
      spin(0.05);
    }
  }

  /// One complete exposure.
  void sendAll()
  {
    const ros::Time stamp = ros::Time::now();
    for (SyntheticDetector* detector : { &left_, &right_ })
    {
      detector->send(stamp);
      detector->sendRegion(stamp, kRegion, 30.0, -20.0);
    }
    geometry_msgs::PoseWithCovarianceStamped pose;
    pose.header.stamp = stamp;
    pose.header.frame_id = "treatment_room";
    pose.pose.pose.orientation.w = 1.0;
    if (posed_)
    {
      pose_.publish(pose);
    }
    if (residuals_)
    {
      residuals_(stamp);
    }
  }

  /// Counts the pictures of the first view.
  void connectPictures(int& pictures)
  {
    QObject::connect(&view(0), &RadiographView::pictureChanged, panel_, [&pictures] { ++pictures; });
  }

  RadiographView& view(std::size_t pane) { return panel_->panes()[pane]->view(); }

  /// Screen position of a pixel's edge in a view.
  QPoint screen(std::size_t pane, double u, double v)
  {
    const Eigen::Vector2d widget = view(pane).picture().request.mapping.toWidget({ u, v });
    return view(pane).mapToGlobal(
        QPoint(static_cast<int>(std::lround(widget.x())), static_cast<int>(std::lround(widget.y()))));
  }

  /// Lets xdotool do what a person would, with the window alive.
  void xdotool(const QStringList& arguments)
  {
    QProcess process;
    process.start("xdotool", arguments);
    run(20.0, [&] { return process.state() == QProcess::NotRunning; });
    ASSERT_EQ(process.exitStatus(), QProcess::NormalExit) << arguments.join(' ').toStdString();
    ASSERT_EQ(process.exitCode(), 0) << process.readAllStandardError().toStdString();
    run(0.2);
  }

  void click(QWidget* widget)
  {
    const QPoint at = widget->mapToGlobal(widget->rect().center());
    xdotool({ "mousemove", QString::number(at.x()), QString::number(at.y()), "sleep", "0.1", "click", "1" });
  }

  void drag(const QPoint& from, const QPoint& to)
  {
    const QPoint half = (from + to) / 2;
    xdotool({ "mousemove",
              QString::number(from.x()),
              QString::number(from.y()),
              "sleep",
              "0.1",
              "mousedown",
              "1",
              "sleep",
              "0.1",
              "mousemove",
              QString::number(half.x()),
              QString::number(half.y()),
              "sleep",
              "0.1",
              "mousemove",
              QString::number(to.x()),
              QString::number(to.y()),
              "sleep",
              "0.1",
              "mouseup",
              "1" });
  }

  SyntheticDetector left_{ "left", 512 };
  SyntheticDetector right_{ "right", 512 };
  ros::Publisher pose_;
  bool posed_ = true;                                      ///< exposures have a pose
  std::function<void(const ros::Time& stamp)> residuals_;  ///< publishes them along, if there are any
  RadiographPanel* panel_ = nullptr;
};

/// Whether a widget shows a colour within two screen pixels of a place.
bool shows(QWidget& widget, const Eigen::Vector2d& at, const QColor& colour)
{
  const QImage image = widget.grab().toImage();
  for (int y = -2; y <= 2; ++y)
  {
    for (int x = -2; x <= 2; ++x)
    {
      const QPoint place(static_cast<int>(at.x()) + x, static_cast<int>(at.y()) + y);
      if (!image.rect().contains(place))
      {
        continue;
      }
      const QColor seen = image.pixelColor(place);
      if (std::abs(seen.red() - colour.red()) + std::abs(seen.green() - colour.green()) +
              std::abs(seen.blue() - colour.blue()) <
          60)
      {
        return true;
      }
    }
  }
  return false;
}

TEST_F(RadiographPanelTest, ShowsWhereTheRegionIs)
{
  const ViewMapping mapping = view(0).picture().request.mapping;
  // Middles of its four sides, moved by (30, -20); pixel edges.
  const double left = kRegion.x + 30 - 0.5, top = kRegion.y - 20 - 0.5;
  for (const Eigen::Vector2d& middle :
       { Eigen::Vector2d(left, top + 50), { left + 80, top + 50 }, { left + 40, top }, { left + 40, top + 100 } })
  {
    EXPECT_TRUE(shows(view(0), mapping.toWidget(middle), look::kGood)) << middle.transpose();
    const Eigen::Vector2d aside = mapping.toWidget(middle) + Eigen::Vector2d(8.0, 8.0);
    EXPECT_FALSE(shows(view(0), aside, look::kGood)) << middle.transpose();
  }
}

/// Asked for only while they are shown; from green to red, wherever the message has them, and no other.
TEST_F(RadiographPanelTest, ShowsResidualsWhileTheyAreWanted)
{
  QPushButton* button = panel_->findChild<QPushButton*>("residuals");
  ros::Publisher residuals =
      ros::NodeHandle().advertise<xray_tracking_msgs::RegionResiduals>("left/region_residuals", 2);
  run(0.5);
  EXPECT_EQ(residuals.getNumSubscribers(), 0U);
  click(button);
  run(5.0, [&] { return residuals.getNumSubscribers() > 0; });
  ASSERT_EQ(residuals.getNumSubscribers(), 1U);
  residuals_ = [&residuals](const ros::Time& stamp)
  {
    xray_tracking_msgs::RegionResiduals message;
    message.header.stamp = stamp;
    message.u = { 200.0F, 240.0F, std::nanf(""), 300.0F };
    message.v = { 210.0F, 230.0F, 250.0F, 300.0F };
    message.residual = { -1.5F, 0.0F, 0.3F, std::nanf("") };
    residuals.publish(message);
  };
  run(1.5);
  const ViewMapping mapping = view(0).picture().request.mapping;
  EXPECT_TRUE(shows(view(0), mapping.toWidget({ 200.0, 210.0 }), look::kBad));
  EXPECT_FALSE(shows(view(0), mapping.toWidget({ 240.0, 230.0 }), look::kBad));
  EXPECT_FALSE(shows(view(0), mapping.toWidget({ 300.0, 300.0 }), look::kBad));
  EXPECT_FALSE(shows(view(1), view(1).picture().request.mapping.toWidget({ 200.0, 210.0 }), look::kBad));
  click(button);
  run(5.0, [&] { return residuals.getNumSubscribers() == 0; });
  run(0.5);
  EXPECT_EQ(residuals.getNumSubscribers(), 0U);
  EXPECT_FALSE(shows(view(0), mapping.toWidget({ 200.0, 210.0 }), look::kBad));
}

TEST_F(RadiographPanelTest, TrainsTheRegionThatIsDrawn)
{
  FakeServices services;
  auto* draw = panel_->findChild<QPushButton*>("draw_region");
  ASSERT_NE(draw, nullptr);
  click(draw);
  ASSERT_TRUE(draw->isChecked());
  // What is tracked now is proposed; another one is drawn in the second view, from its lower right corner.
  ASSERT_TRUE(view(1).region());
  EXPECT_EQ(*view(1).region(), cv::Rect(kRegion.x + 30, kRegion.y - 20, kRegion.width, kRegion.height));
  drag(screen(1, 449.5, 469.5), screen(1, 329.5, 299.5));
  const cv::Rect drawn = view(1).region().value_or(cv::Rect());
  const double pixel = 1.0 / view(1).picture().request.mapping.scale + 1.0;  // a screen pixel's, and rounding
  EXPECT_NEAR(drawn.x, 330, pixel);
  EXPECT_NEAR(drawn.y, 300, pixel);
  EXPECT_NEAR(drawn.br().x, 450, pixel);
  EXPECT_NEAR(drawn.br().y, 470, pixel);
  DetectorPane* pane = panel_->panes()[1];
  EXPECT_EQ(pane->findChild<QSpinBox*>("region_width")->value(), drawn.width);
  // Moved by hand, resized by its right edge, then by a number.
  drag(screen(1, 390, 380), screen(1, 370, 370));
  EXPECT_NEAR(view(1).region()->x, drawn.x - 20, pixel);
  pane->findChild<QSpinBox*>("region_height")->setValue(111);
  EXPECT_EQ(view(1).region()->height, 111);

  const cv::Rect wanted = *view(1).region();
  click(pane->findChild<QPushButton*>("apply"));
  run(5.0, [&] { return !services.trained.empty(); });
  ASSERT_EQ(services.trained.size(), 1U);
  EXPECT_EQ(services.trained[0].first, "right");
  EXPECT_EQ(services.trained[0].second, wanted);
  auto* message = pane->findChild<QLabel*>("message");
  run(5.0, [&] { return message->text().contains("Now tracking"); });
  EXPECT_TRUE(message->text().contains("Now tracking")) << message->text().toStdString();

  // Undo asks for what was tracked before; a refusal is told in its words.
  services.status = xray_tracking_msgs::TrainRegion::Response::INVALID_REGION;
  click(pane->findChild<QPushButton*>("undo"));
  run(5.0, [&] { return message->text().contains("Not taken"); });
  ASSERT_EQ(services.trained.size(), 2U);
  EXPECT_EQ(services.trained[1].second, kRegion);
  EXPECT_TRUE(message->text().contains("as the test wants it")) << message->text().toStdString();
}

TEST_F(RadiographPanelTest, SaysWhenNoTrackerAnswers)
{
  panel_->findChild<QPushButton*>("draw_region")->setChecked(true);
  run(0.3);
  DetectorPane* pane = panel_->panes()[0];
  pane->findChild<QPushButton*>("apply")->click();
  auto* message = pane->findChild<QLabel*>("message");
  run(5.0, [&] { return message->text().contains("there is no service"); });
  EXPECT_TRUE(message->text().contains("there is no service")) << message->text().toStdString();
}

TEST_F(RadiographPanelTest, LaysTheCtOverTheExposureThatWasRendered)
{
  FakeServices services;
  auto* overlay = panel_->findChild<QComboBox*>("overlay");
  overlay->setCurrentIndex(static_cast<int>(Overlay::EDGES));
  run(5.0, [&] { return view(0).picture().request.rendering != nullptr; });
  run(1.0);
  ASSERT_TRUE(view(0).picture().request.rendering);
  // The edge between the halves, at half of the image's height.
  const ViewMapping mapping = view(0).picture().request.mapping;
  EXPECT_TRUE(shows(view(0), mapping.toWidget({ 100.0, 255.5 }), look::kOverlay));
  EXPECT_FALSE(shows(view(0), mapping.toWidget({ 100.0, 235.5 }), look::kOverlay));
  const int before = services.rendered;
  const ros::WallTime start = ros::WallTime::now();
  run(2.0);
  const double seconds = (ros::WallTime::now() - start).toSec();
  EXPECT_GT(services.rendered - before, 4);
  EXPECT_LE(services.rendered - before, 10.0 * seconds + 1.0);
  overlay->setCurrentIndex(0);
  run(0.5);
  const int after = services.rendered;
  run(0.5);
  EXPECT_EQ(services.rendered, after);  // nobody looks
}

/// A target that is lost is seen where it is now, not where it was rendered last.
TEST_F(RadiographPanelTest, WhatWasRenderedDoesNotStayInFrontOfExposuresWithoutAPose)
{
  FakeServices services;
  panel_->findChild<QComboBox*>("overlay")->setCurrentIndex(static_cast<int>(Overlay::EDGES));
  run(5.0, [&] { return view(0).picture().request.rendering != nullptr; });
  ASSERT_TRUE(view(0).picture().request.rendering);
  posed_ = false;
  run(4.0, [&] { return !view(0).picture().request.rendering; });
  EXPECT_FALSE(view(0).picture().request.rendering);
  run(0.5);
  EXPECT_LT((ros::Time::now() - view(0).picture().request.image->header.stamp).toSec(), 1.0);
  const QString said = panel_->findChild<QLabel*>("rendering")->text();
  EXPECT_TRUE(said.contains("No CT")) << said.toStdString();
  posed_ = true;
  run(5.0, [&] { return view(0).picture().request.rendering != nullptr; });
  EXPECT_TRUE(view(0).picture().request.rendering);
}

TEST_F(RadiographPanelTest, SurvivesWhatComes)
{
  sensor_msgs::CameraInfo info = left_.cameraInfo();
  info.K[0] = std::nan("");
  for (int i = 0; i < 10; ++i)
  {
    left_.send(ros::Time::now(), info);
    left_.sendRegion(ros::Time::now(), kRegion, std::nan(""), 1e300);
    spin(0.05);
  }
  const cv::Mat last = left_.pixels();
  panel_->findChild<QPushButton*>("draw_region")->setChecked(true);
  for (const cv::Size& size : { cv::Size(30, 700), cv::Size(1, 1), cv::Size(1500, 40) })
  {
    left_.pixels() = cv::Mat(size, CV_16UC1, cv::Scalar(500));
    run(0.4);
    EXPECT_EQ(view(0).picture().pixels.size(), size);
  }
  left_.pixels() = last;
  left_.send(ros::Time(3.0));
  spin(0.3);
  run(1.0);
  EXPECT_TRUE(view(0).picture().fault.empty()) << view(0).picture().fault;
  spin(2.5);  // silence
  EXPECT_EQ(panel_->panes().size(), 2U);
}

/// Two images of 1024 x 1024 pixels at 30 Hz with the CT laid over them. Processor time is judged, as what else the
/// machine does is not ours.
TEST_F(RadiographPanelTest, DoesNotKeepTheGuiThread)
{
  FakeServices services;
  left_.pixels() = cv::Mat(1024, 1024, CV_16UC1);
  right_.pixels() = cv::Mat(1024, 1024, CV_16UC1);
  cv::randu(left_.pixels(), 1000, 30000);
  cv::randu(right_.pixels(), 1000, 30000);
  panel_->findChild<QComboBox*>("overlay")->setCurrentIndex(static_cast<int>(Overlay::EDGES));
  run(1.0);
  TimedApplication::longest = TimedApplication::longest_wall = 0.0;
  TimedApplication::events = 0;
  int pictures = 0;
  connectPictures(pictures);
  const ros::WallTime end = ros::WallTime::now() + ros::WallDuration(5.0);
  while (ros::WallTime::now() < end)
  {
    sendAll();
    spin(0.025);
  }
  EXPECT_GT(TimedApplication::events, 100);
  EXPECT_GT(pictures, 20);
  EXPECT_LT(TimedApplication::longest, 0.05);
  RecordProperty("longest_event_ms", std::to_string(1e3 * TimedApplication::longest));
  RecordProperty("longest_event_wall_ms", std::to_string(1e3 * TimedApplication::longest_wall));
  std::printf("longest event: %.1f ms of processor, %.1f ms of wall time; %d pictures in 5 s\n",
              1e3 * TimedApplication::longest, 1e3 * TimedApplication::longest_wall, pictures);
}

TEST_F(RadiographPanelTest, KeepsItsSettings)
{
  panel_->findChild<QComboBox*>("overlay")->setCurrentIndex(3);
  panel_->findChild<QPushButton*>("inverted")->setChecked(true);
  panel_->findChild<QPushButton*>("residuals")->setChecked(true);
  view(0).setWindow(GreyWindow{ 1234.5, 30000.25, true });
  panel_->findChild<QPushButton*>("automatic")->setChecked(false);
  view(0).setWindow(GreyWindow{ 1234.5, 30000.25, true });
  run(0.5);
  rviz::Config config;
  panel_->save(config);
  panel_->findChild<QComboBox*>("overlay")->setCurrentIndex(0);
  panel_->findChild<QPushButton*>("inverted")->setChecked(false);
  panel_->findChild<QPushButton*>("residuals")->setChecked(false);
  panel_->findChild<QPushButton*>("automatic")->setChecked(true);
  panel_->load(config);
  run(0.5);
  EXPECT_EQ(panel_->findChild<QComboBox*>("overlay")->currentIndex(), 3);
  EXPECT_TRUE(panel_->findChild<QPushButton*>("inverted")->isChecked());
  EXPECT_TRUE(panel_->findChild<QPushButton*>("residuals")->isChecked());
  EXPECT_NEAR(view(0).picture().window.low, 1234.5, 0.01);
  EXPECT_NEAR(view(0).picture().window.high, 30000.25, 0.01);

  // Also of detectors that have not come, or have no image so far, when it is saved.
  rviz::Config later = config.mapGetChild("Windows").mapMakeChild("later");
  later.mapSetValue("Black", 12.5);
  later.mapSetValue("White", 25.0);
  auto* dark = dynamic_cast<RadiographPanel*>(addPanel("xray_tracking_rviz_plugins/RadiographPanel"));
  ASSERT_NE(dark, nullptr);
  dark->load(config);
  spin(1.5);
  ASSERT_EQ(dark->panes().size(), 2U);
  rviz::Config saved;
  dark->save(saved);
  for (const auto& [name, black] : { std::pair("left", 1234.5F), std::pair("later", 12.5F) })
  {
    float kept = 0.0F;
    EXPECT_TRUE(saved.mapGetChild("Windows").mapGetChild(name).mapGetFloat("Black", &kept)) << name;
    EXPECT_NEAR(kept, black, 0.01) << name;
  }
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  return xray_tracking::RvizWindow::runTests(argc, argv, "radiograph_panel_test");
}
