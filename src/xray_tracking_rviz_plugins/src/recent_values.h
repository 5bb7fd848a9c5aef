#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <deque>

namespace xray_tracking
{
/// Values of the last while, oldest first. Numbers that are none are gaps. Times are of a clock that never goes back.
template <typename Value>
class RecentValues
{
public:
  struct Entry
  {
    std::int64_t time;  ///< [ns]
    Value value;
  };

  /// @param span kept [ns]; @param most entries, the oldest give way
  RecentValues(std::int64_t span, std::size_t most) : span_(span), most_(most) {}

  void add(std::int64_t time, const Value& value)
  {
    entries_.push_back({ time, value });
    forget(time);
  }

  /// Keeps one entry from before the span: what was so when it began.
  void forget(std::int64_t now)
  {
    while (entries_.size() > most_ || (entries_.size() > 1 && entries_[1].time < now - span_))
    {
      entries_.pop_front();
    }
  }

  void clear() { entries_.clear(); }
  const std::deque<Entry>& entries() const { return entries_; }
  std::int64_t span() const { return span_; }

private:
  std::int64_t span_;
  std::size_t most_;
  std::deque<Entry> entries_;
};
}  // namespace xray_tracking
