#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <optional>
#include <vector>

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <rviz/panel.h>
#include <xray_tracking_msgs/RenderViews.h>

#include "detector_pane.h"

class QComboBox;
class QBoxLayout;
class QHBoxLayout;
class QLabel;
class QPushButton;
class QSlider;
class QTimer;

namespace xray_tracking
{
/// All detectors' radiographs side by side, with what is tracked in them, and the CT at the present pose laid over
/// them; regions are drawn here.
///
/// The CT is rendered by the registration, asked at the rate of what is shown and only while that is wanted, one answer
/// at a time. What is then shown is the exposure that was rendered, never a rendering upon another exposure. While
/// somebody publishes `alignment_pose`, that is the pose.
class RadiographPanel : public rviz::Panel
{
  Q_OBJECT
public:
  explicit RadiographPanel(QWidget* parent = nullptr);
  ~RadiographPanel() override;

  void onInitialize() override;
  void load(const rviz::Config& config) override;
  void save(rviz::Config config) const override;

  /// The panes, in the order of the detectors' names.
  std::vector<DetectorPane*> panes() const;

protected:
  void resizeEvent(QResizeEvent* event) override;

private Q_SLOTS:
  void refresh();
  void setOverlay();
  void setInverted(bool inverted);
  void setResiduals(bool shown);
  void setAutomatic(bool automatic);
  void setEditing(bool editing);
  void windowSet();

private:
  using Poses = Recent<geometry_msgs::PoseWithCovarianceStamped>;

  /// A rendering that was asked for, or has come.
  struct Rendered
  {
    ros::Time stamp;                                 ///< of the pose
    std::map<std::string, ShownExposure> exposures;  ///< by detector
  };

  void buildTools(QHBoxLayout* tools);
  /// Side by side or one above the other, whichever shows them larger.
  void arrange();
  void followRoom();
  void addPane(const std::string& detector);
  void askForRendering();
  void takeRendering(const std::optional<xray_tracking_msgs::RenderViews::Response>& response, const std::string& why);
  /// Whether what was rendered last is of now.
  bool renderingIsLive() const;
  bool aligning() const;
  Overlay overlay() const;

  QComboBox* overlay_box_;
  QSlider* share_slider_;
  QPushButton* automatic_button_;
  QPushButton* inverted_button_;
  QPushButton* residuals_button_;
  QPushButton* region_button_;
  QLabel* rendering_label_;
  QLabel* empty_label_;
  QBoxLayout* panes_layout_;
  QTimer* timer_;
  std::vector<std::unique_ptr<DetectorPane>> panes_;
  std::map<std::string, GreyWindow> saved_windows_;  ///< of detectors that may still come

  ros::NodeHandle nh_;
  std::unique_ptr<RoomWatch> watch_;
  Room room_;
  Poses poses_{ 60 };
  geometry_msgs::PoseStampedConstPtr alignment_;
  std::chrono::steady_clock::time_point alignment_came_;
  std::vector<ros::Subscriber> subscribers_;
  std::optional<Rendered> asked_;
  Rendered rendered_;
  std::chrono::steady_clock::time_point asked_at_;
  std::string rendering_fault_;
  std::unique_ptr<ServiceCaller<xray_tracking_msgs::RenderViews>> renderer_;  ///< last: its answers use the others
};
}  // namespace xray_tracking
