#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <utility>

namespace xray_tracking
{
/// What a queue has dropped so far.
struct QueueDrops
{
  std::size_t full = 0;     ///< because the queue was
  std::size_t overdue = 0;  ///< because a newer one was there and the next in turn was overdue
};

/// Hands items from one thread to another in order. Dropped and counted are the oldest one when it is full, and, when
/// the taker is too slow, all but the newest.
template <typename Item>
class BoundedQueue
{
public:
  explicit BoundedQueue(std::size_t capacity) : capacity_(capacity) {}

  void push(Item item)
  {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (items_.size() >= capacity_)
      {
        items_.pop_front();
        ++drops_.full;
      }
      items_.push_back(std::move(item));
    }
    changed_.notify_one();
  }

  /// Waits for the next item, or the newest if the next one is overdue.
  /// @param overdue whether an item has waited for too long; of items behind one another the later ones are as well or
  ///        must give way to the newest
  /// @return nothing once the queue is closed
  template <typename Overdue>
  std::optional<Item> pop(const Overdue& overdue)
  {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return closed_ || !items_.empty(); });
    if (closed_)
    {
      return std::nullopt;
    }
    if (items_.size() > 1 && overdue(items_.front()))
    {
      drops_.overdue += items_.size() - 1;
      items_.erase(items_.begin(), items_.end() - 1);
    }
    std::optional<Item> item(std::move(items_.front()));
    items_.pop_front();
    return item;
  }

  void close()
  {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      closed_ = true;
    }
    changed_.notify_all();
  }

  QueueDrops drops() const
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    return drops_;
  }

private:
  const std::size_t capacity_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Item> items_;
  QueueDrops drops_;
  bool closed_ = false;
};
}  // namespace xray_tracking
