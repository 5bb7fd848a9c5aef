#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <string>

#include <boost/math/distributions/students_t.hpp>

#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
double quantile(std::vector<double> values, double q)
{
  if (values.empty() || std::any_of(values.begin(), values.end(), [](double value) { return std::isnan(value); }))
  {
    throw std::invalid_argument("quantile: expected one or more values, none of them NaN");
  }
  if (!(q >= 0.0 && q <= 1.0))
  {
    throw std::invalid_argument("quantile: q is " + std::to_string(q) + ": expected 0 to 1");
  }
  std::sort(values.begin(), values.end());
  const double position = q * (values.size() - 1);
  const std::size_t below = static_cast<std::size_t>(position);
  const std::size_t above = std::min(below + 1, values.size() - 1);
  return values[below] + (position - below) * (values[above] - values[below]);
}

PairedTTest pairedTTest(const std::vector<double>& a, const std::vector<double>& b)
{
  if (a.size() != b.size() || a.size() < 2)
  {
    throw std::invalid_argument("paired t-test: " + std::to_string(a.size()) + " and " + std::to_string(b.size()) +
                                " values: expected two or more pairs");
  }
  std::vector<double> differences(a.size());
  std::transform(a.begin(), a.end(), b.begin(), differences.begin(), std::minus<>());
  const double n = static_cast<double>(differences.size());
  const double mean = std::accumulate(differences.begin(), differences.end(), 0.0) / n;
  if (!std::isfinite(mean))
  {
    throw std::invalid_argument("paired t-test: expected finite values");
  }
  const double squares = std::accumulate(differences.begin(), differences.end(), 0.0,
                                         [mean](double sum, double difference)
                                         { return sum + (difference - mean) * (difference - mean); });
  const double standard_error = std::sqrt(squares / (n - 1.0) / n);

  PairedTTest result;
  result.n = static_cast<int>(differences.size());
  if (standard_error > 0.0)
  {
    result.t = mean / standard_error;
    const boost::math::students_t distribution(n - 1.0);
    result.p = 2.0 * boost::math::cdf(boost::math::complement(distribution, std::abs(result.t)));
  }
  else if (mean != 0.0)
  {
    result.t = std::copysign(std::numeric_limits<double>::infinity(), mean);
    result.p = 0.0;
  }
  return result;
}
}  // namespace xray_tracking
