#include "bag_recorder.h"

#include <csignal>

#include <sys/prctl.h>

#include <QDateTime>
#include <QDir>
#include <QFileInfo>
#include <QProcess>
#include <QRegularExpression>

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

QString recordedTopics(const QString& prefix)
{
  return "(" + prefix +
         "(.+/(image_raw|camera_info|tracked_region)|.+_hyperplane_tracker/parameter_updates|patient_pose|"
         "patient_motion|predicted_pose|beam_gate|refined_pose|patient_ground_truth|run_description)|"
         "/tf|/tf_static|/diagnostics|/rosout)";
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
            listen();
            const QString why = last_line_.isEmpty() ? QString("no word why") : last_line_;
            if (!stopping_)
            {
              fault_ = "rosbag record has ended: " + why;
            }
            else if (!QFileInfo::exists(file_))
            {
              fault_ = "there is no " + file_ + ": " + why;
            }
            Q_EMIT changed();
          });
  connect(process_, &QProcess::readyRead, this, &BagRecorder::listen);
}

void BagRecorder::listen()
{
  static const QRegularExpression colours("\x1b\\[[0-9;]*m");
  static const QRegularExpression trouble("^\\[ ?(WARN|ERROR|FATAL)\\][^:]*: ");
  // All of it, else what it says fills the pipe, and it waits.
  while (process_->canReadLine() || (!recording() && process_->bytesAvailable() > 0))
  {
    const QString line = QString::fromLocal8Bit(process_->readLine()).remove(colours).trimmed();
    last_line_ = line.isEmpty() ? last_line_ : line;
    if (const QRegularExpressionMatch match = trouble.match(line); match.hasMatch())
    {
      fault_ = "rosbag record: " + line.mid(match.capturedEnd());
      Q_EMIT changed();
    }
  }
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
  last_line_.clear();
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
