#include <OgreCamera.h>
#include <OgreRenderWindow.h>

#include <rviz/properties/property.h>
#include <rviz/properties/status_property.h>
#include <rviz/render_panel.h>
#include <rviz/view_controller.h>
#include <rviz/view_manager.h>

#include "rviz_window.h"
#include "synthetic_room.h"

namespace xray_tracking
{
namespace
{
const cv::Rect kSquare(320, 100, 80, 60);

class RadiographDisplayTest : public RvizWindow
{
protected:
  RadiographDisplayTest() { detector_.pixels()(kSquare).setTo(60000); }

  void SetUp() override
  {
    display_ = addDisplay("xray_tracking_rviz_plugins/Radiographs");
    display_->subProp("Panel distance")->setValue(SyntheticDetector::kDistance);
    display_->subProp("Rays")->setValue(false);
    rviz::ViewController* view = manager_->getViewManager()->getCurrent();
    view->subProp("Distance")->setValue(2.0);
    view->subProp("Yaw")->setValue(-1.2);  // from the source's side, a little from the right and above
    view->subProp("Pitch")->setValue(0.3);
  }

  /// Sends exposures for a while.
  void run(double seconds)
  {
    const ros::WallTime end = ros::WallTime::now() + ros::WallDuration(seconds);
    while (ros::WallTime::now() < end)
    {
      detector_.send(ros::Time::now());
      spin(0.03);
    }
  }

  /// The scene as it is on the screen.
  static Ogre::Image scene()
  {
    manager_->queueRender();
    spin(0.2);
    Ogre::RenderWindow* window = manager_->getRenderPanel()->getRenderWindow();
    Ogre::Image image;
    const std::uint32_t width = window->getWidth(), height = window->getHeight();
    auto* data = OGRE_ALLOC_T(Ogre::uchar, width * height * 3, Ogre::MEMCATEGORY_RENDERSYS);
    image.loadDynamicImage(data, width, height, 1, Ogre::PF_BYTE_RGB, true);
    window->copyContentsToMemory(Ogre::Box(0, 0, width, height), image.getPixelBox(), Ogre::RenderTarget::FB_AUTO);
    return image;
  }

  /// Brightness in the scene where a pixel of the radiograph is seen, 0 to 1.
  float at(const Ogre::Image& image, double u, double v) const
  {
    const std::vector<double> place = detector_.placeOf(u, v);
    const Ogre::Camera* camera = manager_->getRenderPanel()->getCamera();
    const Ogre::Vector3 seen =
        camera->getProjectionMatrix() *
        (camera->getViewMatrix() *
         Ogre::Vector3(static_cast<float>(place[0]), static_cast<float>(place[1]), static_cast<float>(place[2])));
    const auto x = static_cast<std::size_t>((0.5F + 0.5F * seen.x) * static_cast<float>(image.getWidth()));
    const auto y = static_cast<std::size_t>((0.5F - 0.5F * seen.y) * static_cast<float>(image.getHeight()));
    return image.getColourAt(x, y, 0).g;
  }

  void expectSquare() const
  {
    const Ogre::Image image = scene();
    // Five pixels to either side of its edges.
    const double left = kSquare.x, right = kSquare.br().x, top = kSquare.y, bottom = kSquare.br().y;
    const double x = 0.5 * (left + right), y = 0.5 * (top + bottom);
    for (const auto& inside :
         { std::array<double, 2>{ left + 5, y }, { right - 5, y }, { x, top + 5 }, { x, bottom - 5 } })
    {
      EXPECT_GT(at(image, inside[0], inside[1]), 0.8F) << inside[0] << ", " << inside[1];
    }
    for (const auto& outside :
         { std::array<double, 2>{ left - 5, y }, { right + 5, y }, { x, top - 5 }, { x, bottom + 5 } })
    {
      EXPECT_LT(at(image, outside[0], outside[1]), 0.3F) << outside[0] << ", " << outside[1];
    }
  }

  QString status() const
  {
    const rviz::Property* status = display_->childAt(0);
    QString text;
    for (int i = 0; i < status->numChildren(); ++i)
    {
      text += status->childAt(i)->getName() + ": " + status->childAt(i)->getValue().toString() + "\n";
    }
    return text;
  }

  SyntheticDetector detector_{ "overhead", 512 };
  rviz::Display* display_ = nullptr;
};

TEST_F(RadiographDisplayTest, ShowsTheImageWhereTheDetectorStands)
{
  run(3.0);
  EXPECT_TRUE(status().contains("images a second")) << status().toStdString();
  expectSquare();
  // Its own window, inverted.
  display_->subProp("Automatic window")->setValue(false);
  display_->subProp("Inverted")->setValue(true);
  display_->subProp("Black at")->setValue(1000.0);
  display_->subProp("White at")->setValue(65000.0);
  run(0.5);
  const Ogre::Image image = scene();
  EXPECT_LT(at(image, kSquare.x + 20, kSquare.y + 20), 0.1F);
  EXPECT_GT(at(image, kSquare.x - 20, kSquare.y + 20), 0.6F);
}

/// What update() takes of the GUI thread to show a new image of 1024 x 1024 pixels; drawing the scene is RViz's.
TEST_F(RadiographDisplayTest, DoesNotKeepTheGuiThread)
{
  detector_.pixels() = cv::Mat(1024, 1024, CV_16UC1);
  cv::randu(detector_.pixels(), 1000, 30000);
  run(2.0);
  double longest = 0.0;
  for (int i = 0; i < 20; ++i)
  {
    detector_.send(ros::Time::now());
    ros::WallDuration(0.06).sleep();  // the image is converted meanwhile, and nobody takes it
    const double start = TimedApplication::processorTime();
    display_->update(0.03F, 0.03F);
    longest = std::max(longest, TimedApplication::processorTime() - start);
    spin(0.02);
  }
  EXPECT_LT(longest, 0.05);
  EXPECT_GT(longest, 0.0);
  RecordProperty("longest_update_ms", std::to_string(1e3 * longest));
  std::printf("longest update: %.1f ms of processor time\n", 1e3 * longest);
}

TEST_F(RadiographDisplayTest, SurvivesWhatComes)
{
  run(2.0);
  sensor_msgs::CameraInfo info = detector_.cameraInfo();
  info.K[0] = std::nan("");
  for (int i = 0; i < 20; ++i)
  {
    detector_.send(ros::Time::now(), info);
    spin(0.05);
  }
  EXPECT_TRUE(status().contains("nan", Qt::CaseInsensitive)) << status().toStdString();
  // Another size, then the old one, back in time.
  const cv::Mat last = detector_.pixels();
  detector_.pixels() = cv::Mat(300, 300, CV_16UC1, cv::Scalar(500));
  run(1.0);
  EXPECT_TRUE(status().contains("images a second")) << status().toStdString();
  detector_.pixels() = last;
  for (int i = 0; i < 10; ++i)
  {
    detector_.send(ros::Time(5.0 + 0.1 * i));
    spin(0.05);
  }
  run(1.0);
  expectSquare();
  spin(4.5);  // silence
  EXPECT_TRUE(status().contains("No image for")) << status().toStdString();
  manager_->setFixedFrame("nowhere");
  spin(1.0);
  EXPECT_TRUE(status().contains("No transform")) << status().toStdString();
  manager_->setFixedFrame("treatment_room");
  display_->setEnabled(false);
  run(0.5);
  display_->setEnabled(true);
  run(2.0);
  expectSquare();
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  return xray_tracking::RvizWindow::runTests(argc, argv, "radiograph_display_test");
}
