#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <rviz/panel.h>
#include <std_srvs/SetBool.h>
#include <xray_tracking_msgs/PatientMotion.h>

#include "xray_tracking_conversions/service_caller.h"

class QLabel;
class QPushButton;
class QTimer;

namespace xray_tracking
{
/// How fast simulated time goes, by looking at it now and then.
class ClockRate
{
public:
  /// @param clock simulated, @param now monotonic [ns]
  void look(std::int64_t clock, std::int64_t now);
  /// Since the last look but some; 0 if it stands.
  double rate() const { return rate_; }
  bool runs() const { return rate_ > 0.0; }

private:
  std::int64_t clock_ = 0, now_ = 0;
  double rate_ = 0.0;
};

/// Pauses a bag's playback (`rosbag play`), goes on, and goes on to the next exposure. rosbag play neither goes back
/// nor changes its speed while it plays: the panel says so.
class PlaybackPanel : public rviz::Panel
{
  Q_OBJECT
public:
  explicit PlaybackPanel(QWidget* parent = nullptr);
  ~PlaybackPanel() override;

  void load(const rviz::Config& config) override;
  void save(rviz::Config config) const override;

protected:
  void onInitialize() override;

private:
  void connectTo(const QString& player);
  void tick();
  /// Asks the player; what was asked last counts. Locked.
  void pause(bool on);

  ros::CallbackQueue queue_;
  ros::NodeHandle nh_;
  std::unique_ptr<ros::AsyncSpinner> spinner_;
  std::unique_ptr<ServiceCaller<std_srvs::SetBool>> pauser_;
  ros::Subscriber motion_subscriber_;
  std::mutex mutex_;  ///< of the next three, and so that a step's pause is asked for after its going on
  bool stepping_ = false;
  std::optional<bool> asked_next_;  ///< while an earlier call is under way
  std::string fault_;               ///< of the last call

  QString player_ = "player";
  ClockRate clock_;
  QTimer* timer_;
  QPushButton *play_, *step_;
  QLabel *time_, *note_;
};
}  // namespace xray_tracking
