#pragma once

#include <array>
#include <memory>

#include <rviz/panel.h>

#include "treatment_link.h"

class QLabel;
class QPushButton;
class QTimer;

namespace xray_tracking
{
class BagRecorder;
class GateBanner;
class StripChart;
class ToleranceBars;

/// The gate, what it rests on, and what an operator does about it: hold the beam, train, refine, reset, load a CT,
/// record. While it lives, is not hidden, and no modal dialog is open, its heartbeat on `operator_present` says that
/// the operator can hold the beam; when it is closed, hangs or dies, motion estimation holds it.
class TreatmentPanel : public rviz::Panel
{
  Q_OBJECT
public:
  explicit TreatmentPanel(QWidget* parent = nullptr);
  ~TreatmentPanel() override;

  void load(const rviz::Config& config) override;
  void save(rviz::Config config) const override;
  QSize sizeHint() const override { return { 430, 940 }; }

protected:
  void onInitialize() override;

private:
  QWidget* makeStatus();
  QWidget* makeButtons();
  void tick();
  void showStatus(const TreatmentView& view);
  void showCommands(const TreatmentView& view);
  /// Whether a dialog of ours is open, which is brought to the front.
  bool asking();
  void chooseCt();
  void confirmReset();
  void toggleRecording();

  std::unique_ptr<TreatmentLink> link_;
  QTimer* timer_;
  int ticks_ = 0;
  int steady_ticks_ = 0;        ///< in a row that came in time
  std::int64_t last_tick_ = 0;  ///< monotonic clock [ns]
  GateBanner* banner_;
  ToleranceBars* bars_;
  std::array<StripChart*, kQuantities> charts_{};
  QLabel *pose_, *trackers_, *registration_, *exposure_, *message_;
  QPushButton *hold_, *release_, *train_, *refine_, *reset_, *load_, *record_;
  BagRecorder* recorder_;
  QString ct_folder_;
  QString last_message_;                     ///< of the recorder
  std::array<std::string, kCommands> said_;  ///< of the commands
  std::size_t newest_ = kCommands;           ///< which of them has said something last; their number: the recorder
};
}  // namespace xray_tracking
