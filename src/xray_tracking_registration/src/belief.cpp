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
  return figures.here > 0.0 ? std::clamp((figures.here - figures.rival) / figures.here, -1.0, 1.0) : -1.0;
}

/// docs/belief.md says on what these were learnt and judged.
constexpr double kLeast = 1e-4;
constexpr double kOffset = 0.0;
const std::array<Term, 6> kTerms = { {
    { "expected error", [](const BeliefFigures& f) { return std::log(std::max(f.expected_error_mm, 0.01)); }, -1.2,
      -4.0 },
    { "similarity", [](const BeliefFigures& f) { return stretched(f.least_similarity); }, 0.33, 12.0 },
    { "coarse similarity", [](const BeliefFigures& f) { return stretched(f.least_coarse_similarity); }, 0.4, 1.0 },
    { "views' disagreement", [](const BeliefFigures& f) { return std::log(std::max(f.pull_mm, 0.01)); }, -1.5, -0.5 },
    { "distinctness", [](const BeliefFigures& f) { return std::log(std::max(f.distinctness, 0.5)); }, 2.2, 4.0 },
    { "margin over other places", [](const BeliefFigures& f) { return ratioOf(f); }, 0.2, 2.0 },
} };
}  // namespace

double probabilityOf(const BeliefFigures& figures)
{
  double odds = kOffset;
  for (const Term& term : kTerms)
  {
    odds += term.weight * (term.of(figures) - term.centre);
  }
  // Neither 0 nor 1: nothing was learnt from so many that more could be said.
  const double probability = std::clamp(1.0 / (1.0 + std::exp(-odds)), kLeast, 1.0 - kLeast);
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
