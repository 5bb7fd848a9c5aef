#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>

#include <QWidget>

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <tf2_ros/buffer.h>
#include <xray_tracking_msgs/TrainRegion.h>

#include "radiograph_feed.h"
#include "radiograph_view.h"
#include "room_watch.h"
#include "xray_tracking_conversions/service_caller.h"

class QLabel;
class QPushButton;
class QSpinBox;

namespace xray_tracking
{
/// One exposure as a detector has it, with the pose that is drawn into it.
struct ShownExposure
{
  sensor_msgs::ImageConstPtr image;
  std::optional<RigidTransform> room_from_patient;
  std::shared_ptr<const Rendering> rendering;  ///< at that pose; may be null
};

/// One detector in the panel: its radiograph and, while regions are edited, what is asked of its tracker.
class DetectorPane : public QWidget
{
  Q_OBJECT
public:
  DetectorPane(const ros::NodeHandle& nh, const std::string& detector, QWidget* parent = nullptr);
  ~DetectorPane() override;

  const std::string& detector() const { return feed_->detector(); }
  RadiographView& view() { return *view_; }
  RadiographFeed& feed() { return *feed_; }

  /// Shows the newest exposure that is complete.
  /// @param poses of the patient, by the exposures' stamps
  /// @param rendered shown instead, unless newer images have come for a while and it is still of an earlier one; null:
  /// none
  /// @return whether `rendered` is shown
  bool refresh(const Room& room, tf2_ros::Buffer& transforms,
               const Recent<geometry_msgs::PoseWithCovarianceStamped>& poses, const ShownExposure* rendered);
  void setEditing(bool editing);

private Q_SLOTS:
  void train();
  void undo();
  void takeFields();
  void showFields();
  void showReadOut();

private:
  void buildRegionRow();
  void proposeRegion();
  void ask(const cv::Rect& region);
  void answered(const std::optional<xray_tracking_msgs::TrainRegion::Response>& response, const std::string& why);
  void say(const QString& text, const QColor& colour);
  std::optional<ProjectionGeometry> geometryOf(const RadiographFeed::Messages& messages, tf2_ros::Buffer& transforms,
                                               QString& fault) const;

  RadiographView* view_;
  QWidget* region_row_;
  QSpinBox* fields_[4];  ///< x, y, width, height
  QPushButton* train_button_;
  QPushButton* undo_button_;
  QLabel* message_;

  std::optional<ProjectionGeometry> geometry_;
  std::shared_ptr<const TreatmentSetup> setup_;
  xray_tracking_msgs::TrackedRegionConstPtr region_;  ///< the newest
  std::optional<cv::Rect> before_;                    ///< what was tracked before the last training
  std::optional<cv::Rect> asked_;                     ///< under way
  std::optional<cv::Rect> replaced_;                  ///< by what is under way
  std::chrono::steady_clock::time_point asked_at_;

  ros::NodeHandle nh_;
  std::unique_ptr<RadiographFeed> feed_;
  std::unique_ptr<ServiceCaller<xray_tracking_msgs::TrainRegion>> trainer_;  ///< last: its answers use all the others
};
}  // namespace xray_tracking
