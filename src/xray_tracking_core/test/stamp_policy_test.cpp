#include "xray_tracking_core/sequence/stamp_policy.h"

#include <string>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
using Verdict = StampPolicy::Verdict;

constexpr std::int64_t kSecond = 1000000000;
constexpr std::int64_t kNow = 1700000000 * kSecond;
/// The last moment that a ros::Time can say.
constexpr std::int64_t kEnd = ((std::int64_t(1) << 32) - 1) * kSecond + 999999999;

TEST(StampPolicyTest, takesWhatIsNewer)
{
  StampPolicy policy;
  EXPECT_FALSE(policy.last());
  for (const std::int64_t stamp : { kNow - 1000, kNow - 999, kNow + kSecond })
  {
    EXPECT_EQ(Verdict::ACCEPT, policy.take(stamp, kNow));
    EXPECT_EQ(stamp, policy.last());
    EXPECT_EQ("", policy.why());
  }
}

TEST(StampPolicyTest, dropsWhatIsRepeatedOrLate)
{
  StampPolicy policy;
  policy.take(kNow, kNow);
  for (const std::int64_t stamp : { kNow, kNow - 1, kNow - kSecond })
  {
    EXPECT_EQ(Verdict::REPEATED_OR_LATE, policy.take(stamp, kNow));
    EXPECT_EQ(kNow, policy.last());
  }
  EXPECT_EQ("the stamp 1699999999.000000000 s is not newer than the last one, 1700000000.000000000 s", policy.why());
  EXPECT_EQ(Verdict::ACCEPT, policy.take(kNow + 1, kNow));
}

TEST(StampPolicyTest, dropsTheFutureSoThatNothingStartsOver)
{
  StampPolicy policy;
  policy.take(kNow, kNow);
  for (const std::int64_t stamp : { kNow + kSecond + 1, kNow + 3600 * kSecond, kEnd })
  {
    EXPECT_EQ(Verdict::FUTURE, policy.take(stamp, kNow));
    EXPECT_EQ(kNow, policy.last());
  }
  EXPECT_EQ(Verdict::ACCEPT, policy.take(kNow + 1, kNow));
  policy.take(kNow + 3600 * kSecond, kNow);
  EXPECT_EQ(
      "the stamp 1700003600.000000000 s is 3600.000000000 s in the future, expected 1.000000000 s at most (the "
      "clock is at 1700000000.000000000 s)",
      policy.why());
}

TEST(StampPolicyTest, startsOverWhereTimeGoesBack)
{
  StampPolicy policy;
  policy.take(kNow, kNow);
  EXPECT_EQ(Verdict::RESTART, policy.take(kNow - kSecond - 1, kNow));
  EXPECT_EQ(kNow - kSecond - 1, policy.last());
  EXPECT_EQ("time went back from 1700000000.000000000 s to 1699999998.999999999 s", policy.why());
  EXPECT_EQ(Verdict::ACCEPT, policy.take(kNow - kSecond, kNow)) << "the run goes on from there";
  // The clock with it, as of a bag that is played again: what is left of the run before is ahead of it.
  EXPECT_EQ(Verdict::FUTURE, policy.take(kNow, kNow - 100 * kSecond));
  EXPECT_EQ(Verdict::RESTART, policy.take(kNow - 100 * kSecond, kNow - 100 * kSecond));
}

TEST(StampPolicyTest, knowsNoFutureBeforeTheClockBegins)
{
  StampPolicy policy;
  EXPECT_EQ(Verdict::ACCEPT, policy.take(kNow, 0));
}

TEST(StampPolicyTest, comparesStampsThatAreAsFarApartAsTheyCanBe)
{
  StampPolicy policy;
  EXPECT_EQ(Verdict::ACCEPT, policy.take(0, 0));
  EXPECT_EQ(Verdict::ACCEPT, policy.take(kEnd, 0));
  EXPECT_EQ(Verdict::RESTART, policy.take(0, 0));
  EXPECT_EQ(Verdict::FUTURE, policy.take(kEnd, 1));
  EXPECT_EQ(Verdict::ACCEPT, policy.take(kEnd, kEnd));
}

TEST(StampPolicyTest, canBeStricterAboutTheFuture)
{
  StampPolicy policy(StampPolicy::Options{ 5, 0 });
  EXPECT_EQ(Verdict::ACCEPT, policy.take(kNow + 5, kNow));
  EXPECT_EQ(Verdict::FUTURE, policy.take(kNow + 7, kNow + 1));
  EXPECT_NE(std::string::npos, policy.why().find("expected 0.000000005 s at most")) << policy.why();
}

TEST(StampPolicyTest, canWantARestartConfirmed)
{
  StampPolicy policy(StampPolicy::Options{ kSecond, kSecond });
  const auto old = [&](std::int64_t tenths)
  { return policy.take(tenths * kSecond / 10, kNow + tenths * kSecond / 10); };
  EXPECT_EQ(Verdict::ACCEPT, policy.take(kNow, kNow));
  for (int i = 0; i < 10; ++i)
  {
    EXPECT_EQ(Verdict::REPEATED_OR_LATE, old(i)) << i;
  }
  // A single new one, and it was no restart after all.
  EXPECT_EQ(Verdict::ACCEPT, policy.take(kNow + kSecond, kNow + kSecond));
  for (int i = 11; i < 21; ++i)
  {
    EXPECT_EQ(Verdict::REPEATED_OR_LATE, old(i)) << i;
  }
  EXPECT_EQ(Verdict::RESTART, old(21));
  EXPECT_EQ(Verdict::ACCEPT, old(22));
  // The clock goes back with the stamps: nothing else to wait for.
  policy.take(kNow, kNow);
  EXPECT_EQ(Verdict::RESTART, policy.take(5 * kSecond, 5 * kSecond));
}

TEST(StampPolicyTest, forgetsWhenTold)
{
  StampPolicy policy;
  policy.take(kNow, kNow);
  policy.reset();
  EXPECT_EQ(Verdict::ACCEPT, policy.take(kNow - 5 * kSecond, kNow));
}
}  // namespace
}  // namespace xray_tracking
