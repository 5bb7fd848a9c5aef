#include "alignment_panel.h"

#include <algorithm>
#include <cmath>

#include <rviz/render_panel.h>
#include <rviz/tool.h>
#include <rviz/tool_manager.h>
#include <rviz/visualization_manager.h>
#include <rviz/window_manager_interface.h>
#include <QComboBox>
#include <QGridLayout>
#include <QHBoxLayout>
#include <QKeyEvent>
#include <QLabel>
#include <QPushButton>
#include <QTimer>
#include <QVBoxLayout>
#include <pluginlib/class_list_macros.hpp>

#include "alignment_link.h"
#include "alignment_marker.h"
#include "look.h"
#include "seen.h"
#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
constexpr int kTick = 33;                             ///< [ms]
constexpr std::chrono::milliseconds kShowAgain(100);  ///< a pose on alignment_pose that stays where it is
constexpr double kDegrees = 180.0 / EIGEN_PI;
constexpr double kFine = 0.1;  ///< of a step, with Shift

QString figure(double value, int decimals, const char* unit)
{
  // Not "-0.00".
  const double scale = std::pow(10.0, decimals);
  const double rounded = std::round(value * scale) / scale;
  return (rounded > 0.0 ? "+" : "") + QString::number(rounded == 0.0 ? 0.0 : rounded, 'f', decimals) +
         QString::fromUtf8(unit);
}

/// @param steps in `unit`
QComboBox* stepBox(QWidget* parent, const char* name, const std::vector<double>& steps, const char* unit, int chosen)
{
  auto* box = new QComboBox(parent);
  box->setObjectName(name);
  box->setFocusPolicy(Qt::NoFocus);  // the arrow keys move the CT
  for (const double step : steps)
  {
    box->addItem(QString::number(step) + QString::fromUtf8(unit), step);
  }
  box->setCurrentIndex(chosen);
  return box;
}
}  // namespace

AlignmentPanel::AlignmentPanel(QWidget* parent) : rviz::Panel(parent), timer_(new QTimer(this))
{
  setAttribute(Qt::WA_StyledBackground);
  setFocusPolicy(Qt::StrongFocus);
  setStyleSheet(look::styleSheet() +
                "QLabel#quiet { color: #8b97a5; }"
                "QLabel#total { font-size: 15pt; font-weight: bold; }"
                "QPushButton#step { padding: 2px; min-width: 26px; font-size: 12pt; }");
  auto* layout = new QVBoxLayout(this);
  layout->setContentsMargins(8, 8, 8, 8);
  layout->setSpacing(6);
  const auto button = [&](const char* text, const char* name, const char* tip)
  {
    auto* made = new QPushButton(text, this);
    made->setObjectName(name);
    made->setToolTip(tip);
    made->setFocusPolicy(Qt::NoFocus);
    return made;
  };
  align_ = button("Align by hand", "align", "Lays the CT over the radiographs, to be moved by hand");
  layout->addWidget(align_);
  total_ = new QLabel(this);
  total_->setObjectName("total");
  total_->setToolTip("How far the target's centre was moved, and by how much the patient was turned");
  layout->addWidget(total_);
  layout->addWidget(makeAxes());
  layout->addWidget(makeSteps());
  auto* keys = new QLabel(QString::fromUtf8("Keys: ← → x, PgUp PgDn y, ↑ ↓ z\nCtrl: turn, Shift: a tenth"), this);
  keys->setObjectName("quiet");
  layout->addWidget(keys);
  back_ = button("Back to start", "back", "To where the alignment began");
  register_ = button("Register from here", "register",
                     "The registration goes on from here; if it is believed, the patient is taken to be where it ends");
  register_->setProperty("primary", true);
  auto* last = new QHBoxLayout;
  last->addWidget(back_);
  last->addWidget(register_, 1);
  layout->addLayout(last);
  message_ = new QLabel(this);
  message_->setObjectName("message");
  message_->setWordWrap(true);
  message_->setMinimumHeight(64);
  message_->setAlignment(Qt::AlignTop | Qt::AlignLeft);
  layout->addWidget(message_, 1);
  controls_.push_back(back_);
  for (QWidget* control : controls_)
  {
    control->setEnabled(false);
  }
  register_->setEnabled(false);
  align_->setEnabled(false);
  connect(align_, &QPushButton::clicked, this,
          [this] { alignment_ ? end("Cancelled: nothing has changed.", look::kQuiet) : begin(); });
  connect(back_, &QPushButton::clicked, this,
          [this]
          {
            alignment_->shiftBy(-alignment_->shift());
            alignment_->place(alignment_->target(), Eigen::Quaterniond::Identity());
            moved(false);
          });
  connect(register_, &QPushButton::clicked, this,
          [this]
          {
            asked_from_ = alignment_;
            link_->state(alignment_->pose());
            say("Registering from here ...", look::kAccent);
          });
  connect(timer_, &QTimer::timeout, this, &AlignmentPanel::tick);
  showOffset();
}

AlignmentPanel::~AlignmentPanel() = default;

QWidget* AlignmentPanel::makeSteps()
{
  auto* box = new QWidget(this);
  auto* row = new QHBoxLayout(box);
  row->setContentsMargins(0, 0, 0, 0);
  auto* name = new QLabel("Step", box);
  name->setObjectName("quiet");
  shift_step_ = stepBox(box, "shift_step", { 0.1, 0.5, 1.0, 2.0, 5.0, 10.0 }, " mm", 2);
  turn_step_ = stepBox(box, "turn_step", { 0.1, 0.5, 1.0, 2.0, 5.0, 10.0 }, "°", 2);
  row->addWidget(name);
  row->addWidget(shift_step_, 1);
  row->addWidget(turn_step_, 1);
  for (QComboBox* steps : { shift_step_, turn_step_ })
  {
    connect(steps, QOverload<int>::of(&QComboBox::currentIndexChanged), this, [this] { Q_EMIT configChanged(); });
  }
  return box;
}

QWidget* AlignmentPanel::makeAxes()
{
  auto* box = new QWidget(this);
  auto* grid = new QGridLayout(box);
  grid->setContentsMargins(0, 0, 0, 0);
  grid->setHorizontalSpacing(4);
  grid->setVerticalSpacing(4);
  static const char* const kTips[] = { "Room x: along the couch", "Room y: across the couch", "Room z: up" };
  for (int axis = 0; axis < 3; ++axis)
  {
    auto* name = new QLabel(QString("xyz"[axis]), box);
    name->setToolTip(kTips[axis]);
    name->setObjectName("quiet");
    grid->addWidget(name, axis, 0);
    for (const bool turn : { false, true })
    {
      const int column = turn ? 5 : 1;
      auto* value = new QLabel(box);
      value->setAlignment(Qt::AlignCenter);
      value->setMinimumWidth(70);
      (turn ? turns_ : shifts_)[static_cast<std::size_t>(axis)] = value;
      for (const int sign : { -1, 1 })
      {
        auto* button = new QPushButton(QString::fromUtf8(sign > 0 ? "+" : "−"), box);
        button->setObjectName("step");
        button->setAccessibleName(
            QString(turn ? "turn_%1%2" : "shift_%1%2").arg("xyz"[axis]).arg(sign > 0 ? '+' : '-'));
        button->setFocusPolicy(Qt::NoFocus);
        button->setAutoRepeat(true);
        connect(button, &QPushButton::clicked, this, [this, axis, turn, sign] { step(axis, turn, sign); });
        grid->addWidget(button, axis, sign < 0 ? column : column + 2);
        controls_.push_back(button);
      }
      grid->addWidget(value, axis, column + 1);
      grid->setColumnStretch(column + 1, 1);
    }
    grid->setColumnMinimumWidth(4, 8);
  }
  return box;
}

void AlignmentPanel::onInitialize()
{
  const ros::NodeHandle nh;
  watch_ = std::make_unique<RoomWatch>(nh);
  link_ = std::make_unique<AlignmentLink>(nh);
  vis_manager_->getRenderPanel()->installEventFilter(this);
  vis_manager_->getWindowManager()->getParentWindow()->installEventFilter(this);
  last_tick_ = std::chrono::steady_clock::now();
  timer_->start(kTick);
}

void AlignmentPanel::begin()
{
  if (!room_.setup)
  {
    return;
  }
  const std::optional<RigidTransform> pose = link_->patientPose();
  alignment_.emplace(pose.value_or(room_.setup->room_from_patient), room_.setup->targetCentre());
  makeMarker();
  rviz::ToolManager* tools = vis_manager_->getToolManager();
  tool_before_ = tools->getCurrentTool();
  for (int i = 0; i < tools->numTools(); ++i)
  {
    if (tools->getTool(i)->getClassId() == "rviz/Interact")
    {
      tools->setCurrentTool(tools->getTool(i));
    }
  }
  align_->setText("Cancel");
  for (QWidget* control : controls_)
  {
    control->setEnabled(true);
  }
  say(pose ? "Begun at the patient's pose." : "No pose of the patient is known: begun at the setup's initial pose.",
      look::kQuiet);
  setFocus();
  moved(false);
}

void AlignmentPanel::makeMarker()
{
  marker_ = std::make_unique<AlignmentMarker>(vis_manager_,
                                              [this](const Eigen::Vector3d& where, const Eigen::Quaterniond& turn)
                                              {
                                                alignment_->place(kMillimetresPerMetre * where, turn);
                                                moved(true);
                                              });
}

void AlignmentPanel::end(const QString& message, const QColor& colour)
{
  link_->withdraw();
  alignment_.reset();
  marker_.reset();
  rviz::ToolManager* tools = vis_manager_->getToolManager();
  for (int i = 0; i < tools->numTools(); ++i)
  {
    // It may have been removed meanwhile.
    if (tools->getTool(i) == tool_before_)
    {
      tools->setCurrentTool(tool_before_);
    }
  }
  align_->setText("Align by hand");
  for (QWidget* control : controls_)
  {
    control->setEnabled(false);
  }
  say(message, colour);
  lasting_message_ = true;
  showOffset();
}

void AlignmentPanel::tick()
{
  const auto now = std::chrono::steady_clock::now();
  const float elapsed = std::chrono::duration<float>(now - std::exchange(last_tick_, now)).count();
  showRoom();
  if (!alignment_)
  {
    return;
  }
  takeAnswer();
  if (!alignment_)
  {
    return;
  }
  if (!isSeen(*this))
  {
    marker_.reset();
    return;
  }
  if (!marker_)
  {
    makeMarker();
    moved(false);
  }
  marker_->update(elapsed);
  if (now - last_shown_ >= kShowAgain)
  {
    last_shown_ = now;
    link_->show(alignment_->pose());
  }
}

void AlignmentPanel::showRoom()
{
  room_ = watch_->room();
  const bool offered = link_->offered();
  align_->setEnabled(alignment_ || room_.setup);
  register_->setEnabled(alignment_ && offered && !link_->asked());
  register_->setToolTip(offered ? "The registration goes on from here; if it is believed, the patient is taken to be "
                                  "where it ends"
                                : "motion_estimation is not running (no action motion_estimation/align)");
  if (!alignment_ && !lasting_message_)
  {
    say(room_.setup     ? QString("Where no pose is known, or a wrong one, lay the CT over the radiographs by hand.")
        : !room_.asked  ? QString("Asking for the treatment room's setup ...")
        : !room_.master ? QString("The ROS master does not answer. Start roscore or a launch file.")
                        : QString::fromStdString(room_.setup_fault),
        room_.setup ? look::kQuiet : look::kWarning);
  }
}

void AlignmentPanel::takeAnswer()
{
  const std::optional<AlignmentLink::Answer> answer = link_->takeAnswer();
  if (!answer)
  {
    return;
  }
  if (!answer->success)
  {
    say("Not registered, and nothing has changed: " + QString::fromStdString(answer->message), look::kBad);
    return;
  }
  const RigidTransform motion = answer->registered * asked_from_->pose().inverse();
  const double shift = (motion * asked_from_->target() - asked_from_->target()).norm();
  end("Registered, " + QString::number(shift, 'f', 1) + " mm and " +
          QString::number(kDegrees * rotationAngle(motion), 'f', 1) +
          QString::fromUtf8(
              "° from where it was put. Motion counts from there; the gate opens when exposures are good."),
      look::kGood);
}

void AlignmentPanel::say(const QString& text, const QColor& colour)
{
  lasting_message_ = false;
  const QString rich = "<span style='color:" + colour.name() + "'>" + text.toHtmlEscaped() + "</span>";
  if (message_->text() != rich)
  {
    message_->setText(rich);
  }
}

void AlignmentPanel::step(int axis, bool turn, double sign)
{
  if (!alignment_)
  {
    return;
  }
  const Eigen::Vector3d along = sign * Eigen::Vector3d::Unit(axis);
  if (turn)
  {
    alignment_->turnBy(turn_step_->currentData().toDouble() / kDegrees * along);
  }
  else
  {
    alignment_->shiftBy(shift_step_->currentData().toDouble() * along);
  }
  moved(false);
}

void AlignmentPanel::moved(bool by_mouse)
{
  if (!by_mouse)
  {
    marker_->place(alignment_->target() / kMillimetresPerMetre, alignment_->turn());
  }
  last_shown_ = std::chrono::steady_clock::now();
  link_->show(alignment_->pose());
  showOffset();
}

void AlignmentPanel::showOffset()
{
  const Eigen::Vector3d shift = alignment_ ? alignment_->shift() : Eigen::Vector3d::Zero();
  const Eigen::Vector3d turn =
      alignment_ ? Eigen::Vector3d(kDegrees * alignment_->turnVector()) : Eigen::Vector3d::Zero();
  for (int axis = 0; axis < 3; ++axis)
  {
    shifts_[static_cast<std::size_t>(axis)]->setText(alignment_ ? figure(shift[axis], 1, " mm") : QString());
    turns_[static_cast<std::size_t>(axis)]->setText(alignment_ ? figure(turn[axis], 1, "°") : QString());
  }
  total_->setText(alignment_ ? QString::number(shift.norm(), 'f', 1) + " mm   " + QString::number(turn.norm(), 'f', 1) +
                                   QString::fromUtf8("°")
                             : QString());
}

bool AlignmentPanel::handleKey(const QKeyEvent& event)
{
  struct Key
  {
    int key, axis;
    double sign;
  };
  static constexpr Key kKeys[] = {
    { Qt::Key_Right, 0, 1.0 },     { Qt::Key_Left, 0, -1.0 }, { Qt::Key_PageUp, 1, 1.0 },
    { Qt::Key_PageDown, 1, -1.0 }, { Qt::Key_Up, 2, 1.0 },    { Qt::Key_Down, 2, -1.0 }
  };
  const auto* key =
      std::find_if(std::begin(kKeys), std::end(kKeys), [&](const Key& k) { return k.key == event.key(); });
  if (!marker_ || key == std::end(kKeys))
  {
    return false;
  }
  const Qt::KeyboardModifiers modifiers = event.modifiers();
  step(key->axis, modifiers.testFlag(Qt::ControlModifier),
       (modifiers.testFlag(Qt::ShiftModifier) ? kFine : 1.0) * key->sign);
  return true;
}

bool AlignmentPanel::eventFilter(QObject* watched, QEvent* event)
{
  return (event->type() == QEvent::KeyPress && handleKey(*static_cast<QKeyEvent*>(event))) ||
         rviz::Panel::eventFilter(watched, event);
}

void AlignmentPanel::keyPressEvent(QKeyEvent* event)
{
  if (!handleKey(*event))
  {
    rviz::Panel::keyPressEvent(event);
  }
}

void AlignmentPanel::load(const rviz::Config& config)
{
  rviz::Panel::load(config);
  const auto choose = [&](const char* key, QComboBox* box)
  {
    float step = 0.0F;
    if (config.mapGetFloat(key, &step))
    {
      for (int i = 0; i < box->count(); ++i)
      {
        if (std::abs(box->itemData(i).toDouble() - static_cast<double>(step)) < 1e-3)
        {
          box->setCurrentIndex(i);
        }
      }
    }
  };
  choose("Shift Step", shift_step_);
  choose("Turn Step", turn_step_);
}

void AlignmentPanel::save(rviz::Config config) const
{
  rviz::Panel::save(config);
  config.mapSetValue("Shift Step", shift_step_->currentData());
  config.mapSetValue("Turn Step", turn_step_->currentData());
}
}  // namespace xray_tracking

PLUGINLIB_EXPORT_CLASS(xray_tracking::AlignmentPanel, rviz::Panel)
