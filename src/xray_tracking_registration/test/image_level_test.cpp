#include "image_level.h"

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "gauss_newton.h"
#include "phantom_exposures.h"
#include "xray_tracking_registration/attenuation_image.h"

namespace xray_tracking
{
namespace
{
/// A smooth body: Gaussian blobs, each a centre [mm] and a weight.
ScalarVolume blobs(const std::vector<std::pair<Eigen::Vector3d, double>>& shape)
{
  constexpr double kSigma = 9.0;
  ScalarVolume volume;
  volume.grid.size = { 100, 100, 100 };
  volume.grid.patient_from_index = Eigen::Translation3d(-49.5, -49.5, -49.5);
  volume.values.assign(volume.grid.voxelCount(), 0.0f);
  for (int k = 0; k < 100; ++k)
  {
    for (int j = 0; j < 100; ++j)
    {
      for (int i = 0; i < 100; ++i)
      {
        const Eigen::Vector3d point = volume.grid.patient_from_index * Eigen::Vector3d(i, j, k);
        for (const auto& [centre, weight] : shape)
        {
          volume.values[volume.grid.offset(i, j, k)] +=
              static_cast<float>(weight * std::exp(-0.5 * (point - centre).squaredNorm() / (kSigma * kSigma)));
        }
      }
    }
  }
  return volume;
}
AttenuationImage asAttenuation(const cv::Mat& image)
{
  IntensityModel intensity;
  intensity.kind = IntensityModel::Kind::ATTENUATION;
  return { image, intensity };
}
}  // namespace

class ImageLevelTest : public testing::TestWithParam<Moving>
{
};

TEST_P(ImageLevelTest, DerivativesAgreeWithCentralDifferences)
{
  const ProjectionGeometry& geometry = PhantomExposures::instance().views()[0];
  const Eigen::Vector3d centre(2.0, 3.0, -1.0);
  const Bodies bodies({ blobs({ { { 3, -4, 5 }, 0.02 }, { { -12, 9, -6 }, 0.015 }, { { 4, 14, -9 }, 0.01 } }),
                        blobs({ { { -14, 6, 10 }, 0.01 }, { { 12, -12, -2 }, 0.02 } }) },
                      { centre.array() - 10.0, centre.array() + 10.0 }, 1.0, Projector::SHEAR_WARP);
  cv::Mat image(512, 512, CV_32FC1);
  cv::randu(image, 0.0, 1.0);  // derivatives do not depend on it
  const ViewLevel level(geometry, asAttenuation(image), cv::Mat(), cv::Rect(170, 170, 170, 170), { 1.6, 16.0 });
  constexpr double kSaturation = 0.7;
  constexpr float kGain = 0.05f;  // the least, as the image is noise
  std::mt19937 random(1);
  const RigidTransform pose = motionAbout(Eigen::Vector3d::Zero(), randomTwist(random, 20.0, 4.0));
  const PosePair poses{ pose, motionAbout(Eigen::Vector3d::Zero(), randomTwist(random, 1.0, 2.0)) * pose };
  ViewModel model;
  level.model(bodies, poses, kSaturation, GetParam(), model);
  ASSERT_EQ(model.twists, GetParam() == Moving::BOTH ? 12 : 6);
  EXPECT_NEAR(model.image.norm(), kGain, 1e-5f);
  EXPECT_EQ(model.derivatives.rightCols(kPixelRow - 1 - model.twists).norm(), 0.0f);
  // A shift by 1 mm across the rays is what the image depends on most; along them it depends 40 times less.
  const float largest = model.derivatives.middleCols<3>(model.twists - 3).colwise().norm().maxCoeff();
  // What the model is like at a gain of its own at both sides.
  const auto difference_of = [&](const std::array<ViewModel, 2>& sides, double size) -> Eigen::VectorXf
  { return kGain * (sides[1].image.normalized() - sides[0].image.normalized()) / static_cast<float>(2.0 * size); };
  for (int unknown = 0; unknown < model.twists; ++unknown)
  {
    const double size = unknown % 6 < 3 ? 0.02 : 0.5;
    Eigen::VectorXd step = Eigen::VectorXd::Zero(model.twists);
    std::array<ViewModel, 2> sides;
    for (int side = 0; side < 2; ++side)
    {
      step[unknown] = side == 0 ? -size : size;
      level.model(bodies, moved(poses, step, bodies.centre, GetParam()), kSaturation, GetParam(), sides[side]);
    }
    const Eigen::VectorXf difference = difference_of(sides, size);
    // 3 %: the slope of trilinear interpolation against that of what it interpolates.
    EXPECT_LT((difference - model.derivatives.col(unknown)).norm(), 0.03f * std::max(difference.norm(), 0.1f * largest))
        << "unknown " << unknown << " of norm " << difference.norm();
  }
  std::array<ViewModel, 2> sides;
  for (int side = 0; side < 2; ++side)
  {
    level.model(bodies, poses, kSaturation + (side == 0 ? -0.01 : 0.01), GetParam(), sides[side]);
  }
  const Eigen::VectorXf difference = difference_of(sides, 0.01);
  EXPECT_GT(difference.norm(), 0.01f * kGain);
  EXPECT_LT((difference - model.derivatives.col(model.twists)).norm(), 0.01f * difference.norm());
}

TEST_P(ImageLevelTest, aShortStepToFirstOrderIsWhatRenderingGives)
{
  const ProjectionGeometry& geometry = PhantomExposures::instance().views()[0];
  const Bodies bodies({ blobs({ { { 3, -4, 5 }, 0.02 }, { { -12, 9, -6 }, 0.015 } }),
                        blobs({ { { -14, 6, 10 }, 0.01 }, { { 12, -12, -2 }, 0.02 } }) },
                      Eigen::AlignedBox3d(Eigen::Vector3d::Constant(-10.0), Eigen::Vector3d::Constant(10.0)), 1.0,
                      Projector::SHEAR_WARP);
  const RigidTransform pose = RigidTransform::Identity();
  PosePair poses{ pose, pose };
  cv::Mat image(512, 512, CV_32FC1);
  cv::randu(image, 0.0, 1.0);
  const ViewLevel noise(geometry, asAttenuation(image), cv::Mat(), cv::Rect(170, 170, 170, 170), { 1.6, 16.0 });
  noise.modelImage(bodies, poses, 0.3, image);
  // Nearly what the image shows.
  cv::Mat shown(512, 512, CV_32FC1, 0.0f);
  cv::resize(image, shown(cv::Rect(170, 170, 170, 170)), cv::Size(170, 170));
  const ViewLevel level(geometry, asAttenuation(shown), cv::Mat(), cv::Rect(170, 170, 170, 170), { 1.6, 16.0 });
  std::mt19937 random(3);
  Eigen::VectorXd step(GetParam() == Moving::BOTH ? 12 : 6);
  for (Eigen::Index body = 0; body < step.size() / 6; ++body)
  {
    step.segment<6>(6 * body) = randomTwist(random, 0.4, 0.4);
  }
  constexpr double kMore = 0.02;  // of the saturation
  ViewModel moved_model;
  level.model(bodies, poses, 0.3, GetParam(), moved_model);
  const Eigen::VectorXf before = moved_model.image.normalized();
  Eigen::VectorXf all(step.size() + 1);
  all << step.cast<float>(), static_cast<float>(kMore);
  level.move(all, moved_model);
  ViewModel rendered;
  level.model(bodies, moved(poses, step, bodies.centre, GetParam()), 0.3 + kMore, GetParam(), rendered);
  const float change = (rendered.image.normalized() - before).norm();
  EXPECT_GT(change, 0.01f);
  // Of the derivatives as above and of the second order, for blobs of 9 mm; a rendering is good to 0.1 %.
  EXPECT_LT((moved_model.image.normalized() - rendered.image.normalized()).norm(), 0.05f * change + 2e-3f);
  EXPECT_NEAR(moved_model.similarity, rendered.similarity, 0.1 * change);
  EXPECT_NEAR(moved_model.image.norm(), rendered.image.norm(), 0.1 * change);
}

TEST(ImageLevel, theRestIsFollowedNearbyAndRenderedAnewFartherAway)
{
  const ProjectionGeometry& geometry = PhantomExposures::instance().views()[0];
  const Bodies bodies(
      { blobs({ { { 3, -4, 5 }, 0.02 } }), blobs({ { { -14, 6, 10 }, 0.01 }, { { 12, -12, -2 }, 0.02 } }) },
      Eigen::AlignedBox3d(Eigen::Vector3d::Constant(-10.0), Eigen::Vector3d::Constant(10.0)), 1.0,
      Projector::SHEAR_WARP);
  cv::Mat image(512, 512, CV_32FC1);
  cv::randu(image, 0.0, 1.0);
  const ViewLevel level(geometry, asAttenuation(image), cv::Mat(), cv::Rect(170, 170, 170, 170), { 1.6, 16.0 });
  const RigidTransform pose = RigidTransform::Identity();
  ViewModel model;
  level.model(bodies, { pose, pose }, 0.2, Moving::BOTH, model);
  const cv::Mat first = model.rest.clone();
  // Turned and shifted, by nearly what it is followed for at the most, and by twice that.
  for (const double share : { 0.9, 2.0 })
  {
    const Twist twist =
        share * 0.2 * (Twist() << Eigen::Vector3d(0.6, -0.5, 0.6) / 50.0, Eigen::Vector3d(0.7, 0.5, -0.5)).finished();
    const PosePair poses{ pose, motionAbout(Eigen::Vector3d(5, 0, 3), twist) };
    ViewModel followed;
    followed.rendered = model.rendered;
    level.model(bodies, poses, 0.2, Moving::BOTH, followed);
    EXPECT_EQ(share < 1.0, followed.rendered.line_integrals.data == model.rendered.line_integrals.data);
    ViewModel anew;
    level.model(bodies, poses, 0.2, Moving::BOTH, anew);
    const double change = cv::norm(anew.rest, first);
    EXPECT_GT(change, 5e-3 * cv::norm(first));
    EXPECT_LT(cv::norm(followed.rest, anew.rest), share < 1.0 ? 0.05 * change + 1e-3 * cv::norm(first) : 1e-9);
    EXPECT_EQ(0.0, cv::norm(first, model.rest)) << "what others follow from stays";
  }
}

INSTANTIATE_TEST_SUITE_P(All, ImageLevelTest, testing::Values(Moving::TARGET, Moving::TOGETHER, Moving::BOTH));

TEST(ImageLevel, ModelOfTheTruePoseIsLikeTheImage)
{
  const PhantomExposures& phantom = PhantomExposures::instance();
  std::mt19937 random(2);
  const RigidTransform& pose = phantom.roomFromPatient();
  const RegistrationRequest request = phantom.expose(pose, pose, random);
  const AttenuationImage attenuation(request.views[1].image, request.intensity);
  const ViewLevel level(request.views[1].geometry, attenuation, cv::Mat(), cv::Rect(170, 170, 170, 170), { 3.2, 16.0 });
  ViewModel model;
  const Bodies bodies(phantom.bodies(), phantom.targetBox(), 1.0, Projector::SHEAR_WARP);
  level.model(bodies, { pose, pose }, kUsualSaturation, Moving::TARGET, model);
  EXPECT_GT(model.similarity, 0.93);
  EXPECT_NEAR(model.image.norm(), model.similarity, 1e-5);
}

TEST(ImageLevel, LeavesOutWhereTheCtEnds)
{
  // A cube of water that goes on beyond the CT's ends along the patient's z, at room x = -25 and 25 mm; elsewhere air
  // is around it.
  ScalarVolume cube;
  cube.grid.size = Eigen::Vector3i(60, 60, 51);
  cube.grid.patient_from_index = Eigen::Translation3d(-29.5, -29.5, -25.0);
  cube.values.assign(cube.grid.voxelCount(), 0.0f);
  for (int k = 0; k < 51; ++k)
  {
    for (int j = 10; j < 50; ++j)
    {
      std::fill_n(cube.values.begin() + cube.grid.offset(10, j, k), 40, 0.02f);
    }
  }
  const PhantomExposures& phantom = PhantomExposures::instance();
  const ProjectionGeometry& geometry = phantom.views()[0];
  cv::Mat image(512, 512, CV_32FC1);
  cv::randu(image, 0.0, 1.0);
  const CtEnds ends(cube);
  const ViewLevel level(geometry, asAttenuation(image), cv::Mat(), cv::Rect(100, 180, 312, 150), { 1.6, 1.6 },
                        { { ends, phantom.roomFromPatient() } });
  int judged = 0;
  for (int row = 0; row < level.size().height; ++row)
  {
    for (int column = 0; column < level.size().width; ++column)
    {
      // The region begins in the bin of pixel 100, 180: bins of 4 px, whose centres are seen at the isocentre here.
      const double u = 4.0 * column + 1.5 + 100.0;
      const double x = (u - 255.5) * 0.4 * 2600.0 / 3800.0;
      const bool valid = level.valid()[row * level.size().width + column] > 0.0f;
      if (std::abs(std::abs(x) - 25.0) > 6.0)  // the cube's depth and what is left out beside it blur the end
      {
        EXPECT_TRUE(valid) << "at x = " << x;
        ++judged;
      }
      else if (std::abs(std::abs(x) - 25.0) < 0.3)
      {
        EXPECT_FALSE(valid) << "at x = " << x;
        EXPECT_EQ(level.measured()[row * level.size().width + column], 0.0f);
        ++judged;
      }
    }
  }
  EXPECT_GT(judged, 1000);
  EXPECT_NEAR(level.measured().norm(), 1.0f, 1e-5f);
  EXPECT_NEAR(level.measured().sum(), 0.0f, 1e-3f);
  // A cube that ends in air by itself has none.
  EXPECT_FALSE(ends.cut({ Eigen::Vector3d(0.0, -2600.0, 0.0), Eigen::Vector3d::UnitY() }));
}

TEST(ImageLevel, UnusablePixelsDoNotCount)
{
  // A plane in grey, which a high-pass takes away but at borders, and a plate without any signal across a part of it.
  const PhantomExposures& phantom = PhantomExposures::instance();
  const ProjectionGeometry& geometry = phantom.views()[0];
  cv::Mat image(512, 512, CV_32FC1);
  cv::randu(image, 0.9, 1.1);
  cv::Mat spoilt = image.clone();
  const cv::Rect plate(200, 0, 40, 512);
  spoilt(plate).setTo(7.0f);
  spoilt.at<float>(256, 300) = -50.0f;
  cv::Mat usable(512, 512, CV_8UC1, cv::Scalar(1));  // whatever is not 0 counts
  usable(plate).setTo(0);
  usable.at<std::uint8_t>(256, 300) = 0;
  const cv::Rect region(150, 180, 200, 150);
  const ViewLevel masked(geometry, asAttenuation(spoilt), usable, region, { 1.6, 16.0 });
  const ViewLevel same(geometry, asAttenuation(image), usable, region, { 1.6, 16.0 });
  EXPECT_EQ(masked.measured(), same.measured()) << "what is not usable has changed what is";
  const auto width = masked.size().width;
  for (int column = 0; column < width; ++column)
  {
    const int u = 148 + 4 * column;  // bins of 4 px from a multiple of 4 on
    const float valid = masked.valid()[width + column];
    EXPECT_EQ(valid, u + 3 < plate.x || u >= plate.x + plate.width ? 1.0f : 0.0f) << "bin at " << u;
  }
  usable(cv::Rect(150, 0, 110, 512)).setTo(0);
  try
  {
    ViewLevel(geometry, asAttenuation(spoilt), usable, region, { 1.6, 16.0 });
    FAIL();
  }
  catch (const std::invalid_argument& error)
  {
    EXPECT_NE(std::string(error.what()).find("detector_a: much of the region to compare is not usable"),
              std::string::npos)
        << error.what();
  }
}

TEST(ImageLevel, NamesViewOfARegionThatCannotBeCompared)
{
  const PhantomExposures& phantom = PhantomExposures::instance();
  const cv::Mat constant(512, 512, CV_32FC1, cv::Scalar(1.0));
  const auto expectView = [&](const cv::Rect& region)
  {
    try
    {
      ViewLevel(phantom.views()[0], asAttenuation(constant), cv::Mat(), region, { 1.6, 1.6 });
      FAIL();
    }
    catch (const std::invalid_argument& error)
    {
      EXPECT_NE(std::string(error.what()).find("detector_a"), std::string::npos) << error.what();
    }
  };
  expectView({ 100, 100, 200, 200 });  // constant
  expectView({ 600, 100, 200, 200 });
  expectView({ 100, 100, 2, 200 });
  expectView({ -900, -900, 100, 100 });
}

TEST(AttenuationImage, IsTheLogarithmOfTransmission)
{
  IntensityModel intensity;
  intensity.offset = 100.0;
  intensity.air_counts = 10100.0;
  cv::Mat counts = (cv::Mat_<std::uint16_t>(1, 3) << 10100, 1100, 40);
  const cv::Rect all(0, 0, 3, 1);
  cv::Mat attenuation = AttenuationImage(counts, intensity).bins(all, 1).mean;
  EXPECT_NEAR(attenuation.at<float>(0), 0.0, 1e-6);
  EXPECT_NEAR(attenuation.at<float>(1), std::log(10.0), 1e-6);
  EXPECT_NEAR(attenuation.at<float>(2), std::log(10000.0), 1e-5);  // below the offset: one count
  intensity.air_counts.reset();
  counts.at<std::uint16_t>(0) = 5100;
  attenuation = AttenuationImage(counts, intensity).bins(all, 1).mean;
  EXPECT_NEAR(attenuation.at<float>(1), std::log(5.0), 1e-6);
  intensity.kind = IntensityModel::Kind::ATTENUATION;
  attenuation = AttenuationImage(counts, intensity).bins(all, 1).mean;
  EXPECT_EQ(attenuation.at<float>(1), 1100.0f);
  attenuation = AttenuationImage(counts, intensity).bins(cv::Rect(1, 0, 2, 1), 1).mean;
  EXPECT_EQ(attenuation.size(), cv::Size(2, 1));
  EXPECT_EQ(attenuation.at<float>(0), 1100.0f);
}

TEST(AttenuationImage, binsAreMeansOfWhatIsUsable)
{
  cv::RNG random(7);
  const cv::Rect bins(1, 2, 5, 3);
  for (const int edge : { 1, 3, 9 })
  {
    cv::Mat usable(60, 70, CV_8UC1);
    random.fill(usable, cv::RNG::UNIFORM, 0, 3);
    usable(cv::Rect(bins.tl() * edge, cv::Size(edge, edge))).setTo(0);  // nothing of the first bin
    for (const int type : { CV_8UC1, CV_16UC1, CV_32FC1 })
    {
      cv::Mat image(60, 70, type);
      random.fill(image, cv::RNG::UNIFORM, 0, type == CV_8UC1 ? 256 : 65536);
      for (const auto kind : { IntensityModel::Kind::COUNTS, IntensityModel::Kind::ATTENUATION })
      {
        IntensityModel intensity;
        intensity.kind = kind;
        intensity.offset = 20.0;
        intensity.air_counts = 70000.0;
        cv::Mat values;
        image.convertTo(values, CV_64F);
        for (const cv::Mat& mask : { cv::Mat(), usable })
        {
          const AttenuationBins result = AttenuationImage(image, intensity).bins(bins, edge, mask);
          ASSERT_EQ(mask.empty(), result.share.empty());
          for (int n = 0; n < bins.area(); ++n)
          {
            const cv::Point bin(n % bins.width, n / bins.width);
            double sum = 0.0;
            int count = 0;
            for (int pixel = 0; pixel < edge * edge; ++pixel)
            {
              const cv::Point at = (bins.tl() + bin) * edge + cv::Point(pixel % edge, pixel / edge);
              if (mask.empty() || mask.at<std::uint8_t>(at) != 0)
              {
                const double value = values.at<double>(at);
                sum += kind == IntensityModel::Kind::COUNTS ? std::log((70000.0 - 20.0) / std::max(value - 20.0, 1.0))
                                                            : value;
                ++count;
              }
            }
            const double mean = count > 0 ? sum / count : 0.0;
            EXPECT_NEAR(mean, result.mean.at<float>(bin), 1e-6 * std::max(std::abs(mean), 12.0));
            if (!mask.empty())
            {
              EXPECT_FLOAT_EQ(static_cast<float>(count) / static_cast<float>(edge * edge), result.share.at<float>(bin));
            }
          }
        }
      }
    }
  }
}

TEST(AttenuationImage, AirOfNoCountsAboveANegativeOffsetIsNoAttenuationImage)
{
  IntensityModel intensity;
  intensity.offset = -100.0;
  intensity.air_counts = 0.0;
  const cv::Mat counts = (cv::Mat_<float>(1, 2) << 0.0f, -90.0f);
  const cv::Mat attenuation = AttenuationImage(counts, intensity).bins(cv::Rect(0, 0, 2, 1), 1).mean;
  EXPECT_NEAR(attenuation.at<float>(0), 0.0, 1e-6);
  EXPECT_NEAR(attenuation.at<float>(1), std::log(10.0), 1e-5);
}

TEST(AttenuationImage, RefusesWhatHasNoLogarithm)
{
  IntensityModel intensity;
  intensity.offset = 100.0;
  EXPECT_THROW(AttenuationImage(cv::Mat(), intensity), std::invalid_argument);
  EXPECT_THROW(AttenuationImage(cv::Mat(4, 4, CV_8UC3), intensity), std::invalid_argument);
  EXPECT_THROW(AttenuationImage(cv::Mat(4, 4, CV_16UC1, cv::Scalar(90)), intensity), std::invalid_argument);
  EXPECT_THROW(AttenuationImage(cv::Mat(4, 4, CV_32FC1, cv::Scalar(NAN)), intensity), std::invalid_argument);
}
}  // namespace xray_tracking
