// RViz with all displays and panels, everything in them switched on, for as long as the launch file says.
#include "own_classes.h"
#include "rviz_window.h"

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <numeric>

#include <rviz/properties/property.h>
#include <rviz/view_manager.h>
#include <QComboBox>
#include <QPushButton>

#include "radiograph_panel.h"

namespace xray_tracking
{
namespace
{
/// Till charts and trails are full and caches made; ten minutes are begun after a minute [s].
double warmUp(double duration)
{
  return std::clamp(0.1 * duration, 8.0, 60.0);
}

/// What this process has taken of the machine.
struct Usage
{
  double resident = 0.0;  ///< [MB]
  std::ptrdiff_t descriptors = 0, threads = 0;

  static Usage now()
  {
    const auto count = [](const char* folder)
    { return std::distance(std::filesystem::directory_iterator(folder), std::filesystem::directory_iterator()); };
    std::ifstream statm("/proc/self/statm");
    double size = 0.0, resident = 0.0;
    statm >> size >> resident;
    return { 1e-6 * resident * static_cast<double>(sysconf(_SC_PAGESIZE)), count("/proc/self/fd"),
             count("/proc/self/task") };
  }
};

std::ostream& operator<<(std::ostream& stream, const Usage& usage)
{
  return stream << usage.resident << " MB, " << usage.descriptors << " descriptors, " << usage.threads << " threads";
}

class EnduranceTest : public RvizWindow
{
protected:
  void showEverything()
  {
    for (const std::string& name : ownClasses<rviz::Display>("rviz::Display"))
    {
      rviz::Display* display = addDisplay(name);
      for (const char* plane : { "Axial", "Coronal", "Sagittal" })
      {
        if (name == "xray_tracking_rviz_plugins/Anatomy")
        {
          display->subProp("CT planes")->subProp(plane)->setValue(true);
        }
      }
    }
    for (const std::string& name : ownClasses<rviz::Panel>("rviz::Panel"))
    {
      const bool images = name == "xray_tracking_rviz_plugins/RadiographPanel";
      rviz::Panel* panel = addPanel(name, images ? Qt::BottomDockWidgetArea : Qt::RightDockWidgetArea);
      ASSERT_NE(panel, nullptr) << name;
      if (images)
      {
        radiographs_ = dynamic_cast<RadiographPanel*>(panel);
      }
    }
    ASSERT_NE(radiographs_, nullptr);
    radiographs_->findChild<QPushButton*>("residuals")->setChecked(true);
    radiographs_->findChild<QPushButton*>("draw_region")->setChecked(true);
  }

  /// Lets the window live, the view turning, each overlay for a second.
  void live(double seconds)
  {
    const int overlays = radiographs_->findChild<QComboBox*>("overlay")->count();
    for (const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
         std::chrono::steady_clock::now() < end; ++lived_)
    {
      radiographs_->findChild<QComboBox*>("overlay")->setCurrentIndex(lived_ % overlays);
      manager_->getViewManager()->getCurrent()->subProp("Yaw")->setValue(0.1 * lived_);
      spin(1.0);
      for (DetectorPane* pane : radiographs_->panes())
      {
        rates_.push_back(pane->feed().messages().rate);
      }
    }
  }

  RadiographPanel* radiographs_ = nullptr;
  std::vector<double> rates_;  ///< of images, once a second for each detector [Hz]
  int lived_ = 0;
};

TEST_F(EnduranceTest, TakesNoMoreOfTheMachineThanAtFirst)
{
  double duration = 0.0;
  ASSERT_TRUE(ros::NodeHandle("~").getParam("duration", duration));
  const Usage alone = Usage::now();
  showEverything();
  const auto rendered = [&]
  {
    const std::vector<DetectorPane*> panes = radiographs_->panes();
    return panes.size() == 2 &&
           std::all_of(panes.begin(), panes.end(),
                       [](DetectorPane* pane) { return pane->view().picture().request.rendering != nullptr; });
  };
  radiographs_->findChild<QComboBox*>("overlay")->setCurrentIndex(1);
  ASSERT_TRUE(spinUntil(rendered, 90.0)) << "no CT over the images";
  live(warmUp(duration));
  const Usage before = Usage::now();
  rates_.clear();
  std::cout << "RViz alone: " << alone << "\nwith everything: " << before << std::endl;
  Usage after;
  for (int part = 1; part <= 10; ++part)
  {
    live(duration / 10.0);
    after = Usage::now();
    std::cout << "after " << part * duration / 10.0 << " s: " << after << std::endl;
  }
  const double mean = std::accumulate(rates_.begin(), rates_.end(), 0.0) / static_cast<double>(rates_.size());
  std::cout << "images of a detector: " << mean << " Hz\nlongest event: " << 1e3 * TimedApplication::longest
            << " ms of processor (" << TimedApplication::longest_of
            << ")\nlongest event: " << 1e3 * TimedApplication::longest_wall << " ms of wall time ("
            << TimedApplication::longest_wall_of << ")" << std::endl;
  // What is freed goes back late. 60 images a second have 31 MB; in ten minutes this is 2 kB an exposure.
  EXPECT_LT(after.resident, before.resident + 40.0);
  EXPECT_LE(after.descriptors, before.descriptors + 2);  // a service call's connection may be open just now
  EXPECT_LE(after.threads, before.threads + 2);
  EXPECT_GT(mean, 5.0);  // 30 where nothing else is done beside it
  EXPECT_LT(TimedApplication::longest, 0.05);
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  return xray_tracking::RvizWindow::runTests(argc, argv, "endurance_test");
}
