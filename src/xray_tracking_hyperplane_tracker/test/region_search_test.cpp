// The search for a lost region, where neighbours look alike.

#include "xray_tracking_hyperplane_tracker/region_search.h"

#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "spine_field.h"
#include "xray_tracking_core/volume/attenuation.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

namespace xray_tracking
{
namespace
{
/// Search, refinement of every candidate, proof. @return what is proven
std::optional<TrackResult> recover(const RegionSearch& search, HyperplaneTracker& tracker, const cv::Mat& image)
{
  std::vector<TrackResult> refined;
  for (const RegionCandidate& candidate : search.find(image))
  {
    refined.push_back(tracker.trackFrom(image, candidate.displacement));
  }
  const std::optional<std::size_t> proven = provenCandidate(refined);
  return proven ? std::optional<TrackResult>(refined[*proven]) : std::nullopt;
}

TEST(RegionSearch, findsTheRegionWhereItsNeighbourHasTakenItsPlace)
{
  constexpr double kNoise = 0.01;  // 10,000 quanta a pixel
  const SpineField spine(0.5);
  const cv::Mat reference = spine.expose({ 0.0, 0.0 }, kNoise, 0);
  const RegionSearch search(reference, kRegion, {});
  HyperplaneTracker tracker({}, {});
  tracker.train(reference, kRegion);
  int traps = 0;
  for (int i = 0; i < 10; ++i)
  {
    // By one or two vertebrae up or down: what is now at the region's place is a neighbour.
    const double vertebrae[]{ -2.0, -1.0, 1.0, 2.0 };
    const Eigen::Vector2d displacement(3.7 * i - 18.0, vertebrae[i % 4] * kPeriod + 0.3 * i);
    const cv::Mat image = spine.expose(displacement, kNoise, i + 1);
    for (const RegionCandidate& candidate : search.find(image))
    {
      traps += std::abs(candidate.displacement.y() - displacement.y()) > 0.5 * kPeriod && candidate.correlation > 0.6;
    }
    const std::optional<TrackResult> found = recover(search, tracker, image);
    ASSERT_TRUE(found) << displacement.transpose();
    EXPECT_LT((found->displacement - displacement).norm(), 0.3);  // the tracker's accuracy, not the search's
  }
  EXPECT_GE(traps, 10) << "neighbours do not look alike";
}

TEST(RegionSearch, provesNothingAmongTwins)
{
  const SpineField spine(0.0);
  const cv::Mat reference = spine.expose({ 0.0, 0.0 }, 0.03, 0);
  const RegionSearch search(reference, kRegion, {});
  HyperplaneTracker tracker({}, {});
  tracker.train(reference, kRegion);
  EXPECT_FALSE(recover(search, tracker, spine.expose({ 2.0, kPeriod }, 0.03, 1)));
}

TEST(RegionSearch, provesNothingWithoutTheRegion)
{
  const SpineField spine(0.5);
  const cv::Mat reference = spine.expose({ 0.0, 0.0 }, 0.03, 0);
  const RegionSearch search(reference, kRegion, {});
  HyperplaneTracker tracker({}, {});
  tracker.train(reference, kRegion);
  cv::Mat noise(kSize, CV_16UC1), turned;
  cv::RNG(5).fill(noise, cv::RNG::NORMAL, 5000, 300);
  cv::flip(spine.expose({ 0.0, 0.0 }, 0.03, 1), turned, 1);
  for (const cv::Mat& image : { noise, turned, cv::Mat(cv::Mat::zeros(kSize, CV_16UC1)) })
  {
    EXPECT_FALSE(recover(search, tracker, image));
  }
}

TEST(RegionSearch, givesPlaceAndCorrelation)
{
  const SpineField spine(0.5);
  const RegionSearch search(spine.expose({ 0.0, 0.0 }, 0.0, 0), kRegion, {});
  // Multiples of any bin size: the coarse images are the same but for the borders, which shading comes from.
  for (const Eigen::Vector2d& displacement : { Eigen::Vector2d(0.0, 0.0), { 24.0, -36.0 }, { -48.0, 60.0 } })
  {
    const std::vector<RegionCandidate> candidates = search.find(spine.expose(displacement, 0.0, 0));
    ASSERT_FALSE(candidates.empty());
    EXPECT_LT((candidates[0].displacement - displacement).norm(), 0.5);
    EXPECT_GT(candidates[0].correlation, 0.99);
    for (std::size_t i = 1; i < candidates.size(); ++i)
    {
      EXPECT_LE(candidates[i].correlation, candidates[i - 1].correlation);
    }
  }
}

TEST(RegionSearch, findsARegionThatIsPartlyOutside)
{
  const SpineField spine(0.5);
  const RegionSearch search(spine.expose({ 0.0, 0.0 }, 0.0, 0), kRegion, {});
  const Eigen::Vector2d displacement(0.0, -(kRegion.y + 14.0));  // a fifth of its height
  double nearest = 1e9;
  for (const RegionCandidate& candidate : search.find(spine.expose(displacement, 0.0, 0)))
  {
    nearest = std::min(nearest, (candidate.displacement - displacement).norm());
  }
  EXPECT_LT(nearest, 4.0);  // a coarse pixel
}

TEST(RegionSearch, takesImagesOfAnyContent)
{
  const SpineField spine(0.5);
  const RegionSearch search(spine.expose({ 0.0, 0.0 }, 0.0, 0), kRegion, {});
  EXPECT_TRUE(search.find(cv::Mat::ones(10, 10, CV_16UC1)).empty());
  EXPECT_NO_THROW(search.find(cv::Mat(400, 600, CV_8UC1, cv::Scalar(7))));
  EXPECT_THROW(search.find(cv::Mat::zeros(400, 600, CV_32FC1)), std::invalid_argument);
}

TEST(ProvenCandidate, isTheBestThatNoOtherPlaceEquals)
{
  const auto at = [](double x, double quality, TrackResult::Status status = TrackResult::Status::TRACKED)
  {
    TrackResult result;
    result.displacement.x() = x;
    result.quality = quality;
    result.status = status;
    return result;
  };
  const auto lost = TrackResult::Status::LOW_CORRELATION;
  EXPECT_FALSE(provenCandidate({}));
  EXPECT_FALSE(provenCandidate({ at(0.0, 0.5, lost) }));
  EXPECT_EQ(provenCandidate({ at(0.0, 0.5, lost), at(50.0, 0.9) }), 1u);
  EXPECT_EQ(provenCandidate({ at(0.0, 0.8), at(50.0, 0.9) }), 1u);  // unexplained 0.36 and 0.19
  EXPECT_FALSE(provenCandidate({ at(0.0, 0.89), at(50.0, 0.9) }));  // 0.21 and 0.19
  EXPECT_FALSE(provenCandidate({ at(0.0, 0.9, lost), at(50.0, 0.9) }));
  EXPECT_EQ(provenCandidate({ at(0.1, 0.9), at(0.0, 0.91), at(50.0, 0.5) }), 1u);  // twice the same place
}

TEST(RegionSearchOnTheNeckPhantom, tellsAVertebraFromItsNeighbours)
{
  const TreatmentSetup setup = loadTreatmentSetup(XRAY_TRACKING_PHANTOM_SETUP);
  const NeckPhantom phantom;
  const ProjectionGeometry& geometry = setup.detectors.front();
  std::mt19937 random(5);
  const auto expose = [&](const Eigen::Vector3d& shift)
  {
    const RigidTransform pose = Eigen::Translation3d(shift) * setup.room_from_patient;
    cv::Mat soft, bone;
    phantom.lineIntegrals(geometry, pose, pose, soft, bone);
    std::normal_distribution<double> normal;
    cv::Mat image(soft.size(), CV_16UC1);
    for (int y = 0; y < image.rows; ++y)
    {
      for (int x = 0; x < image.cols; ++x)
      {
        const double signal =
            60000.0 * std::exp(-soft.at<float>(y, x) * kWaterAttenuation - bone.at<float>(y, x) * kBoneAttenuation);
        image.at<std::uint16_t>(y, x) = cv::saturate_cast<std::uint16_t>(signal + std::sqrt(signal) * normal(random));
      }
    }
    return image;
  };
  const cv::Mat reference = expose(Eigen::Vector3d::Zero());
  const cv::Rect region = projectedTargetRegion(setup, geometry);
  const RegionSearch search(reference, region, {});
  HyperplaneTracker tracker({}, {});
  tracker.train(reference, region);
  const Eigen::Vector3d centre = setup.room_from_patient * setup.targetCentre();
  // Along the spine, room x: C3 or C5 comes to where C4 was.
  for (const double along : { -36.0, -18.0, 18.0, 36.0 })
  {
    const Eigen::Vector3d shift(along, 4.0, -3.0);
    const std::optional<TrackResult> found = recover(search, tracker, expose(shift));
    ASSERT_TRUE(found) << along;
    const Eigen::Vector2d truth = geometry.project(centre + shift) - geometry.project(centre);
    // The rays cross it at up to 0.8 degrees to the first ones, so bone 20 mm before its centre is seen 1 px elsewhere.
    EXPECT_LT((found->displacement - truth).norm(), 1.5);
  }
}
}  // namespace
}  // namespace xray_tracking
