#include "belief.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "message.h"

namespace xray_tracking
{
namespace
{
/// One term of the log odds: weight * (transform(figure) - centre).
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
constexpr double kOffset = 0.272;
/// What results near a right start are more probable by than the figures of all starts say: learnt on starts within 5
/// mm and 3 degrees. A start that is verified is no worse.
constexpr double kNearVerified = 0.4;
const std::array<Term, 6> kTerms = { {
    { "expected error", [](const BeliefFigures& f) { return std::log(std::max(f.expected_error_mm, 0.1)); }, -0.542,
      -1.74 },
    { "similarity", [](const BeliefFigures& f) { return stretched(f.least_similarity); }, 0.576, 1.66 },
    { "views' disagreement", [](const BeliefFigures& f) { return std::log(std::max(f.pull_mm, 0.03)); }, -1.71, -0.36 },
    { "distinctness", [](const BeliefFigures& f) { return std::log(std::max(f.distinctness, 0.5)); }, 1.97, 0.881 },
    { "margin over other places", [](const BeliefFigures& f) { return ratioOf(f); }, 0.249, 4.8 },
    { "similarity aside", [](const BeliefFigures& f) { return std::clamp(f.loss_aside, -0.05, 0.1); }, 0.061, 14.1 },
} };

/// How probable it is that an error of the expected size, along one direction, stays below the limit.
double within(double expected_error_mm)
{
  return std::erf(kBelievedError / (std::sqrt(2.0) * std::max(expected_error_mm, 0.01)));
}
}  // namespace

double probabilityOf(const BeliefFigures& figures, bool near_verified)
{
  double odds = kOffset + (near_verified ? kNearVerified : 0.0);
  for (const Term& term : kTerms)
  {
    odds += term.weight * (term.of(figures) - term.centre);
  }
  // At the right place, and not too far off there. Neither 0 nor 1: nothing was learnt from so many that more could be
  // said.
  const double probability =
      std::clamp(within(figures.expected_error_mm) / (1.0 + std::exp(-odds)), kLeast, 1.0 - kLeast);
  return std::isfinite(odds) ? probability : 0.0;
}

std::string mostDoubtful(const BeliefFigures& figures)
{
  const Term& worst =
      *std::min_element(kTerms.begin(), kTerms.end(),
                        [&](const Term& a, const Term& b)
                        { return a.weight * (a.of(figures) - a.centre) < b.weight * (b.of(figures) - b.centre); });
  return worst.name;
}
}  // namespace xray_tracking
