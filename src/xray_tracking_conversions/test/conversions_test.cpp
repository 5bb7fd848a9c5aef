#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/image_pixels.h"
#include "xray_tracking_conversions/log_throttle.h"

#include <cmath>
#include <functional>
#include <limits>
#include <stdexcept>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

namespace xray_tracking
{
namespace
{
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kSourceToDetector = 3800.0;

void expectRefused(const std::function<void()>& call, const std::string& field)
{
  try
  {
    call();
    ADD_FAILURE() << "nothing thrown, expected a message about " << field;
  }
  catch (const std::invalid_argument& error)
  {
    EXPECT_NE(std::string(error.what()).find(field), std::string::npos) << error.what();
  }
}

/// 90 degrees about z and (1, 2, 3) mm, so that every image of a point is known by hand.
RigidTransform quarterTurn()
{
  RigidTransform transform = RigidTransform::Identity();
  transform.linear() << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  transform.translation() << 1, 2, 3;
  return transform;
}

/// Off-centre, with unequal pitches, tilted about the room's axes.
ProjectionGeometry obliqueDetector()
{
  const double angle = 0.5;
  return ProjectionGeometry::fromDescription({ "detector_a",
                                               { 512, 400 },
                                               { 0.4, 0.5 },
                                               { 10.0, 20.0, 2600.0 },
                                               { -90.0, 110.0, -1200.0 },
                                               { std::cos(angle), 0.0, std::sin(angle) },
                                               { 0.0, -1.0, 0.0 } });
}

TEST(Conversions, TransformIsInMetres)
{
  const geometry_msgs::Transform message = transformMsgFromRigid(quarterTurn());
  EXPECT_DOUBLE_EQ(message.translation.x, 0.001);
  EXPECT_DOUBLE_EQ(message.translation.y, 0.002);
  EXPECT_DOUBLE_EQ(message.translation.z, 0.003);
  EXPECT_NEAR(message.rotation.x, 0.0, 1e-15);
  EXPECT_NEAR(message.rotation.y, 0.0, 1e-15);
  EXPECT_NEAR(message.rotation.z, std::sqrt(0.5), 1e-15);
  EXPECT_NEAR(message.rotation.w, std::sqrt(0.5), 1e-15);
  EXPECT_TRUE(rigidFromTransformMsg(message).isApprox(quarterTurn(), 1e-12));
}

TEST(Conversions, PoseIsInMetres)
{
  const geometry_msgs::Pose message = poseMsgFromRigid(quarterTurn());
  EXPECT_DOUBLE_EQ(message.position.y, 0.002);
  EXPECT_NEAR(message.orientation.z, std::sqrt(0.5), 1e-15);
  EXPECT_TRUE(rigidFromPoseMsg(message).isApprox(quarterTurn(), 1e-12));
  EXPECT_DOUBLE_EQ(vectorMsgFromMillimetres({ 4.0, 5.0, 6.0 }).z, 0.006);
}

TEST(Conversions, PosesThatAreNoneAreRefused)
{
  const geometry_msgs::Pose good = poseMsgFromRigid(quarterTurn());
  geometry_msgs::Pose bad = good;
  bad.position.y = kNaN;
  expectRefused([&] { rigidFromPoseMsg(bad); }, "position");
  bad = good;
  bad.orientation.w = kNaN;
  expectRefused([&] { rigidFromPoseMsg(bad); }, "orientation");
  expectRefused([] { rigidFromPoseMsg(geometry_msgs::Pose()); }, "orientation");
  geometry_msgs::Transform transform = transformMsgFromRigid(quarterTurn());
  transform.translation.x = std::numeric_limits<double>::infinity();
  expectRefused([&] { rigidFromTransformMsg(transform); }, "translation");
}

TEST(Conversions, CovarianceIsInMetresAndRadians)
{
  Eigen::Matrix<double, 6, 6> covariance;
  for (int i = 0; i < 36; ++i)
    covariance(i / 6, i % 6) = 1.0 + i;
  const geometry_msgs::PoseWithCovariance message = poseWithCovarianceMsg(quarterTurn(), covariance);
  EXPECT_DOUBLE_EQ(message.covariance[1], 2.0e-6);    // x, y: mm^2
  EXPECT_DOUBLE_EQ(message.covariance[5], 6.0e-3);    // x, rotation z: mm rad
  EXPECT_DOUBLE_EQ(message.covariance[30], 31.0e-3);  // rotation z, x
  EXPECT_DOUBLE_EQ(message.covariance[35], 36.0);     // rotation z: rad^2
  EXPECT_TRUE(covarianceFromPoseMsg(message).isApprox(covariance, 1e-15));
  geometry_msgs::PoseWithCovariance bad = message;
  bad.covariance[7] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(covarianceFromPoseMsg(bad), std::invalid_argument);
  const auto block = covarianceMsgFromMillimetres(covariance.topLeftCorner<3, 3>());
  EXPECT_DOUBLE_EQ(block[1], 2.0e-6);
  EXPECT_DOUBLE_EQ(block[3], 7.0e-6);
}

TEST(Conversions, TimeKeepsEveryNanosecond)
{
  const std::int64_t nanoseconds = 1700000000123456789;
  EXPECT_EQ(timeFromNanoseconds(nanoseconds).sec, 1700000000u);
  EXPECT_EQ(timeFromNanoseconds(nanoseconds).nsec, 123456789u);
  EXPECT_EQ(nanosecondsFromTime(timeFromNanoseconds(nanoseconds)), nanoseconds);
  EXPECT_THROW(timeFromNanoseconds(-1), std::invalid_argument);
  EXPECT_THROW(timeFromNanoseconds(std::numeric_limits<std::int64_t>::max()), std::invalid_argument);
}

TEST(Conversions, CameraInfoProjectsAsTheGeometryDoes)
{
  const ProjectionGeometry geometry = obliqueDetector();
  const sensor_msgs::CameraInfo info = cameraInfoFromGeometry(geometry);
  EXPECT_EQ(info.header.frame_id, "detector_a_optical_frame");
  EXPECT_EQ(info.width, 512u);
  EXPECT_EQ(info.height, 400u);

  // Line-plane intersection from the description alone, without focal length or foot.
  const DetectorDescription& d = geometry.description();
  const Eigen::Vector3d point(15.0, -25.0, 35.0);
  const Eigen::Vector3d normal = d.x_direction.cross(d.y_direction);
  const double along = normal.dot(d.origin - d.source) / normal.dot(point - d.source);
  const Eigen::Vector3d on_panel = d.source + along * (point - d.source) - d.origin;
  const Eigen::Vector2d expected(on_panel.dot(d.x_direction) / 0.4, on_panel.dot(d.y_direction) / 0.5);

  const RigidTransform room_from_optical = rigidFromTransformMsg(transformMsgFromRigid(geometry.roomFromOptical()));
  const Eigen::Vector3d in_camera = room_from_optical.inverse() * point;
  const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> p(info.P.data());
  EXPECT_TRUE(expected.isApprox((p * in_camera.homogeneous()).hnormalized(), 1e-9));
  // Another distance of the panel is the same projection.
  for (const double distance : { geometry.sourceToDetector(), 1000.0 })
  {
    const auto restored = geometryFromCameraInfo("detector_a", info, room_from_optical, distance);
    EXPECT_TRUE(expected.isApprox(restored.project(point), 1e-9)) << restored.project(point).transpose();
  }
  EXPECT_TRUE(geometryFromCameraInfo("detector_a", info, room_from_optical, geometry.sourceToDetector())
                  .origin()
                  .isApprox(d.origin, 1e-9));
}

TEST(Conversions, CameraInfoOfAForeignDriver)
{
  // No R, no P, no distortion model, the ROI spelt out.
  sensor_msgs::CameraInfo info = cameraInfoFromGeometry(obliqueDetector());
  info.R.assign(0.0);
  info.P.assign(0.0);
  info.D.clear();
  info.distortion_model.clear();
  info.roi.width = info.width;
  info.roi.height = info.height;
  EXPECT_NO_THROW(geometryFromCameraInfo("a", info, RigidTransform::Identity(), kSourceToDetector));
}

TEST(Conversions, CameraInfoThatIsNoPinholeIsRefused)
{
  const auto refused = [](const std::string& field, const std::function<void(sensor_msgs::CameraInfo&)>& damage)
  {
    sensor_msgs::CameraInfo info = cameraInfoFromGeometry(obliqueDetector());
    damage(info);
    expectRefused([&] { geometryFromCameraInfo("a", info, RigidTransform::Identity(), kSourceToDetector); }, field);
  };
  refused("K[0]", [](auto& info) { info.K.assign(0.0); });
  refused("K[4]", [](auto& info) { info.K[4] = -1.0; });
  refused("K[2]", [](auto& info) { info.K[2] = kNaN; });
  refused("K[1]", [](auto& info) { info.K[1] = 0.5; });
  refused("K[8]", [](auto& info) { info.K[8] = kNaN; });
  refused("R[0]", [](auto& info) { info.R[0] = -1.0; });
  refused("P[0]", [](auto& info) { info.P[0] *= 2.0; });
  refused("P[3]", [](auto& info) { info.P[3] = -100.0; });
  refused("D[1]", [](auto& info) { info.D[1] = 0.01; });
  refused("D[0]", [](auto& info) { info.D[0] = kNaN; });
  refused("binning_x", [](auto& info) { info.binning_x = 2; });
  refused("binning_y", [](auto& info) { info.binning_y = 4; });
  refused("roi", [](auto& info) { info.roi.x_offset = 1; });
  refused("roi", [](auto& info) { info.roi.width = 100; });
  refused("width", [](auto& info) { info.width = std::numeric_limits<std::uint32_t>::max(); });
  refused("image_size", [](auto& info) { info.height = 0; });
}

TEST(Conversions, RegionKeepsItsPlace)
{
  const cv::Rect rect(100, 120, 150, 200);
  const sensor_msgs::RegionOfInterest message = regionMsgFromRect(rect);
  EXPECT_EQ(message.x_offset, 100u);
  EXPECT_EQ(message.height, 200u);
  EXPECT_EQ(rectFromRegionMsg(message), rect);
  EXPECT_THROW(regionMsgFromRect({ -1, 0, 10, 10 }), std::invalid_argument);
  sensor_msgs::RegionOfInterest huge = message;
  huge.width = std::numeric_limits<std::uint32_t>::max();
  expectRefused([&] { rectFromRegionMsg(huge); }, "width");
}

/// 3 x 2 pixels 1, 258, 3 / 515, 5, 65535 in every form that messages have.
TEST(Conversions, PixelsOfEveryImage)
{
  cv::Mat wide = (cv::Mat_<std::uint16_t>(2, 3) << 1, 258, 3, 515, 5, 65535);
  cv::Mat narrow = (cv::Mat_<std::uint8_t>(2, 3) << 1, 2, 3, 4, 5, 255);
  for (const std::uint32_t padding : { 0u, 1u, 4u })
  {
    for (const bool big_endian : { false, true })
    {
      for (const char* encoding : { "mono8", "8UC1", "mono16", "16UC1" })
      {
        SCOPED_TRACE(testing::Message() << encoding << ", padding " << padding << ", big endian " << big_endian);
        const cv::Mat& expected = std::string(encoding).find("16") != std::string::npos ? wide : narrow;
        const int bytes = static_cast<int>(expected.elemSize());
        sensor_msgs::Image message;
        message.width = 3;
        message.height = 2;
        message.encoding = encoding;
        message.is_bigendian = big_endian;
        message.step = static_cast<std::uint32_t>(3 * bytes) + padding;
        for (int y = 0; y < 2; ++y)
        {
          for (int x = 0; x < 3; ++x)
          {
            const int value = bytes == 1 ? narrow.at<std::uint8_t>(y, x) : wide.at<std::uint16_t>(y, x);
            for (int byte = 0; byte < bytes; ++byte)
            {
              message.data.push_back(static_cast<std::uint8_t>(value >> 8 * (big_endian ? bytes - 1 - byte : byte)));
            }
          }
          message.data.insert(message.data.end(), padding, 77);
        }
        const cv::Mat pixels = pixelsFromMsg(message);
        ASSERT_EQ(pixels.type(), expected.type());
        EXPECT_EQ(cv::countNonZero(pixels != expected), 0) << pixels;
        message.data.resize(message.data.size() - padding - 1);
        expectRefused([&] { pixelsFromMsg(message); }, "step");
      }
    }
  }
  sensor_msgs::Image colour;
  colour.encoding = "rgb8";
  expectRefused([&] { pixelsFromMsg(colour); }, "image.encoding");

  for (const cv::Mat& image : { wide, narrow })
  {
    sensor_msgs::CompressedImage message;
    message.format = "mono16; png compressed ";
    cv::imencode(".png", image, message.data);
    EXPECT_EQ(cv::countNonZero(pixelsFromMsg(message) != image), 0);
    message.data.resize(message.data.size() / 2);
    expectRefused([&] { pixelsFromMsg(message); }, "png compressed");
  }
  sensor_msgs::CompressedImage message;
  expectRefused([&] { pixelsFromMsg(message); }, "compressed image");
  cv::imencode(".png", cv::Mat(2, 3, CV_8UC3, cv::Scalar(1, 2, 3)), message.data);
  expectRefused([&] { pixelsFromMsg(message); }, "one channel");
  cv::imencode(".png", cv::Mat(2, 16385, CV_8UC1, cv::Scalar(1)), message.data);
  expectRefused([&] { pixelsFromMsg(message); }, "16384 x 16384 pixels at most");
}

TEST(LogThrottle, EachCauseOnceASecond)
{
  LogThrottle one, other;
  EXPECT_TRUE(one.due("lost"));
  EXPECT_FALSE(one.due("lost"));
  EXPECT_TRUE(one.due("blind"));
  EXPECT_TRUE(other.due("lost")) << "of another detector";
  ros::WallDuration(1.1).sleep();
  EXPECT_TRUE(one.due("lost"));
  EXPECT_FALSE(one.due("lost"));
}
}  // namespace
}  // namespace xray_tracking
