#include "xray_tracking_core/sequence/stamp_policy.h"

#include <iomanip>
#include <sstream>

namespace xray_tracking
{
namespace
{
std::string seconds(std::int64_t nanoseconds)
{
  constexpr std::int64_t kPerSecond = 1000000000;
  std::ostringstream text;
  text << nanoseconds / kPerSecond << '.' << std::setw(9) << std::setfill('0') << nanoseconds % kPerSecond << " s";
  return text.str();
}
}  // namespace

StampPolicy::Verdict StampPolicy::take(std::int64_t stamp_ns, std::int64_t now_ns)
{
  stamp_ = stamp_ns;
  if (now_ns != 0 && stamp_ns - now_ns > options_.max_ahead)
  {
    compared_ = now_ns;
    return verdict_ = Verdict::FUTURE;
  }
  if (!last_ || stamp_ns > *last_)
  {
    return accept(stamp_ns, Verdict::ACCEPT);
  }
  compared_ = *last_;
  if (isRepeatedOrLate(stamp_ns, *last_) || !isRestart(stamp_ns, now_ns))
  {
    return verdict_ = Verdict::REPEATED_OR_LATE;
  }
  return accept(stamp_ns, Verdict::RESTART);
}

StampPolicy::Verdict StampPolicy::accept(std::int64_t stamp, Verdict verdict)
{
  last_ = stamp;
  older_.reset();
  return verdict_ = verdict;
}

bool StampPolicy::isRestart(std::int64_t stamp, std::int64_t now)
{
  if (options_.restart_confirmed == 0 || (now != 0 && *last_ - now > options_.max_ahead))
  {
    return true;  // the last one was not of the future when it came
  }
  if (!older_ || stamp <= older_->stamp)
  {
    older_ = Older{ stamp, now };
  }
  older_->stamp = stamp;
  return now - older_->since >= options_.restart_confirmed;
}

std::string StampPolicy::why() const
{
  switch (verdict_)
  {
    case Verdict::FUTURE:
      return "the stamp " + seconds(stamp_) + " is " + seconds(stamp_ - compared_) + " in the future, expected " +
             seconds(options_.max_ahead) + " at most (the clock is at " + seconds(compared_) + ")";
    case Verdict::REPEATED_OR_LATE:
      return "the stamp " + seconds(stamp_) + " is not newer than the last one, " + seconds(compared_);
    case Verdict::RESTART:
      return "time went back from " + seconds(compared_) + " to " + seconds(stamp_);
    default:
      return std::string();
  }
}
}  // namespace xray_tracking
