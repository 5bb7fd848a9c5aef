#pragma once

#include <chrono>
#include <future>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

#include <xray_tracking_msgs/TrainRegion.h>

#include "xray_tracking_hyperplane_tracker/view_tracker.h"

namespace xray_tracking
{
/// What to learn and where its asker waits for the answer.
struct TrainingRequest
{
  Training training;
  std::promise<xray_tracking_msgs::TrainRegion::Response> response;
};

/// Where a service call leaves its request for the thread that learns, one at a time.
class TrainingMailbox
{
public:
  using Response = xray_tracking_msgs::TrainRegion::Response;

  static Response makeResponse(std::uint8_t status, const std::string& message)
  {
    Response response;
    response.status = status;
    response.message = message;
    return response;
  }

  /// Leaves a request and waits: for as long as the training takes, but no longer than `timeout` [s] for its beginning.
  Response ask(const Training& training, double timeout)
  {
    const auto mine = std::make_shared<TrainingRequest>();
    mine->training = training;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (closed_ || asked_)
      {
        return closed_ ? makeResponse(Response::NO_IMAGE, "the tracker is shutting down")
                       : makeResponse(Response::BUSY, "another training is going on");
      }
      waiting_ = mine;
      asked_ = true;
    }
    std::future<Response> answer = mine->response.get_future();
    if (answer.wait_for(std::chrono::duration<double>(timeout)) != std::future_status::ready)
    {
      refuse(mine, "no exposure within " + std::to_string(timeout) + " s");
    }
    Response response = answer.get();
    const std::lock_guard<std::mutex> lock(mutex_);
    asked_ = false;
    return response;
  }

  /// The request that waits, if any; who takes it must answer.
  std::shared_ptr<TrainingRequest> take()
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    return std::exchange(waiting_, nullptr);
  }

  /// From now on nobody takes requests.
  void close()
  {
    std::shared_ptr<TrainingRequest> left;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      closed_ = true;
      left = waiting_;
    }
    refuse(left, "the tracker is shutting down");
  }

private:
  /// Answers a request unless it has been taken.
  void refuse(const std::shared_ptr<TrainingRequest>& request, const std::string& message)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (request && waiting_ == request)
    {
      waiting_.reset();
      request->response.set_value(makeResponse(Response::NO_IMAGE, message));
    }
  }

  std::mutex mutex_;
  std::shared_ptr<TrainingRequest> waiting_;
  bool asked_ = false;  ///< from a request to its answer
  bool closed_ = false;
};
}  // namespace xray_tracking
