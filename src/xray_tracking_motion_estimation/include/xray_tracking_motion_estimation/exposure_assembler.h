#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "xray_tracking_core/sequence/stamp_policy.h"

namespace xray_tracking
{
/// Puts together what the views of one exposure sent: items of the same stamp, or of stamps that differ by no more than
/// a tolerance. Exposures come out complete and in the order of their stamps; whatever else arrives is counted. A
/// view's own items are expected in the order of their stamps, the views relative to each other in any order.
///
/// Which stamps count, StampPolicy says: an exposure's, once it is complete.
///
/// Memory is allocated by the constructor only.
template <typename Item>
class ExposureAssembler
{
public:
  enum class Outcome
  {
    PENDING,   ///< other views' items are still to come
    COMPLETE,  ///< exposure() is what add() completed
    FUTURE,    ///< as COMPLETE, but stamped later than it can have been made; the ones that follow do not count from it
    DUPLICATE,
    LATE  ///< the exposure is older than one that has been completed
  };

  /// @param capacity number of incomplete exposures kept, 1 or more; what has waited longest gives way
  /// @param tolerance of stamps of one exposure [ns], less than half the time between exposures; 0: the same stamp
  ExposureAssembler(std::size_t views, std::size_t capacity, std::int64_t tolerance = 0,
                    const StampPolicy::Options& stamps = {})
    : views_(views),
      capacity_(capacity),
      tolerance_(tolerance),
      policy_(stamps),
      expected_(views, true),
      slots_(capacity + 1)
  {
    for (Slot& slot : slots_)
    {
      slot.items.resize(views);
      slot.stamps.resize(views);
    }
    exposure_.reserve(views);
    stamps_.resize(views);
    last_.reserve(views);
  }

  /// Whether exposures wait for this view, as they do at first. One that is not waited for and not there is an Item()
  /// in exposure().
  void expect(std::size_t view, bool expected) { expected_[view] = expected; }

  /// @param stamp exposure time [ns]
  /// @param now by the clock that stamps are of [ns]
  Outcome add(std::size_t view, std::int64_t stamp, Item item, std::int64_t now)
  {
    const bool repeated = !last_.empty() && stamp == last_[view];
    if (!repeated && !last_.empty() && StampPolicy::isRepeatedOrLate(stamp, last_[view]))
    {
      ++late_;
      return Outcome::LATE;
    }
    const auto waiting = slots_.begin() + static_cast<std::ptrdiff_t>(used_);
    const bool known = std::any_of(slots_.begin(), waiting,
                                   [&](const Slot& slot) { return slot.items[view] && slot.stamps[view] == stamp; });
    if (known || repeated)
    {
      ++duplicates_;
      return Outcome::DUPLICATE;
    }

    auto slot = waiting;
    for (auto candidate = slots_.begin(); candidate != waiting; ++candidate)
    {
      const std::int64_t apart = std::abs(candidate->stamp - stamp);
      if (!candidate->items[view] && apart <= tolerance_ && (slot == waiting || apart < std::abs(slot->stamp - stamp)))
      {
        slot = candidate;
      }
    }
    if (slot == waiting)
    {
      slot->stamp = stamp;
      ++used_;
    }
    slot->stamps[view] = stamp;
    slot->items[view] = std::move(item);
    if (isComplete(*slot))
    {
      return complete(slot, now);
    }
    if (used_ > capacity_)
    {
      incomplete_ += giveUp([&](const Slot& other) { return &other == &slots_.front(); });
    }
    return Outcome::PENDING;
  }

  /// The items of the last exposure that was COMPLETE or FUTURE, one a view.
  const std::vector<Item>& exposure() const { return exposure_; }

  /// That exposure's stamp: the first view's [ns].
  std::int64_t stamp() const { return stamps_.front(); }

  /// How much later than stamp() a view's item of it was exposed [ns].
  std::int64_t offset(std::size_t view) const { return stamps_[view] - stamps_.front(); }

  /// Why the last exposure was FUTURE, or restarted(), in words.
  std::string why() const { return policy_.why(); }

  /// True if the last complete exposure is the first one after a backward jump of time.
  bool restarted() const { return restarted_; }

  std::size_t pending() const { return used_; }           ///< incomplete exposures
  std::size_t incomplete() const { return incomplete_; }  ///< exposures that were given up because a view is missing
  std::size_t duplicates() const { return duplicates_; }  ///< items
  std::size_t late() const { return late_; }              ///< items
  std::size_t future() const { return future_; }          ///< exposures

private:
  struct Slot
  {
    std::int64_t stamp = 0;  ///< its first item's
    std::vector<std::int64_t> stamps;
    std::vector<std::optional<Item>> items;
  };
  using SlotIterator = typename std::vector<Slot>::iterator;

  bool isComplete(const Slot& slot) const
  {
    for (std::size_t view = 0; view < views_; ++view)
    {
      if (expected_[view] && !slot.items[view])
      {
        return false;
      }
    }
    return true;
  }

  Outcome complete(SlotIterator slot, std::int64_t now)
  {
    const Slot* const completed = &*slot;
    const std::int64_t begun = slot->stamp;
    const std::int64_t stamp = slot->items.front() ? slot->stamps.front() : begun;
    const StampPolicy::Verdict verdict = policy_.take(stamp, now);
    if (verdict == StampPolicy::Verdict::REPEATED_OR_LATE)
    {
      late_ += static_cast<std::size_t>(std::count_if(
          slot->items.begin(), slot->items.end(), [](const std::optional<Item>& item) { return item.has_value(); }));
      giveUp([&](const Slot& other) { return &other == completed; });
      return Outcome::LATE;
    }
    exposure_.clear();
    for (std::size_t view = 0; view < views_; ++view)
    {
      exposure_.push_back(slot->items[view] ? std::move(*slot->items[view]) : Item());
      stamps_[view] = slot->items[view] ? slot->stamps[view] : begun;
    }
    if (verdict == StampPolicy::Verdict::FUTURE)
    {
      ++future_;
      restarted_ = false;
      giveUp([&](const Slot& other) { return &other == completed; });
      return Outcome::FUTURE;
    }

    restarted_ = verdict == StampPolicy::Verdict::RESTART;
    // What began to wait before this exposure and is older was overtaken; what began later and is older belongs to a
    // recording that starts again. After such a start, what is newer than its end belongs to the time before it.
    incomplete_ += giveUp(
                       [&](const Slot& other)
                       {
                         return &other == completed || (&other < completed && other.stamp < begun) ||
                                (restarted_ && other.stamp > last_.front());
                       }) -
                   1;  // the completed one itself is none
    last_ = stamps_;
    return Outcome::COMPLETE;
  }

  /// @return how many
  template <typename Predicate>
  std::size_t giveUp(const Predicate& predicate)
  {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < used_; ++i)
    {
      if (predicate(slots_[i]))
      {
        std::fill(slots_[i].items.begin(), slots_[i].items.end(), std::nullopt);
      }
      else
      {
        std::swap(slots_[kept++], slots_[i]);
      }
    }
    return std::exchange(used_, kept) - kept;
  }

  std::size_t views_;
  std::size_t capacity_;
  std::int64_t tolerance_;
  StampPolicy policy_;  ///< of complete exposures
  std::vector<bool> expected_;
  std::vector<Slot> slots_;  ///< the first `used_` are in use, in the order in which they began to wait
  std::size_t used_ = 0;
  std::vector<Item> exposure_;
  std::vector<std::int64_t> stamps_;  ///< of exposure_
  std::vector<std::int64_t> last_;    ///< of the last complete exposure; empty before
  bool restarted_ = false;
  std::size_t incomplete_ = 0;
  std::size_t duplicates_ = 0;
  std::size_t late_ = 0;
  std::size_t future_ = 0;
};
}  // namespace xray_tracking
