#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <map>
#include <optional>
#include <utility>
#include <vector>

namespace xray_tracking
{
/// Puts together what the views of one exposure sent: items of exactly the same stamp. Exposures come out complete and
/// in the order of their stamps; whatever else arrives is counted.
///
/// A recording that starts again is recognised by a complete exposure more than a second older than the last one.
template <typename Item>
class ExposureAssembler
{
public:
  enum class Outcome
  {
    PENDING,   ///< other views' items are still to come
    COMPLETE,  ///< exposure() is what add() completed
    DUPLICATE,
    LATE  ///< the exposure is older than one that has been completed
  };

  /// @param capacity number of incomplete exposures kept, 1 or more
  ExposureAssembler(std::size_t views, std::size_t capacity) : views_(views), capacity_(capacity) {}

  /// @param stamp exposure time [ns]
  Outcome add(std::size_t view, std::int64_t stamp, Item item)
  {
    if (last_ && stamp == *last_)
    {
      ++duplicates_;
      return Outcome::DUPLICATE;
    }
    if (last_ && stamp < *last_ && stamp >= *last_ - kBackwardJump)
    {
      ++late_;
      return Outcome::LATE;
    }
    auto& items = pending_.emplace(stamp, std::vector<std::optional<Item>>(views_)).first->second;
    if (items[view])
    {
      ++duplicates_;
      return Outcome::DUPLICATE;
    }
    items[view] = std::move(item);
    if (!std::all_of(items.begin(), items.end(), [](const auto& i) { return i.has_value(); }))
    {
      if (pending_.size() > capacity_)
      {
        pending_.erase(pending_.begin());
        ++incomplete_;
      }
      return Outcome::PENDING;
    }
    complete(stamp);
    return Outcome::COMPLETE;
  }

  /// The items of the last complete exposure, one a view.
  const std::vector<Item>& exposure() const { return exposure_; }

  /// True if the last complete exposure is the first one after a backward jump of time.
  bool restarted() const { return restarted_; }

  std::size_t incomplete() const { return incomplete_; }  ///< exposures that were given up because a view is missing
  std::size_t duplicates() const { return duplicates_; }  ///< items
  std::size_t late() const { return late_; }              ///< items

private:
  static constexpr std::int64_t kBackwardJump = 1000000000;  // ns

  void complete(std::int64_t stamp)
  {
    const auto entry = pending_.find(stamp);
    exposure_.clear();
    for (std::optional<Item>& item : entry->second)
    {
      exposure_.push_back(std::move(*item));
    }
    restarted_ = last_ && stamp < *last_;
    if (restarted_)
    {
      // What is newer than the jump's start belongs to the time before it.
      giveUp(pending_.upper_bound(*last_), pending_.end());
    }
    giveUp(pending_.begin(), entry);
    pending_.erase(entry);
    last_ = stamp;
  }

  using Pending = std::map<std::int64_t, std::vector<std::optional<Item>>>;
  void giveUp(typename Pending::iterator begin, typename Pending::iterator end)
  {
    incomplete_ += static_cast<std::size_t>(std::distance(begin, end));
    pending_.erase(begin, end);
  }

  std::size_t views_;
  std::size_t capacity_;
  Pending pending_;
  std::vector<Item> exposure_;
  std::optional<std::int64_t> last_;
  bool restarted_ = false;
  std::size_t incomplete_ = 0;
  std::size_t duplicates_ = 0;
  std::size_t late_ = 0;
};
}  // namespace xray_tracking
