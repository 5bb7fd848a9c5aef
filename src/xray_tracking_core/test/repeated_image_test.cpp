#include "xray_tracking_core/image/repeated_image.h"

#include <set>

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

TEST(RepeatedImageTest, everyBitOfEveryEighthRowCounts)
{
  for (const int type : { CV_8UC1, CV_16UC1 })
  {
    const cv::Mat image = noise(type, 3);
    std::set<std::uint64_t> seen{ imageFingerprint(image) };
    std::size_t images = 1;
    for (int row = 0; row < image.rows; row += 8)
    {
      for (std::size_t byte = 0; byte < image.cols * image.elemSize(); ++byte)
      {
        cv::Mat other = image.clone();
        other.ptr(row)[byte] ^= static_cast<std::uint8_t>(1 << byte % 8);
        seen.insert(imageFingerprint(other));
        ++images;
      }
    }
    EXPECT_EQ(images, seen.size());
  }
}

TEST(RepeatedImageTest, whatIsTheSameIsToldWhereverItLies)
{
  const cv::Mat image = noise(CV_16UC1, 3);
  cv::Mat wide(image.rows, image.cols + 9, CV_16UC1, cv::Scalar(7));
  image.copyTo(wide.colRange(0, image.cols));
  EXPECT_EQ(imageFingerprint(image), imageFingerprint(image.clone()));
  EXPECT_EQ(imageFingerprint(image), imageFingerprint(wide.colRange(0, image.cols)));
  EXPECT_NE(imageFingerprint(image), imageFingerprint(image.reshape(0, image.cols)));
  cv::Mat swapped = image.clone();
  image.row(0).copyTo(swapped.row(8));
  image.row(8).copyTo(swapped.row(0));
  EXPECT_NE(imageFingerprint(image), imageFingerprint(swapped));
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
    image.at<std::uint16_t>(8, 3) = static_cast<std::uint16_t>(number);
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
