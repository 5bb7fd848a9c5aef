#include "xray_tracking_motion_estimation/view_clarity.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

namespace xray_tracking
{
namespace
{
/// Of the usual similarity: rods of 5 to 50 px in a region of 89 px leave 0.1 to 0.25 of it (phantom, on which this was
/// chosen), finer or coarser images 0.8.
constexpr double kLeast = 0.5;
/// Of the difference, in each registration: slower than anything passes.
constexpr double kAdapting = 0.02;
}  // namespace

std::vector<double> oneAView(const std::vector<double>& compared, const std::vector<bool>& without)
{
  const auto count = static_cast<std::size_t>(std::count(without.begin(), without.end(), false));
  std::vector<double> figures;
  for (std::size_t i = 0, next = 0; compared.size() == count && i < without.size(); ++i)
  {
    figures.push_back(without[i] ? std::numeric_limits<double>::quiet_NaN() : compared[next++]);
  }
  return figures;
}

std::vector<bool> ViewClarity::hidden(const std::vector<double>& similarities)
{
  usual_.resize(similarities.size());
  std::vector<bool> result(similarities.size(), false);
  for (std::size_t i = 0; i < similarities.size(); ++i)
  {
    if (!std::isfinite(similarities[i]))
    {
      continue;
    }
    double& usual = usual_[i] ? *usual_[i] : usual_[i].emplace(similarities[i]);
    result[i] = similarities[i] < kLeast * usual;
    if (!result[i])
    {
      usual += kAdapting * (similarities[i] - usual);
    }
  }
  return result;
}
}  // namespace xray_tracking
