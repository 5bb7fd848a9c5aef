#include "xray_tracking_motion_estimation/exposure_assembler.h"

#include <string>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
using Assembler = ExposureAssembler<std::string>;
using Outcome = Assembler::Outcome;
constexpr std::int64_t kSecond = 1000000000;

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

TEST(ExposureAssembler, StartsAgainAfterABackwardJump)
{
  Assembler assembler(2, 10);
  assembler.add(0, 10 * kSecond, "");
  assembler.add(1, 10 * kSecond, "");
  assembler.add(0, 11 * kSecond, "before the jump");
  // A second is still a late message, more is the start of another run, but only once all views have it.
  EXPECT_EQ(assembler.add(0, 9 * kSecond, ""), Outcome::LATE);
  EXPECT_EQ(assembler.add(0, 2 * kSecond, ""), Outcome::PENDING);
  EXPECT_EQ(assembler.add(0, 3 * kSecond, "after the jump"), Outcome::PENDING);
  EXPECT_EQ(assembler.add(1, 2 * kSecond, ""), Outcome::COMPLETE);
  EXPECT_TRUE(assembler.restarted());
  EXPECT_EQ(assembler.add(1, 3 * kSecond, ""), Outcome::COMPLETE);
  EXPECT_FALSE(assembler.restarted());
  EXPECT_EQ(assembler.exposure()[0], "after the jump");
  EXPECT_EQ(assembler.add(1, 11 * kSecond, ""), Outcome::PENDING);
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
