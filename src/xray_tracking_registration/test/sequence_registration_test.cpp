// What is carried from one exposure to the next, and what is not.

#include "xray_tracking_registration/sequence_registration.h"

#include <algorithm>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

#include "phantom_exposures.h"
#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
constexpr std::int64_t kSecond = 1000000000;
constexpr double kLimit = 0.3;  // the phantom's registrations are good to 0.1 mm

const PhantomExposures& phantom()
{
  return PhantomExposures::instance();
}

std::shared_ptr<const Registration> registration()
{
  static const auto shared = std::make_shared<const Registration>(phantom().bodies(), phantom().targetBox());
  return shared;
}

class SequenceRegistrationTest : public testing::Test
{
protected:
  SequenceRegistrationTest() : sequence_(phantom().centre()) { sequence_.setRegistration(registration()); }

  /// An exposure of the target at an offset [mm], with the start where the offset `from` puts it.
  RegistrationRequest expose(const Eigen::Vector3d& offset, const Eigen::Vector3d& from)
  {
    const RigidTransform at_rest = phantom().roomFromPatient();
    RegistrationRequest request = phantom().expose(Eigen::Translation3d(offset) * at_rest,
                                                   Eigen::Translation3d(offset + rest_) * at_rest, random_);
    request.room_from_patient = Eigen::Translation3d(from) * at_rest;
    return request;
  }

  double error(const RegistrationResult& result, const Eigen::Vector3d& offset) const
  {
    return targetRegistrationError(result.room_from_patient, Eigen::Translation3d(offset) * phantom().roomFromPatient(),
                                   phantom().targetBox());
  }

  /// Whether a result is of a verified start: then no coarse views are laid out.
  static bool verified(const RegistrationResult& result) { return result.views.front().coarse_similarity == 0.0; }

  RegistrationResult runAt(std::int64_t stamp_ns, const Eigen::Vector3d& offset, const Eigen::Vector3d& from,
                           bool unverified = false)
  {
    RegistrationResult result = sequence_.run(expose(offset, from), stamp_ns, unverified);
    EXPECT_EQ(RegistrationStatus::SUCCESS, result.status) << result.reason;
    EXPECT_LT(error(result, offset), kLimit);
    return result;
  }

  /// A run that is cancelled before its first step says where it would have begun.
  RigidTransform restAtStart(std::int64_t stamp_ns, bool unverified)
  {
    RegistrationRequest request = expose({ 0, 0, 0 }, { 0, 0, 0 });
    request.progress = [](const RegistrationProgress&) { return false; };
    const RegistrationResult result = sequence_.run(request, stamp_ns, unverified);
    EXPECT_EQ(RegistrationStatus::CANCELLED, result.status);
    return result.target_from_rest;
  }

  Eigen::Vector3d rest_{ 1.5, -1.0, 2.0 };  ///< of the rest's motion against the target's [mm]
  std::mt19937 random_{ 1 };
  SequenceRegistration sequence_;
};

TEST_F(SequenceRegistrationTest, aStartIsVerifiedByABelievedPoseShortlyBefore)
{
  EXPECT_FALSE(verified(runAt(10 * kSecond, { 0, 0, 0 }, { 1, 0, 0 }))) << "the first one";
  EXPECT_TRUE(verified(runAt(11 * kSecond, { 1, 0, 1 }, { 0, 0, 0 })));
  EXPECT_TRUE(verified(runAt(11 * kSecond, { 1, 0, 1 }, { 0, 0, 0 }))) << "asked about again";
  EXPECT_FALSE(verified(runAt(12 * kSecond, { 1, 0, 1 }, { 0, 0, 0 }, true))) << "who asks says so";
  EXPECT_TRUE(verified(runAt(17 * kSecond, { 0, 0, 1 }, { 1, 0, 1 })));
  EXPECT_FALSE(verified(runAt(22 * kSecond + 1, { 0, 0, 1 }, { 0, 0, 1 }))) << "more than 5 s later";
  EXPECT_FALSE(verified(runAt(22 * kSecond, { 0, 0, 1 }, { 0, 0, 1 }))) << "before it";
  EXPECT_FALSE(verified(runAt(23 * kSecond, { 0, 0, 1 }, { 0, 0, 10.5 }))) << "another vertebra's start";
  EXPECT_TRUE(verified(runAt(24 * kSecond, { 0, 0, 1 }, { 0, 0, 0 })));
}

TEST_F(SequenceRegistrationTest, theRestIsLookedForWhereItWas)
{
  const auto rest_at_start = [this](std::int64_t stamp_ns) { return restAtStart(stamp_ns, false); };
  EXPECT_TRUE(rest_at_start(9 * kSecond).isApprox(RigidTransform::Identity()));
  const RigidTransform found = runAt(10 * kSecond, { 0, 0, 0 }, { 0.5, 0, 0 }).target_from_rest;
  EXPECT_GT(found.translation().norm(), 1.0) << "of the rest's motion by 2.7 mm";
  EXPECT_TRUE(rest_at_start(11 * kSecond).isApprox(found)) << "and what is not believed changes nothing";
  EXPECT_TRUE(rest_at_start(12 * kSecond).isApprox(found));
  sequence_.forget();
  EXPECT_TRUE(rest_at_start(13 * kSecond).isApprox(RigidTransform::Identity()));
}

TEST_F(SequenceRegistrationTest, theRestIsLookedForAsInTheCtIfWhatIsFoundIsNotBelieved)
{
  const RigidTransform found = runAt(10 * kSecond, { 0, 0, 0 }, { 0.5, 0, 0 }).target_from_rest;
  const auto doubt = [this](std::int64_t stamp_ns)
  {
    const RegistrationResult result = sequence_.run(expose({ 0, 0, 0 }, { 0, 60, 0 }), stamp_ns, true);
    EXPECT_EQ(RegistrationStatus::UNRELIABLE, result.status) << result.reason;
  };
  EXPECT_TRUE(restAtStart(11 * kSecond, true).isApprox(found));
  for (const bool as_in_ct : { true, true, false, false, true })
  {
    doubt(12 * kSecond);
    EXPECT_TRUE(restAtStart(13 * kSecond, true).isApprox(as_in_ct ? RigidTransform::Identity() : found));
    EXPECT_TRUE(restAtStart(13 * kSecond, false).isApprox(found)) << "a verified start is of the pose that had it";
  }
  const RigidTransform again = runAt(14 * kSecond, { 0, 0, 0 }, { 0.5, 0, 0 }, true).target_from_rest;
  EXPECT_TRUE(restAtStart(15 * kSecond, true).isApprox(again));
}

TEST_F(SequenceRegistrationTest, theViewsSaturateAsTheyDid)
{
  // A run that is cancelled before its first step says where it would have begun.
  const auto saturation_at_start = [this](std::int64_t stamp_ns, bool unverified, bool reversed = false)
  {
    RegistrationRequest request = expose({ 0, 0, 0 }, { 0, 0, 0 });
    if (reversed)
    {
      std::reverse(request.views.begin(), request.views.end());
    }
    request.progress = [](const RegistrationProgress&) { return false; };
    std::vector<double> saturations;
    for (const ViewResidual& view : sequence_.run(request, stamp_ns, unverified).views)
    {
      saturations.push_back(view.saturation);
    }
    return saturations;
  };
  // The second view's images are made to saturate.
  constexpr double kSaturation = 1.0;
  RegistrationRequest request = expose({ 0, 0, 0 }, { 0.5, 0, 0 });
  const double air = request.intensity.air_counts.value();
  cv::Mat counts;
  request.views[1].image.convertTo(counts, CV_32F);
  cv::Mat transmission = cv::max(counts - request.intensity.offset, 1.0) / (air - request.intensity.offset);
  cv::pow(transmission, kSaturation, transmission);  // exp(-k L)
  cv::exp((transmission - 1.0) / kSaturation, transmission);
  request.views[1].image = transmission * (air - request.intensity.offset) + request.intensity.offset;
  const RegistrationResult result = sequence_.run(request, 10 * kSecond, false);
  ASSERT_EQ(RegistrationStatus::SUCCESS, result.status) << result.reason;
  const std::vector<double> found{ result.views[0].saturation, result.views[1].saturation };
  ASSERT_GT(found[1], found[0]);
  EXPECT_EQ(found, saturation_at_start(11 * kSecond, false));
  EXPECT_EQ((std::vector<double>{ found[1], found[0] }), saturation_at_start(12 * kSecond, false, true));
  EXPECT_EQ((std::vector<double>{ kUsualSaturation, kUsualSaturation }), saturation_at_start(13 * kSecond, true));
}

TEST_F(SequenceRegistrationTest, forgetsWithAnotherRunOrAnotherCt)
{
  runAt(10 * kSecond, { 0, 0, 0 }, { 0, 0, 0 });
  sequence_.setRegistration(registration());
  EXPECT_TRUE(verified(runAt(11 * kSecond, { 0, 0, 0 }, { 0, 0, 0 }))) << "the same CT";
  sequence_.setRegistration(std::make_shared<const Registration>(phantom().bodies(), phantom().targetBox()));
  EXPECT_FALSE(verified(runAt(12 * kSecond, { 0, 0, 0 }, { 0, 0, 0 })));
  sequence_.forget();
  EXPECT_FALSE(verified(runAt(13 * kSecond, { 0, 0, 0 }, { 0, 0, 0 })));
}

TEST_F(SequenceRegistrationTest, imagesOfNoSequenceSayNothingOfIt)
{
  const RegistrationRequest request = expose({ 0, 0, 0 }, { 0, 0, 0 });
  for (int i = 0; i < 2; ++i)
  {
    const RegistrationResult result = sequence_.run(request, std::nullopt, false);
    EXPECT_EQ(RegistrationStatus::SUCCESS, result.status) << result.reason;
    EXPECT_FALSE(verified(result));
  }
  EXPECT_FALSE(verified(runAt(10 * kSecond, { 0, 0, 0 }, { 0, 0, 0 })));
}

TEST_F(SequenceRegistrationTest, takesStampsThatAreAsFarApartAsTheyCanBe)
{
  EXPECT_FALSE(verified(runAt(1, { 0, 0, 0 }, { 0, 0, 0 })));
  EXPECT_FALSE(verified(runAt(4294967295 * kSecond, { 0, 0, 0 }, { 0, 0, 0 })));
  EXPECT_FALSE(verified(runAt(1, { 0, 0, 0 }, { 0, 0, 0 })));
}

TEST_F(SequenceRegistrationTest, needsARegistration)
{
  SequenceRegistration none(phantom().centre());
  EXPECT_THROW(none.run(expose({ 0, 0, 0 }, { 0, 0, 0 }), std::nullopt, false), std::logic_error);
}
}  // namespace
}  // namespace xray_tracking
