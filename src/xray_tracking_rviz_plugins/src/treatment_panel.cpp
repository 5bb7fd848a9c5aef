#include "treatment_panel.h"

#include <algorithm>

#include <QApplication>
#include <QDir>
#include <QFileDialog>
#include <QFileInfo>
#include <QGridLayout>
#include <QLabel>
#include <QMessageBox>
#include <QPushButton>
#include <QTimer>
#include <QVBoxLayout>
#include <pluginlib/class_list_macros.hpp>

#include "bag_recorder.h"
#include "look.h"
#include "seen.h"
#include "treatment_widgets.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::PatientMotion;
using xray_tracking_msgs::RefinementResult;
using xray_tracking_msgs::TrackedRegion;

constexpr int kTick = 100;  ///< [ms]
constexpr std::int64_t kMillisecond = 1000000;
/// Ticks in time, one after the other, before the first heartbeat: a window that is still being built stops for
/// seconds, which would hold the beam.
constexpr int kSteady = 10;
constexpr std::int64_t kOld = 2000 * kMillisecond;  ///< what was said longer ago is told as old

QString coloured(const QString& text, const QColor& colour)
{
  return "<span style='color:" + colour.name() + "'>" + text.toHtmlEscaped() + "</span>";
}

QString quiet(const QString& text)
{
  return coloured(text, look::kQuiet);
}

QString seconds(double value)
{
  return QString::number(value, 'f', value < 10.0 ? 2 : 0) + " s";
}

QString trackerText(const TrackerView& tracker, std::int64_t now)
{
  static const char* const kStates[] = { "untrained", "training", "tracking", "lost", "degraded", "blind" };
  const QString name = QString::fromStdString(tracker.detector) + "  ";
  if (tracker.arrival == 0 || now - tracker.arrival > kOld)
  {
    return quiet(name) + coloured(tracker.arrival == 0 ? "nothing so far" : "silent", look::kQuiet);
  }
  const QColor colour = tracker.state == TrackedRegion::TRACKING   ? look::kGood
                        : tracker.state == TrackedRegion::DEGRADED ? look::kWarning
                        : tracker.state == TrackedRegion::TRAINING ? look::kAccent
                                                                   : look::kBad;
  QString text = quiet(name) + coloured(tracker.state < 6 ? kStates[tracker.state] : "unknown state", colour);
  if (tracker.state == TrackedRegion::TRACKING || tracker.state == TrackedRegion::DEGRADED)
  {
    text += quiet("  correlation " + QString::number(tracker.correlation, 'f', 3));
  }
  return tracker.fault.empty() ? text : text + quiet("  " + QString::fromStdString(tracker.fault));
}

QString registrationText(const TreatmentView& view, std::int64_t now)
{
  if (!view.refined || now - view.refined_arrival > 5 * kOld)
  {
    return view.registration ? quiet("running, not asked") : coloured("not running", look::kQuiet);
  }
  const RefinementResult& result = view.refined->result;
  const QString figures = "  " + QString::number(result.probability, 'f', 2) + " probable, " +
                          QString::number(1e3 * result.time.toSec(), 'f', 0) + " ms";
  if (result.status == RefinementResult::SUCCESS)
  {
    return coloured("believed", look::kGood) + quiet(figures);
  }
  return coloured("not believed", look::kWarning) + quiet("  " + QString::fromStdString(result.reason));
}

QString poseText(const TreatmentView& view, std::int64_t now)
{
  static const char* const kStates[] = { "measured",     "waiting",           "lost",        "views contradict",
                                         "no reference", "stamped in future", "unregistered" };
  if (!view.motion)
  {
    return coloured("nothing on patient_motion", look::kQuiet);
  }
  if (now - view.motion_arrival > kOld)
  {
    return coloured("no exposures any more", look::kQuiet);
  }
  const PatientMotion& motion = *view.motion;
  if (motion.state != PatientMotion::OK)
  {
    return coloured(motion.state < 7 ? kStates[motion.state] : "unknown state", look::kBad) +
           quiet("  " + QString::fromStdString(motion.reason));
  }
  if (motion.source == PatientMotion::REGISTERED)
  {
    return coloured("registered with the CT", look::kGood);
  }
  return coloured("tracked", look::kAccent) +
         quiet("  not registered: " + QString::fromStdString(motion.not_registered));
}
}  // namespace

TreatmentPanel::TreatmentPanel(QWidget* parent)
  : rviz::Panel(parent), timer_(new QTimer(this)), banner_(new GateBanner(this)), bars_(new ToleranceBars(this))
{
  setAttribute(Qt::WA_StyledBackground);
  setStyleSheet(look::styleSheet() +
                "QLabel#quiet { color: #8b97a5; }"
                "QPushButton#hold { background: #8a2722; border: 2px solid #ff5c5c; color: white; font-size: 20px;"
                "  font-weight: bold; padding: 12px; }"
                "QPushButton#hold:hover { background: #a9332d; }"
                "QPushButton#release { font-size: 16px; padding: 12px; }"
                "QPushButton#release:enabled { border: 2px solid #ffb946; color: #ffb946; }"
                "QPushButton#record:checked { background: #8a2722; border-color: #ff5c5c; }");
  auto* layout = new QVBoxLayout(this);
  layout->setContentsMargins(8, 8, 8, 8);
  layout->setSpacing(6);
  layout->addWidget(banner_);

  hold_ = new QPushButton("HOLD BEAM", this);
  hold_->setObjectName("hold");
  hold_->setToolTip("Closes the gate at once, until it is released");
  release_ = new QPushButton("Release", this);
  release_->setObjectName("release");
  release_->setEnabled(false);
  auto* beam = new QHBoxLayout;
  beam->addWidget(hold_, 3);
  beam->addWidget(release_, 1);
  layout->addLayout(beam);
  layout->addWidget(bars_);

  const std::array<std::tuple<const char*, const char*, int>, kQuantities> quantities{ { { "Displacement", "mm", 2 },
                                                                                         { "Rotation", "°", 1 },
                                                                                         { "Uncertainty", "mm", 2 },
                                                                                         { "Views' disagreement", "px",
                                                                                           2 },
                                                                                         { "Similarity", "", 2 },
                                                                                         { "Latency", "ms", 0 } } };
  auto* charts = new QVBoxLayout;
  charts->setSpacing(2);
  for (std::size_t i = 0; i < kQuantities; ++i)
  {
    const auto& [name, unit, decimals] = quantities[i];
    charts_[i] = new StripChart(QString::fromUtf8(name), QString::fromUtf8(unit), decimals, this);
    charts->addWidget(charts_[i]);
  }
  layout->addLayout(charts, 1);
  layout->addWidget(makeStatus());
  layout->addWidget(makeButtons());
  message_ = new QLabel(this);
  message_->setObjectName("quiet");
  message_->setWordWrap(true);
  message_->setFixedHeight(72);  // four lines: what it says must not move the buttons
  message_->setAlignment(Qt::AlignTop | Qt::AlignLeft);
  layout->addWidget(message_);
  connect(timer_, &QTimer::timeout, this, &TreatmentPanel::tick);
}

TreatmentPanel::~TreatmentPanel() = default;

QWidget* TreatmentPanel::makeStatus()
{
  auto* box = new QWidget(this);
  auto* grid = new QGridLayout(box);
  grid->setContentsMargins(2, 2, 2, 2);
  grid->setVerticalSpacing(3);
  grid->setColumnStretch(1, 1);
  int row = 0;
  const auto line = [&](const char* name)
  {
    auto* title = new QLabel(name, box);
    title->setObjectName("quiet");
    title->setMinimumWidth(82);
    title->setAlignment(Qt::AlignTop);
    auto* value = new QLabel(box);
    value->setTextFormat(Qt::RichText);
    value->setWordWrap(true);
    value->setSizePolicy(QSizePolicy::Ignored, QSizePolicy::Preferred);
    grid->addWidget(title, row, 0);
    grid->addWidget(value, row++, 1);
    return value;
  };
  pose_ = line("Pose");
  exposure_ = line("Exposures");
  trackers_ = line("Trackers");
  registration_ = line("Registration");
  return box;
}

QWidget* TreatmentPanel::makeButtons()
{
  auto* box = new QWidget(this);
  auto* grid = new QGridLayout(box);
  grid->setContentsMargins(0, 0, 0, 0);
  grid->setSpacing(6);
  int count = 0;
  const auto button = [&](const char* text, const char* name, const char* tip)
  {
    auto* made = new QPushButton(text, box);
    made->setObjectName(name);
    made->setToolTip(tip);
    made->setProperty("tip", tip);
    grid->addWidget(made, count / 3, count % 3);
    ++count;
    return made;
  };
  refine_ = button("Refine now", "refine", "Registers the latest exposure with the CT");
  train_ = button("Train", "train", "Every tracker learns its template again from the next exposure; references stay");
  reset_ = button("Reset", "reset", "Starts over: you state that the patient is at the setup's initial pose");
  load_ = button("Load CT ...", "load", "Another CT for the registration");
  record_ = button("Record", "record", "Records the run into a bag of its own");
  record_->setCheckable(true);
  for (QPushButton* asks : { refine_, train_, reset_, load_ })
  {
    asks->setEnabled(false);  // until somebody is found who can be asked
  }
  return box;
}

void TreatmentPanel::onInitialize()
{
  const ros::NodeHandle nh;
  link_ = std::make_unique<TreatmentLink>(nh);
  const QString prefix = QString::fromStdString(nh.resolveName("x")).chopped(1);
  recorder_ = new BagRecorder(recordedTopics(prefix), this);
  connect(hold_, &QPushButton::clicked, this, [this] { link_->commands().hold(true); });
  connect(release_, &QPushButton::clicked, this, [this] { link_->commands().hold(false); });
  connect(train_, &QPushButton::clicked, this, [this] { link_->commands().train(); });
  connect(refine_, &QPushButton::clicked, this,
          [this]
          {
            link_->view().commands[static_cast<std::size_t>(Command::REFINE)].busy
                ? link_->commands().cancelRefinement()
                : link_->commands().refine();
          });
  connect(reset_, &QPushButton::clicked, this, &TreatmentPanel::confirmReset);
  connect(load_, &QPushButton::clicked, this, &TreatmentPanel::chooseCt);
  connect(record_, &QPushButton::clicked, this, &TreatmentPanel::toggleRecording);
  connect(recorder_, &BagRecorder::changed, this,
          [this]
          {
            record_->setChecked(recorder_->recording());
            record_->setText(recorder_->recording() ? "Stop recording" : "Record");
            newest_ = kCommands;
            last_message_ = !recorder_->fault().isEmpty() ? recorder_->fault()
                            : recorder_->recording()      ? "recording into " + recorder_->file()
                                                          : "recorded " + recorder_->file();
          });
  timer_->start(kTick);
}

void TreatmentPanel::tick()
{
  const std::int64_t now = steadyNanoseconds();
  if (steady_ticks_ < kSteady)
  {
    steady_ticks_ = now - last_tick_ < 3 * kTick * kMillisecond ? steady_ticks_ + 1 : 0;
  }
  last_tick_ = now;
  if (steady_ticks_ >= kSteady)
  {
    // A modal dialog of whomever keeps the operator from the button.
    link_->beat(isSeen(*this) && QApplication::activeModalWidget() == nullptr);
  }
  const TreatmentView view = link_->view();
  banner_->display(view.gate_view);
  bars_->display(view);  // as often: both have figures of the same thing
  release_->setEnabled(view.gate_view.light == GateLight::HELD);
  if (++ticks_ % 3 == 0)
  {
    showStatus(view);
    showCommands(view);
    const TreatmentFeed::Charts charts = link_->feed().charts();
    const TreatmentFeed::Lights lights = link_->feed().lights();
    const std::array<std::optional<double>, kQuantities> tolerances{ view.max_displacement, view.max_rotation,
                                                                     view.max_sigma,        std::nullopt,
                                                                     std::nullopt,          std::nullopt };
    for (std::size_t i = 0; i < kQuantities; ++i)
    {
      charts_[i]->display(charts[i], lights, tolerances[i], now);
    }
  }
}

void TreatmentPanel::showStatus(const TreatmentView& view)
{
  const std::int64_t now = steadyNanoseconds();
  pose_->setText(poseText(view, now));
  if (!view.frozen_clock.empty())
  {
    exposure_->setText(coloured(QString::fromStdString(view.frozen_clock), look::kWarning));
  }
  else if (view.exposure_age)
  {
    exposure_->setText(
        coloured("last one " + seconds(*view.exposure_age) + " ago", view.stale ? look::kBad : look::kText) +
        quiet("  " + QString::number(view.rate, 'f', 1) + " a second"));
  }
  else
  {
    exposure_->setText(coloured("none so far", look::kQuiet) + quiet("  start a detector, the simulator or a bag"));
  }
  QStringList lines;
  for (const TrackerView& tracker : view.trackers)
  {
    lines << trackerText(tracker, now);
  }
  trackers_->setText(lines.isEmpty() ? coloured("none is running", look::kQuiet) : lines.join("<br>"));
  registration_->setText(registrationText(view, now));
}

void TreatmentPanel::showCommands(const TreatmentView& view)
{
  const auto state = [&](Command which) -> const CommandState&
  { return view.commands[static_cast<std::size_t>(which)]; };
  const auto show = [&](QPushButton* button, Command which)
  {
    const CommandState& command = state(which);
    button->setEnabled(command.offered && !command.busy);
    button->setToolTip(command.offered ? button->property("tip").toString() : QString::fromStdString(command.text));
  };
  show(train_, Command::TRAIN);
  show(reset_, Command::RESET);
  show(load_, Command::LOAD_CT);
  show(refine_, Command::REFINE);
  refine_->setEnabled(state(Command::REFINE).offered);
  refine_->setText(state(Command::REFINE).busy ? "Cancel" : "Refine now");

  static const char* const kNames[] = { "Beam", "Train", "Refine", "Reset", "CT" };
  QStringList lines;
  if (!state(Command::HOLD).offered)
  {
    lines << coloured("The beam cannot be held from here: " + QString::fromStdString(state(Command::HOLD).text),
                      look::kBad);
  }
  for (std::size_t i = 0; i < kCommands; ++i)
  {
    const CommandState& command = view.commands[i];
    if (command.text != said_[i])
    {
      said_[i] = command.text;
      newest_ = i;
    }
    // What is under way or has failed, and what was said last.
    if (command.offered && !command.text.empty() && (command.busy || command.failed || newest_ == i))
    {
      lines << coloured(QString(kNames[i]) + ": " + QString::fromStdString(command.text), command.failed ? look::kBad
                                                                                          : command.busy
                                                                                              ? look::kAccent
                                                                                              : look::kQuiet);
    }
  }
  if (!last_message_.isEmpty() && (newest_ == kCommands || recorder_->recording()))
  {
    lines << coloured(last_message_, recorder_->fault().isEmpty() ? look::kQuiet : look::kBad);
  }
  const QString text = lines.join("<br>");
  if (message_->text() != text)
  {
    message_->setText(text);
  }
}

bool TreatmentPanel::asking()
{
  auto* dialog = findChild<QDialog*>();
  if (dialog != nullptr)
  {
    dialog->raise();
  }
  return dialog != nullptr;
}

void TreatmentPanel::chooseCt()
{
  if (asking())
  {
    return;
  }
  // Not native, and not modal: time goes on, and with it the heartbeat; the beam can be held meanwhile.
  auto* dialog = new QFileDialog(this, "A CT: a volume file, or any file of a DICOM series' folder", ct_folder_,
                                 "Volumes (*.nrrd *.nhdr *.mha *.mhd *.nii *.nii.gz *.dcm);;All files (*)");
  dialog->setOption(QFileDialog::DontUseNativeDialog);
  dialog->setAttribute(Qt::WA_DeleteOnClose);
  connect(dialog, &QFileDialog::fileSelected, this,
          [this](const QString& path)
          {
            const QFileInfo file(path);
            ct_folder_ = file.absolutePath();
            const bool slice = file.suffix().isEmpty() || file.suffix() == "dcm";
            link_->commands().loadCt((slice ? file.absolutePath() : file.absoluteFilePath()).toStdString());
            Q_EMIT configChanged();
          });
  dialog->show();
}

void TreatmentPanel::confirmReset()
{
  if (asking())
  {
    return;
  }
  auto* box = new QMessageBox(QMessageBox::Warning, "Reset",
                              "Trackers forget their templates, and motion estimation starts over.\n\n"
                              "You state that the patient IS at the setup's initial pose.",
                              QMessageBox::Ok | QMessageBox::Cancel, this);
  box->setAttribute(Qt::WA_DeleteOnClose);
  box->setDefaultButton(QMessageBox::Cancel);
  connect(box, &QMessageBox::finished, this,
          [this](int button)
          {
            if (button == QMessageBox::Ok)
            {
              link_->commands().reset();
            }
          });
  box->setModal(false);
  box->show();
}

void TreatmentPanel::toggleRecording()
{
  if (recorder_->recording())
  {
    recorder_->stop();
  }
  else
  {
    recorder_->start(dataFolder() + "/recordings");
  }
}

void TreatmentPanel::load(const rviz::Config& config)
{
  rviz::Panel::load(config);
  config.mapGetString("CT Folder", &ct_folder_);
}

void TreatmentPanel::save(rviz::Config config) const
{
  rviz::Panel::save(config);
  config.mapSetValue("CT Folder", ct_folder_);
}
}  // namespace xray_tracking

PLUGINLIB_EXPORT_CLASS(xray_tracking::TreatmentPanel, rviz::Panel)
