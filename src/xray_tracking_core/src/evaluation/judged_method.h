#pragma once

#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
/// A method's frames with their errors, ready to be written or summed up.
struct JudgedMethod
{
  std::string name;
  std::vector<FrameResult> frames;  ///< status OK only with a finite rigid pose
  std::vector<double> tre_mm;       ///< one for each frame, NaN where there is none
};

/// Checks an evaluation and judges its methods, `uncorrected` first. @throws std::invalid_argument, see summarize()
std::vector<JudgedMethod> judgeMethods(const Evaluation& evaluation);

/// Figures for reports, in which NaN stands for "not known".
inline double quantileOrNan(const std::vector<double>& values, double q)
{
  return values.empty() ? std::numeric_limits<double>::quiet_NaN() : quantile(values, q);
}

inline double meanOrNan(const std::vector<double>& values)
{
  return values.empty() ? std::numeric_limits<double>::quiet_NaN()
                        : std::accumulate(values.begin(), values.end(), 0.0) / values.size();
}
}  // namespace xray_tracking
