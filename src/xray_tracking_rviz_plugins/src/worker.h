#pragma once

#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>

namespace xray_tracking
{
/// Runs a job in a thread of its own after it was woken. What is woken while the job runs makes it run once more, not
/// once for each: the newest is what counts.
class Worker
{
public:
  explicit Worker(std::function<void()> job) : job_(std::move(job)), thread_([this] { work(); }) {}
  /// Waits for the job that is under way.
  ~Worker()
  {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }

  Worker(const Worker&) = delete;
  Worker& operator=(const Worker&) = delete;

  /// From any thread; returns at once.
  void wake()
  {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      woken_ = true;
    }
    changed_.notify_all();
  }

private:
  void work()
  {
    std::unique_lock<std::mutex> lock(mutex_);
    while (true)
    {
      changed_.wait(lock, [this] { return woken_ || stop_; });
      if (stop_)
      {
        return;
      }
      woken_ = false;
      lock.unlock();
      job_();
      lock.lock();
    }
  }

  std::function<void()> job_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool woken_ = false;
  bool stop_ = false;
  std::thread thread_;  ///< last: it uses all the others
};
}  // namespace xray_tracking
