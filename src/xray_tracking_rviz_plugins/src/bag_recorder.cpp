#include "bag_recorder.h"

#include <csignal>

#include <sys/prctl.h>

#include <QDateTime>
#include <QDir>
#include <QProcess>

namespace xray_tracking
{
namespace
{
constexpr int kClosing = 5000;  ///< that closing a bag may take when the panel goes [ms]

class Child : public QProcess
{
public:
  using QProcess::QProcess;

protected:
  void setupChildProcess() override
  {
    // Kept by what `rosrun` becomes: a window that is killed leaves a closed bag behind, and no process.
    prctl(PR_SET_PDEATHSIG, SIGINT);
  }
};
}  // namespace

QString dataFolder()
{
  const QString home = qEnvironmentVariable("ROS_HOME");
  return (home.isEmpty() ? QDir::homePath() + "/.ros" : home) + "/xray_tracking";
}

BagRecorder::BagRecorder(const QString& topics, QObject* parent)
  : QObject(parent), topics_(topics), process_(new Child(this))
{
  process_->setProcessChannelMode(QProcess::MergedChannels);
  connect(process_, &QProcess::started, this, &BagRecorder::changed);
  connect(process_, &QProcess::errorOccurred, this,
          [this](QProcess::ProcessError error)
          {
            if (error == QProcess::FailedToStart)
            {
              fault_ = "rosrun cannot be started: is rosbash installed?";
              Q_EMIT changed();
            }
          });
  connect(process_, QOverload<int, QProcess::ExitStatus>::of(&QProcess::finished), this,
          [this](int, QProcess::ExitStatus)
          {
            if (!stopping_)
            {
              const QStringList lines = QString::fromLocal8Bit(process_->readAll()).split('\n', Qt::SkipEmptyParts);
              fault_ = "rosbag record has ended: " + (lines.isEmpty() ? QString("no word why") : lines.last());
            }
            Q_EMIT changed();
          });
  // Else what it says fills the pipe, and it waits.
  connect(process_, &QProcess::readyRead, this,
          [this]
          {
            if (recording() && !stopping_)
            {
              process_->readAll();
            }
          });
}

BagRecorder::~BagRecorder()
{
  process_->disconnect(this);
  stop();
  if (recording())
  {
    process_->waitForFinished(kClosing);
  }
}

void BagRecorder::start(const QString& parent_folder)
{
  if (recording())
  {
    return;
  }
  stopping_ = false;
  fault_.clear();
  const QString folder = parent_folder + "/" + QDateTime::currentDateTime().toString("yyyyMMdd_HHmmss_zzz");
  if (!QDir().mkpath(folder))
  {
    fault_ = folder + " cannot be made";
    Q_EMIT changed();
    return;
  }
  file_ = folder + "/recorded.bag";
  process_->start("rosrun", { "rosbag", "record", "-O", file_, "--regex", topics_ });
}

void BagRecorder::stop()
{
  if (recording() && process_->processId() > 0)
  {
    stopping_ = true;
    ::kill(static_cast<pid_t>(process_->processId()), SIGINT);
  }
}

bool BagRecorder::recording() const
{
  return process_->state() != QProcess::NotRunning;
}
}  // namespace xray_tracking
