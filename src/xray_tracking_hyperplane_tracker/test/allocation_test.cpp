#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <vector>

#include <gtest/gtest.h>

#include "synthetic_exposure.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

// glibc's own allocator behind counters: everything that operator new, Eigen and OpenCV do ends here.
namespace
{
std::atomic<int> allocations{ 0 };
}
extern "C"
{
  void* __libc_malloc(std::size_t size);
  void* __libc_memalign(std::size_t alignment, std::size_t size);

  void* malloc(std::size_t size)
  {
    ++allocations;
    return __libc_malloc(size);
  }
  int posix_memalign(void** result, std::size_t alignment, std::size_t size)
  {
    ++allocations;
    *result = __libc_memalign(alignment, size);
    return *result == nullptr ? ENOMEM : 0;
  }
  void* aligned_alloc(std::size_t alignment, std::size_t size)
  {
    ++allocations;
    return __libc_memalign(alignment, size);
  }
}

namespace xray_tracking
{
TEST(Allocation, countersSeeContainersEigenAndOpenCv)
{
  const auto counts = [](auto call)
  {
    const int before = allocations;
    call();
    return allocations - before;
  };
  EXPECT_GT(counts([] { std::vector<int>(100).back() = 1; }), 0);
  EXPECT_GT(counts([] { Eigen::VectorXf::Zero(100).eval(); }), 0);
  EXPECT_GT(counts([] { cv::Mat(20, 20, CV_8UC1); }), 0);
}

TEST(Allocation, trackingDoesNotAllocate)
{
  IntensityModel intensity;
  intensity.offset = kOffset;
  std::vector<cv::Mat> images = { cv::Mat::zeros(exposureSize(), CV_16UC1) };
  for (const double shift : { 0.0, 5.0, 21.0, 60.0, 100.0, -3.0 })
  {
    Exposure exposure;
    exposure.displacement = { shift, 0.5 * shift };
    images.push_back(expose(exposure));
  }
  for (const MotionModel model :
       { MotionModel::TRANSLATION, MotionModel::EUCLIDEAN, MotionModel::SIMILARITY, MotionModel::AFFINE })
  {
    for (const bool whole_region : { true, false })
    {
      HyperplaneTrackerOptions options;
      options.model = model;
      options.whole_region = whole_region;
      HyperplaneTracker tracker(options, intensity);
      tracker.train(expose({}), cv::Rect(70, 55, 100, 90));
      const int before = allocations;
      for (const cv::Mat& image : images)
      {
        tracker.track(image);
      }
      EXPECT_EQ(allocations - before, 0) << static_cast<int>(model) << " parameters, whole region: " << whole_region;
    }
  }
}
}  // namespace xray_tracking
