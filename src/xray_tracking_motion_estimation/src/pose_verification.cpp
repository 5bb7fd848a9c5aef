#include "xray_tracking_motion_estimation/pose_verification.h"

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <sstream>

#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
void PoseVerificationOptions::validate() const
{
  requireOption(max_unverified_time > 0.0 && std::isfinite(max_unverified_time), "max_unverified_time",
                max_unverified_time, "a number > 0 s");
  requireOption(max_unverified_exposures >= 1.0 && std::isfinite(max_unverified_exposures), "max_unverified_exposures",
                max_unverified_exposures, "a number >= 1, in exposure intervals");
}

PoseVerification::PoseVerification(const PoseVerificationOptions& options) : options_(options)
{
  options_.validate();
  restart();
}

void PoseVerification::restart()
{
  confirmed_.reset();
  refusals_ = 0;
  refused_last_ = false;
  claimed_ = true;
  if (options_.registration)
  {
    doubt_ = "no registration has confirmed the initial pose";
  }
  else
  {
    doubt_ = options_.initial_pose_verified ? ""
                                            : "nothing has confirmed the initial pose: no registration is asked, and "
                                              "initial_pose_verified is false";
  }
}

void PoseVerification::doubt(const std::string& why)
{
  // The first of several is where it began.
  if (claimed_ || doubt_.empty())
  {
    doubt_ = why;
  }
  claimed_ = false;
}

void PoseVerification::update(std::int64_t stamp, std::int64_t interval)
{
  latest_ = stamp;
  interval_ = interval;
}

void PoseVerification::confirm(std::int64_t stamp)
{
  if (refused_last_)
  {
    refused_last_ = false;
    return;
  }
  confirmed_ = stamp;
  doubt_.clear();
  claimed_ = false;
  refusals_ = 0;
}

void PoseVerification::refuse(const std::string& why, bool contradicts)
{
  ++refusals_;
  refused_last_ = true;
  last_refusal_ = why;
  if (contradicts)
  {
    doubt("registration and tracks contradict each other");
  }
}

double PoseVerification::age() const
{
  return 1e-9 * static_cast<double>(latest_ - *confirmed_);
}

double PoseVerification::maxAge() const
{
  return std::max(options_.max_unverified_time,
                  1e-9 * options_.max_unverified_exposures * static_cast<double>(interval_));
}

bool PoseVerification::due() const
{
  return options_.registration && (!verified() || age() > 0.5 * maxAge());
}

std::string PoseVerification::fault() const
{
  if (verified())
  {
    return std::string();
  }
  std::ostringstream text;
  text << doubt_;
  if (doubt_.empty())
  {
    text << std::fixed << std::setprecision(3) << "no registration has confirmed the tracks since the exposure at "
         << 1e-9 * static_cast<double>(*confirmed_) << " s, for " << age() << " s, expected at most " << maxAge()
         << " s";
  }
  if (options_.registration && refusals_ == 0)
  {
    text << "; it has not answered since";
  }
  else if (options_.registration)
  {
    text << "; " << refusals_ << " refused since, the last one: " << last_refusal_
         << (refused_last_ ? "" : "; then one was accepted, and it takes two in a row");
  }
  return text.str();
}
}  // namespace xray_tracking
