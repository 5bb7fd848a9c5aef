#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include <ros/callback_queue.h>
#include <ros/ros.h>

namespace xray_tracking
{
/// Calls a service from a thread of its own, over a connection that stays: one call at a time, which may take long. The
/// answer comes back as a callback of the node's own queue, so that nobody has to look for it. All methods return at
/// once and are to be called from that queue's thread.
template <typename Service>
class ServiceCaller
{
public:
  /// @param answer given the response, or none and why not
  using Answer = std::function<void(const std::optional<typename Service::Response>& response, const std::string& why)>;

  ServiceCaller(const ros::NodeHandle& nh, const std::string& name, Answer answered)
    : nh_(nh), name_(nh.resolveName(name)), answered_(std::move(answered)), thread_([this] { work(); })
  {
  }

  ~ServiceCaller() { shutdown(); }

  ServiceCaller(const ServiceCaller&) = delete;
  ServiceCaller& operator=(const ServiceCaller&) = delete;

  /// Breaks off and waits for what is under way, an answer that another thread is being given included; no calls and no
  /// answers from here on. Whose members the answer uses calls it before any of them goes, this one among them.
  void shutdown()
  {
    if (!thread_.joinable())
    {
      return;
    }
    {
      std::unique_lock<std::mutex> lock(mutex_);
      stop_ = true;
      wake_.notify_all();
      while (!ended_)
      {
        // Again and again: a call that begins just now opens the connection anew.
        client_.shutdown();
        wake_.wait_for(lock, std::chrono::milliseconds(10));
      }
    }
    thread_.join();
    queue()->removeByID(id());
  }

  /// @return false if an earlier call is still under way
  bool call(typename Service::Request request)
  {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (busy_ || stop_)
      {
        return false;
      }
      busy_ = true;
      cancelled_ = false;
      request_ = std::move(request);
    }
    wake_.notify_all();
    return true;
  }

  /// Breaks off the call under way, if there is one: its answer is none. To be repeated: a call that begins just then
  /// opens the connection anew.
  void cancel()
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (busy_)
    {
      cancelled_ = true;
      client_.shutdown();
    }
  }

private:
  class Callback : public ros::CallbackInterface
  {
  public:
    explicit Callback(std::function<void()> function) : function_(std::move(function)) {}
    CallResult call() override
    {
      function_();
      return Success;
    }

  private:
    std::function<void()> function_;
  };

  ros::CallbackQueueInterface* queue() const
  {
    return nh_.getCallbackQueue() != nullptr ? nh_.getCallbackQueue() : ros::getGlobalCallbackQueue();
  }
  std::uint64_t id() const { return reinterpret_cast<std::uint64_t>(this); }

  void work()
  {
    std::unique_lock<std::mutex> lock(mutex_);
    while (!stop_)
    {
      if (!request_)
      {
        wake_.wait(lock);
        continue;
      }
      Service message;
      message.request = std::move(*request_);
      request_.reset();
      const std::string why = attempt(message, lock);
      if (stop_)
      {
        break;
      }
      queue()->addCallback(
          boost::make_shared<Callback>([this, why, response = std::move(message.response)] { deliver(response, why); }),
          id());
    }
    ended_ = true;
    wake_.notify_all();
  }

  void deliver(const typename Service::Response& response, const std::string& why)
  {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      busy_ = false;
    }
    answered_(why.empty() ? std::optional<typename Service::Response>(response) : std::nullopt, why);
  }

  /// Unlocks while it waits. @return why there is no response; empty if there is
  std::string attempt(Service& message, std::unique_lock<std::mutex>& lock)
  {
    // A connection that was open may have ended with the node at its other side; a new one tells.
    for (bool kept = client_.isValid();; kept = false)
    {
      if (!kept)
      {
        lock.unlock();
        const bool exists = ros::service::exists(name_, false);
        // Persistent: shutdown() breaks off no other kind of call.
        ros::ServiceClient client = exists ? nh_.serviceClient<Service>(name_, true) : ros::ServiceClient();
        lock.lock();
        if (!exists)
        {
          return "there is no service " + name_;
        }
        client_ = client;
      }
      if (stop_ || cancelled_)
      {
        return "broken off";
      }
      ros::ServiceClient client = client_;
      lock.unlock();
      const bool done = client.call(message);
      lock.lock();
      if (done)
      {
        return std::string();
      }
      client_.shutdown();
      client_ = ros::ServiceClient();
      if (stop_ || cancelled_ || !kept)
      {
        return "the call of " + name_ + " failed or was broken off";
      }
    }
  }

  ros::NodeHandle nh_;
  std::string name_;
  Answer answered_;
  std::mutex mutex_;  ///< of all below
  std::condition_variable wake_;
  std::optional<typename Service::Request> request_;
  ros::ServiceClient client_;
  bool busy_ = false;
  bool cancelled_ = false;
  bool stop_ = false;
  bool ended_ = false;
  std::thread thread_;  ///< last: it uses all the others
};
}  // namespace xray_tracking
