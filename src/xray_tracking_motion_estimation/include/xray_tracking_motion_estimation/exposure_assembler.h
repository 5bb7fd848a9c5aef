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
    const auto [entry, is_new] = pending_.try_emplace(stamp);
    auto& items = entry->second.items;
    if (is_new)
    {
      items.resize(views_);
      entry->second.number = ++number_;
    }
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
        // The one that came first, not the one of the lowest stamp: that may be the first after a backward jump.
        const auto first =
            std::min_element(pending_.begin(), pending_.end(),
                             [](const auto& a, const auto& b) { return a.second.number < b.second.number; });
        giveUp(first, std::next(first));
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
    for (std::optional<Item>& item : entry->second.items)
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

  struct Exposure
  {
    std::vector<std::optional<Item>> items;  ///< one a view
    std::uint64_t number = 0;                ///< order of arrival
  };
  using Pending = std::map<std::int64_t, Exposure>;
  void giveUp(typename Pending::iterator begin, typename Pending::iterator end)
  {
    incomplete_ += static_cast<std::size_t>(std::distance(begin, end));
    pending_.erase(begin, end);
  }

  std::size_t views_;
  std::size_t capacity_;
  Pending pending_;
  std::uint64_t number_ = 0;
  std::vector<Item> exposure_;
  std::optional<std::int64_t> last_;
  bool restarted_ = false;
  std::size_t incomplete_ = 0;
  std::size_t duplicates_ = 0;
  std::size_t late_ = 0;
};
}  // namespace xray_tracking
