#include "xray_tracking_registration/exposure_store.h"

#include <gtest/gtest.h>
#include <boost/make_shared.hpp>
#include <boost/weak_ptr.hpp>

namespace xray_tracking
{
namespace
{
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
  static void addView(ExposureStore& store, std::size_t detector, double stamp)
  {
    store.addCameraInfo(detector, stamped<sensor_msgs::CameraInfo>(stamp));
    store.addImage(detector, stamped<sensor_msgs::Image>(stamp));
  }
  static void addViews(ExposureStore& store, double stamp)
  {
    addView(store, 0, stamp);
    addView(store, 1, stamp);
  }
  static void expectNext(ExposureStore& store, double stamp, const std::string& missing)
  {
    const auto due = store.next();
    ASSERT_TRUE(due);
    EXPECT_EQ(ros::Time(stamp), due->stamp);
    EXPECT_EQ(missing, due->missing);
  }

  const std::vector<std::string> names_ = { "a", "b" };
};

TEST_F(ExposureStoreTest, handsOutInOrderEachOnce)
{
  ExposureStore store(names_, 10, true);
  addView(store, 0, 1.0);
  EXPECT_FALSE(store.next());
  addView(store, 0, 2.0);
  addView(store, 1, 1.0);
  expectNext(store, 1.0, "");
  EXPECT_FALSE(store.next());
  addView(store, 0, 3.0);
  EXPECT_EQ(2U, store.waiting());
  addView(store, 1, 3.0);
  // All of a later one is there: what is missing now will not come.
  expectNext(store, 2.0, "b/image_raw has not arrived");
  expectNext(store, 3.0, "");
  addView(store, 1, 2.0);
  EXPECT_FALSE(store.next());
  EXPECT_EQ(0U, store.waiting());
  EXPECT_EQ("", store.missingView(*store.find(ros::Time(2.0)))) << "late, but there for who asks";
}

TEST_F(ExposureStoreTest, isBoundedAndSaysWhatGaveWay)
{
  ExposureStore store(names_, 2, true);
  for (const double stamp : { 1.0, 2.0, 3.0 })
  {
    addViews(store, stamp);
  }
  EXPECT_EQ(2U, store.size());
  EXPECT_EQ(nullptr, store.find(ros::Time(1.0)));
  expectNext(store, 1.0, "it gave way, as more than 2 exposures were kept");
  expectNext(store, 2.0, "");
  expectNext(store, 3.0, "");
  EXPECT_FALSE(store.next());
}

TEST_F(ExposureStoreTest, isBoundedWhereNobodyTakesThemInTurn)
{
  ExposureStore store(names_, 2, false);
  addViews(store, 1.0);
  const boost::weak_ptr<const sensor_msgs::Image> first = store.find(ros::Time(1.0))->images[0];
  addViews(store, 2.0);
  EXPECT_FALSE(first.expired());
  addViews(store, 3.0);
  EXPECT_EQ(2U, store.size());
  EXPECT_EQ(0U, store.waiting());
  EXPECT_TRUE(first.expired()) << "an image that nobody can ask for";
  EXPECT_FALSE(store.next());
}

TEST_F(ExposureStoreTest, findsByStampOrTheLatestWhole)
{
  ExposureStore store(names_, 10, true);
  EXPECT_EQ(nullptr, store.find(ros::Time()));
  addViews(store, 1.0);
  addViews(store, 2.0);
  addView(store, 0, 3.0);
  EXPECT_EQ(ros::Time(2.0), store.find(ros::Time())->images[1]->header.stamp);
  EXPECT_EQ("b/image_raw has not arrived", store.missingView(*store.find(ros::Time(3.0))));
  EXPECT_EQ(nullptr, store.find(ros::Time(4.0)));
}

TEST_F(ExposureStoreTest, beginsAnewWhenTimeJumpsBack)
{
  ExposureStore store(names_, 10, true);
  for (const double stamp : { 5.0, 6.0, 8.0 })
  {
    addViews(store, stamp);
  }
  expectNext(store, 5.0, "");
  EXPECT_FALSE(store.takeRestart());
  addViews(store, 5.0);
  EXPECT_EQ(1U, store.size());
  EXPECT_TRUE(store.takeRestart());
  EXPECT_FALSE(store.takeRestart());
  expectNext(store, 5.0, "");
  addViews(store, 6.0);
  expectNext(store, 6.0, "");
}
}  // namespace
}  // namespace xray_tracking
