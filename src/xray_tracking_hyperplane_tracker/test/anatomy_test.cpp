// The tracker on projections in which the target moves and all else moves otherwise: the exact phantom, and sequences
// that others made.

#include <cmath>
#include <cstdlib>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_core/volume/attenuation.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

namespace xray_tracking
{
namespace
{
/// Size of a pixel in the target's distance [mm].
double pixelAtTarget(const ProjectionGeometry& geometry, const TreatmentSetup& setup)
{
  return geometry.pixelPitch().x() / geometry.magnification(setup.room_from_patient * setup.targetCentre());
}

/// Errors [mm in the target's distance] of all exposures after the first, which trains the tracker.
std::vector<double> trackingErrors(const std::vector<cv::Mat>& images, const std::vector<Eigen::Vector2d>& places,
                                   const TreatmentSetup& setup, const ProjectionGeometry& geometry,
                                   const cv::Rect& region)
{
  HyperplaneTracker tracker({}, setup.intensity);
  tracker.train(images[0], region);
  std::vector<double> errors;
  for (std::size_t k = 1; k < images.size(); ++k)
  {
    const TrackResult& result = tracker.track(images[k]);
    EXPECT_TRUE(result.found()) << geometry.name() << ", exposure " << k;
    errors.push_back((result.displacement - (places[k] - places[0])).norm() * pixelAtTarget(geometry, setup));
  }
  return errors;
}

double rootMeanSquare(const std::vector<double>& values)
{
  double squares = 0.0;
  for (const double value : values)
  {
    squares += value * value;
  }
  return std::sqrt(squares / static_cast<double>(values.size()));
}

/// Counts behind the phantom: monochromatic, with quantum noise of one quantum a count.
cv::Mat exposePhantom(const NeckPhantom& phantom, const TreatmentSetup& setup, const ProjectionGeometry& geometry,
                      const RigidTransform& room_from_target, const RigidTransform& room_from_rest,
                      std::mt19937& random)
{
  cv::Mat soft, bone;
  phantom.lineIntegrals(geometry, room_from_target, room_from_rest, soft, bone);
  std::normal_distribution<double> normal;
  cv::Mat image(soft.size(), CV_16UC1);
  for (int y = 0; y < image.rows; ++y)
  {
    for (int x = 0; x < image.cols; ++x)
    {
      const double attenuation = soft.at<float>(y, x) * kWaterAttenuation + bone.at<float>(y, x) * kBoneAttenuation;
      const double signal = (*setup.intensity.air_counts - setup.intensity.offset) * std::exp(-attenuation);
      image.at<std::uint16_t>(y, x) =
          cv::saturate_cast<std::uint16_t>(setup.intensity.offset + signal + std::sqrt(signal) * normal(random));
    }
  }
  return image;
}

TEST(HyperplaneTrackerOnAnatomy, followsTheVertebraInTheNeckPhantom)
{
  const TreatmentSetup setup = loadTreatmentSetup(XRAY_TRACKING_PHANTOM_SETUP);
  const NeckPhantom phantom;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> step(-4.0, 4.0);
  std::normal_distribution<double> jitter(0.0, 0.4);
  std::vector<std::vector<cv::Mat>> images(setup.detectors.size());
  std::vector<std::vector<Eigen::Vector2d>> places(setup.detectors.size());
  Eigen::Vector3d shift = Eigen::Vector3d::Zero();
  for (int k = 0; k < 30; ++k)
  {
    Eigen::Vector3d rest = Eigen::Vector3d::Zero();
    if (k > 0)
    {
      Eigen::Vector3d next;
      do
      {
        next = shift + Eigen::Vector3d(step(random), step(random), step(random));
      } while (next.norm() > 10.0);
      shift = next;
      rest = 0.9 * shift + Eigen::Vector3d(jitter(random), jitter(random), jitter(random));
    }
    RigidTransform room_from_target = setup.room_from_patient;
    RigidTransform room_from_rest = setup.room_from_patient;
    room_from_target.pretranslate(shift);
    room_from_rest.pretranslate(rest);
    for (std::size_t d = 0; d < setup.detectors.size(); ++d)
    {
      images[d].push_back(exposePhantom(phantom, setup, setup.detectors[d], room_from_target, room_from_rest, random));
      places[d].push_back(setup.detectors[d].project(room_from_target * setup.targetCentre()));
    }
  }
  for (std::size_t d = 0; d < setup.detectors.size(); ++d)
  {
    const ProjectionGeometry& geometry = setup.detectors[d];
    const std::vector<double> errors =
        trackingErrors(images[d], places[d], setup, geometry, projectedTargetRegion(setup, geometry));
    RecordProperty(geometry.name() + "_median_mm", std::to_string(quantile(errors, 0.5)));
    RecordProperty(geometry.name() + "_max_mm", std::to_string(quantile(errors, 1.0)));
    // What leaves room for a 3D error of 0.1 mm in the median and 0.2 mm at most; without regard for the rest of the
    // body the errors are 0.054 and 0.11 mm.
    EXPECT_LT(quantile(errors, 0.5), 0.05) << geometry.name();
    EXPECT_LT(quantile(errors, 1.0), 0.1) << geometry.name();
  }
}

/// Real anatomy by an independent generator. In a view the error of the target's centre is a part of the TRE, which
/// other 2D trackers (correlation and back-projection) reached in the median.
void judgeSharedSequence(const std::string& name, double median_of_others)
{
  const char* folder = std::getenv("XRAY_TRACKING_SHARED_DATA");
  if (folder == nullptr)
  {
    GTEST_SKIP() << "XRAY_TRACKING_SHARED_DATA names no folder with sequences/" << name;
  }
  const Sequence sequence = loadSequence(std::string(folder) + "/sequences/" + name);
  ASSERT_FALSE(sequence.gold_standard.empty());
  for (std::size_t d = 0; d < sequence.setup.detectors.size(); ++d)
  {
    const ProjectionGeometry& geometry = sequence.setup.detectors[d];
    std::vector<cv::Mat> images;
    std::vector<Eigen::Vector2d> places;
    for (std::size_t k = 0; k < sequence.exposures.size(); ++k)
    {
      images.push_back(sequence.image(k, d));
      places.push_back(geometry.project(sequence.gold_standard[k].room_from_patient * sequence.setup.targetCentre()));
    }
    const std::vector<double> errors =
        trackingErrors(images, places, sequence.setup, geometry, sequence.setup.regions.at(geometry.name()));
    ::testing::Test::RecordProperty(geometry.name() + "_rmse_mm", std::to_string(rootMeanSquare(errors)));
    ::testing::Test::RecordProperty(geometry.name() + "_median_mm", std::to_string(quantile(errors, 0.5)));
    EXPECT_LT(quantile(errors, 0.5), median_of_others) << name << ", " << geometry.name();
  }
}

TEST(HyperplaneTrackerOnAnatomy, isNoWorseThanOthersOnTheThorax)
{
  judgeSharedSequence("thorax_01", 1.07);
}

/// Metal that turns by up to 7.6 degrees and moves by 43 mm, beside another bone, in 8 bit with correlated noise: the
/// reference is good to 0.2 mm. In a view a plate that turns out of the plane looks otherwise by some pixels, of which
/// a motion in the plane keeps a part.
TEST(HyperplaneTrackerOnAnatomy, followsARealKneeInEveryExposure)
{
  const char* folder = std::getenv("XRAY_TRACKING_SHARED_DATA");
  if (folder == nullptr)
  {
    GTEST_SKIP() << "XRAY_TRACKING_SHARED_DATA names no folder with sequences/knee_real";
  }
  const Sequence sequence = loadSequence(std::string(folder) + "/sequences/knee_real");
  const TreatmentSetup& setup = sequence.setup;
  for (std::size_t d = 0; d < setup.detectors.size(); ++d)
  {
    const ProjectionGeometry& geometry = setup.detectors[d];
    const auto place = [&](std::size_t k)
    { return geometry.project(sequence.gold_standard[k].room_from_patient * setup.targetCentre()); };
    HyperplaneTrackerOptions options;
    options.model = MotionModel::EUCLIDEAN;
    HyperplaneTracker tracker(options, setup.intensity);
    const cv::Rect region = projectedTargetRegion(setup, geometry);
    const Eigen::Vector2d arm =
        place(0) - Eigen::Vector2d(region.x + 0.5 * (region.width - 1), region.y + 0.5 * (region.height - 1));
    tracker.train(sequence.image(0, d), region);
    std::vector<double> errors;
    for (std::size_t k = 1; k < sequence.exposures.size(); ++k)
    {
      const TrackResult& result = tracker.track(sequence.image(k, d));
      EXPECT_TRUE(result.found()) << geometry.name() << ", exposure " << k;
      const Eigen::Vector2d moved = result.displacement + result.linear * arm - arm;
      errors.push_back((moved - (place(k) - place(0))).norm() * pixelAtTarget(geometry, setup));
    }
    ::testing::Test::RecordProperty(geometry.name() + "_median_mm", std::to_string(quantile(errors, 0.5)));
    ::testing::Test::RecordProperty(geometry.name() + "_max_mm", std::to_string(quantile(errors, 1.0)));
    EXPECT_LT(quantile(errors, 0.5), 0.6) << geometry.name();
    EXPECT_LT(quantile(errors, 1.0), 1.2) << geometry.name();
  }
}

TEST(HyperplaneTrackerOnAnatomy, isNoWorseThanOthersOnTheHardThorax)
{
  judgeSharedSequence("thorax_02", 1.29);
}
}  // namespace
}  // namespace xray_tracking
