#include "xray_tracking_motion_estimation/pose_verification.h"

#include <cmath>
#include <limits>
#include <stdexcept>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
constexpr std::int64_t kMillisecond = 1000000;
constexpr std::int64_t kSecond = 1000 * kMillisecond;
constexpr std::int64_t kStart = 1700000000 * kSecond;

PoseVerificationOptions withRegistration()
{
  PoseVerificationOptions options;
  options.registration = true;
  return options;
}

bool says(const PoseVerification& verification, const std::string& words)
{
  return verification.fault().find(words) != std::string::npos;
}

TEST(PoseVerification, WithoutARegistrationOnlyAStatementHolds)
{
  PoseVerificationOptions options;
  PoseVerification unstated(options);
  EXPECT_FALSE(unstated.verified());
  EXPECT_FALSE(unstated.due()) << "nobody could be asked";
  EXPECT_TRUE(says(unstated, "no registration is asked"));

  options.initial_pose_verified = true;
  PoseVerification stated(options);
  for (int i = 0; i < 1000; ++i)
  {
    stated.update(kStart + 20 * i * kSecond, 20 * kSecond);
    EXPECT_TRUE(stated.verified()) << "the bounds do not apply";
    EXPECT_TRUE(stated.fault().empty());
  }
  stated.doubt("time went back");
  EXPECT_EQ(stated.fault(), "time went back");
  stated.doubt("something else");
  EXPECT_EQ(stated.fault(), "time went back") << "where the doubt began";
  stated.restart();
  EXPECT_TRUE(stated.verified());
}

TEST(PoseVerification, WithARegistrationAStatementCountsForNothing)
{
  PoseVerificationOptions options = withRegistration();
  options.initial_pose_verified = true;
  PoseVerification verification(options);
  EXPECT_FALSE(verification.verified());
  EXPECT_TRUE(verification.due());
  EXPECT_TRUE(says(verification, "no registration has confirmed the initial pose"));
  EXPECT_TRUE(says(verification, "has not answered"));
}

/// The time between the last confirmed exposure and the first one that is no longer verified, and how long before that
/// the registration is asked.
void expectHolds(std::int64_t interval, double seconds)
{
  PoseVerification verification(withRegistration());
  verification.update(kStart, interval);
  verification.confirm(kStart);
  for (int i = 0; i < 1000; ++i)
  {
    const double age = 1e-9 * static_cast<double>(i * interval);
    verification.update(kStart + i * interval, interval);
    EXPECT_EQ(verification.verified(), age < seconds + 1e-6) << interval << " ns, " << age << " s";
    EXPECT_EQ(verification.due(), age > 0.5 * seconds + 1e-6) << interval << " ns, " << age << " s";
    EXPECT_EQ(verification.fault().empty(), verification.verified());
  }
  EXPECT_TRUE(says(verification, "since the exposure at 1700000000.000 s")) << verification.fault();
}

// 0.5 s, or three intervals where these are longer.
TEST(PoseVerification, HoldsForTheLongerOfTwoBounds)
{
  expectHolds(33 * kMillisecond, 0.5);
  expectHolds(200 * kMillisecond, 0.6);
  expectHolds(1 * kSecond, 3.0);
  expectHolds(4 * kSecond, 12.0);
  expectHolds(20 * kSecond, 60.0);
}

TEST(PoseVerification, CountsFromTheConfirmedExposureAndNotFromTheAnswer)
{
  PoseVerification verification(withRegistration());
  verification.update(kStart + 5 * kSecond, 200 * kMillisecond);
  verification.confirm(kStart);  // about an exposure from 5 s ago
  EXPECT_FALSE(verification.verified());
  EXPECT_TRUE(says(verification, "5.000 s, expected at most 0.600 s")) << verification.fault();
  verification.confirm(kStart + 4 * kSecond + 500 * kMillisecond);
  EXPECT_TRUE(verification.verified());
}

TEST(PoseVerification, ARefusalByItselfTakesNothingBack)
{
  PoseVerification verification(withRegistration());
  verification.refuse("the optimum is flat", false);
  EXPECT_TRUE(says(verification, "1 refused since, the last one: the optimum is flat")) << verification.fault();
  verification.update(kStart, 200 * kMillisecond);
  verification.confirm(kStart);
  EXPECT_FALSE(verification.verified()) << "the first one after a refusal";
  EXPECT_TRUE(says(verification, "two in a row")) << verification.fault();
  EXPECT_TRUE(verification.due());
  verification.confirm(kStart);
  for (int i = 0; i < 7; ++i)
  {
    verification.refuse("the probability is 0.4", false);
    EXPECT_TRUE(verification.verified());
  }
  verification.update(kStart + 4 * kSecond, 200 * kMillisecond);
  EXPECT_FALSE(verification.verified());
  EXPECT_TRUE(says(verification, "7 refused since, the last one: the probability is 0.4")) << verification.fault();
}

TEST(PoseVerification, AContradictionTakesItBackUntilTheNextConfirmation)
{
  PoseVerification verification(withRegistration());
  verification.update(kStart, 200 * kMillisecond);
  verification.confirm(kStart);
  verification.refuse("the correction is 7 mm", true);
  EXPECT_FALSE(verification.verified());
  EXPECT_TRUE(verification.due());
  EXPECT_TRUE(says(verification, "contradict")) << verification.fault();
  EXPECT_TRUE(says(verification, "the correction is 7 mm")) << verification.fault();
  verification.confirm(kStart + 200 * kMillisecond);
  EXPECT_FALSE(verification.verified());
  verification.confirm(kStart + 400 * kMillisecond);
  EXPECT_TRUE(verification.verified());
  EXPECT_FALSE(verification.due());
}

// A registration that is asked about a wrong pose and believes it now and then.
TEST(PoseVerification, AcceptedOnesAmongRefusalsVerifyNothing)
{
  PoseVerification verification(withRegistration());
  for (int i = 0; i < 100; ++i)
  {
    const std::int64_t stamp = kStart + i * kSecond / 5;
    verification.update(stamp, kSecond / 5);
    if (i % 2 == 0)
    {
      verification.refuse("the probability is 0.4", false);
    }
    else
    {
      verification.confirm(stamp);
    }
    EXPECT_FALSE(verification.verified());
  }
}

TEST(PoseVerification, StampsAsFarApartAsTheyGoAreNoError)
{
  PoseVerification verification(withRegistration());
  verification.confirm(0);
  verification.update(4294967295 * kSecond, 500 * kMillisecond);  // the latest that ros::Time has
  EXPECT_FALSE(verification.verified());
}

TEST(PoseVerification, OptionsAreChecked)
{
  for (const double bad : { 0.0, -1.0, std::numeric_limits<double>::infinity(), std::nan("") })
  {
    PoseVerificationOptions options;
    options.max_unverified_time = bad;
    EXPECT_THROW(PoseVerification{ options }, std::invalid_argument) << bad;
    options = PoseVerificationOptions();
    options.max_unverified_exposures = bad;
    EXPECT_THROW(PoseVerification{ options }, std::invalid_argument) << bad;
  }
}
}  // namespace
}  // namespace xray_tracking
