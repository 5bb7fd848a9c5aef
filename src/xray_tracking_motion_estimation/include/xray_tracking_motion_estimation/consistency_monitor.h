#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <boost/circular_buffer.hpp>

#include "xray_tracking_motion_estimation/motion_estimator.h"

namespace xray_tracking
{
struct ConsistencyOptions
{
  /// Standard deviation of a track along either pixel axis that the tracker's own covariance does not know of and that
  /// is new in every exposure, at the target [mm], > 0.
  double floor_sigma = 0.135;

  /// Number of exposures whose residuals are averaged, >= 1. A disagreement that stays is found up to sqrt(window)
  /// times smaller than by one exposure alone, `window` exposures after it began.
  int window = 3;

  /// Probability that a good exposure is refused, in (0, 1).
  double significance = 0.002;

  /// Standard deviation of the part of a track's error that good exposures keep from one to the next, along either
  /// pixel axis, at the target [mm], >= 0: surroundings that move otherwise than the target. It does not average out,
  /// so it is the limit of what the window can find. 0 for a rigid phantom.
  double persistent_sigma = 0.135;

  /// @throws std::invalid_argument naming the key, its value and what was expected
  void validate() const;
};

struct ConsistencyReport
{
  bool consistent = true;
  double chi_square = 0.0;  ///< of the residuals averaged over the window
  double limit = 0.0;       ///< of chi_square, beyond which they are not consistent
  int degrees_of_freedom = 0;
  double disagreement = 0.0;  ///< averaged, RMS over the views [px]
  int exposures = 0;          ///< averaged over
};

/// For people.
std::string describe(const ConsistencyReport& report);

/// What one view says of an axis that others see too, checked over several exposures: averages the signed residuals of
/// the latest exposures and tests whether one motion of the target could still explain them.
class ConsistencyMonitor
{
public:
  /// @throws std::invalid_argument as the options' validate()
  explicit ConsistencyMonitor(const ConsistencyOptions& options);

  /// To be called with every estimate that is OK or INCONSISTENT, in the order of exposures. The window starts again
  /// when other views take part than in the exposure before. @throws std::invalid_argument for fewer than two views
  ConsistencyReport add(const MotionEstimate& estimate);

  /// After a new reference or a gap.
  void reset() { window_.clear(); }

private:
  using Residuals = decltype(MotionEstimate::residuals);

  ConsistencyOptions options_;
  boost::circular_buffer<Residuals> window_;
  std::vector<double> limits_;  ///< by degrees of freedom
};
}  // namespace xray_tracking
