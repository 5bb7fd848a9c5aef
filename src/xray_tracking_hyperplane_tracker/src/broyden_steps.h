#pragma once

#include "warp.h"

namespace xray_tracking
{
/// Steps to where a predictor's answer A i is zero. The first is eq. (1)'s, m <- m - A i, which takes a unit slope for
/// granted; from then on the slope is what the steps have met (Broyden 1965, inverse form), because in an image that
/// has rotated, or in which parts move otherwise, it is another, and plain steps would circle around the answer.
class BroydenSteps
{
public:
  /// @param range what the predictor was trained on [px]; beyond it an answer has a direction but no size
  BroydenSteps(Eigen::Index parameters, float range) : range_(range)
  {
    step_.setZero(parameters);
    inverse_slope_.setIdentity(parameters, parameters);
  }

  const Parameters& next(const Parameters& answer)
  {
    const float length_before = step_.squaredNorm();
    if (length_before > 0.f)
    {
      const Parameters expected = inverse_slope_ * (answer - answer_);
      const float slope = step_.dot(expected) / length_before;
      const Parameters row = inverse_slope_.transpose() * step_;
      if (slope > kMinSlope)
      {
        inverse_slope_ += (step_ - expected) * row.transpose() / (slope * length_before);
      }
      else if (slope > 0.f)
      {
        inverse_slope_ += step_ * row.transpose() / length_before;  // steps twice as long, no more
      }
      else
      {
        // The noise has its own say between places so near; what it says about the slope is not worth keeping.
        inverse_slope_.setIdentity();
        inverse_slope_ *= 0.5f;
      }
    }
    answer_ = answer;
    step_.noalias() = -inverse_slope_ * answer;
    const float length = step_.norm();
    if (length > range_)
    {
      step_ *= range_ / length;
    }
    return step_;
  }

private:
  static constexpr float kMinSlope = 0.3f;

  float range_;
  Parameters answer_;
  Parameters step_;
  ParameterMatrix inverse_slope_;
};
}  // namespace xray_tracking
