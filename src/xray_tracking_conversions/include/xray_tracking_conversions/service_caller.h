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
#include <ros/connection.h>
#include <ros/ros.h>
#include <ros/service_manager.h>
#include <ros/service_server_link.h>

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
        const ros::ConnectionPtr connection = connectionToDrop();
        lock.unlock();
        drop(connection);
        lock.lock();
        wake_.wait_for(lock, std::chrono::milliseconds(10), [this] { return ended_; });
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
      asked_ = ros::SteadyTime::now();
      request_ = std::move(request);
    }
    wake_.notify_all();
    return true;
  }

  /// Breaks off the call under way, if there is one that has taken longer: its answer is none. To be repeated, as a
  /// call that has only just begun is left alone.
  void cancelAfter(const ros::WallDuration& time)
  {
    ros::ConnectionPtr connection;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (!busy_ || (!cancelled_ && ros::SteadyTime::now() - asked_ <= time))
      {
        return;
      }
      cancelled_ = true;
      connection = connectionToDrop();
    }
    drop(connection);
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
    close();
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

  /// Of a call that can be broken off; null if there is none. A link drops what it has queued when its connection is
  /// dropped, but between a look at the connection and the queue it would wait for ever: so not before it surely waits.
  ros::ConnectionPtr connectionToDrop() const
  {
    constexpr double kSurelyWaits = 0.1;  // [s]
    return calling_ && (ros::SteadyTime::now() - calling_since_).toSec() > kSurelyWaits ? link_->getConnection()
                                                                                        : ros::ConnectionPtr();
  }

  /// As roscpp does from another thread when it shuts down. Unlocked: it waits for the call's end.
  static void drop(const ros::ConnectionPtr& connection)
  {
    if (connection)
    {
      connection->drop(ros::Connection::Destructing);
    }
  }

  /// Unlocks while it waits. @return why there is no response; empty if there is
  std::string attempt(Service& message, std::unique_lock<std::mutex>& lock)
  {
    const ros::SerializedMessage request = ros::serialization::serializeMessage(message.request);
    // A connection that was open may have ended with the node at its other side; a new one tells.
    for (bool kept = link_ && link_->isValid();; kept = false)
    {
      if (!kept)
      {
        lock.unlock();
        const std::string md5 = ros::service_traits::md5sum<Service>();
        const ros::ServiceServerLinkPtr link =
            ros::ServiceManager::instance()->createServiceServerLink(name_, true, md5, md5, ros::M_string());
        lock.lock();
        link_ = link;
        if (!link)
        {
          return "there is no service " + name_;
        }
      }
      if (stop_ || cancelled_)
      {
        return "broken off";
      }
      calling_ = true;
      calling_since_ = ros::SteadyTime::now();
      const ros::ServiceServerLinkPtr link = link_;
      lock.unlock();
      ros::SerializedMessage response;
      const bool done = link->call(request, response);
      lock.lock();
      calling_ = false;
      if (done)
      {
        ros::serialization::deserializeMessage(response, message.response);
        return std::string();
      }
      close();
      if (stop_ || cancelled_ || !kept)
      {
        return "the call of " + name_ + " failed or was broken off";
      }
    }
  }

  /// Nothing is called.
  void close()
  {
    if (link_)
    {
      link_->getConnection()->drop(ros::Connection::Destructing);
      link_.reset();
    }
  }

  ros::NodeHandle nh_;
  std::string name_;
  Answer answered_;
  std::mutex mutex_;  ///< of all below
  std::condition_variable wake_;
  std::optional<typename Service::Request> request_;
  /// What a persistent ros::ServiceClient has inside. Its shutdown() may not be called beside its call(): both touch
  /// the same pointer to the link.
  ros::ServiceServerLinkPtr link_;
  bool calling_ = false;  ///< the thread is in the link's call(), or just before or behind it
  ros::SteadyTime calling_since_;
  ros::SteadyTime asked_;  ///< when the call was asked for
  bool busy_ = false;
  bool cancelled_ = false;
  bool stop_ = false;
  bool ended_ = false;
  std::thread thread_;  ///< last: it uses all the others
};
}  // namespace xray_tracking
