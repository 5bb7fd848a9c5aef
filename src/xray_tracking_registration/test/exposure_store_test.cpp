#include "xray_tracking_registration/exposure_store.h"

#include <gtest/gtest.h>
#include <boost/make_shared.hpp>
#include <boost/weak_ptr.hpp>

namespace xray_tracking
{
namespace
{
constexpr std::int64_t kSecond = 1000000000;

/// A store of two detectors and how to fill it.
class ExposureStoreTest : public testing::Test
{
protected:
  template <typename Message>
  static boost::shared_ptr<Message> stamped(double stamp)
  {
    const auto message = boost::make_shared<Message>();
    message->header.stamp = ros::Time(stamp);
    return message;
  }
  void addView(std::size_t detector, double stamp)
  {
    EXPECT_EQ("", store_.addCameraInfo(detector, stamped<sensor_msgs::CameraInfo>(stamp), kNow));
    EXPECT_EQ("", store_.addImage(detector, stamped<sensor_msgs::Image>(stamp), kNow));
  }
  void addViews(double stamp)
  {
    addView(0, stamp);
    addView(1, stamp);
  }

  static constexpr std::int64_t kNow = 100 * kSecond;
  ExposureStore store_{ { "a", "b" }, 3 };
};

TEST_F(ExposureStoreTest, findsByStampOrTheLatestWhole)
{
  EXPECT_EQ(nullptr, store_.find(0));
  addViews(1.0);
  addViews(2.0);
  addView(0, 3.0);
  EXPECT_EQ(ros::Time(2.0), store_.find(0)->images[1]->header.stamp);
  EXPECT_EQ(ros::Time(1.0), store_.find(kSecond)->camera_infos[0]->header.stamp);
  EXPECT_EQ("b/image_raw has not arrived", store_.missingView(*store_.find(3 * kSecond)));
  EXPECT_EQ("", store_.addImage(1, stamped<sensor_msgs::Image>(3.0), kNow));
  EXPECT_EQ("b/camera_info has not arrived", store_.missingView(*store_.find(3 * kSecond)));
  EXPECT_EQ(nullptr, store_.find(4 * kSecond));
}

TEST_F(ExposureStoreTest, isBounded)
{
  addViews(1.0);
  const boost::weak_ptr<const sensor_msgs::Image> first = store_.find(kSecond)->images[0];
  addViews(2.0);
  addViews(3.0);
  EXPECT_FALSE(first.expired());
  addViews(4.0);
  EXPECT_EQ(3U, store_.size());
  EXPECT_EQ(nullptr, store_.find(kSecond));
  EXPECT_TRUE(first.expired()) << "an image that nobody can ask for";
}

TEST_F(ExposureStoreTest, beginsAnewWhenTimeJumpsBack)
{
  for (const double stamp : { 5.0, 6.0, 8.0 })
  {
    addViews(stamp);
  }
  EXPECT_FALSE(store_.takeRestart());
  addViews(5.0);
  EXPECT_EQ(1U, store_.size());
  EXPECT_EQ("", store_.missingView(*store_.find(5 * kSecond)));
  EXPECT_TRUE(store_.takeRestart());
  EXPECT_FALSE(store_.takeRestart());
  addViews(6.0);
  EXPECT_EQ(2U, store_.size());
  EXPECT_FALSE(store_.takeRestart());
}

TEST_F(ExposureStoreTest, aStampOfTheFutureForgetsNothing)
{
  addViews(5.0);
  for (const double stamp : { 102.0, 4294967295.0 })
  {
    EXPECT_NE(std::string::npos,
              store_.addImage(1, stamped<sensor_msgs::Image>(stamp), kNow).find("b/image_raw: the stamp"));
    EXPECT_NE(std::string::npos,
              store_.addCameraInfo(0, stamped<sensor_msgs::CameraInfo>(stamp), kNow).find("in the future"));
  }
  addViews(6.0);
  EXPECT_EQ(2U, store_.size());
  EXPECT_FALSE(store_.takeRestart());
}

TEST_F(ExposureStoreTest, dropsWhatIsRepeatedOrLate)
{
  addViews(5.0);
  addViews(6.0);
  const sensor_msgs::ImageConstPtr first = store_.find(6 * kSecond)->images[0];
  EXPECT_NE(std::string::npos, store_.addImage(0, stamped<sensor_msgs::Image>(6.0), kNow).find("not newer"));
  EXPECT_NE(std::string::npos, store_.addImage(0, stamped<sensor_msgs::Image>(5.5), kNow).find("not newer"));
  EXPECT_EQ(first, store_.find(6 * kSecond)->images[0]);
  EXPECT_EQ(2U, store_.size());
  // As roscpp links publisher and subscriber of one process twice if both come up at the same time.
  EXPECT_EQ("", store_.addImage(0, first, kNow));
}
}  // namespace
}  // namespace xray_tracking
