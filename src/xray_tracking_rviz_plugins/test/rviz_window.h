#pragma once

#include <ctime>

#include <algorithm>
#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include <QApplication>
#include <QDockWidget>

#include <gtest/gtest.h>
#include <ros/ros.h>
#include <rviz/failed_display.h>
#include <rviz/panel.h>
#include <rviz/visualization_frame.h>
#include <rviz/visualization_manager.h>

#include "spin_until.h"

namespace xray_tracking
{
/// Knows how long our own objects, and what is in our widgets, have kept the GUI thread with one event.
class TimedApplication : public QApplication
{
public:
  using QApplication::QApplication;

  bool notify(QObject* receiver, QEvent* event) override
  {
    const double start = processorTime();
    const auto wall_start = std::chrono::steady_clock::now();
    const char* who = nullptr;  // static, as the receiver may be gone afterwards
    for (const QObject* object = receiver; object != nullptr && who == nullptr; object = object->parent())
    {
      const char* const name = object->metaObject()->className();
      who = QByteArray(name).startsWith("xray_tracking::") ? name : nullptr;
    }
    const char* const within = receiver->metaObject()->className();
    const int what = event->type();
    const bool result = QApplication::notify(receiver, event);
    if (who != nullptr)
    {
      const double time = processorTime() - start;
      const double wall = std::chrono::duration<double>(std::chrono::steady_clock::now() - wall_start).count();
      const auto whose = [&] { return std::string(who) + ", its " + within + ", event " + std::to_string(what); };
      if (time > longest)
      {
        longest = time;
        longest_of = whose();
      }
      if (wall > longest_wall)
      {
        longest_wall = wall;
        longest_wall_of = whose() + ", of which " + std::to_string(1e3 * time) + " ms of processor";
      }
      ++events;
    }
    return result;
  }

  /// Of this thread [s].
  static double processorTime()
  {
    timespec now{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
  }

  static inline double longest = 0.0;       ///< processor time of one event [s]
  static inline std::string longest_of;     ///< whose it was: class of ours, the receiver's within, the event's type
  static inline double longest_wall = 0.0;  ///< [s]
  static inline std::string longest_wall_of;
  static inline int events = 0;
};

/// RViz's own main window in this process, on the display that with_display makes. There is one for all tests of a
/// program, as Ogre allows no second; each test gets it without displays and panels.
class RvizWindow : public testing::Test
{
public:
  /// main() of a test program.
  static int runTests(int argc, char** argv, const std::string& node_name)
  {
    testing::InitGoogleTest(&argc, argv);
    ros::init(argc, argv, node_name, ros::init_options::NoSigintHandler);
    TimedApplication application(argc, argv);
    rviz::VisualizationFrame frame;
    frame.setSplashPath("");
    frame.initialize(XRAY_TRACKING_TEST_FOLDER "/empty.rviz");
    frame.resize(1500, 900);
    frame.show();
    frame_ = &frame;
    manager_ = frame.getManager();
    spin(0.2);
    return RUN_ALL_TESTS();
  }

protected:
  void TearDown() override
  {
    spin(0.1);  // rviz's property tree has events for what is to go
    manager_->removeAllDisplays();
    for (QDockWidget* dock : docks_)
    {
      delete dock;
    }
    docks_.clear();
    spin(0.1);
  }

  static rviz::Display* addDisplay(const std::string& class_id)
  {
    return manager_->createDisplay(QString::fromStdString(class_id), QString::fromStdString(class_id), true);
  }

  /// @return none if the class could not be loaded
  rviz::Panel* addPanel(const std::string& class_id, Qt::DockWidgetArea area = Qt::RightDockWidgetArea)
  {
    QDockWidget* dock =
        frame_->addPanelByName(QString::fromStdString(class_id), QString::fromStdString(class_id), area);
    if (dock == nullptr)
    {
      return nullptr;
    }
    docks_.push_back(dock);
    return qobject_cast<rviz::Panel*>(dock->widget());
  }

  static inline rviz::VisualizationFrame* frame_ = nullptr;
  static inline rviz::VisualizationManager* manager_ = nullptr;

private:
  std::vector<QDockWidget*> docks_;
};
}  // namespace xray_tracking
