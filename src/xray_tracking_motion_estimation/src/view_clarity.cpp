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
/// What is usual falls within so long, which is slower than what is moved in front of a patient [s], and rises by such
/// a share of the difference with each registration: what hid the target at first is soon told from it.
constexpr double kFalling = 60.0;
constexpr double kRising = 0.3;
}  // namespace

std::vector<double> ofViews(const std::vector<double>& figures, const std::vector<std::string>& compared,
                            const std::vector<std::string>& views)
{
  if (figures.size() != compared.size())
  {
    return {};
  }
  std::vector<double> result;
  for (const std::string& view : views)
  {
    const auto found = std::find(compared.begin(), compared.end(), view);
    result.push_back(found == compared.end() ? std::numeric_limits<double>::quiet_NaN()
                                             : figures[static_cast<std::size_t>(found - compared.begin())]);
  }
  return result;
}

void ViewClarity::takeUp(const std::vector<ViewSight>& sights, std::int64_t stamp)
{
  usual_.clear();
  hidden_.clear();
  for (const ViewSight& sight : sights)
  {
    usual_.push_back(sight.usual);
    hidden_.push_back(sight.hidden);
  }
  last_stamp_ = stamp;
}

void ViewClarity::restart()
{
  usual_.clear();
  hidden_.clear();
  last_stamp_.reset();
}

const std::vector<bool>& ViewClarity::hidden(const std::vector<double>& similarities, std::int64_t stamp)
{
  if (similarities.empty())
  {
    return hidden_;
  }
  const double elapsed = last_stamp_ ? std::max(0.0, 1e-9 * static_cast<double>(stamp - *last_stamp_)) : 0.0;
  last_stamp_ = stamp;
  usual_.resize(similarities.size());
  hidden_.resize(similarities.size(), false);
  for (std::size_t i = 0; i < similarities.size(); ++i)
  {
    const double similarity = similarities[i];
    if (!(std::abs(similarity) <= 1.0))
    {
      continue;
    }
    double& usual = usual_[i] ? *usual_[i] : usual_[i].emplace(similarity);
    hidden_[i] = usual > 0.0 && similarity < kLeast * usual;
    if (!hidden_[i])
    {
      usual += (similarity > usual ? kRising : 1.0 - std::exp(-elapsed / kFalling)) * (similarity - usual);
    }
  }
  return hidden_;
}
}  // namespace xray_tracking
