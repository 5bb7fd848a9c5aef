#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <new>

#include "scene.h"
#include "xray_tracking_motion_estimation/consistency_monitor.h"

namespace
{
std::atomic<long> allocations{ 0 };
}

// Every way to the heap of this program, Eigen's apart from operator new included.
extern "C" void* __libc_malloc(std::size_t size);
extern "C" void* malloc(std::size_t size)
{
  ++allocations;
  return __libc_malloc(size);
}

namespace xray_tracking
{
namespace
{
// The time is told, not judged: it depends on what else the machine does.
TEST(Cost, OfAnExposureIsWithoutTheHeap)
{
  for (const TrackModel model : { TrackModel::TRANSLATION, TrackModel::EUCLIDEAN, TrackModel::AFFINE })
  {
    for (const std::size_t count : { 2, 4, 8 })
    {
      const Scene scene{ count == 2 ? cyberknife() : viewsAround(count), { 12.0, -9.0, 15.0 } };
      const MotionEstimator estimator = scene.estimator(MotionEstimationOptions());
      ConsistencyOptions rigid;
      rigid.floor_sigma = 0.027;
      rigid.persistent_sigma = 0.0;
      ConsistencyMonitor monitor{ ConsistencyOptions() };
      ConsistencyMonitor rigid_monitor{ rigid };
      Random random;
      Measurements tracks =
          scene.exactTracks(scene.motion(Eigen::Vector3d(1.0, 2.0, -1.0) * kDegree, { 4.0, -6.0, 3.0 }), model);
      for (auto& measurement : tracks)
      {
        random.disturb(measurement->track, MotionEstimationOptions());
      }
      ASSERT_EQ(estimator.estimate(tracks).status, EstimateStatus::OK);
      const long before = allocations;
      double best = 1e9;
      // The least of many: what other processes take does not count.
      for (int block = 0; block < 50; ++block)
      {
        const auto start = std::chrono::steady_clock::now();
        for (int i = 0; i < 20; ++i)
        {
          const MotionEstimate estimate = estimator.estimate(tracks);
          monitor.add(estimate);
          rigid_monitor.add(estimate);
        }
        best = std::min(
            best, std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start).count() / 20);
      }
      EXPECT_EQ(allocations - before, 0);
      std::printf("[ figures  ] %d parameters, %zu views: %.1f us an exposure\n", static_cast<int>(model), count, best);
    }
  }
}
}  // namespace
}  // namespace xray_tracking
