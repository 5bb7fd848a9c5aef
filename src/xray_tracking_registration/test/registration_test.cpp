#include "xray_tracking_registration/registration.h"

#include <algorithm>
#include <atomic>
#include <limits>
#include <thread>

#include <gtest/gtest.h>
#include <boost/math/distributions/beta.hpp>
#include <boost/math/distributions/chi_squared.hpp>

#include "phantom_exposures.h"
#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
const PhantomExposures& phantom()
{
  return PhantomExposures::instance();
}

const Registration& twoBodies()
{
  static const Registration registration(phantom().bodies(), phantom().targetBox());
  return registration;
}

/// How far a start and the rest are off.
struct Offsets
{
  double start_mm;
  double start_degrees;
  double rest_mm;
  double rest_degrees;
};

/// One exposure of a target that moved, with its truth.
struct KnownExposure
{
  RegistrationRequest request;
  RigidTransform gold;
};

KnownExposure randomExposure(const Offsets& offsets, std::mt19937& random)
{
  KnownExposure exposure;
  exposure.gold = motionAbout(Eigen::Vector3d::Zero(), randomTwist(random, 2.0, 6.0)) * phantom().roomFromPatient();
  const RigidTransform rest =
      exposure.gold * motionAbout(phantom().centre(), randomTwist(random, offsets.rest_degrees, offsets.rest_mm));
  exposure.request = phantom().expose(exposure.gold, rest, random);
  exposure.request.room_from_patient =
      motionAbout(exposure.gold * phantom().centre(), randomTwist(random, offsets.start_degrees, offsets.start_mm)) *
      exposure.gold;
  return exposure;
}

double error(const RegistrationResult& result, const RigidTransform& gold)
{
  return targetRegistrationError(result.room_from_patient, gold, phantom().targetBox());
}

/// An exposure for the tests of what else a request can hold.
KnownExposure someExposure()
{
  std::mt19937 random(11);
  return randomExposure({ 2.0, 1.0, 1.0, 0.5 }, random);
}
}  // namespace

TEST(Registration, FindsTargetThatMovesOtherwiseThanTheRest)
{
  std::mt19937 random(1);
  std::vector<double> errors;
  std::vector<double> nees;
  for (int n = 0; n < 20; ++n)
  {
    const KnownExposure exposure = randomExposure({ 2.0, 1.0, 4.0, 2.0 }, random);
    const RegistrationResult result = twoBodies().run(exposure.request);
    ASSERT_EQ(result.status, RegistrationStatus::SUCCESS) << result.reason;
    EXPECT_GT(result.similarity_after, result.similarity_before);
    errors.push_back(error(result, exposure.gold));
    const Twist twist =
        twistAbout(exposure.gold * phantom().centre(), result.room_from_patient * exposure.gold.inverse());
    nees.push_back(twist.dot(result.covariance.ldlt().solve(twist)));
  }
  EXPECT_LE(quantile(errors, 0.5), 0.3);
  EXPECT_LE(quantile(errors, 0.95), 0.8);
  // The squared error in units of the covariance is chi-square with 6 degrees of freedom if that is right. Of 20 the
  // 10th is then above, and the 11th below, these quantiles in all but 1 of 2000 cases each.
  const boost::math::chi_squared normalised(6);
  const double median = quantile(nees, 0.5);
  EXPECT_GT(median,
            boost::math::quantile(normalised, boost::math::quantile(boost::math::beta_distribution<>(10, 11), 0.0005)));
  EXPECT_LT(median,
            boost::math::quantile(normalised, boost::math::quantile(boost::math::beta_distribution<>(11, 10), 0.9995)));
}

TEST(Registration, ReachesFromFarOff)
{
  std::mt19937 random(2);
  int near = 0;
  for (int n = 0; n < 20; ++n)
  {
    const KnownExposure exposure = randomExposure({ 10.0, 5.0, 4.0, 2.0 }, random);
    const RegistrationResult result = twoBodies().run(exposure.request);
    near += error(result, exposure.gold) < 1.0 ? 1 : 0;
  }
  EXPECT_GE(near, 19);
}

TEST(Registration, ReturnsNothingFarOffAsSuccess)
{
  std::mt19937 random(3);
  int lost = 0;
  for (int n = 0; n < 10; ++n)
  {
    // Farther than the bounds of 30 mm.
    const KnownExposure exposure = randomExposure({ 45.0, 12.0, 4.0, 2.0 }, random);
    const RegistrationResult result = twoBodies().run(exposure.request);
    if (error(result, exposure.gold) > 1.5)
    {
      EXPECT_NE(result.status, RegistrationStatus::SUCCESS) << error(result, exposure.gold) << " mm off";
      ++lost;
    }
  }
  EXPECT_GT(lost, 0) << "starts too near to fail";
}

TEST(Registration, OneBodyFollowsAPatientThatMovesAsOne)
{
  const Registration one(oneBody(phantom().ct()), phantom().targetBox());
  std::mt19937 random(4);
  for (int n = 0; n < 3; ++n)
  {
    const KnownExposure exposure = randomExposure({ 5.0, 3.0, 0.0, 0.0 }, random);
    const RegistrationResult result = one.run(exposure.request);
    EXPECT_EQ(result.status, RegistrationStatus::SUCCESS) << result.reason;
    EXPECT_LT(error(result, exposure.gold), 0.3);
    EXPECT_TRUE(result.target_from_rest.isApprox(RigidTransform::Identity()));
  }
}

TEST(Registration, OneBodyIsDoubtedWhereTheRestMovesOtherwise)
{
  const Registration one(oneBody(phantom().ct()), phantom().targetBox());
  std::mt19937 random(9);
  int far = 0, doubted = 0;
  for (int n = 0; n < 24; ++n)
  {
    const KnownExposure exposure = randomExposure({ 2.0, 1.0, 14.0, 6.0 }, random);
    const RegistrationResult result = one.run(exposure.request);
    doubted += result.status != RegistrationStatus::SUCCESS ? 1 : 0;
    if (error(result, exposure.gold) > 1.5)
    {
      EXPECT_NE(result.status, RegistrationStatus::SUCCESS) << error(result, exposure.gold) << " mm off";
      ++far;
    }
  }
  EXPECT_GT(far, 0) << "the rest moves too little to mislead";
  EXPECT_GE(doubted, far);
}

TEST(Registration, CtThatEndsNextToTheTargetDoesNotMislead)
{
  // Nothing above 8 mm and below -8 mm from the target: inside of what is compared.
  CtVolume ct = phantom().ct();
  const Eigen::Affine3d index_from_patient = ct.grid.patient_from_index.inverse();
  const double last = (index_from_patient * (phantom().targetBox().max() + Eigen::Vector3d(0, 0, 8))).z();
  const double first = (index_from_patient * (phantom().targetBox().min() - Eigen::Vector3d(0, 0, 8))).z();
  CtVolume part;
  part.grid = ct.grid;
  part.grid.size.z() = static_cast<int>(last) - static_cast<int>(first);
  part.grid.patient_from_index = ct.grid.patient_from_index * Eigen::Translation3d(0, 0, static_cast<int>(first));
  const auto begin = ct.hu.begin() + static_cast<std::ptrdiff_t>(ct.grid.offset(0, 0, static_cast<int>(first)));
  part.hu.assign(begin, begin + static_cast<std::ptrdiff_t>(part.grid.voxelCount()));
  const Registration registration(splitBodies(part, targetMaskFromBone(part, phantom().targetBox())),
                                  phantom().targetBox());
  std::mt19937 random(10);
  std::vector<double> errors;
  for (int n = 0; n < 10; ++n)
  {
    const KnownExposure exposure = randomExposure({ 2.0, 1.0, 4.0, 2.0 }, random);
    const RegistrationResult result = registration.run(exposure.request);
    if (result.status == RegistrationStatus::SUCCESS)
    {
      errors.push_back(error(result, exposure.gold));
    }
  }
  // Little of the rest is left, so that some are doubted for nothing.
  ASSERT_GE(errors.size(), 6u);
  EXPECT_LE(quantile(errors, 0.5), 0.4);
  EXPECT_LE(quantile(errors, 1.0), 1.0);
}

class DerivativeFreeTest : public testing::TestWithParam<std::string>
{
};

TEST_P(DerivativeFreeTest, FindsTarget)
{
  RegistrationOptions options;
  options.optimiser = Optimiser::BOBYQA;
  options.similarity = GetParam();
  const Registration registration(oneBody(phantom().ct()), phantom().targetBox(), options);
  std::mt19937 random(6);
  const KnownExposure exposure = randomExposure({ 2.0, 1.0, 0.0, 0.0 }, random);
  const RegistrationResult result = registration.run(exposure.request);
  EXPECT_LT(error(result, exposure.gold), 0.8) << result.reason;
}

INSTANTIATE_TEST_SUITE_P(All, DerivativeFreeTest,
                         testing::Values("normalised_mutual_information", "gradient_correlation"));

TEST(Registration, AttenuationFieldGivesThePosesOfRayCasting)
{
  std::mt19937 random(8);
  const KnownExposure exposure = randomExposure({ 2.0, 1.0, 0.0, 0.0 }, random);
  std::vector<RigidTransform> poses;
  for (const Projector projector : { Projector::RAY_CASTING, Projector::ATTENUATION_FIELD })
  {
    RegistrationOptions options;
    options.optimiser = Optimiser::BOBYQA;
    options.projector = projector;
    const Registration registration(oneBody(phantom().ct()), phantom().targetBox(), options);
    const RegistrationResult result = registration.run(exposure.request);
    EXPECT_LT(error(result, exposure.gold), 0.8) << result.reason;
    poses.push_back(result.room_from_patient);
    const AttenuationField::Statistics statistics = registration.fieldStatistics();
    RecordProperty("hits", std::to_string(statistics.hits));
    RecordProperty("lookups", std::to_string(statistics.lookups));
    if (projector == Projector::ATTENUATION_FIELD)
    {
      EXPECT_GT(statistics.hits, 0u);
      EXPECT_LE(registration.memory(), std::size_t{ 300 } << 20);
    }
  }
  // Both stop within BOBYQA's tolerance of optima that differ by rounding rays to an eighth of a voxel.
  EXPECT_LT(targetRegistrationError(poses[1], poses[0], phantom().targetBox()), 0.25);
  RegistrationOptions options;
  options.projector = Projector::RAY_CASTING;
  EXPECT_THROW(Registration(phantom().bodies(), phantom().targetBox(), options), std::invalid_argument);
}

TEST(Registration, ReturnsTheBestSoFarWhenTimeIsUp)
{
  KnownExposure exposure = someExposure();
  // Less than any rendering takes, so the start is all there is.
  exposure.request.time_budget = std::chrono::duration<double>(1e-6);
  const RegistrationResult result = twoBodies().run(exposure.request);
  EXPECT_EQ(result.status, RegistrationStatus::TIMED_OUT);
  EXPECT_NE(result.reason.find("time budget"), std::string::npos);
  EXPECT_TRUE(result.room_from_patient.isApprox(exposure.request.room_from_patient));
}

TEST(Registration, TellsProgressAndStopsAtOnce)
{
  KnownExposure exposure = someExposure();
  std::vector<RegistrationProgress> seen;
  exposure.request.progress = [&](const RegistrationProgress& progress)
  {
    seen.push_back(progress);
    return true;
  };
  ASSERT_EQ(twoBodies().run(exposure.request).status, RegistrationStatus::SUCCESS);
  ASSERT_GT(seen.size(), 3u);
  EXPECT_EQ(seen.front().level, 0);
  EXPECT_EQ(seen.back().level, 1);
  EXPECT_TRUE(
      std::is_sorted(seen.begin(), seen.end(), [](const auto& a, const auto& b) { return a.iteration < b.iteration; }));

  int calls = 0;
  exposure.request.progress = [&](const RegistrationProgress&) { return ++calls < 3; };
  const RegistrationResult cancelled = twoBodies().run(exposure.request);
  EXPECT_EQ(cancelled.status, RegistrationStatus::CANCELLED);
  EXPECT_EQ(calls, 3);
  RegistrationResult start;
  start.room_from_patient = exposure.request.room_from_patient;
  EXPECT_LT(error(cancelled, exposure.gold), error(start, exposure.gold));
}

TEST(Registration, AnswersACancelWithin50Ms)
{
  // Far off, so that it tries other starts too; cancelled at any time by another thread, as a node does.
  std::mt19937 random(7);
  KnownExposure exposure = randomExposure({ 25.0, 12.0, 4.0, 2.0 }, random);
  std::vector<double> latencies;
  for (int n = 0; n < 21; ++n)
  {
    std::atomic<bool> cancelled(false);
    exposure.request.progress = [&](const RegistrationProgress&) { return !cancelled; };
    std::chrono::steady_clock::time_point cancelled_at;
    std::thread canceller(
        [&]
        {
          std::this_thread::sleep_for(std::chrono::milliseconds(2 * n));
          cancelled_at = std::chrono::steady_clock::now();
          cancelled = true;
        });
    const RegistrationResult result = twoBodies().run(exposure.request);
    const auto returned = std::chrono::steady_clock::now();
    canceller.join();
    if (result.status == RegistrationStatus::CANCELLED)
    {
      latencies.push_back(std::chrono::duration<double, std::milli>(returned - cancelled_at).count());
    }
  }
  ASSERT_GT(latencies.size(), 5u) << "ended before they were cancelled";
  // The median, as single ones may wait for a core of a busy machine.
  EXPECT_LT(quantile(latencies, 0.5), 50.0);
}

TEST(Registration, StaysWithinBounds)
{
  KnownExposure exposure = someExposure();
  exposure.request.max_translation_mm = 0.5;
  const RegistrationResult result = twoBodies().run(exposure.request);
  const Eigen::Vector3d centre = phantom().centre();
  EXPECT_LE((result.room_from_patient * centre - exposure.request.room_from_patient * centre).norm(), 0.5 + 1e-9);
  // Held up by them: nobody knows whether the target is there.
  EXPECT_NE(result.status, RegistrationStatus::SUCCESS);
}

TEST(Registration, BadRequestsAreAnsweredAndTheNextOneWorks)
{
  const auto expectInvalid = [](const std::function<void(RegistrationRequest&)>& spoil, const std::string& part)
  {
    RegistrationRequest request = someExposure().request;
    spoil(request);
    const RegistrationResult result = twoBodies().run(request);
    EXPECT_EQ(result.status, RegistrationStatus::INVALID);
    EXPECT_NE(result.reason.find(part), std::string::npos) << "'" << part << "' is missing in: " << result.reason;
  };
  expectInvalid([](auto& request) { request.views.clear(); }, "views");
  expectInvalid([](auto& request) { request.views[1].image = cv::Mat(); }, "detector_b");
  expectInvalid([](auto& request) { request.views[0].image = request.views[0].image.rowRange(0, 400); }, "512 x 400");
  expectInvalid([](auto& request) { request.views[0].image = cv::Mat(512, 512, CV_8UC3); }, "detector_a");
  expectInvalid([](auto& request) { request.views[1].image.setTo(7000); }, "detector_b: the image is constant");
  expectInvalid([](auto& request)
                { request.room_from_patient.translation().x() = std::numeric_limits<double>::quiet_NaN(); },
                "start pose");
  expectInvalid([](auto& request) { request.room_from_patient.translation().x() += 400.0; }, "detector_a");
  expectInvalid([](auto& request) { request.room_from_patient.translation().z() += 9000.0; }, "detector_a");
  expectInvalid([](auto& request) { request.views[0].region = { 500, 500, 300, 300 }; }, "detector_a");
  // Behind both sources, where a region would be compared all the same.
  expectInvalid(
      [](auto& request)
      {
        request.room_from_patient.translation().z() += 9000.0;
        request.views[0].region = request.views[1].region = { 200, 200, 100, 100 };
      },
      "detector_a: does not see the target");
  expectInvalid([](auto& request) { request.max_translation_mm = 0.0; }, "bounds");
  expectInvalid([](auto& request) { request.time_budget = std::chrono::duration<double>(-1.0); }, "time budget");

  const KnownExposure exposure = someExposure();
  EXPECT_LT(error(twoBodies().run(exposure.request), exposure.gold), 0.5);
}

TEST(Registration, OneViewAloneIsUncertainAlongItsRays)
{
  KnownExposure exposure = someExposure();
  exposure.request.views.pop_back();
  const RegistrationResult result = twoBodies().run(exposure.request);
  ASSERT_EQ(result.views.size(), 1u);
  if (result.status == RegistrationStatus::SUCCESS)
  {
    EXPECT_LT(error(result, exposure.gold), 1.5);
  }
  const Eigen::Vector3d ray = phantom().views()[0].roomFromOptical().linear().col(2);
  const Eigen::Matrix3d covariance = result.covariance.bottomRightCorner<3, 3>();
  EXPECT_GT(ray.dot(covariance * ray), 0.5 * covariance.trace());
}

TEST(Registration, NamesWhatIsWrongWithOptions)
{
  RegistrationOptions options;
  options.min_probability = 1.5;
  EXPECT_THROW(Registration(phantom().bodies(), phantom().targetBox(), options), std::invalid_argument);
  EXPECT_THROW(Registration(BodyModel(), phantom().targetBox()), std::invalid_argument);
  EXPECT_THROW(Registration(phantom().bodies(), Eigen::AlignedBox3d()), std::invalid_argument);
}

TEST(Registration, CopiesOfTheVolumeStaySmall)
{
  EXPECT_LE(twoBodies().memory(), phantom().ct().hu.size() * sizeof(std::int16_t));
}
}  // namespace xray_tracking
