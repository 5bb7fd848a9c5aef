#include "xray_tracking_detector_simulator/detector_simulator.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include "test_room.h"

namespace xray_tracking
{
namespace
{
DetectorSimulator makeSimulator(const ImageFormationOptions& image = {}, std::uint64_t seed = 1)
{
  return { makeSetup(), std::make_unique<PhantomAnatomy>(), MotionOptions(), image, seed };
}

std::vector<cv::Mat> expose(DetectorSimulator& simulator, int exposure)
{
  std::vector<cv::Mat> images;
  simulator.expose(exposure, images);
  return images;
}

bool same(const std::vector<cv::Mat>& a, const std::vector<cv::Mat>& b)
{
  return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin(),
                                            [](const cv::Mat& x, const cv::Mat& y)
                                            { return x.size() == y.size() && cv::norm(x, y, cv::NORM_INF) == 0.0; });
}

TEST(DetectorSimulator, AnExposureDependsOnItsIndexAndTheSeedAlone)
{
  DetectorSimulator simulator = makeSimulator();
  const std::vector<cv::Mat> third = expose(simulator, 3);
  const std::vector<cv::Mat> first = expose(simulator, 1);
  ASSERT_EQ(third.size(), 2U);
  EXPECT_FALSE(same(first, third));
  EXPECT_FALSE(same({ third[0] }, { third[1] }));
  EXPECT_TRUE(same(expose(simulator, 3), third));

  for (const int threads : { 1, 3 })
  {
    const tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
    DetectorSimulator another = makeSimulator();
    EXPECT_TRUE(same(expose(another, 1), first)) << threads << " threads";
    EXPECT_TRUE(same(expose(another, 3), third)) << threads << " threads";
  }

  DetectorSimulator other_seed = makeSimulator({}, 2);
  EXPECT_FALSE(same(expose(other_seed, 3), third));
}

TEST(DetectorSimulator, ImagesAreWrittenIntoTheCallersMemory)
{
  DetectorSimulator simulator = makeSimulator();
  std::vector<std::uint16_t> memory(128 * 128, 0);
  std::vector<cv::Mat> images = { cv::Mat(128, 128, CV_16UC1, memory.data()), cv::Mat() };
  simulator.expose(0, images);
  EXPECT_EQ(images[0].data, reinterpret_cast<std::uint8_t*>(memory.data()));
  EXPECT_GT(*std::max_element(memory.begin(), memory.end()), 0);
}

TEST(DetectorSimulator, CountsAreThoseOfTheMaterialAlongTheRay)
{
  ImageFormationOptions ideal;
  ideal.scatter_fraction = 0.0;
  ideal.blur_sigma_px = 0.0;
  ideal.air_quanta = 0.0;
  ideal.electronic_noise = 0.0;
  ideal.gain_drift = 0.0;
  ideal.offset_drift = 0.0;
  DetectorSimulator simulator = makeSimulator(ideal);
  const TreatmentSetup setup = makeSetup();
  const std::vector<cv::Mat> images = expose(simulator, 0);
  const NeckPhantom phantom;
  const RigidTransform patient_from_room = setup.room_from_patient.inverse();
  double darkest = 60000.0;
  for (std::size_t i = 0; i < images.size(); ++i)
  {
    for (int row = 0; row < 128; row += 9)
    {
      for (int column = 0; column < 128; column += 9)
      {
        const Ray ray = setup.detectors[i].backProject(Eigen::Vector2d(column, row));
        const Materials m =
            phantom.lineIntegral({ patient_from_room * ray.source, patient_from_room.linear() * ray.direction });
        const double expected = 100.0 + 59900.0 * primaryTransmission(filteredBeam(), m.soft, m.bone);
        // Half a count of rounding; lengths in single precision.
        EXPECT_NEAR(images[i].at<std::uint16_t>(row, column), expected, 1.0 + 1e-4 * expected) << column << ", " << row;
        darkest = std::min(darkest, expected);
      }
    }
  }
  EXPECT_LT(darkest, 15000.0);
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
