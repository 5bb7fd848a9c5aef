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
  const QString& fault() const { return fault_; }  ///< of the last recording; empty if there was none

Q_SIGNALS:
  void changed();

private:
  QString topics_;
  QProcess* process_;
  QString file_, fault_;
  bool stopping_ = false;
};

/// $ROS_HOME/xray_tracking, by default in ~/.ros.
QString dataFolder();
}  // namespace xray_tracking
