#include "xray_tracking_core/image/repeated_image.h"

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
cv::Mat noise(int type, std::uint64_t seed)
{
  cv::Mat image(61, 67, type);  // rows of a length that no word divides
  cv::RNG(seed).fill(image, cv::RNG::UNIFORM, 0, 200);
  return image;
}

TEST(RepeatedImageTest, everyBitOfOneInEightRowsCounts)
{
  for (const int type : { CV_8UC1, CV_16UC1 })
  {
    // Rows of which next to nothing differs from pixel to pixel count as a whole.
    cv::Mat image(61, 67, type, cv::Scalar(9));
    RepeatedImageCheck check;
    EXPECT_FALSE(check.add(image, 0));
    EXPECT_EQ(0, check.add(image.clone(), 1));
    std::int64_t images = 1;
    for (int n = 0; n < 8; ++n)
    {
      for (std::size_t byte = 0; byte < image.cols * image.elemSize(); byte += 5)
      {
        cv::Mat other = image.clone();
        other.ptr(8 * n + n % 2)[byte] ^= static_cast<std::uint8_t>(1 << byte % 8);
        EXPECT_FALSE(check.add(other, images)) << "row " << n << ", byte " << byte;
        EXPECT_EQ(images, check.add(other, 1000));
        ++images;
      }
    }
  }
}

TEST(RepeatedImageTest, whatIsTheSameIsToldWhereverItLies)
{
  const cv::Mat image = noise(CV_16UC1, 3);
  cv::Mat wide(image.rows, image.cols + 9, CV_16UC1, cv::Scalar(7));
  image.copyTo(wide.colRange(0, image.cols));
  RepeatedImageCheck check;
  EXPECT_FALSE(check.add(image, 1));
  EXPECT_EQ(1, check.add(wide.colRange(0, image.cols), 2));
  EXPECT_FALSE(check.add(image.reshape(0, image.cols), 3)) << "of another size";
}

/// A grabber that is late: rows of an image before below the new ones, or in every other row.
TEST(RepeatedImageTest, partsAreToldToo)
{
  const auto fresh = [](std::uint64_t seed)
  {
    cv::Mat image(512, 400, CV_16UC1);
    cv::RNG(seed).fill(image, cv::RNG::NORMAL, 2000, 20);
    image.rowRange(0, 100) = cv::Scalar(65535);  // saturated air, and black at the side
    image.colRange(0, 60) = cv::Scalar(0);
    return image;
  };
  for (const auto mixed : { +[](int y) { return y >= 340; }, +[](int y) { return y % 2 == 0; },
                            +[](int y) { return y % 2 == 1; }, +[](int y) { return y < 280; } })
  {
    RepeatedImageCheck check;
    EXPECT_FALSE(check.add(fresh(1), 1));
    EXPECT_FALSE(check.add(fresh(2), 2));
    const cv::Mat old = fresh(2);
    cv::Mat image = fresh(3);
    for (int y = 0; y < image.rows; ++y)
    {
      if (mixed(y))
      {
        old.row(y).copyTo(image.row(y));
      }
    }
    EXPECT_EQ(2, check.add(image, 3));
    EXPECT_FALSE(check.add(fresh(4), 4));
  }
}

/// Burnt-in text above a narrow field: its rows are the same in every exposure.
TEST(RepeatedImageTest, textThatStaysIsNoRepeat)
{
  const cv::Mat text = noise(CV_8UC1, 7);
  const auto fresh = [&](std::uint64_t seed)
  {
    cv::Mat image(text.size(), CV_8UC1, cv::Scalar(0));
    text.rowRange(0, text.rows / 4).copyTo(image.rowRange(0, text.rows / 4));
    cv::RNG(seed).fill(image.rowRange(text.rows / 2, text.rows), cv::RNG::NORMAL, 100, 6);
    return image;
  };
  RepeatedImageCheck check;
  for (int n = 1; n < 6; ++n)
  {
    EXPECT_FALSE(check.add(fresh(n), n));
  }
}

TEST(RepeatedImageTest, tellsTheExposureThatIsRepeated)
{
  RepeatedImageCheck check;
  for (int i = 0; i < 10; ++i)
  {
    EXPECT_FALSE(check.add(noise(CV_16UC1, 10 + static_cast<std::uint64_t>(i)), 1000 + i));
  }
  EXPECT_EQ(1009, check.add(noise(CV_16UC1, 19), 1010)) << "the last one";
  EXPECT_EQ(1009, check.add(noise(CV_16UC1, 19), 1011)) << "once more";
  EXPECT_EQ(1006, check.add(noise(CV_16UC1, 16), 1012)) << "one before";
  EXPECT_FALSE(check.add(noise(CV_16UC1, 20), 1013));
  check.reset();
  EXPECT_FALSE(check.add(noise(CV_16UC1, 16), 5));
}

TEST(RepeatedImageTest, forgetsWhatIsLongAgo)
{
  RepeatedImageCheck check;
  cv::Mat image(16, 16, CV_16UC1, cv::Scalar(0));
  const auto add = [&](std::size_t number)
  {
    image.at<std::uint16_t>(9, 3) = static_cast<std::uint16_t>(number);
    return check.add(image, static_cast<std::int64_t>(number));
  };
  for (std::size_t i = 0; i <= RepeatedImageCheck::kRemembered; ++i)
  {
    EXPECT_FALSE(add(i));
  }
  EXPECT_EQ(1, add(1));
  EXPECT_EQ(RepeatedImageCheck::kRemembered, add(RepeatedImageCheck::kRemembered));
  EXPECT_FALSE(add(0));
}
}  // namespace
}  // namespace xray_tracking
