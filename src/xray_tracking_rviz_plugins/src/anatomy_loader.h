#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "anatomy.h"

namespace xray_tracking
{
/// Makes anatomy in a thread of its own, the newest that was asked for.
class AnatomyLoader
{
public:
  /// @param folder of the cache
  explicit AnatomyLoader(std::string folder) : folder_(std::move(folder)) {}
  /// Breaks off; waits for a CT that is being read.
  ~AnatomyLoader() { stop(); }

  AnatomyLoader(const AnatomyLoader&) = delete;
  AnatomyLoader& operator=(const AnatomyLoader&) = delete;

  /// Returns at once unless busy().
  void load(const AnatomySource& source)
  {
    stop();
    stop_ = false;
    done_ = false;
    fault_.clear();
    thread_ = std::thread(
        [this, source]
        {
          std::shared_ptr<const Anatomy> made;
          std::string fault;
          try
          {
            made = std::make_shared<const Anatomy>(cachedAnatomy(source, folder_, stop_));
            made = stop_ ? nullptr : made;
          }
          catch (const std::exception& error)
          {
            fault = error.what();
          }
          const std::lock_guard<std::mutex> lock(mutex_);
          made_ = made;
          fault_ = fault;
          done_ = true;
        });
  }

  /// What is under way is to end soon, with nothing.
  void cancel() { stop_ = true; }

  bool busy() const { return thread_.joinable() && !done_; }
  /// What has been made since the last call, once; null if there is nothing new.
  std::shared_ptr<const Anatomy> take()
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    return std::move(made_);
  }
  std::string fault() const
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    return fault_;
  }

private:
  void stop()
  {
    stop_ = true;
    if (thread_.joinable())
    {
      thread_.join();
    }
  }

  std::string folder_;
  std::atomic<bool> stop_{ false };
  std::atomic<bool> done_{ false };
  mutable std::mutex mutex_;
  std::shared_ptr<const Anatomy> made_;
  std::string fault_;
  std::thread thread_;
};
}  // namespace xray_tracking
