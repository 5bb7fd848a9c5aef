#include "xray_tracking_core/image/xray_field.h"

#include <cctype>
#include <cstdint>
#include <string>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>

#include "test_helpers.h"
#include "xray_scene.h"

namespace xray_tracking
{
namespace
{
struct Blades
{
  const char* name;
  Shape lit;
  /// The same with a margin [px], > 0 for less of the field.
  std::function<bool(double x, double y, double margin)> field;
};

std::vector<Blades> allBlades()
{
  const auto make = [](const char* name, const std::function<double(double x, double y)>& inside)
  {
    return Blades{ name, [inside](double x, double y) { return inside(x, y) > 0.0; },
                   [inside](double x, double y, double margin) { return inside(x, y) > margin; } };
  };
  return {
    make("left", [](double x, double) { return x - 40.5; }),
    make("right, in air", [](double x, double) { return 470.5 - x; }),
    make("top", [](double, double y) { return y - 60.5; }),
    make("bottom", [](double, double y) { return 500.5 - y; }),
    make("all four",
         [](double x, double y) {
           return std::min({ x - 100.5, 400.5 - x, y - 120.5, 430.5 - y });
         }),
    make("oblique", [](double x, double y) { return 0.8 * x + 0.6 * y - 150.5; }),
    make("a corner", [](double x, double y) { return M_SQRT1_2 * (x + y) - 60.5; }),
    make("a turned square",
         [](double x, double y)
         {
           const double u = 0.94 * (x - 250.0) + 0.34 * (y - 250.0), v = 0.94 * (y - 250.0) - 0.34 * (x - 250.0);
           return 170.5 - std::max(std::abs(u), std::abs(v));
         }),
    make("round", [](double x, double y) { return 200.5 - std::hypot(x - 240.0, y - 260.0); }),
    make("round, beyond the image's sides",
         [](double x, double y) { return 275.5 - std::hypot(x - 256.0, y - 256.0); }),
  };
}

class BladesTest : public testing::TestWithParam<std::tuple<Blades, double>>
{
};

TEST_P(BladesTest, areFoundWithTheirPenumbra)
{
  const auto& [blades, scatter] = GetParam();
  const Shape covered = [lit = blades.lit](double x, double y) { return !lit(x, y); };
  for (const int scale : { 1, 2 })
  {
    const cv::Mat image = Scene(kSize * scale).cover(covered, 0.003).scatter(scatter).expose(kAir, 4.0, 1, 1.5);
    for (const int bins : { 64, 128 })
    {
      SCOPED_TRACE(testing::Message() << kSize * scale << " px, " << bins << " bins");
      XrayField field(bins);
      field.update(image, kCounts);
      EXPECT_EQ("", field.nothing());
      cv::Mat marks(image.size(), CV_8UC1, cv::Scalar(0));
      field.mark({ {}, image.size() }, 1, marks);
      double missed = 0.0, outside = 0.0, wrong = 0.0;
      for (int y = 0; y < image.rows; ++y)
      {
        for (int x = 0; x < image.cols; ++x)
        {
          const bool marked = marks.at<std::uint8_t>(y, x) != 0;
          const double u = x / double(scale), v = y / double(scale);
          outside += !blades.field(u, v, 2.0);
          missed += !marked && !blades.field(u, v, 2.0);
          wrong += marked && blades.field(u, v, 3.5 * kSize / bins);
        }
      }
      EXPECT_LE(missed, 0.01 * outside);
      EXPECT_LE(wrong, (bins == 64 ? 3e-3 : 1e-4) * image.total());  // in acute corners
    }
  }
}

INSTANTIATE_TEST_SUITE_P(XrayField, BladesTest,
                         testing::Combine(testing::ValuesIn(allBlades()), testing::Values(0.0, 0.1, 0.3)),
                         [](const auto& info)
                         {
                           std::string name = std::get<0>(info.param).name;
                           for (char& c : name)
                           {
                             c = std::isalnum(static_cast<unsigned char>(c)) ? c : '_';
                           }
                           return name + "_" + std::to_string(int(100.0 * std::get<1>(info.param)));
                         });

TEST(XrayFieldTest, tellsWhatIsInside)
{
  // A field from 100 to 400 across, 120 to 430 down.
  const Shape covered = [](double x, double y) { return x < 100.5 || x > 399.5 || y < 120.5 || y > 429.5; };
  XrayField field;
  field.update(Scene().cover(covered, 0.0).expose(), kCounts);
  EXPECT_EQ(0.0, field.outside({ 120, 140, 260, 270 }));
  EXPECT_EQ(1.0, field.outside({ 0, 0, 95, 512 }));
  EXPECT_NEAR(0.5, field.outside({ 50, 200, 100, 100 }), 0.1);
  EXPECT_EQ(1.0, field.outside({ 600, 0, 50, 50 }));
  EXPECT_NEAR(0.5, field.outside({ 250, 400, 10, 60 }), 0.2);

  EXPECT_EQ(cv::Rect(150, 160, 100, 90), field.inside({ 150, 160, 100, 90 }));
  const cv::Rect inside = field.inside({ 80, 90, 100, 100 });
  EXPECT_EQ(cv::Point(180, 190), inside.br());
  EXPECT_GE(inside.x, 101);
  EXPECT_LE(inside.x, 112);
  EXPECT_GE(inside.y, 121);
  EXPECT_LE(inside.y, 132);
  EXPECT_TRUE(field.inside({ 0, 0, 90, 512 }).empty());
}

TEST(XrayFieldTest, findsTheLargestRectangleInARoundField)
{
  const Shape covered = [](double x, double y) { return std::hypot(x - 256.0, y - 256.0) > 200.0; };
  XrayField field;
  field.update(Scene().cover(covered, 0.0).expose(), kCounts);
  const cv::Rect inside = field.inside({ 0, 0, kSize, kSize });
  // The square in the circle, but for the penumbra on both sides.
  EXPECT_LE(inside.area(), 200.0 * 200.0 * 2.0);
  EXPECT_GE(inside.area(), 188.0 * 188.0 * 2.0);
  EXPECT_EQ(0.0, field.outside(inside));
}

TEST(XrayFieldTest, ofAnImageThatShowsNothingAllIsOutside)
{
  XrayField field;
  field.update(cv::Mat(300, 200, CV_8UC1, cv::Scalar(7)), { IntensityModel::Kind::COUNTS, 0.0, {} });
  EXPECT_NE("", field.nothing());
  EXPECT_EQ(1.0, field.outside({ 10, 10, 100, 100 }));
  EXPECT_TRUE(field.inside({ 10, 10, 100, 100 }).empty());
  cv::Mat marks(200, 100, CV_8UC1, cv::Scalar(2));
  field.mark({ 50, 50, 100, 200 }, 5, marks);
  EXPECT_EQ(0, cv::countNonZero(marks != 7));
}

TEST(XrayFieldTest, stripesAreNoImage)
{
  // A dark frame: every column's amplifier has its own offset, beside noise.
  cv::Mat columns(1, 300, CV_32FC1), image, noise(200, 300, CV_32FC1);
  cv::RNG random(9);
  random.fill(columns, cv::RNG::NORMAL, 500.0, 60.0);
  random.fill(noise, cv::RNG::NORMAL, 0.0, 5.0);
  cv::repeat(columns, 200, 1, image);
  image += noise;
  for (const cv::Mat& stripes : { image, cv::Mat(image.t()) })
  {
    XrayField field;
    field.update(stripes, { IntensityModel::Kind::COUNTS, 0.0, {} });
    EXPECT_NE("", field.nothing());
  }
}

TEST(XrayFieldTest, stuckPixelsAreNoBorder)
{
  cv::RNG random(5);
  for (const double share : { 0.003, 0.02 })
  {
    const Shape covered = [](double x, double) { return x < 60.0; };
    cv::Mat image = Scene().cover(covered, 0.0).expose();
    for (int n = 0; n < share * static_cast<double>(image.total()); ++n)
    {
      image.at<std::uint16_t>(random.uniform(0, kSize), random.uniform(0, kSize)) =
          static_cast<std::uint16_t>(random.uniform(0, 2) * 65535);
    }
    image.rowRange(200, 202) = cv::Scalar(65535);
    XrayField field;
    field.update(image, kCounts);
    EXPECT_EQ("", field.nothing());
    EXPECT_GE(field.outside({ 0, 0, 56, kSize }), 0.99);
    EXPECT_EQ(0.0, field.outside({ 76, 0, kSize - 76, kSize }));
  }
}

TEST(XrayFieldTest, namesWhatItCannotUse)
{
  XrayField field;
  expectError<std::invalid_argument>([&] { field.update(cv::Mat(8, 64, CV_16UC1, cv::Scalar(1)), kCounts); },
                                     { "64 x 8", "16 x 16" });
  expectError<std::invalid_argument>([&] { field.update(cv::Mat(64, 64, CV_8UC3, cv::Scalar()), kCounts); },
                                     { "type 16" });
}

/// Less than a sixteenth of the dose that stays is blind in one exposure alone where noise tells, and else for as long
/// as lag may have so much light.
TEST(XrayFieldTest, aDoseThatStaysIsNoLag)
{
  for (const double share : { 1.0 / 18.0, 0.03, 0.01 })
  {
    XrayField field;
    field.update(Scene().expose(), kCounts);
    for (int image = 0; image < 12; ++image)
    {
      const cv::Mat exposure = Scene().expose(share * kAir, 4.0, 2 + static_cast<std::uint64_t>(image));
      field.update(exposure, kCounts);
      EXPECT_EQ(image < 3, !field.nothing().empty()) << share << ", image " << image << ": " << field.nothing();
    }
  }
  // Without noise: 0.98^n = 16 * 0.03 at n = 36.
  XrayField field;
  const auto eight_bit = [&](double share)
  {
    cv::Mat image;
    Scene().expose(share * kAir, 0.0).convertTo(image, CV_8U, 255.0 / kAir, -kOffset * 255.0 / kAir);
    field.update(image, { IntensityModel::Kind::COUNTS, 0.0, {} });
    return field.nothing();
  };
  EXPECT_EQ("", eight_bit(1.0));
  int images = 0;
  while (images < 200 && !eight_bit(0.03).empty())
  {
    ++images;
  }
  EXPECT_NEAR(images, 36, 8);
}

/// What a panel remembers when X-rays go off; and what is darker for other reasons.
TEST(XrayFieldTest, lagIsNoExposure)
{
  XrayField field;
  const auto nothing = [&](const cv::Mat& image)
  {
    field.update(image, kCounts);
    return field.nothing();
  };
  EXPECT_EQ("", nothing(Scene().expose(0.02 * kAir, 1.0))) << "the first one is judged alone";
  EXPECT_EQ("", nothing(Scene().expose()));
  EXPECT_EQ("", nothing(Scene().expose(0.1 * kAir))) << "a tenth of the dose";
  EXPECT_EQ("", nothing(Scene().expose()));
  const Shape blades = [](double x, double y) { return x < 180.0 || x > 280.0 || y < 200.0 || y > 300.0; };
  EXPECT_EQ("", nothing(Scene().cover(blades, 0.002).expose())) << "blades leave a twentieth of the field";
  EXPECT_EQ("", nothing(Scene().expose()));
  // X-rays are off: the light falls as the root of the number of images, with the panel's noise alone.
  const cv::Mat last = Scene().expose();
  EXPECT_EQ("", nothing(last));
  const auto lag = [&](double share, int image, double sd = 5.0)
  {
    cv::Mat values, noise(last.size(), CV_32FC1), off;
    cv::RNG(static_cast<std::uint64_t>(image)).fill(noise, cv::RNG::NORMAL, kOffset, sd);
    last.convertTo(values, CV_32F, share, -share * kOffset);
    values += noise;
    values.convertTo(off, CV_16U);
    return off;
  };
  for (int image = 1; image <= 60; ++image)
  {
    const std::string what = nothing(lag(0.03 / std::sqrt(image), image));
    EXPECT_NE(std::string::npos, what.find("shows nothing")) << "image " << image;
    EXPECT_EQ(1.0, field.outside({ 100, 100, 200, 200 }));
  }
  // Nor if it stayed, with as much noise as an exposure of so little light has in the middle: it is the same
  // everywhere.
  for (const double noise : { 5.0, 30.0 })
  {
    EXPECT_EQ("", nothing(last));
    for (int image = 1; image <= 30; ++image)
    {
      EXPECT_NE(std::string::npos, nothing(lag(0.03, image, noise)).find("shows nothing")) << "image " << image;
    }
  }
  EXPECT_EQ("", nothing(Scene().expose()));
  cv::Mat eight_bit;
  Scene().expose().convertTo(eight_bit, CV_8U, 255.0 / kAir);
  field.update(eight_bit, { IntensityModel::Kind::COUNTS, 0.0, {} });
  EXPECT_EQ("", field.nothing()) << "of another scale";
  EXPECT_EQ("", nothing(Scene().expose()));
  EXPECT_NE("", nothing(Scene().expose(0.03 * kAir, 0.5)));
  field.forget();
  EXPECT_EQ("", nothing(Scene().expose(0.03 * kAir, 0.5)));
}
}  // namespace
}  // namespace xray_tracking
