#pragma once

#include <QObject>
#include <QString>

class QProcess;

namespace xray_tracking
{
/// `rosbag record` as a child process, into a new folder for every recording. It ends, and closes its bag, with this
/// object or with its process, however that ends.
class BagRecorder : public QObject
{
  Q_OBJECT
public:
  /// @param topics a regular expression of full names
  BagRecorder(const QString& topics, QObject* parent);
  ~BagRecorder() override;

  /// @param parent_folder made if it is missing
  void start(const QString& parent_folder);
  /// Asks it to close the bag; changed() tells when that is done.
  void stop();
  bool recording() const;
  const QString& file() const { return file_; }
  /// Of this recording or the last one: the last warning or error that rosbag gave of it, as that messages are dropped
  /// or the disk is full, or why there is no bag. Empty if there was none.
  const QString& fault() const { return fault_; }

Q_SIGNALS:
  void changed();

private:
  void listen();

  QString topics_;
  QProcess* process_;
  QString file_, fault_;
  QString last_line_;  ///< of what it said
  bool stopping_ = false;
};

/// What is to be recorded of a treatment, as a regular expression of full names: all that the launch files' recorder
/// takes, with run_description and parameters, so that the recording can be judged by itself.
/// @param prefix of the treatment's names, with a slash at its end
QString recordedTopics(const QString& prefix);

/// $ROS_HOME/xray_tracking, by default in ~/.ros.
QString dataFolder();
}  // namespace xray_tracking
