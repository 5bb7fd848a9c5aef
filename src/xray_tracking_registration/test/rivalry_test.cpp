#include "rivalry.h"

#include <cmath>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
constexpr double kAsked = 0.95;

RigidTransform shifted(double mm)
{
  RigidTransform pose = RigidTransform::Identity();
  pose.translation().z() = mm;
  return pose;
}

/// Places along an axis, the start at 0.
class Rivalry : public testing::Test
{
protected:
  static Outcome place(double mm, double similarity)
  {
    Outcome outcome;
    outcome.poses.target = shifted(mm);
    outcome.similarity = similarity;
    outcome.probability = 0.99;
    return outcome;
  }

  double odds(const Outcome& outcome, const Outcome& rival)
  {
    RunControl control(request_, Eigen::Vector3d::Zero());
    return oddsOver(xray_tracking::Run{ request_, {}, control }, outcome, rivalFrom(rival));
  }

  std::vector<Rival> weigh(std::vector<Rival> rivals, Outcome& answer)
  {
    RunControl control(request_, Eigen::Vector3d::Zero());
    return weighRivals(xray_tracking::Run{ request_, {}, control }, box_, std::move(rivals), kAsked, answer);
  }

  bool isBelieved(double mm, double rival_mm, double share)
  {
    Outcome answer = place(mm, 0.6);
    weigh({ rivalFrom(place(rival_mm, share * 0.6)) }, answer);
    EXPECT_EQ(answer.doubt.empty(), answer.probability > 0.5) << answer.doubt;
    return answer.doubt.empty();
  }

  RegistrationRequest request_;
  const Eigen::AlignedBox3d box_{ Eigen::Vector3d::Constant(-20.0), Eigen::Vector3d::Constant(20.0) };
};
}  // namespace

TEST_F(Rivalry, WhatIsMoreAlikeOrNearerToTheStartIsMoreProbable)
{
  EXPECT_GT(odds(place(5.0, 0.6), place(-5.0, 0.5)), 0.0);
  EXPECT_GT(odds(place(2.0, 0.6), place(17.0, 0.6)), 0.0);
  EXPECT_GT(odds(place(2.0, 0.6), place(17.0, 0.62)), 0.0) << "hardly more alike";
  EXPECT_LT(odds(place(2.0, 0.6), place(17.0, 0.72)), 0.0) << "clearly more alike";
  EXPECT_NEAR(odds(place(2.0, 0.6), place(17.0, 0.5)), -odds(place(17.0, 0.5), place(2.0, 0.6)), 1e-9);
  EXPECT_TRUE(std::isfinite(odds(place(2.0, -0.1), place(17.0, 0.0))));
}

TEST_F(Rivalry, AnAnswerFartherFromTheStartThanItsRivalHasToBeMuchMoreAlike)
{
  EXPECT_TRUE(isBelieved(2.0, 17.0, 0.93));
  EXPECT_FALSE(isBelieved(17.0, 2.0, 0.93));
  EXPECT_TRUE(isBelieved(17.0, 2.0, 0.75));
  // As far off as the other: by the similarity alone.
  EXPECT_FALSE(isBelieved(8.5, -8.5, 0.93));
  EXPECT_TRUE(isBelieved(8.5, -8.5, 0.85));
}

TEST_F(Rivalry, AStartThatIsNotVerifiedMayBeAtTheWrongVertebra)
{
  EXPECT_FALSE(isBelieved(1.0, 20.0, 0.985));
  request_.start_verified = true;
  EXPECT_TRUE(isBelieved(1.0, 20.0, 0.985));
}

TEST_F(Rivalry, OfAWideSearchTheStartTellsNothing)
{
  request_.search = Search::WIDE;
  EXPECT_NEAR(odds(place(2.0, 0.6), place(40.0, 0.6)), 0.0, 1e-9);
}

TEST_F(Rivalry, RivalsAreSortedAndThoseThatAreTheAnswerLeftOut)
{
  Outcome answer = place(3.0, 0.6);
  const std::vector<Rival> rivals =
      weigh({ rivalFrom(place(20.0, 0.3)), rivalFrom(place(3.5, 0.6)), rivalFrom(place(-14.0, 0.4)) }, answer);
  ASSERT_EQ(rivals.size(), 2U);
  EXPECT_NEAR(rivals[0].distance_mm, 17.0, 1e-9);
  EXPECT_DOUBLE_EQ(rivals[0].similarity, 0.4);
  EXPECT_DOUBLE_EQ(rivals[1].similarity, 0.3);
  EXPECT_TRUE(answer.doubt.empty());
}
}  // namespace xray_tracking
