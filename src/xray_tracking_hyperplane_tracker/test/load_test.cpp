// Eight trackers in one nodelet manager at 30 exposures a second each, as a clinical room would run at most: what they
// cost together, and that none of them copies an image.
#include <time.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nodelet/loader.h>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>
#include <boost/make_shared.hpp>

#include <xray_tracking_msgs/TrackedRegion.h>

namespace
{
constexpr int kEdge = 512;  // of an image [px]
constexpr std::size_t kImageBytes = 2 * kEdge * kEdge;
std::atomic<int> large_allocations{ 0 };  // of an image's size or more

void count(std::size_t size)
{
  if (size >= kImageBytes)
  {
    ++large_allocations;
  }
}
}  // namespace

// glibc's own allocator behind a counter: everything that operator new and OpenCV do ends here.
extern "C"
{
  void* __libc_malloc(std::size_t size);
  void* __libc_memalign(std::size_t alignment, std::size_t size);

  void* malloc(std::size_t size)
  {
    count(size);
    return __libc_malloc(size);
  }
  int posix_memalign(void** result, std::size_t alignment, std::size_t size)
  {
    count(size);
    *result = __libc_memalign(alignment, size);
    return *result == nullptr ? ENOMEM : 0;
  }
}

namespace
{
using xray_tracking_msgs::TrackedRegion;

constexpr int kTrackers = 8;
constexpr int kPictures = 12;
constexpr double kRate = 30.0;  // [Hz]
constexpr int kParts = 4;
constexpr int kExposures = 60;      // of a part: two seconds
constexpr double kPatience = 60.0;  // [s]

double processSeconds()
{
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// Counts behind waves of several lengths that have moved by (dx, dy), with noise.
sensor_msgs::ImagePtr picture(double dx, double dy)
{
  auto image = boost::make_shared<sensor_msgs::Image>();
  image->height = image->width = kEdge;
  image->step = 2 * kEdge;
  image->encoding = "mono16";
  image->data.resize(2 * kEdge * kEdge);
  auto* pixels = reinterpret_cast<std::uint16_t*>(image->data.data());
  std::uint32_t random = 1;
  for (int y = 0; y < kEdge; ++y)
  {
    for (int x = 0; x < kEdge; ++x)
    {
      const double u = x - dx, v = y - dy;
      const double attenuation = 0.2 * std::sin(0.19 * u + 0.05 * v) + 0.2 * std::sin(0.23 * v - 0.07 * u) +
                                 0.2 * std::sin(0.083 * u + 0.061 * v + 2.0 * std::sin(0.031 * u));
      random = 1664525U * random + 1013904223U;
      *pixels++ = static_cast<std::uint16_t>(20000.0 * std::exp(-attenuation) + 200.0 * (random / 4294967296.0 - 0.5));
    }
  }
  return image;
}

TEST(Trackers, takeLittleOfOneCoreAndCopyNothing)
{
  ros::NodeHandle nh;
  // Shared with all trackers, as a driver in their manager would share them.
  std::vector<sensor_msgs::ImagePtr> pictures;
  for (int i = 0; i < kPictures; ++i)
  {
    pictures.push_back(picture(4.0 * std::sin(2.0 * M_PI * i / kPictures), 3.0 * std::cos(2.0 * M_PI * i / kPictures)));
  }

  nodelet::Loader loader(nh);
  std::vector<ros::Publisher> publishers;
  std::vector<ros::Subscriber> subscribers;
  std::atomic<int> tracked{ 0 };
  for (int i = 0; i < kTrackers; ++i)
  {
    const std::string name = "/detector_" + std::to_string(i);
    publishers.push_back(nh.advertise<sensor_msgs::Image>(name + "/image_raw", 10));
    ros::NodeHandle pnh(name + "/tracker");
    pnh.setParam("region/x_offset", 180);
    pnh.setParam("region/y_offset", 200);
    pnh.setParam("region/width", 150);
    pnh.setParam("region/height", 100);
    ASSERT_TRUE(loader.load(name + "/tracker", "xray_tracking_hyperplane_tracker/HyperplaneTracker", {}, {}));
    subscribers.push_back(nh.subscribe<TrackedRegion>(name + "/tracked_region", 100,
                                                      [&tracked](const TrackedRegion::ConstPtr& region)
                                                      { tracked += region->state == TrackedRegion::TRACKING; }));
  }
  ros::AsyncSpinner spinner(1);
  spinner.start();
  const auto wait_until = [](const auto& done)
  {
    const ros::SteadyTime end = ros::SteadyTime::now() + ros::WallDuration(kPatience);
    while (!done() && ros::SteadyTime::now() < end)
    {
      ros::WallDuration(0.01).sleep();
    }
    return done();
  };
  for (const ros::Publisher& publisher : publishers)
  {
    ASSERT_TRUE(wait_until([&publisher] { return publisher.getNumSubscribers() > 0; }));
  }

  double stamp = 1e6;
  const auto send = [&](const sensor_msgs::ImagePtr& image)
  {
    stamp += 1.0 / kRate;
    image->header.stamp = ros::Time(stamp);
    for (const ros::Publisher& publisher : publishers)
    {
      publisher.publish(image);
    }
  };
  const auto first = boost::make_shared<sensor_msgs::Image>(*pictures.front());
  send(first);
  ASSERT_TRUE(wait_until([&tracked] { return tracked == kTrackers; })) << tracked;
  // The trackers keep the first one: this very message, not copies.
  EXPECT_TRUE(wait_until([&first] { return first.use_count() == 1 + kTrackers; })) << first.use_count();
  const int allocations = large_allocations;
  ASSERT_GT(allocations, kPictures);  // the counter sees the pictures

  // Other work on the machine takes caches away, so the least of several times is the trackers' own.
  double share = 1.0;
  ros::WallRate rate(kRate);
  for (int part = 0; part < kParts; ++part)
  {
    const double start = processSeconds();
    for (int k = part * kExposures + 1; k <= (part + 1) * kExposures; ++k)
    {
      // Nobody may still look at the picture, whose stamp changes.
      ASSERT_TRUE(wait_until([&] { return tracked >= kTrackers * (k - kPictures + 1); }));
      const sensor_msgs::ImagePtr& next = pictures[static_cast<std::size_t>(k % kPictures)];
      // The last byte of a pixel in every row: the same rows again would be those of a panel that has stopped.
      for (std::uint32_t row = 0; row < next->height; ++row)
      {
        next->data[row * next->step] = static_cast<std::uint8_t>(k);
      }
      send(next);
      rate.sleep();
    }
    ASSERT_TRUE(wait_until([&] { return tracked == kTrackers * (1 + (part + 1) * kExposures); })) << tracked;
    share = std::min(share, (processSeconds() - start) / (kExposures / kRate));
  }
  EXPECT_EQ(large_allocations, allocations);
  RecordProperty("percent_of_a_core", std::to_string(100.0 * share));
  std::cout << kTrackers << " trackers at " << kRate << " Hz take " << 100.0 * share << " % of a core\n";
  // 14 to 18 % were measured beside other work, once 22; before each exposure was looked at and rotations were followed
  // 8 to 9 %.
  EXPECT_LT(share, 0.25);
}
}  // namespace

int main(int argc, char** argv)
{
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "load_test");
  return RUN_ALL_TESTS();
}
