#include "treatment_link.h"

#include <chrono>

#include <std_msgs/Header.h>

namespace xray_tracking
{
namespace
{
ros::NodeHandle withQueue(ros::NodeHandle nh, ros::CallbackQueue& queue)
{
  nh.setCallbackQueue(&queue);
  return nh;
}
}  // namespace

TreatmentLink::TreatmentLink(const ros::NodeHandle& nh)
  : nh_(withQueue(nh, queue_)),
    commands_(nh_, [this] { return feed_.pose(); }),
    feed_(nh_, [this](const xray_tracking_msgs::BeamGate& gate) { commands_.gateSaid(gate); }),
    heartbeat_(nh_.advertise<std_msgs::Header>("operator_present", 1)),
    spinner_(std::make_unique<ros::AsyncSpinner>(1, &queue_))
{
  spinner_->start();
  watcher_ = std::thread([this] { watch(); });
}

TreatmentLink::~TreatmentLink()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  stopping_.notify_all();
  watcher_.join();
  spinner_->stop();
}

TreatmentView TreatmentLink::view() const
{
  TreatmentView view;
  feed_.show(view);
  view.registration = commands_.registrationIsThere();
  view.commands = commands_.states();
  if (ros::Time::isSimTime() && ros::Time::now().isZero())
  {
    view.frozen_clock = "simulated time, but nothing on /clock: start the playback, or set /use_sim_time to false";
  }
  return view;
}

void TreatmentLink::watch()
{
  std::unique_lock<std::mutex> lock(mutex_);
  while (!stop_)
  {
    lock.unlock();
    for (const std::string& detector : feed_.look())
    {
      commands_.addTracker(detector);
    }
    commands_.look();
    lock.lock();
    stopping_.wait_for(lock, std::chrono::seconds(1), [this] { return stop_; });
  }
}

void TreatmentLink::beat(bool shown)
{
  feed_.noteLight();
  if (!commands_.holdIsConfirmed())
  {
    return;
  }
  if (shown)
  {
    std_msgs::Header header;
    header.stamp = ros::Time::now();
    header.frame_id = ros::this_node::getName();
    heartbeat_.publish(header);
  }
  commands_.refineAgain();
}
}  // namespace xray_tracking
