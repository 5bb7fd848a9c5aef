#include "playback_panel.h"

#include <utility>

#include <QHBoxLayout>
#include <QLabel>
#include <QPushButton>
#include <QTimer>
#include <pluginlib/class_list_macros.hpp>

#include "look.h"

namespace xray_tracking
{
namespace
{
constexpr int kTick = 200;                 ///< [ms]
constexpr std::int64_t kLook = 400000000;  ///< over which a rate is taken [ns]
}  // namespace

void ClockRate::look(std::int64_t clock, std::int64_t now)
{
  if (now_ == 0 || clock < clock_)
  {
    clock_ = clock;
    now_ = now;
    rate_ = 0.0;
  }
  else if (now - now_ >= kLook)
  {
    rate_ = static_cast<double>(clock - clock_) / static_cast<double>(now - now_);
    clock_ = clock;
    now_ = now;
  }
}

PlaybackPanel::PlaybackPanel(QWidget* parent) : rviz::Panel(parent), timer_(new QTimer(this))
{
  setAttribute(Qt::WA_StyledBackground);
  setStyleSheet(look::styleSheet() + "QLabel#quiet { color: #8b97a5; }");
  auto* layout = new QHBoxLayout(this);
  layout->setContentsMargins(8, 4, 8, 4);
  play_ = new QPushButton("Pause", this);
  play_->setObjectName("play");
  play_->setMinimumWidth(90);
  step_ = new QPushButton("Next exposure", this);
  step_->setObjectName("step");
  time_ = new QLabel(this);
  time_->setObjectName("time");
  time_->setMinimumWidth(220);
  note_ = new QLabel(this);
  note_->setObjectName("quiet");
  layout->addWidget(play_);
  layout->addWidget(step_);
  layout->addWidget(time_);
  layout->addWidget(note_, 1);
  connect(play_, &QPushButton::clicked, this,
          [this]
          {
            const std::lock_guard<std::mutex> lock(mutex_);
            stepping_ = false;
            pause(clock_.runs());
          });
  connect(step_, &QPushButton::clicked, this,
          [this]
          {
            const std::lock_guard<std::mutex> lock(mutex_);
            stepping_ = true;
            pause(false);
          });
  connect(timer_, &QTimer::timeout, this, &PlaybackPanel::tick);
}

PlaybackPanel::~PlaybackPanel()
{
  motion_subscriber_.shutdown();
  if (spinner_)
  {
    spinner_->stop();
  }
  if (pauser_)
  {
    pauser_->shutdown();
  }
}

void PlaybackPanel::onInitialize()
{
  nh_.setCallbackQueue(&queue_);
  connectTo(player_);
  const boost::function<void(const xray_tracking_msgs::PatientMotion::ConstPtr&)> decided =
      [this](const xray_tracking_msgs::PatientMotion::ConstPtr&)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (std::exchange(stepping_, false))
    {
      pause(true);
    }
  };
  motion_subscriber_ = nh_.subscribe<xray_tracking_msgs::PatientMotion>("patient_motion", 10, decided);
  spinner_ = std::make_unique<ros::AsyncSpinner>(1, &queue_);
  spinner_->start();
  timer_->start(kTick);
}

void PlaybackPanel::connectTo(const QString& player)
{
  player_ = player;
  pauser_ = std::make_unique<ServiceCaller<std_srvs::SetBool>>(
      nh_, player.toStdString() + "/pause_playback",
      [this](const std::optional<std_srvs::SetBool::Response>& response, const std::string& why)
      {
        const std::lock_guard<std::mutex> lock(mutex_);
        fault_ = !response ? why : response->success ? "" : response->message;
        if (const std::optional<bool> next = std::exchange(asked_next_, std::nullopt))
        {
          pause(*next);
        }
      });
}

void PlaybackPanel::pause(bool on)
{
  std_srvs::SetBool::Request request;
  request.data = static_cast<std::uint8_t>(on);
  if (!pauser_->call(request))
  {
    asked_next_ = on;
    fault_ = "the player does not answer an earlier call";
  }
}

void PlaybackPanel::tick()
{
  const bool simulated = ros::Time::isSimTime();
  const std::int64_t clock = static_cast<std::int64_t>(ros::Time::now().toNSec());
  clock_.look(simulated ? clock : 0, static_cast<std::int64_t>(ros::SteadyTime::now().toNSec()));
  play_->setText(clock_.runs() ? "Pause" : "Play");
  play_->setEnabled(simulated);
  step_->setEnabled(simulated && !clock_.runs());
  if (!simulated)
  {
    time_->setText("time is the real one");
    note_->setText("nothing is played in simulated time: start playback.launch");
    return;
  }
  time_->setText(clock == 0 ? QString("nothing on /clock")
                            : QString::number(1e-9 * static_cast<double>(clock), 'f', 2) + " s   " +
                                  (clock_.runs() ? "x " + QString::number(clock_.rate(), 'f', 2) : QString("stands")));
  const std::lock_guard<std::mutex> lock(mutex_);
  note_->setText(!fault_.empty() ? QString::fromStdString(fault_)
                                 : QString("rosbag play keeps its speed (launch argument speed) and does not go back"));
}

void PlaybackPanel::load(const rviz::Config& config)
{
  rviz::Panel::load(config);
  QString player;
  if (!config.mapGetString("Player", &player) || player.isEmpty())
  {
    return;
  }
  player_ = player;
  if (pauser_)
  {
    pauser_->shutdown();
    connectTo(player);
  }
}

void PlaybackPanel::save(rviz::Config config) const
{
  rviz::Panel::save(config);
  config.mapSetValue("Player", player_);
}
}  // namespace xray_tracking

PLUGINLIB_EXPORT_CLASS(xray_tracking::PlaybackPanel, rviz::Panel)
