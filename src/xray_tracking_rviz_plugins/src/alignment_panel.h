#pragma once

#include <array>
#include <chrono>
#include <memory>
#include <optional>

#include <rviz/panel.h>

#include "alignment.h"
#include "room_watch.h"

class QComboBox;
class QKeyEvent;
class QLabel;
class QPushButton;
class QTimer;

namespace rviz
{
class Tool;
}

namespace xray_tracking
{
class AlignmentLink;
class AlignmentMarker;

/// The CT is laid over the radiographs by hand, from the patient's pose on, or, where none is known, from the setup's
/// initial pose: by arrows and rings in the scene, by buttons and by keys. Then motion estimation is asked to have the
/// registration go on from there, and to take the patient to be where that finds it. Until then, and if it is cancelled
/// or refused, nothing but the pictures changes, and those only while the panel is seen that says so.
class AlignmentPanel : public rviz::Panel
{
  Q_OBJECT
public:
  explicit AlignmentPanel(QWidget* parent = nullptr);
  ~AlignmentPanel() override;

  void load(const rviz::Config& config) override;
  void save(rviz::Config config) const override;

protected:
  void onInitialize() override;
  /// Keys that nothing else in the window takes.
  bool eventFilter(QObject* watched, QEvent* event) override;
  void keyPressEvent(QKeyEvent* event) override;

private:
  QWidget* makeSteps();
  QWidget* makeAxes();
  void begin();
  void makeMarker();
  void end(const QString& message, const QColor& colour);
  void tick();
  void showRoom();
  void showOffset();
  void takeAnswer();
  void say(const QString& text, const QColor& colour);
  /// @param sign of one step along or about the axis, or a fraction of one
  void step(int axis, bool turn, double sign);
  bool handleKey(const QKeyEvent& event);
  void moved(bool by_mouse);

  QTimer* timer_;
  QPushButton *align_, *back_, *register_;
  QComboBox *shift_step_, *turn_step_;
  std::array<QLabel*, 3> shifts_{}, turns_{};
  QLabel *total_, *message_;
  std::vector<QWidget*> controls_;  ///< which work only while something is aligned

  std::unique_ptr<RoomWatch> watch_;
  Room room_;
  std::unique_ptr<AlignmentLink> link_;
  std::optional<Alignment> alignment_;       ///< while it is done
  std::optional<Alignment> asked_from_;      ///< where it was when the registration was asked last
  std::unique_ptr<AlignmentMarker> marker_;  ///< while, besides, the panel is seen: nothing moves without it
  rviz::Tool* tool_before_ = nullptr;
  bool lasting_message_ = false;  ///< of how the last alignment has ended
  std::chrono::steady_clock::time_point last_tick_, last_shown_;
};
}  // namespace xray_tracking
