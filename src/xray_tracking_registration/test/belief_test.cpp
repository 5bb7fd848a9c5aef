#include "belief.h"

#include <limits>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
/// Neither believed beyond doubt nor not at all, so that every figure counts.
BeliefFigures middling()
{
  BeliefFigures figures;
  figures.expected_error_mm = 0.5;
  figures.least_similarity = 0.35;
  figures.pull_mm = 0.2;
  figures.here = 0.5;
  figures.rival = 0.38;
  figures.distinctness = 8.0;
  figures.loss_aside = 0.05;
  return figures;
}
}  // namespace

TEST(Belief, EveryFigureSpeaksAsItsMeaningHasIt)
{
  const double probability = probabilityOf(middling());
  const auto changed = [](double BeliefFigures::*figure, double value)
  {
    BeliefFigures figures = middling();
    figures.*figure = value;
    return probabilityOf(figures);
  };
  EXPECT_GT(probabilityOf(middling(), true), probability);
  EXPECT_LT(changed(&BeliefFigures::expected_error_mm, 1.0), probability);
  EXPECT_LT(changed(&BeliefFigures::pull_mm, 1.0), probability);
  EXPECT_GT(changed(&BeliefFigures::least_similarity, 0.7), probability);
  EXPECT_GT(changed(&BeliefFigures::distinctness, 14.0), probability);
  EXPECT_LT(changed(&BeliefFigures::rival, 0.48), probability);
  EXPECT_LT(changed(&BeliefFigures::loss_aside, -0.01), probability);
}

TEST(Belief, NothingIsBelievedOfFiguresThatAreNotThere)
{
  EXPECT_LT(probabilityOf(BeliefFigures()), 0.5);
  for (double BeliefFigures::*figure : { &BeliefFigures::expected_error_mm, &BeliefFigures::least_similarity,
                                         &BeliefFigures::pull_mm, &BeliefFigures::distinctness,
                                         &BeliefFigures::loss_aside })
  {
    BeliefFigures figures = middling();
    figures.*figure = std::numeric_limits<double>::quiet_NaN();
    EXPECT_EQ(probabilityOf(figures), 0.0);
  }
}
}  // namespace xray_tracking
