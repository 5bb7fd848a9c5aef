#include "xray_tracking_motion_estimation/exposure_assembler.h"

#include <string>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
using Outcome = ExposureAssembler<std::string>::Outcome;
constexpr std::int64_t kSecond = 1000000000;

/// As the node's, with a clock that shows what a test sets, or a time after all stamps.
class Assembler : public ExposureAssembler<std::string>
{
public:
  Assembler(std::size_t views, std::size_t capacity, std::int64_t tolerance = 0, std::int64_t max_ahead = 0)
    : ExposureAssembler<std::string>(views, capacity, tolerance, { max_ahead, kSecond })
  {
  }
  Outcome add(std::size_t view, std::int64_t stamp, const std::string& item)
  {
    return ExposureAssembler<std::string>::add(view, stamp, item, now);
  }
  /// An exposure of two views.
  Outcome expose(std::int64_t stamp)
  {
    add(0, stamp, "");
    return add(1, stamp, "");
  }

  std::int64_t now = 1000 * kSecond;
};

TEST(ExposureAssembler, CompletesInAnyOrderOfViews)
{
  Assembler assembler(3, 10);
  EXPECT_EQ(assembler.add(2, 5, "c"), Outcome::PENDING);
  EXPECT_EQ(assembler.add(0, 5, "a"), Outcome::PENDING);
  EXPECT_EQ(assembler.add(1, 5, "b"), Outcome::COMPLETE);
  EXPECT_EQ(assembler.exposure(), (std::vector<std::string>{ "a", "b", "c" }));
  EXPECT_FALSE(assembler.restarted());
}

TEST(ExposureAssembler, PairsOnlyTheSameStamp)
{
  Assembler assembler(2, 10);
  assembler.add(0, 5, "a5");
  EXPECT_EQ(assembler.add(1, 6, "b6"), Outcome::PENDING);
  EXPECT_EQ(assembler.add(1, 5, "b5"), Outcome::COMPLETE);
  EXPECT_EQ(assembler.exposure(), (std::vector<std::string>{ "a5", "b5" }));
  EXPECT_EQ(assembler.add(0, 6, "a6"), Outcome::COMPLETE);
}

TEST(ExposureAssembler, CountsExposuresThatANewerOneOvertakes)
{
  Assembler assembler(2, 10);
  assembler.add(0, 1, "");
  assembler.add(1, 2, "");
  assembler.add(0, 3, "");
  assembler.add(1, 3, "");
  EXPECT_EQ(assembler.incomplete(), 2u);
  EXPECT_EQ(assembler.add(1, 1, ""), Outcome::LATE);
  EXPECT_EQ(assembler.late(), 1u);
}

TEST(ExposureAssembler, CountsDuplicates)
{
  Assembler assembler(2, 10);
  assembler.add(0, 1, "first");
  EXPECT_EQ(assembler.add(0, 1, "second"), Outcome::DUPLICATE);
  EXPECT_EQ(assembler.add(1, 1, ""), Outcome::COMPLETE);
  EXPECT_EQ(assembler.exposure()[0], "first");
  EXPECT_EQ(assembler.add(1, 1, ""), Outcome::DUPLICATE);
  EXPECT_EQ(assembler.duplicates(), 2u);
}

TEST(ExposureAssembler, IsBounded)
{
  Assembler assembler(2, 3);
  for (int stamp = 1; stamp <= 10; ++stamp)
  {
    assembler.add(0, stamp, "");
  }
  EXPECT_EQ(assembler.incomplete(), 7u);
  EXPECT_EQ(assembler.add(1, 8, ""), Outcome::COMPLETE);
  EXPECT_EQ(assembler.add(1, 10, ""), Outcome::COMPLETE);
  EXPECT_EQ(assembler.incomplete(), 8u);
}

TEST(ExposureAssembler, StartsAgainWhenTheClockGoesBack)
{
  Assembler assembler(2, 10);
  assembler.now = 11 * kSecond;
  assembler.expose(10 * kSecond);
  assembler.add(0, 11 * kSecond, "before the jump");
  // A second is still a late message, more is the start of another run, but only once all views have it.
  assembler.now = 4 * kSecond;
  EXPECT_EQ(assembler.add(0, 9 * kSecond, ""), Outcome::LATE);
  EXPECT_EQ(assembler.add(0, 2 * kSecond, ""), Outcome::PENDING);
  EXPECT_EQ(assembler.add(0, 3 * kSecond, "after the jump"), Outcome::PENDING);
  EXPECT_EQ(assembler.add(1, 2 * kSecond, ""), Outcome::COMPLETE);
  EXPECT_TRUE(assembler.restarted());
  EXPECT_EQ(assembler.add(1, 3 * kSecond, ""), Outcome::COMPLETE);
  EXPECT_FALSE(assembler.restarted());
  EXPECT_EQ(assembler.exposure()[0], "after the jump");
  assembler.now = 11 * kSecond;
  EXPECT_EQ(assembler.add(1, 11 * kSecond, ""), Outcome::PENDING);
}

// The clock goes on; exposures that were answered come once more, or for the first time, more than a second late.
TEST(ExposureAssembler, OldExposuresAreLateWhileNewOnesCome)
{
  Assembler assembler(2, 10);
  std::int64_t last = 0;
  std::size_t old_ones = 0;
  for (std::int64_t tenth = 0; tenth < 300; ++tenth)
  {
    assembler.now = 100 * kSecond + tenth * kSecond / 10;
    last = assembler.now;
    ASSERT_EQ(assembler.expose(last), Outcome::COMPLETE);
    ASSERT_FALSE(assembler.restarted());
    // One, and after a while bursts of them.
    for (std::int64_t i = 0; i < (tenth < 100 ? 1 : 20); ++i)
    {
      ASSERT_EQ(assembler.expose(last - 60 * kSecond + i * kSecond / 10), Outcome::LATE);
      ++old_ones;
    }
    ASSERT_EQ(assembler.stamp(), last);
  }
  EXPECT_EQ(assembler.late(), 2 * old_ones);
  EXPECT_EQ(assembler.incomplete(), 0u);
  EXPECT_EQ(assembler.pending(), 0u);
}

// Recorded exposures without their clock, played again.
TEST(ExposureAssembler, StartsAgainAfterASecondOfOldExposuresAlone)
{
  Assembler assembler(2, 10);
  assembler.expose(100 * kSecond);
  const std::int64_t start = assembler.now;
  int answered = 0;
  for (int tenth = 0; tenth < 20; ++tenth)
  {
    assembler.now = start + tenth * kSecond / 10;
    const Outcome outcome = assembler.expose(kSecond + tenth * kSecond / 10);
    EXPECT_EQ(outcome, tenth < 10 ? Outcome::LATE : Outcome::COMPLETE) << tenth;
    answered += outcome == Outcome::COMPLETE ? 1 : 0;
    EXPECT_EQ(assembler.restarted(), answered == 1) << tenth;
  }
}

TEST(ExposureAssembler, OldExposuresInDisorderAreNoRestart)
{
  Assembler assembler(2, 10);
  assembler.expose(100 * kSecond);
  for (int i = 0; i < 50; ++i)
  {
    assembler.now += kSecond / 10;
    EXPECT_EQ(assembler.expose((60 - i) * kSecond), Outcome::LATE);
  }
}

TEST(ExposureAssembler, RefusesExposuresOfTheFutureAndCountsNothingFromThem)
{
  Assembler assembler(2, 10, 0, 5);
  assembler.now = 100 * kSecond;
  EXPECT_EQ(assembler.expose(assembler.now + 5), Outcome::COMPLETE);
  assembler.now += kSecond;
  for (const std::int64_t ahead : { std::int64_t{ 6 }, kSecond, 1000000 * kSecond })
  {
    assembler.add(0, assembler.now + ahead, "future");
    EXPECT_EQ(assembler.add(1, assembler.now + ahead, ""), Outcome::FUTURE);
    EXPECT_EQ(assembler.stamp(), assembler.now + ahead);
    EXPECT_EQ(assembler.exposure()[0], "future");
    EXPECT_FALSE(assembler.restarted());
  }
  EXPECT_EQ(assembler.future(), 3u);
  // What is stamped right is neither late nor a restart, also if it waited for its other view meanwhile.
  assembler.add(0, assembler.now - 10, "");
  assembler.expose(assembler.now + kSecond);
  EXPECT_EQ(assembler.add(1, assembler.now - 10, ""), Outcome::COMPLETE);
  EXPECT_FALSE(assembler.restarted());
  EXPECT_EQ(assembler.stamp(), assembler.now - 10);
  EXPECT_EQ(assembler.expose(assembler.now), Outcome::COMPLETE);
  EXPECT_FALSE(assembler.restarted());
  EXPECT_EQ(assembler.late() + assembler.incomplete() + assembler.duplicates(), 0u);
}

// A view falls silent, the queue fills with what the other one sends, and the recording starts again.
TEST(ExposureAssembler, StartsAgainWithAFullQueue)
{
  for (const bool completed_before : { false, true })
  {
    Assembler assembler(2, 3);
    if (completed_before)
    {
      assembler.add(0, 10 * kSecond, "");
      assembler.add(1, 10 * kSecond, "");
    }
    for (int i = 1; i <= 10; ++i)
    {
      assembler.add(0, 10 * kSecond + i, "before the jump");
    }
    EXPECT_EQ(assembler.incomplete(), 7u);
    assembler.now = kSecond;
    EXPECT_EQ(assembler.add(0, kSecond, "a"), Outcome::PENDING);
    EXPECT_EQ(assembler.add(1, kSecond, "b"), Outcome::COMPLETE);
    EXPECT_EQ(assembler.exposure(), (std::vector<std::string>{ "a", "b" }));
    EXPECT_EQ(assembler.restarted(), completed_before);
  }
}

TEST(ExposureAssembler, AStrayOldMessageIsNoRestart)
{
  Assembler assembler(2, 10);
  assembler.add(0, 10 * kSecond, "");
  assembler.add(1, 10 * kSecond, "");
  EXPECT_EQ(assembler.add(0, kSecond, ""), Outcome::PENDING);
  assembler.add(0, 11 * kSecond, "");
  EXPECT_EQ(assembler.add(1, 11 * kSecond, ""), Outcome::COMPLETE);
  EXPECT_FALSE(assembler.restarted());
  EXPECT_EQ(assembler.incomplete(), 1u);
}

// One view's part of the new recording comes before the other's end of the old one.
TEST(ExposureAssembler, StartsAgainOneViewAfterTheOther)
{
  Assembler assembler(2, 10);
  assembler.add(0, 100 * kSecond, "");
  assembler.add(1, 100 * kSecond, "");
  assembler.add(0, 101 * kSecond, "");
  assembler.add(0, kSecond, "");
  EXPECT_EQ(assembler.add(1, 101 * kSecond, ""), Outcome::COMPLETE);
  EXPECT_FALSE(assembler.restarted());
  assembler.now = kSecond;
  EXPECT_EQ(assembler.add(1, kSecond, ""), Outcome::COMPLETE);
  EXPECT_TRUE(assembler.restarted());
  EXPECT_EQ(assembler.incomplete(), 0u);
}

TEST(ExposureAssembler, DoesNotWaitForAViewThatIsNotExpected)
{
  Assembler assembler(3, 10);
  assembler.expect(0, false);
  assembler.add(1, kSecond, "b1");
  EXPECT_EQ(assembler.add(2, kSecond, "c1"), Outcome::COMPLETE);
  EXPECT_EQ(assembler.exposure(), (std::vector<std::string>{ "", "b1", "c1" }));
  EXPECT_EQ(assembler.stamp(), kSecond);
  // It comes after all: for what has been completed it is too late, for the next one it is in time.
  EXPECT_EQ(assembler.add(0, kSecond, "a1"), Outcome::DUPLICATE);
  assembler.add(0, 2 * kSecond, "a2");
  assembler.add(1, 2 * kSecond, "b2");
  EXPECT_EQ(assembler.add(2, 2 * kSecond, "c2"), Outcome::COMPLETE);
  EXPECT_EQ(assembler.exposure(), (std::vector<std::string>{ "a2", "b2", "c2" }));
  assembler.expect(0, true);
  assembler.add(1, 3 * kSecond, "b3");
  EXPECT_EQ(assembler.add(2, 3 * kSecond, "c3"), Outcome::PENDING);
  EXPECT_EQ(assembler.add(0, 3 * kSecond, "a3"), Outcome::COMPLETE);
  EXPECT_FALSE(assembler.restarted());
}

TEST(ExposureAssembler, PairsWithinATolerance)
{
  Assembler assembler(2, 10, 4);
  assembler.add(1, 103, "b103");
  EXPECT_EQ(assembler.add(0, 108, "a108"), Outcome::PENDING);
  EXPECT_EQ(assembler.add(0, 100, "a100"), Outcome::COMPLETE);
  EXPECT_EQ(assembler.exposure(), (std::vector<std::string>{ "a100", "b103" }));
  EXPECT_EQ(assembler.stamp(), 100);
  EXPECT_EQ(assembler.offset(0), 0);
  EXPECT_EQ(assembler.offset(1), 3);
  EXPECT_EQ(assembler.add(1, 106, "b106"), Outcome::COMPLETE);
  EXPECT_EQ(assembler.stamp(), 108);
  EXPECT_EQ(assembler.offset(1), -2);
  EXPECT_EQ(assembler.add(1, 106, ""), Outcome::DUPLICATE);
  EXPECT_EQ(assembler.add(1, 104, ""), Outcome::LATE);
}

TEST(ExposureAssembler, PrefersTheNearestStamp)
{
  Assembler assembler(2, 10, 5);
  assembler.add(0, 100, "a100");
  assembler.add(0, 109, "a109");
  EXPECT_EQ(assembler.add(1, 105, "b105"), Outcome::COMPLETE);
  EXPECT_EQ(assembler.exposure()[0], "a109");
}

TEST(ExposureAssembler, HasNoToleranceUnlessAsked)
{
  Assembler assembler(2, 10);
  assembler.add(0, 100, "");
  EXPECT_EQ(assembler.add(1, 101, ""), Outcome::PENDING);
}
}  // namespace
}  // namespace xray_tracking
