#pragma once

#include <vector>

#include "contestant.h"

namespace xray_tracking
{
/// Exposures with known truth. The first one is what the template is learnt from.
struct KnownSequence
{
  BenchmarkView view;
  std::vector<BenchmarkFrame> frames;
  std::vector<Eigen::Vector2d> displacements;  ///< of the region, since the first exposure [px]
};

/// How a contestant did. Times are processor time.
struct FollowScore
{
  double training_ms = 0.0;  ///< median
  double median_us = 0.0;    ///< an exposure
  double rmse = 0.0;         ///< of the exposures that are not lost [px], both directions together; NaN if all are
  int lost = 0;              ///< the contestant says so, or it errs by more than `lost_error`
};

/// For every sequence: learns the first exposure and follows the others in order; after a lost one the search starts
/// again at the template's place.
FollowScore follow(Contestant& contestant, const std::vector<KnownSequence>& sequences, double lost_error);
}  // namespace xray_tracking
