#include "xray_tracking_core/image/image_inspector.h"

#include <filesystem>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "shared_data.h"
#include "test_helpers.h"
#include "xray_scene.h"
#include "xray_tracking_core/image/pixel_repair.h"

namespace xray_tracking
{
namespace
{
/// Shares of pixels of a shape, shrunk or grown by a margin [px], that have a flaw.
double shareWith(const ImageReport& report, std::uint8_t flaw, const Shape& shape)
{
  double with = 0.0, all = 0.0;
  for (int y = 0; y < report.flaws.rows; ++y)
  {
    for (int x = 0; x < report.flaws.cols; ++x)
    {
      if (shape(x, y))
      {
        all += 1.0;
        with += (report.flaws.at<std::uint8_t>(y, x) & flaw) != 0;
      }
    }
  }
  return with / all;
}

class ImageInspectorTest : public testing::Test
{
protected:
  const ImageReport& inspect(const cv::Mat& image, const IntensityModel& intensity = kCounts, const cv::Rect& part = {})
  {
    return inspector_.inspect(image, intensity, part);
  }
  ImageInspector inspector_;
};

TEST_F(ImageInspectorTest, findsNothingWrongWithAnatomy)
{
  for (const double dose : { 5000.0, 20000.0, 60000.0 })
  {
    for (const double quantum : { 0.1, 1.0, 5.0 })
    {
      const ImageReport& report = inspect(Scene().expose(dose, quantum));
      EXPECT_EQ("", report.nothing);
      EXPECT_EQ(0.0, report.border) << dose << " counts, " << quantum << " a quantum";
      EXPECT_LE(report.stuck * report.flaws.total(), 10.0) << dose << " counts, " << quantum << " a quantum";
    }
  }
}

TEST_F(ImageInspectorTest, lettersBesideTheFieldAreNotTheField)
{
  const Shape blade = [](double x, double) { return x < 120.0; };
  cv::Mat image = Scene().cover(blade, 0.01).expose();
  cv::putText(image, "R 12:30", { 5, 300 }, cv::FONT_HERSHEY_SIMPLEX, 0.8, cv::Scalar(65535), 2);
  EXPECT_GE(shareWith(inspect(image), BORDER, blade), 0.995);
}

TEST_F(ImageInspectorTest, whatIsThinIsNoBorder)
{
  // A rod of 20 px from below, and one from the left.
  const Shape rods = [](double x, double y)
  { return (std::abs(x - 200.0) < 10.0 && y > 200.0) || (std::abs(y - 100.0 + 0.2 * x) < 8.0 && x < 350.0); };
  EXPECT_EQ(0.0, inspect(Scene().cover(rods, 0.02).expose()).border);
}

TEST_F(ImageInspectorTest, aThinFrameIsBorder)
{
  const Shape frame = [](double x, double y) { return x < 6.0 || y < 6.0 || x > 505.0 || y > 505.0; };
  EXPECT_GE(shareWith(inspect(Scene().cover(frame, 0.0).expose()), BORDER, frame), 0.99);
}

TEST_F(ImageInspectorTest, attenuationImagesHaveBordersToo)
{
  const Shape blade = [](double x, double y) { return y > 380.0 + 0.2 * x; };
  cv::Mat values;
  Scene().cover(blade, 0.02).expose().convertTo(values, CV_32F);
  cv::log(cv::max(values - kOffset, 1.0) / kAir, values);
  values = -values;
  const IntensityModel attenuation{ IntensityModel::Kind::ATTENUATION, 0.0, {} };
  EXPECT_GE(shareWith(inspect(values, attenuation), BORDER, blade), 0.999);
  cv::Mat scaled;
  values.convertTo(scaled, CV_16U, 5000.0);
  const double share = inspect(scaled, attenuation).border;
  EXPECT_GE(shareWith(inspector_.report(), BORDER, blade), 0.999);
  EXPECT_LT(share, 0.3);
}

TEST_F(ImageInspectorTest, findsStuckPixels)
{
  cv::RNG random(5);
  const cv::Rect part(150, 100, 200, 300);
  for (const double share : { 0.0005, 0.003, 0.02 })
  {
    for (const int edge : { 1, 2, 3 })  // clusters
    {
      cv::Mat image = Scene().expose();
      cv::Mat stuck(image.size(), CV_8UC1, cv::Scalar(0));
      for (int n = 0; n < share * static_cast<double>(image.total()) / (edge * edge); ++n)
      {
        const cv::Rect place(random.uniform(0, kSize - edge), random.uniform(0, kSize - edge), edge, edge);
        image(place) = cv::Scalar(random.uniform(0, 2) == 0 ? 0 : random.uniform(8000, 65536));
        stuck(place) = 255;
      }
      const ImageReport& report = inspect(image, kCounts, part);
      cv::Mat found = (report.flaws & STUCK) != 0;
      const cv::Mat truth = stuck(part);
      const double hits = cv::countNonZero(found & truth) / double(cv::countNonZero(truth));
      const double wrong = cv::countNonZero(found & ~truth) / double(part.area());
      EXPECT_GE(hits, edge < 3 ? 0.95 : 0.85) << share << " of the pixels in clusters of " << edge;
      EXPECT_LE(wrong, 1e-4) << share << " of the pixels in clusters of " << edge;
      EXPECT_NEAR(report.stuck, cv::countNonZero(truth) / double(part.area()), 0.1 * share + 1e-4);
      EXPECT_EQ(0.0, report.border);
    }
  }
}

TEST_F(ImageInspectorTest, findsDeadRowsAndColumns)
{
  cv::Mat image = Scene().expose();
  image.row(200) = cv::Scalar(0);
  image.rowRange(300, 302) = cv::Scalar(40000);
  image.col(230) = cv::Scalar(0);
  image(cv::Rect(260, 256, 1, 256)) = cv::Scalar(65535);
  const ImageReport& report = inspect(image);
  EXPECT_EQ(0.0, report.border);
  const auto lines = [](double x, double y)
  { return y == 200.0 || y == 300.0 || y == 301.0 || x == 230.0 || (x == 260.0 && y >= 256.0); };
  // Where bone is darkest zero is within the noise.
  EXPECT_GE(shareWith(report, STUCK, lines), 0.9);
  EXPECT_LE(shareWith(report, STUCK, [&](double x, double y) { return !lines(x, y); }), 1e-4);
}

/// A panel's lines of another gain: no pixel of them is apart by much more than its noise.
TEST_F(ImageInspectorTest, findsLinesOfAnotherGain)
{
  const auto factor = [](int x, int y)
  {
    const double row = y % 37 == 11 ? 1.2 : y == 300 || y == 301 ? 0.8 : 1.0;
    return row * (x % 43 == 7 ? 0.8 : x == 260 && y >= 256 ? 1.25 : 1.0);
  };
  for (const double quantum : { 0.2, 0.5 })
  {
    const cv::Mat clean = Scene().expose(kAir, quantum);
    cv::Mat image = clean.clone();
    for (int y = 0; y < kSize; ++y)
    {
      for (int x = 0; x < kSize; ++x)
      {
        auto& counts = image.at<std::uint16_t>(y, x);
        counts = cv::saturate_cast<std::uint16_t>(kOffset + factor(x, y) * (counts - kOffset));
      }
    }
    const ImageReport& report = inspect(image);
    const Shape lines = [&](double x, double y) { return factor(static_cast<int>(x), static_cast<int>(y)) != 1.0; };
    EXPECT_GE(shareWith(report, STUCK, lines), 0.98) << quantum;
    EXPECT_LE(shareWith(report, STUCK, [&](double x, double y) { return !lines(x, y); }), 1e-4) << quantum;
    PixelRepair repair;
    repair.add(report, image.size());
    cv::Mat repaired;
    repair.apply(image, repaired);
    EXPECT_EQ(0.0, inspect(repaired).border);
    EXPECT_LE(inspector_.report().stuck, 1e-4) << quantum;
  }
  // Every other row, as of two amplifiers: nothing would be left to mend them by.
  cv::Mat image = Scene().expose();
  for (int y = 0; y < kSize; y += 2)
  {
    image.row(y) *= 1.1;
  }
  EXPECT_LE(inspect(image).stuck, 1e-4);
}

/// A long bone along the columns or rows of a quiet image of 8 bit: all along it X-rays pass most bone at its inner
/// surface, where the image is darkest.
TEST_F(ImageInspectorTest, aCortexAlongRowsOrColumnsIsNoFaultyLine)
{
  for (const double outer : { 12.0, 20.0, 40.0 })
  {
    for (const double thickness : { 1.5, 2.5, 4.0, 7.0 })
    {
      for (const double blur : { 0.5, 0.8, 1.5 })
      {
        SCOPED_TRACE(testing::Message() << outer << " px, cortex of " << thickness << ", blur of " << blur);
        const auto chord = [](double radius, double x) { return std::sqrt(std::max(0.0, radius * radius - x * x)); };
        cv::Mat light(kSize, kSize, CV_32FC1), noise(kSize, kSize, CV_32FC1), image;
        cv::RNG(4).fill(noise, cv::RNG::NORMAL, 0.0, 0.4);
        for (int y = 0; y < kSize; ++y)
        {
          for (int x = 0; x < kSize; ++x)
          {
            const double bone = chord(outer, x - 256.3) - chord(outer - thickness, x - 256.3);
            light.at<float>(y, x) = static_cast<float>(150.0 * std::exp(-0.08 * bone - 0.2 * std::cos(0.01 * y)));
          }
        }
        cv::GaussianBlur(light, light, {}, blur);
        light += noise;
        light.convertTo(image, CV_8U);
        const IntensityModel eight{ IntensityModel::Kind::COUNTS, 0.0, {} };
        EXPECT_EQ(0.0, inspect(image, eight).stuck);
        EXPECT_EQ(0.0, inspect(image.t(), eight).stuck);
        // A line of the detector on it is one nevertheless.
        image.col(256) *= 0.85;
        EXPECT_GE(shareWith(inspect(image, eight), STUCK, [](double x, double) { return x == 256.0; }), 1.0);
      }
    }
  }
}

/// A clock in white, which goes on.
TEST_F(ImageInspectorTest, repairsLettering)
{
  for (const double size : { 0.5, 0.8, 1.2 })
  {
    const auto written = [&](const cv::Mat& image, const std::string& text)
    {
      cv::Mat with = image.clone();
      cv::putText(with, text, { 150, 250 }, cv::FONT_HERSHEY_SIMPLEX, size, cv::Scalar(65535), 2);
      return with;
    };
    const cv::Mat first = written(Scene().expose(), "0000 12:30:00");
    const ImageReport& report = inspect(first);
    EXPECT_LE(report.stuck, 0.04);
    EXPECT_EQ(0.0, report.border);
    PixelRepair repair;
    repair.add(report, first.size());
    const cv::Mat later = Scene().expose(kAir, 4.0, 2);
    cv::Mat repaired, difference;
    repair.apply(written(later, "0017 12:34:58"), repaired);
    cv::absdiff(repaired, later, difference);
    double largest = 0.0;
    cv::minMaxLoc(difference, nullptr, &largest);
    EXPECT_LT(largest, 0.2 * kAir) << "letters are 65535, " << size;
  }
}

TEST_F(ImageInspectorTest, saturatedWindowsAreNoLetters)
{
  cv::Mat image = Scene().expose();
  for (const int x : { 130, 190, 250 })
  {
    cv::circle(image, { x, 250 }, 15, cv::Scalar(65535), cv::FILLED);
    cv::rectangle(image, cv::Rect(x, 290, 24, 40), cv::Scalar(65535), cv::FILLED);
  }
  EXPECT_LE(inspect(image).stuck, 1e-3);
}

TEST_F(ImageInspectorTest, smallThingsInThePatientAreNotStuck)
{
  // Metal beads and wires of any width, seen through a detector's blur.
  for (const double width : { 1.0, 2.0, 3.0, 5.0 })
  {
    const Shape metal = [width](double x, double y)
    {
      const double u = std::fmod(x, 40.0) - 20.0, v = std::fmod(y, 40.0) - 20.0;
      return std::hypot(u, v) <= 0.5 * width || std::abs(0.6 * x - 0.8 * y - 60.0) < 0.5 * width;
    };
    const ImageReport& report = inspect(Scene().cover(metal, 0.3).expose());
    EXPECT_LE(report.stuck, 3e-4) << width << " px";
    EXPECT_EQ(0.0, report.border) << width << " px";
  }
}

TEST_F(ImageInspectorTest, repairsStuckPixels)
{
  const cv::Mat image = Scene().expose();
  cv::Mat broken = image.clone();
  cv::RNG random(7);
  for (int n = 0; n < 800; ++n)
  {
    broken.at<std::uint16_t>(random.uniform(0, kSize), random.uniform(0, kSize)) = 65535;
  }
  broken.col(230) = cv::Scalar(0);
  PixelRepair repair;
  EXPECT_TRUE(repair.empty());
  repair.add(inspect(broken), broken.size());
  EXPECT_FALSE(repair.empty());
  cv::Mat repaired;
  repair.apply(broken, repaired);
  cv::Mat difference;
  cv::absdiff(image, repaired, difference);
  // As apart as two noisy pixels are, beside one another across a bone's edge at most.
  double largest = 0.0;
  cv::minMaxLoc(difference, nullptr, &largest);
  EXPECT_LT(largest, 0.2 * kAir);
  EXPECT_LT(cv::mean(difference.col(230))[0], 100.0);
  EXPECT_LE(inspect(repaired).stuck, 1e-4);
}

TEST_F(ImageInspectorTest, leavesImagesOfAnotherSizeOrTypeAsTheyAre)
{
  cv::Mat broken = Scene().expose();
  broken.col(230) = cv::Scalar(0);
  PixelRepair repair;
  repair.add(inspect(broken), broken.size());
  ASSERT_FALSE(repair.empty());
  for (const cv::Mat& other : { cv::Mat(40, 30, CV_16UC1, cv::Scalar(7)), cv::Mat(kSize, 231, CV_16UC1, cv::Scalar(7)),
                                cv::Mat(kSize, kSize, CV_16SC1, cv::Scalar(7)) })
  {
    cv::Mat repaired;
    repair.apply(other, repaired);
    ASSERT_EQ(other.size(), repaired.size());
    ASSERT_EQ(other.type(), repaired.type());
    EXPECT_EQ(0.0, cv::norm(other, repaired, cv::NORM_INF));
  }
}

TEST_F(ImageInspectorTest, tellsSaturation)
{
  // Air at the end of 8 bit.
  cv::Mat image;
  Scene().expose(2.0 * kAir).convertTo(image, CV_8U, 255.0 / kAir);
  const IntensityModel eight{ IntensityModel::Kind::COUNTS, 0.0, 255.0 };
  const auto air = [](double x, double) { return x > 480.0; };
  EXPECT_EQ(1.0, shareWith(inspect(image, eight), SATURATED_BRIGHT, air));
  EXPECT_EQ(cv::countNonZero(image == 255) / double(image.total()), inspector_.report().bright);
  EXPECT_EQ(0.0, inspector_.report().border);

  // A converter that ends at 12000, and one below which nothing is told, at 600 counts.
  image = Scene().expose();
  cv::min(image, 12000, image);
  cv::max(image, 600, image);
  EXPECT_NEAR(cv::countNonZero(image == 12000) / double(image.total()), inspect(image).bright, 1e-12);
  EXPECT_NEAR(cv::countNonZero(image == 600) / double(image.total()), inspector_.report().dark, 1e-12);
  EXPECT_GT(inspector_.report().dark, 0.01);

  // The tails of a real image are none.
  EXPECT_EQ(0.0, inspect(Scene().expose()).bright);
  EXPECT_EQ(0.0, inspector_.report().dark);
}

TEST_F(ImageInspectorTest, tellsWhatShowsNothing)
{
  const auto noise = [](double level, double sd, double blur)
  {
    cv::Mat values(kSize, kSize, CV_32FC1), image;
    cv::RNG(3).fill(values, cv::RNG::NORMAL, 0.0, sd);
    if (blur > 0.0)
    {
      cv::GaussianBlur(values, values, {}, blur);
    }
    values += level;
    values.convertTo(image, CV_16U);
    return image;
  };
  const auto expect_nothing = [&](const cv::Mat& image, const char* why)
  {
    const ImageReport& report = inspect(image);
    EXPECT_NE(std::string::npos, report.nothing.find(why)) << report.nothing;
    EXPECT_EQ(report.nothing, report.describe());
    EXPECT_EQ(1.0, report.border);
    EXPECT_EQ(0, cv::countNonZero(report.flaws != BORDER));
  };
  expect_nothing(cv::Mat(kSize, kSize, CV_16UC1, cv::Scalar(0)), "0 everywhere");
  expect_nothing(cv::Mat(kSize, kSize, CV_16UC1, cv::Scalar(65535)), "65535 everywhere");
  expect_nothing(noise(kOffset, 5.0, 0.0), "above the offset");
  expect_nothing(noise(80.0, 5.0, 0.0), "above the offset");
  expect_nothing(noise(5000.0, 70.0, 0.0), "noise");
  expect_nothing(noise(5000.0, 200.0, 1.0), "noise");
  // X-rays off: a column's own offset each.
  cv::Mat columns = noise(kOffset, 5.0, 0.0);
  for (int x = 0; x < columns.cols; ++x)
  {
    columns.col(x) += cv::Scalar(x / 37 % 3);
  }
  expect_nothing(columns, "above the offset");
  // A hundredth of the dose still shows something.
  EXPECT_EQ("", inspect(Scene().expose(0.01 * kAir, 1.0)).nothing);
}

TEST_F(ImageInspectorTest, judgesAPartAsItDoesTheWhole)
{
  cv::Mat image = Scene().cover([](double x, double y) { return x + y < 300.0; }, 0.02).expose();
  image.at<std::uint16_t>(300, 300) = 65535;
  const cv::Mat whole = inspect(image).flaws.clone();
  const cv::Rect part(90, 60, 333, 350);
  EXPECT_EQ(part, inspect(image, kCounts, part).part);
  EXPECT_LE(cv::countNonZero(whole(part) != inspector_.report().flaws), 2);
  EXPECT_NE(0, inspector_.report().flaws.at<std::uint8_t>(300 - part.y, 300 - part.x) & STUCK);
  cv::Mat usable;
  inspector_.report().usable(usable);
  EXPECT_EQ(cv::countNonZero((inspector_.report().flaws & kUnusable) == 0), cv::countNonZero(usable));
  EXPECT_NE(std::string::npos, inspector_.report().describe().find("% outside the field"));
}

TEST_F(ImageInspectorTest, namesWhatItCannotInspect)
{
  expectError<std::invalid_argument>([&] { inspect(cv::Mat(8, 64, CV_16UC1, cv::Scalar(1))); },
                                     { "64 x 8", "16 x 16" });
  expectError<std::invalid_argument>([&] { inspect(cv::Mat(64, 64, CV_8UC3, cv::Scalar())); }, { "type 16" });
  expectError<std::invalid_argument>(
      [&] {
        inspect(Scene().expose(), kCounts, { 400, 0, 200, 100 });
      },
      { "part", "200 x 100", "512 x 512" });
}

class ImageInspectorDataTest : public SharedDataTest
{
protected:
  ImageReport inspect(const std::string& file, double offset)
  {
    const cv::Mat image = cv::imread(folder_ + "/" + file, cv::IMREAD_UNCHANGED);
    EXPECT_FALSE(image.empty()) << file;
    return ImageInspector().inspect(image, { IntensityModel::Kind::COUNTS, offset, {} });
  }
};

TEST_F(ImageInspectorDataTest, simulatedThoraxIsUsableAsAWhole)
{
  for (const char* sequence : { "thorax_01", "thorax_02" })
  {
    for (const auto& entry : std::filesystem::directory_iterator(folder_ + "/sequences/" + sequence))
    {
      if (entry.path().extension() == ".png")
      {
        const ImageReport report =
            inspect("sequences/" + std::string(sequence) + "/" + entry.path().filename().string(), 100);
        EXPECT_EQ("", report.describe()) << entry.path();
      }
    }
  }
}

/// Bones along rows and columns, whatever way they lay: images turned by some degrees.
TEST_F(ImageInspectorDataTest, realBonesAreNoFaultyLines)
{
  for (const char* file :
       { "sequences/knee_real/detector_a_000.png", "sequences/knee_real/detector_b_020.png",
         "wrist_biplane/images/xr_rad_uln_cam01_UND.0099.tif", "wrist_biplane/images/xr_rad_uln_cam02_UND.0158.tif" })
  {
    cv::Mat image = cv::imread(folder_ + "/" + file, cv::IMREAD_UNCHANGED);
    ASSERT_FALSE(image.empty()) << file;
    cv::resize(image, image, {}, 0.25, 0.25, cv::INTER_AREA);  // so that noise hides nothing
    const cv::Point2f centre(0.5f * image.cols, 0.5f * image.rows);
    for (int angle = 0; angle < 180; angle += 2)
    {
      cv::Mat turned;
      cv::warpAffine(image, turned, cv::getRotationMatrix2D(centre, angle, 1.0), image.size(), cv::INTER_LINEAR);
      EXPECT_LE(ImageInspector().inspect(turned, { IntensityModel::Kind::COUNTS, 0.0, {} }).stuck, 2e-4)
          << file << " turned by " << angle << " degrees";
    }
  }
}

/// Seen in pictures of the flaws over the images: circles of 870 to 1010 px in 1024, and of 1700 in 1760; a square with
/// its corners cut. All of air that is saturated lies inside.
TEST_F(ImageInspectorDataTest, realFieldsAreFound)
{
  const auto expect_field = [&](const std::string& file, double from, double to)
  {
    const ImageReport report = inspect(file, 0.0);
    EXPECT_EQ("", report.nothing) << file;
    EXPECT_GE(report.border, from) << file;
    EXPECT_LE(report.border, to) << file;
    EXPECT_LE(report.stuck, 1e-4) << file;
    // Outside is one piece with the image's border, and of the field's middle half nothing is outside.
    const cv::Size size = report.flaws.size();
    const cv::Mat middle = report.flaws(cv::Rect(size.width / 4, size.height / 4, size.width / 2, size.height / 2));
    EXPECT_EQ(0, cv::countNonZero((middle & BORDER) != 0)) << file;
  };
  for (int i = 0; i < 40; i += 3)
  {
    for (const char* detector : { "a", "b" })
    {
      char name[64];
      std::snprintf(name, sizeof(name), "sequences/knee_real/detector_%s_%03d.png", detector, i);
      expect_field(name, 0.23, 0.27);
    }
  }
  for (const char* frame : { "0002", "0099", "0158" })
  {
    for (const char* camera : { "01", "02" })
    {
      expect_field("wrist_biplane/images/xr_rad_uln_cam" + std::string(camera) + "_UND." + frame + ".tif", 0.22, 0.3);
    }
  }
  for (const char* view : { "m20", "m16", "m12", "m08", "m04", "p00", "p04", "p08", "p12", "p16", "p20" })
  {
    expect_field("sequences/portal_real/images/portal_" + std::string(view) + ".png", 0.09, 0.13);
  }
}
}  // namespace
}  // namespace xray_tracking
