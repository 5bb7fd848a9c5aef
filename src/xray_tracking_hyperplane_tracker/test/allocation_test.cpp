#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <memory>
#include <vector>

#include <gtest/gtest.h>

#include "synthetic_exposure.h"
#include "xray_tracking_hyperplane_tracker/exposure_check.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"
#include "xray_tracking_hyperplane_tracker/view_tracker.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
TEST(Allocation, isNotCountedWhereASanitizerHasAnAllocatorOfItsOwn)
{
  GTEST_SKIP();
}
#else
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

TEST(Allocation, answeringAllocatesNoMoreThanLooking)
{
  IntensityModel intensity;
  intensity.offset = kOffset;
  HyperplaneTrackerOptions options;
  options.model = MotionModel::EUCLIDEAN;
  ViewTracker tracker(std::make_unique<HyperplaneTracker>(options, intensity), intensity, 1, options.model, true,
                      cv::Rect(70, 55, 100, 90));
  const auto exposure = [](std::uint32_t n)
  {
    Exposure exposure;
    exposure.displacement = { 0.5 * n, -0.25 * n };
    exposure.noise = 0.01;
    exposure.seed = n;
    return expose(exposure);
  };
  std::vector<cv::Mat> images;
  for (std::uint32_t n = 0; n < 12; ++n)
  {
    images.push_back(exposure(n));
  }
  // OpenCV's morphology, by which the X-ray field is found, allocates.
  ExposureCheck check(intensity);
  int looking = 0;
  int answering = 0;
  for (std::size_t n = 0; n < images.size(); ++n)
  {
    const auto stamp = static_cast<std::int64_t>(n + 1);
    int before = allocations;
    check.look(images[n], stamp);
    const int of_look = allocations - before;
    before = allocations;
    const ViewAnswer& answer = tracker.answer(images[n], stamp);
    if (n >= 2)  // the first ones make room
    {
      looking += of_look;
      answering += allocations - before;
    }
    ASSERT_EQ(ViewAnswer::State::TRACKING, answer.state) << answer.fault;
  }
  EXPECT_EQ(looking, answering);
}
}  // namespace xray_tracking
#endif
