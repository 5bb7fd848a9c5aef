#include "region_editor.h"

#include <random>

#include <gtest/gtest.h>

#include "view_mapping.h"

namespace xray_tracking
{
namespace
{
using Grip = RegionEditor::Grip;

RegionEditor editorOf(const cv::Size& size)
{
  RegionEditor editor;
  editor.setImageSize(size);
  return editor;
}

TEST(RegionEditor, DrawsFromAnyCornerToAnyOther)
{
  for (const bool left : { false, true })
  {
    for (const bool up : { false, true })
    {
      RegionEditor editor = editorOf({ 200, 100 });
      // Edges of pixels 20..59 and 30..79.
      editor.press({ left ? 59.5 : 19.5, up ? 79.5 : 29.5 }, 3.0);
      editor.drag({ 40.0, 50.0 });
      editor.drag({ left ? 19.5 : 59.5, up ? 29.5 : 79.5 });
      editor.release();
      ASSERT_TRUE(editor.region());
      EXPECT_EQ(*editor.region(), cv::Rect(20, 30, 40, 50));
    }
  }
}

TEST(RegionEditor, MovesAndResizes)
{
  RegionEditor editor = editorOf({ 200, 100 });
  editor.set({ 20, 30, 40, 50 });
  editor.press({ 40.0, 50.0 }, 3.0);
  editor.drag({ 51.0, 47.0 });
  editor.release();
  EXPECT_EQ(*editor.region(), cv::Rect(31, 27, 40, 50));
  EXPECT_EQ(editor.gripAt({ 30.5, 50.0 }, 3.0), Grip::LEFT);
  EXPECT_EQ(editor.gripAt({ 70.5, 76.5 }, 3.0), Grip::BOTTOM_RIGHT);
  EXPECT_EQ(editor.gripAt({ 100.0, 50.0 }, 3.0), Grip::NONE);
  editor.press({ 70.5, 76.5 }, 3.0);
  editor.drag({ 79.5, 89.5 });
  editor.release();
  EXPECT_EQ(*editor.region(), cv::Rect(31, 27, 49, 63));
  editor.press({ 30.5, 50.0 }, 3.0);
  editor.drag({ 500.0, 50.0 });  // beyond the other edge
  EXPECT_EQ(editor.region()->width, RegionEditor::kMinSize);
  EXPECT_EQ(editor.region()->br().x, 80);
}

TEST(RegionEditor, AClickLeavesTheRegion)
{
  RegionEditor editor = editorOf({ 200, 100 });
  editor.set({ 20, 30, 40, 50 });
  editor.press({ 150.0, 50.0 }, 3.0);
  editor.drag({ 151.0, 51.0 });
  editor.release();
  EXPECT_EQ(*editor.region(), cv::Rect(20, 30, 40, 50));
}

TEST(RegionEditor, StaysInsideTheImageWhateverIsDone)
{
  std::mt19937 random(11);
  std::uniform_real_distribution<double> anywhere(-80.0, 260.0);
  RegionEditor editor = editorOf({ 200, 100 });
  for (int i = 0; i < 5000; ++i)
  {
    editor.press({ anywhere(random), anywhere(random) }, 5.0);
    editor.drag({ anywhere(random), anywhere(random) });
    editor.drag({ anywhere(random), i % 7 == 0 ? std::nan("") : anywhere(random) });
    editor.release();
    if (editor.region())
    {
      const cv::Rect region = *editor.region();
      ASSERT_EQ(region & cv::Rect(0, 0, 200, 100), region);
      ASSERT_GE(region.width, RegionEditor::kMinSize);
      ASSERT_GE(region.height, RegionEditor::kMinSize);
    }
  }
  EXPECT_TRUE(editor.region());
  editor.setImageSize({ 12, 12 });
  EXPECT_TRUE(!editor.region() || editor.region()->width <= 12);
}

TEST(ViewMapping, FitsZoomsAndGoesBackAndForth)
{
  const ViewMapping fit = ViewMapping::fit({ 1000, 500 }, { 400, 300 });
  EXPECT_DOUBLE_EQ(fit.scale, 0.4);
  EXPECT_TRUE(fit.toWidget({ -0.5, -0.5 }).isApprox(Eigen::Vector2d(1e-300, 50.0)));
  EXPECT_TRUE(fit.toWidget({ 999.5, 499.5 }).isApprox(Eigen::Vector2d(400.0, 250.0)));
  const Eigen::Vector2d at(123.0, 77.0);
  const ViewMapping zoomed = fit.zoomed(3.0, at);
  EXPECT_TRUE(zoomed.toPixel(at).isApprox(fit.toPixel(at)));
  EXPECT_TRUE(zoomed.toPixel(zoomed.toWidget({ 3.25, 8.5 })).isApprox(Eigen::Vector2d(3.25, 8.5)));
  EXPECT_DOUBLE_EQ(fit.zoomed(1e9, at).scale, ViewMapping::kMaxScale);
}
}  // namespace
}  // namespace xray_tracking
