#include "belief.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "message.h"

namespace xray_tracking
{
namespace
{
/// One term of log odds: weight * (transform(figure) - centre).
struct Term
{
  const char* name;
  double (*of)(const BeliefFigures& figures);
  double centre;
  double weight;
};

double stretched(double similarity)
{
  return std::atanh(std::clamp(similarity, -0.999, 0.999));
}

double ratioOf(const BeliefFigures& figures)
{
  return figures.here > 0.0 ? std::clamp((figures.here - figures.rival) / figures.here, -0.2, 0.4) : -0.2;
}

constexpr double kLeast = 1e-4;
/// docs/belief.md says on what these were learnt and judged; fit_belief.py prints them.
constexpr double kOffset = 1.01;
/// What results near a right start are more probable by than the figures of all starts say: learnt on starts within 5
/// mm and 3 degrees, rounded down from 1.2. A start that is verified is no worse.
constexpr double kNearVerified = 1.0;
const std::array<Term, 5> kTerms = { {
    { "expected error", [](const BeliefFigures& f) { return std::log(std::max(f.expected_error_mm, 0.1)); }, -0.563,
      -1.91 },
    { "similarity", [](const BeliefFigures& f) { return stretched(f.least_similarity); }, 0.62, 1.61 },
    { "views' disagreement", [](const BeliefFigures& f) { return std::log(std::max(f.pull_mm, 0.03)); }, -1.77,
      -0.333 },
    { "distinctness", [](const BeliefFigures& f) { return std::log(std::max(f.distinctness, 0.5)); }, 2, 1.34 },
    { "margin over other places", [](const BeliefFigures& f) { return ratioOf(f); }, 0.256, 4.21 },
} };
const Term kAside{ "similarity aside", [](const BeliefFigures& f) { return std::clamp(f.loss_aside, -0.05, 0.07); },
                   0.0104, 93.6 };

double logistic(double odds)
{
  return 1.0 / (1.0 + std::exp(-odds));
}

double oddsOf(const Term& term, const BeliefFigures& figures)
{
  return term.weight * (term.of(figures) - term.centre);
}

/// How probable it is that the place is right.
double atPlace(const BeliefFigures& figures, bool near_verified)
{
  double odds = kOffset + (near_verified ? kNearVerified : 0.0);
  for (const Term& term : kTerms)
  {
    odds += oddsOf(term, figures);
  }
  return logistic(odds);
}

/// How probable it is that the target is kept there, if the place is right.
double kept(const BeliefFigures& figures)
{
  return logistic(oddsOf(kAside, figures));
}

/// How probable it is that an error of the expected size, along one direction, stays below the limit.
double within(double expected_error_mm)
{
  return std::erf(kBelievedError / (std::sqrt(2.0) * std::max(expected_error_mm, 0.01)));
}
}  // namespace

double probabilityOf(const BeliefFigures& figures, bool near_verified)
{
  const double probability = within(figures.expected_error_mm) * atPlace(figures, near_verified) * kept(figures);
  // Neither 0 nor 1: nothing was learnt from so many that more could be said.
  return std::isfinite(probability) ? std::clamp(probability, kLeast, 1.0 - kLeast) : 0.0;
}

std::string mostDoubtful(const BeliefFigures& figures)
{
  if (kept(figures) < atPlace(figures, false))
  {
    return kAside.name;
  }
  return std::min_element(kTerms.begin(), kTerms.end(),
                          [&](const Term& a, const Term& b) { return oddsOf(a, figures) < oddsOf(b, figures); })
      ->name;
}
}  // namespace xray_tracking
