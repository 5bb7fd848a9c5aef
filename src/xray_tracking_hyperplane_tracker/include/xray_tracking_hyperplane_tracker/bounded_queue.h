#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <utility>

namespace xray_tracking
{
/// Hands items from one thread to another in order; when it is full, the oldest item is dropped and counted.
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
        ++dropped_;
      }
      items_.push_back(std::move(item));
    }
    changed_.notify_one();
  }

  /// Waits for the next item. @return nothing once the queue is closed
  std::optional<Item> pop()
  {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return closed_ || !items_.empty(); });
    if (closed_)
    {
      return std::nullopt;
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

  std::size_t dropped() const
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    return dropped_;
  }

private:
  const std::size_t capacity_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Item> items_;
  std::size_t dropped_ = 0;
  bool closed_ = false;
};
}  // namespace xray_tracking
