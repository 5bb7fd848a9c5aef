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
  void addInfo(std::size_t detector, std::int64_t stamp)
  {
    EXPECT_EQ("", store_.takeCameraInfo(detector, stamp, kNow));
    store_.keepCameraInfo(detector, stamp, boost::make_shared<sensor_msgs::CameraInfo>(), std::nullopt);
  }
  void addImage(std::size_t detector, std::int64_t stamp)
  {
    EXPECT_EQ("", store_.takeImage(detector, stamp, kNow));
    const auto image = boost::make_shared<sensor_msgs::Image>();
    image->header.seq = static_cast<std::uint32_t>(stamp / kSecond);
    store_.keepImage(detector, stamp, store_.run(), UsableImage(), image);
  }
  void addView(std::size_t detector, std::int64_t stamp)
  {
    addInfo(detector, stamp);
    addImage(detector, stamp);
  }
  void addViews(std::int64_t stamp)
  {
    addView(0, stamp);
    addView(1, stamp);
  }
  const StoredExposure* find(std::int64_t stamp) const { return store_.find(stamp); }

  static constexpr std::int64_t kNow = 100 * kSecond;
  ExposureStore store_{ { "a", "b" }, 3 };
};

TEST_F(ExposureStoreTest, findsByStampOrTheLatestWhole)
{
  std::int64_t latest = 0;
  EXPECT_EQ(nullptr, store_.find(latest));
  EXPECT_EQ(0, latest);
  addViews(1 * kSecond);
  addViews(2 * kSecond);
  addView(0, 3 * kSecond);
  EXPECT_EQ(2U, store_.find(latest)->at(1).pixels->header.seq);
  EXPECT_EQ(2 * kSecond, latest);
  EXPECT_EQ(1U, find(kSecond)->at(1).pixels->header.seq);
  EXPECT_EQ("", store_.missingView(*find(kSecond)));
  EXPECT_EQ("b/image_raw has not arrived", store_.missingView(*find(3 * kSecond)));
  addImage(1, 3 * kSecond);
  EXPECT_EQ("b/camera_info has not arrived", store_.missingView(*find(3 * kSecond)));
  EXPECT_EQ(nullptr, find(4 * kSecond));
}

/// What a request leaves out need not have come, of the latest exposure neither.
TEST_F(ExposureStoreTest, findsTheLatestThatLacksNothingButWhatIsLeftOut)
{
  addViews(1 * kSecond);
  addView(0, 2 * kSecond);
  addInfo(0, 3 * kSecond);
  std::int64_t latest = 0;
  ASSERT_NE(nullptr, store_.find(latest, { "b" }));
  EXPECT_EQ(2 * kSecond, latest);
  latest = 0;
  ASSERT_NE(nullptr, store_.find(latest, { "a" }));
  EXPECT_EQ(1 * kSecond, latest);
  EXPECT_EQ("b/image_raw has not arrived", store_.missingView(*find(3 * kSecond), { "a" }));
}

TEST_F(ExposureStoreTest, isBounded)
{
  addViews(1 * kSecond);
  const boost::weak_ptr<const sensor_msgs::Image> first = find(kSecond)->at(0).pixels;
  addViews(2 * kSecond);
  addViews(3 * kSecond);
  EXPECT_FALSE(first.expired());
  addViews(4 * kSecond);
  EXPECT_EQ(3U, store_.size());
  EXPECT_EQ(nullptr, find(kSecond));
  EXPECT_TRUE(first.expired()) << "an image that nobody can ask for";
}

TEST_F(ExposureStoreTest, beginsAnewWhenTimeJumpsBack)
{
  for (const std::int64_t stamp : { 5, 6, 8 })
  {
    addViews(stamp * kSecond);
  }
  EXPECT_EQ("", store_.takeImage(1, 9 * kSecond, kNow));
  EXPECT_EQ(0U, store_.run());
  addViews(5 * kSecond);
  EXPECT_EQ(1U, store_.run());
  EXPECT_EQ(1U, store_.size());
  EXPECT_EQ("", store_.missingView(*find(5 * kSecond)));
  // An image of the run before that was being looked at meanwhile.
  store_.keepImage(1, 9 * kSecond, 0, UsableImage(), nullptr);
  EXPECT_EQ(1U, store_.size());
  addViews(6 * kSecond);
  EXPECT_EQ(2U, store_.size());
  EXPECT_EQ(1U, store_.run());
}

/// As of a bag that is played in a loop, whose images, larger, come later than the next pass's camera_infos.
TEST_F(ExposureStoreTest, whatComesLateIsNoOtherRun)
{
  addViews(5 * kSecond);
  addInfo(0, 8 * kSecond);
  addInfo(1, 8 * kSecond);
  addInfo(0, 5 * kSecond);
  EXPECT_EQ(1U, store_.run());
  for (const std::size_t detector : { 0, 1 })
  {
    EXPECT_NE(std::string::npos, store_.takeImage(detector, 8 * kSecond, kNow).find("is of the run before"));
    addImage(detector, 5 * kSecond);
  }
  addInfo(1, 5 * kSecond);
  EXPECT_EQ(1U, store_.run());
  EXPECT_EQ("", store_.missingView(*find(5 * kSecond)));
  EXPECT_EQ(1U, store_.size());
  // And the next pass.
  addViews(8 * kSecond);
  addInfo(1, 5 * kSecond);
  EXPECT_EQ(2U, store_.run());
  EXPECT_EQ(1U, store_.size());
}

TEST_F(ExposureStoreTest, aStampOfTheFutureForgetsNothing)
{
  addViews(5 * kSecond);
  for (const std::int64_t stamp : { std::int64_t(102), std::int64_t(4294967295) })
  {
    EXPECT_NE(std::string::npos, store_.takeImage(1, stamp * kSecond, kNow).find("b/image_raw: the stamp"));
    EXPECT_NE(std::string::npos, store_.takeCameraInfo(0, stamp * kSecond, kNow).find("in the future"));
  }
  addViews(6 * kSecond);
  EXPECT_EQ(2U, store_.size());
  EXPECT_EQ(0U, store_.run());
}

TEST_F(ExposureStoreTest, dropsWhatIsRepeatedOrLate)
{
  addViews(5 * kSecond);
  addViews(6 * kSecond);
  EXPECT_NE(std::string::npos, store_.takeImage(0, 6 * kSecond, kNow).find("not newer"));
  EXPECT_NE(std::string::npos, store_.takeImage(0, 5 * kSecond + 1, kNow).find("not newer"));
}
}  // namespace
}  // namespace xray_tracking
