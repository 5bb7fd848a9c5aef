#include "xray_tracking_core/image/mixed_rows.h"

#include <cmath>
#include <cstdio>
#include <string>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "shared_data.h"
#include "xray_scene.h"

namespace xray_tracking
{
namespace
{
constexpr int kMargin = 30;
const cv::Rect kPart(140, 130, 150, 100);  // spine and ribs

/// The scene with ribs all over it, moved, with noise of its own.
cv::Mat exposeAt(const cv::Point& shift, std::uint64_t seed, double dose = kAir, double quantum = 0.2)
{
  const cv::Rect seen(kMargin + shift.x, kMargin + shift.y, kSize - 2 * kMargin, kSize - 2 * kMargin);
  const Shape ribs = [](double x, double y) { return std::fmod(y + 2.0 * x, 80.0) < 30.0; };
  return Scene().cover(ribs, 0.7).expose(dose, quantum, seed)(seen).clone();
}

cv::Mat woven(const cv::Mat& image, const cv::Mat& before, int first)
{
  cv::Mat mixed = image.clone();
  for (int y = first; y < image.rows; y += 2)
  {
    before.row(y).copyTo(mixed.row(y));
  }
  return mixed;
}

TEST(MixedRows, areToldWhereWhatIsSeenHasMoved)
{
  MixedRows rows;
  for (const cv::Point& shift : { cv::Point(5, 0), cv::Point(4, 3), cv::Point(-6, 2), cv::Point(12, 2) })
  {
    const cv::Mat now = exposeAt(shift, 1), before = exposeAt({}, 2);
    for (const int first : { 0, 1 })
    {
      EXPECT_NE(std::string::npos, rows.look(woven(now, before, first), kPart).find("every other row")) << shift;
    }
  }
}

TEST(MixedRows, areNoneInOneExposure)
{
  MixedRows rows;
  for (const double dose : { 5000.0, 20000.0, 60000.0 })
  {
    for (const double quantum : { 0.0, 0.1, 1.0, 5.0 })
    {
      const cv::Mat image = exposeAt({ 2, 1 }, 3, dose, quantum);
      SCOPED_TRACE(testing::Message() << dose << " counts, " << quantum << " a quantum");
      EXPECT_EQ("", rows.look(image, kPart));
      EXPECT_EQ("", rows.look(image, { 0, 0, image.cols, image.rows }));
      cv::Mat eight_bit;
      image.convertTo(eight_bit, CV_8U, 200.0 / dose);
      EXPECT_EQ("", rows.look(eight_bit, kPart));
      // Two exposures of what stands still are as good as one.
      const cv::Mat other = exposeAt({ 2, 1 }, 4, dose, quantum);
      EXPECT_EQ("", rows.look(woven(image, other, 0), kPart));
    }
  }
  EXPECT_EQ("", rows.look(exposeAt({}, 1), { -100, -100, 130, 130 })) << "too small a part inside";
}

/// Two amplifiers for odd and even rows, a panel of two halves, correlated noise.
TEST(MixedRows, areNoneOfADetectorsOwn)
{
  MixedRows rows;
  cv::Mat image = exposeAt({}, 3);
  for (int y = 0; y < image.rows; y += 2)
  {
    image.row(y) = image.row(y) * 1.1 + 40.0;
  }
  EXPECT_EQ("", rows.look(image, kPart));
  image = exposeAt({}, 3);
  image.rowRange(171, image.rows) = image.rowRange(171, image.rows) * 1.2 + 60.0;
  EXPECT_EQ("", rows.look(image, kPart));
  cv::GaussianBlur(exposeAt({}, 3, 5000.0, 20.0), image, {}, 1.5);
  EXPECT_EQ("", rows.look(image, kPart));
}

/// A thick plate's edge along a row, which a detector's blur spreads over some.
TEST(MixedRows, areNoneAtAnEdgeAlongThem)
{
  MixedRows rows;
  for (double edge = 200.0; edge < 201.0; edge += 0.25)
  {
    const Shape plate = [edge](double, double y) { return y > edge; };
    EXPECT_EQ("", rows.look(Scene().cover(plate, 0.3).expose(), { 150, 140, 150, 100 })) << edge;
  }
}

/// Something with edges that no detector has blurred, in front of a part of the image.
TEST(MixedRows, areNoneAtAThingsEdge)
{
  MixedRows rows;
  cv::Mat image = exposeAt({ 2, 1 }, 3);
  image(cv::Rect(170, 160, 80, 50)) = cv::Scalar(9000);
  EXPECT_EQ("", rows.look(image, kPart));
}

class MixedRowsDataTest : public SharedDataTest
{
protected:
  cv::Mat read(const std::string& file)
  {
    const cv::Mat image = cv::imread(folder_ + "/" + file, cv::IMREAD_UNCHANGED);
    EXPECT_FALSE(image.empty()) << file;
    return image;
  }
  static std::string numbered(const char* format, int number)
  {
    char name[96];
    std::snprintf(name, sizeof(name), format, number);
    return name;
  }
};

TEST_F(MixedRowsDataTest, realExposuresHaveNone)
{
  MixedRows rows;
  const auto expect_none = [&](const std::string& file)
  {
    const cv::Mat image = read(file);
    const int w = image.cols / 8, h = image.rows / 4;
    for (int x = w; x + 2 * w < image.cols; x += w)
    {
      for (int y = h; y < 3 * h; y += h)
      {
        EXPECT_EQ("", rows.look(image, { x, y, 2 * w, h })) << file << " at " << x << ", " << y;
      }
    }
  };
  for (int i = 0; i < 20; ++i)
  {
    for (const char* sequence : { "thorax_01", "thorax_02" })
    {
      for (const char* detector : { "a", "b" })
      {
        expect_none("sequences/" + std::string(sequence) + "/detector_" + detector + numbered("_%03d.png", i));
      }
    }
    expect_none(numbered("sequences/knee_real/detector_a_%03d.png", 2 * i));
    expect_none(numbered("sequences/knee_real/detector_b_%03d.png", 2 * i));
  }
  for (const char* frame : { "01_UND.0002", "02_UND.0002", "01_UND.0099", "02_UND.0099", "01_UND.0158", "02_UND.0158" })
  {
    expect_none("wrist_biplane/images/xr_rad_uln_cam" + std::string(frame) + ".tif");
  }
  for (const char* view : { "m20", "m16", "m12", "m08", "m04", "p00", "p04", "p08", "p12", "p16", "p20" })
  {
    expect_none("sequences/portal_real/images/portal_" + std::string(view) + ".png");
  }
}
}  // namespace
}  // namespace xray_tracking
