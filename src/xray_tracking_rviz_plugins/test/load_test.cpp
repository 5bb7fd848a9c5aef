#include "own_classes.h"
#include "rviz_window.h"

#include <rviz/failed_panel.h>
#include <rviz/failed_tool.h>
#include <rviz/tool_manager.h>

namespace xray_tracking
{
namespace
{
TEST_F(RvizWindow, LoadsEveryDisplay)
{
  const std::vector<std::string> classes = ownClasses<rviz::Display>("rviz::Display");
  EXPECT_FALSE(classes.empty());
  for (const std::string& name : classes)
  {
    SCOPED_TRACE(name);
    const rviz::Display* display = addDisplay(name);
    ASSERT_NE(display, nullptr);
    EXPECT_EQ(dynamic_cast<const rviz::FailedDisplay*>(display), nullptr);
  }
  spin(1.0);
}

TEST_F(RvizWindow, LoadsEveryPanel)
{
  const std::vector<std::string> classes = ownClasses<rviz::Panel>("rviz::Panel");
  EXPECT_FALSE(classes.empty());
  for (const std::string& name : classes)
  {
    SCOPED_TRACE(name);
    const rviz::Panel* panel = addPanel(name);
    ASSERT_NE(panel, nullptr);
    EXPECT_EQ(dynamic_cast<const rviz::FailedPanel*>(panel), nullptr);
  }
  spin(1.0);
}

TEST_F(RvizWindow, LoadsEveryTool)
{
  for (const std::string& name : ownClasses<rviz::Tool>("rviz::Tool"))
  {
    SCOPED_TRACE(name);
    const rviz::Tool* tool = manager_->getToolManager()->addTool(QString::fromStdString(name));
    ASSERT_NE(tool, nullptr);
    EXPECT_EQ(dynamic_cast<const rviz::FailedTool*>(tool), nullptr);
  }
  spin(1.0);
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  return xray_tracking::RvizWindow::runTests(argc, argv, "load_test");
}
