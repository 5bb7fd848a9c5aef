// The phantom's bone on the screen, against rays through its closed-form solids.
#include "rviz_window.h"

#include <cmath>
#include <limits>

#include <OgreCamera.h>
#include <OgreRenderWindow.h>
#include <OgreViewport.h>
#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <rviz/properties/property.h>
#include <rviz/properties/status_list.h>
#include <rviz/render_panel.h>
#include <rviz/view_controller.h>
#include <rviz/view_manager.h>
#include <std_msgs/String.h>
#include <tf2_ros/static_transform_broadcaster.h>
#include <Eigen/Geometry>
#include <QImage>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/volume/neck_phantom.h"

namespace xray_tracking
{
namespace
{
constexpr const char* kDisplay = "xray_tracking_rviz_plugins/Anatomy";

class AnatomyDisplayTest : public RvizWindow
{
protected:
  static void SetUpTestSuite()
  {
    geometry_msgs::TransformStamped transform;
    transform.header.frame_id = kRoomFrame;
    transform.child_frame_id = "somewhere";
    transform.transform.rotation.w = 1.0;
    broadcaster_ = std::make_unique<tf2_ros::StaticTransformBroadcaster>();
    broadcaster_->sendTransform(transform);
  }
  static void TearDownTestSuite() { broadcaster_.reset(); }

  void SetUp() override
  {
    ros::NodeHandle nh;
    poses_ = nh.advertise<geometry_msgs::PoseWithCovarianceStamped>("patient_pose", 1, true);
    truths_ = nh.advertise<geometry_msgs::PoseStamped>("patient_ground_truth", 1, true);
    display_ = addDisplay(kDisplay);
    ASSERT_NE(display_, nullptr);
    rviz::ViewController* view = manager_->getViewManager()->getCurrent();
    view->subProp("Distance")->setValue(0.45);
    view->subProp("Yaw")->setValue(0.7);
    view->subProp("Pitch")->setValue(0.4);
    view->subProp("Near Clip Distance")->setValue(0.01);
  }

  void publish(const RigidTransform& room_from_patient)
  {
    geometry_msgs::PoseWithCovarianceStamped pose;
    pose.header.stamp = ros::Time::now();
    pose.header.frame_id = kRoomFrame;
    pose.pose = poseWithCovarianceMsg(room_from_patient, 0.01 * Eigen::Matrix<double, 6, 6>::Identity());
    poses_.publish(pose);
  }

  /// What is in RViz's 3D view.
  static QImage picture()
  {
    manager_->queueRender();
    spin(0.3);
    Ogre::RenderTarget* window = manager_->getRenderPanel()->getViewport()->getTarget();
    QImage image(static_cast<int>(window->getWidth()), static_cast<int>(window->getHeight()), QImage::Format_RGB888);
    window->copyContentsToMemory(
        Ogre::Box(0, 0, window->getWidth(), window->getHeight()),
        Ogre::PixelBox(window->getWidth(), window->getHeight(), 1, Ogre::PF_BYTE_RGB, image.bits()));
    return image;
  }

  static bool isBackground(const QColor& colour)
  {
    return colour.red() < 40 && colour.green() < 40 && colour.blue() < 40;
  }

  static std::size_t bonePixels()
  {
    const QImage image = picture();
    std::size_t count = 0;
    for (int y = 0; y < image.height(); y += 4)
    {
      for (int x = 0; x < image.width(); x += 4)
      {
        count += isBackground(image.pixelColor(x, y)) ? 0 : 1;
      }
    }
    return count;
  }

  static inline std::unique_ptr<tf2_ros::StaticTransformBroadcaster> broadcaster_;
  rviz::Display* display_ = nullptr;
  ros::Publisher poses_, truths_;
};

TEST_F(AnatomyDisplayTest, BoneIsWhereItsProjectionIs)
{
  display_->subProp("Target box")->setValue(false);
  display_->subProp("Uncertainty")->setValue(false);
  RigidTransform room_from_patient = RigidTransform::Identity();
  room_from_patient.linear() =
      (Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 3).normalized()) * Eigen::Quaterniond(0.5, 0.5, -0.5, 0.5))
          .toRotationMatrix();
  room_from_patient.translation() = Eigen::Vector3d(20.0, -15.0, 10.0);
  ASSERT_TRUE(spinUntil(
      [&]
      {
        publish(room_from_patient);
        return bonePixels() > 500;
      },
      120.0));
  publish(room_from_patient);
  const QImage image = picture();

  const Ogre::Camera* camera = manager_->getRenderPanel()->getCamera();
  const NeckPhantom phantom;
  const RigidTransform patient_from_room = room_from_patient.inverse();
  // What the 200 mm of CT hold of the phantom, which is what can be shown.
  const Eigen::AlignedBox3d ct(Eigen::Vector3d::Constant(-99.5), Eigen::Vector3d::Constant(99.5));
  int right = 0;
  int bone = 0;
  int judged = 0;
  for (int y = 5; y < image.height(); y += 10)
  {
    for (int x = 5; x < image.width(); x += 10)
    {
      const Ogre::Ray ray = camera->getCameraToViewportRay((x + 0.5F) / image.width(), (y + 0.5F) / image.height());
      const auto vector = [](const Ogre::Vector3& v) { return Eigen::Vector3d(v.x, v.y, v.z); };
      const Eigen::Vector3d from = patient_from_room * (1e3 * vector(ray.getOrigin()));
      const Eigen::Vector3d along = patient_from_room.linear() * vector(ray.getDirection()).normalized();
      double most = -1000.0;
      for (double step = 50.0; step < 800.0; step += 0.5)
      {
        const Eigen::Vector3d point = from + step * along;
        if (ct.contains(point))
        {
          most = std::max(most, huFromMaterials(phantom.at(point)));
        }
      }
      ++judged;
      bone += most > 200.0 ? 1 : 0;
      right += (most > 200.0) == !isBackground(image.pixelColor(x, y)) ? 1 : 0;
    }
  }
  EXPECT_GT(bone, judged / 20);
  // Edges of bone are as wide as a voxel, 1 mm of the 300 that are seen; thin plates are lost by partial volume.
  EXPECT_GT(right, 0.97 * judged) << right << " of " << judged << ", bone " << bone;
}

TEST_F(AnatomyDisplayTest, TargetIsColouredAndFollowsThePose)
{
  for (const char* name : { "Target box", "Uncertainty", "Bones" })
  {
    display_->subProp(name)->setValue(false);
  }
  const auto middle = [&](double x_mm)
  {
    RigidTransform pose = RigidTransform::Identity();
    pose.translation() = Eigen::Vector3d(0.0, 0.0, x_mm);
    EXPECT_TRUE(spinUntil(
        [&]
        {
          publish(pose);
          return bonePixels() > 50;
        },
        60.0));
    publish(pose);
    const QImage image = picture();
    double rows = 0.0;
    int count = 0;
    for (int y = 0; y < image.height(); y += 2)
    {
      for (int x = 0; x < image.width(); x += 2)
      {
        const QColor colour = image.pixelColor(x, y);
        if (!isBackground(colour))
        {
          EXPECT_GT(colour.red(), 1.2 * colour.green()) << colour.name().toStdString();  // not bone's colour
          rows += y;
          ++count;
        }
      }
    }
    return rows / count;
  };
  const double below = middle(-20.0);
  const double above = middle(20.0);
  EXPECT_GT(below - above, 20.0);  // up by 40 mm

  const auto brightness = [&]
  {
    const QImage image = picture();
    double sum = 0.0;
    for (int y = 0; y < image.height(); y += 2)
    {
      for (int x = 0; x < image.width(); x += 2)
      {
        const QColor colour = image.pixelColor(x, y);
        sum += isBackground(colour) ? 0.0 : colour.red();
      }
    }
    return sum;
  };
  middle(0.0);
  const double known = brightness();
  double seen = known;
  // Half of it and more where several surfaces lie behind each other.
  EXPECT_TRUE(spinUntil([&] { return (seen = brightness()) < 0.9 * known; }, 10.0))
      << "where no pose comes any more it is faded: " << seen << " of " << known;
  middle(0.0);
  EXPECT_TRUE(spinUntil([&] { return brightness() > 0.99 * known; }, 5.0));
}

TEST_F(AnatomyDisplayTest, IsOfTheCtThatTheRegistrationHasLoaded)
{
  ros::Publisher volumes = ros::NodeHandle().advertise<std_msgs::String>("registration/volume", 1, true);
  const auto status = [&]
  {
    std::string text;
    for (int i = 0; i < display_->numChildren(); ++i)
    {
      const auto* list = dynamic_cast<const rviz::StatusList*>(display_->childAt(i));
      for (int k = 0; list != nullptr && k < list->numChildren(); ++k)
      {
        const rviz::Property* line = list->childAt(k);
        text += line->getNameStd() + ": " + line->getValue().toString().toStdString() + "\n";
      }
    }
    return text;
  };
  std_msgs::String volume;
  volume.data = "/nowhere/another.nrrd";
  volumes.publish(volume);
  EXPECT_TRUE(spinUntil([&] { return status().find("/nowhere/another.nrrd: leads out of the") != std::string::npos; }))
      << status();
  volume.data.clear();
  volumes.publish(volume);
  EXPECT_TRUE(spinUntil([&] { return status().find("CT: the neck phantom") != std::string::npos; }, 120.0)) << status();
}

TEST_F(AnatomyDisplayTest, LivesThroughWhateverComes)
{
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (int i = 0; i < 30; ++i)
  {
    geometry_msgs::PoseWithCovarianceStamped pose;
    pose.header.stamp = ros::Time(1000.0 - i);
    pose.pose.pose.orientation.w = i % 3 == 0 ? 0.0 : i % 3 == 1 ? nan : 1.0;
    pose.pose.pose.position.x = i % 4 == 0 ? nan : 1e12;
    pose.pose.covariance[0] = i % 2 == 0 ? nan : -1.0;
    poses_.publish(pose);
    geometry_msgs::PoseStamped truth;
    truth.pose.position.y = nan;
    truths_.publish(truth);
    if (i % 10 == 5)
    {
      display_->setEnabled(!display_->isEnabled());
    }
    if (i == 20)
    {
      display_->reset();
    }
    spin(0.05);
  }
  display_->setEnabled(true);
  publish(RigidTransform::Identity());
  EXPECT_TRUE(spinUntil(
      [&]
      {
        publish(RigidTransform::Identity());
        return bonePixels() > 500;
      },
      60.0));
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  return xray_tracking::RvizWindow::runTests(argc, argv, "anatomy_display_test");
}
