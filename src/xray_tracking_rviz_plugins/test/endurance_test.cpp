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
constexpr double kWarmUp = 60.0;  // charts and trails are full, caches made; a third of a run that is shorter [s]

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
        display->subProp("CT planes")->subProp(plane)->setValue(true);
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
  live(std::min(kWarmUp, duration / 3.0));
  const Usage before = Usage::now();
  rates_.clear();
  live(duration);
  const Usage after = Usage::now();
  const double mean = std::accumulate(rates_.begin(), rates_.end(), 0.0) / static_cast<double>(rates_.size());
  std::cout << "RViz alone: " << alone << "\nwith everything: " << before << "\n"
            << duration << " s later: " << after << "\nimages of a detector: " << mean
            << " Hz\nlongest event: " << 1e3 * TimedApplication::longest << " ms of processor, "
            << 1e3 * TimedApplication::longest_wall << " ms of wall time" << std::endl;
  // 60 images a second have 31 MB: one of a hundred that stays would be 3 MB in 10 s, and 190 MB in ten minutes.
  EXPECT_LT(after.resident, before.resident + 20.0);
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
