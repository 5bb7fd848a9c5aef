#include "pixel_rows.h"

#include <random>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
constexpr int kWidth = 83;  // no multiple of what is done at once
constexpr int kHeight = 71;

float uniform(std::mt19937& random)
{
  return std::uniform_real_distribution<float>(-1.0f, 1.0f)(random);
}

PixelRows randomRows(int count, std::mt19937& random)
{
  return PixelRows::NullaryExpr(count, kPixelRow, [&](Eigen::Index, Eigen::Index) { return uniform(random); });
}

Eigen::VectorXf randomColumn(int count, std::mt19937& random)
{
  return Eigen::VectorXf::NullaryExpr(count, [&](Eigen::Index) { return uniform(random); });
}
}  // namespace

class RunningBlurTest : public testing::TestWithParam<double>
{
};

TEST_P(RunningBlurTest, IsNearlyAGaussian)
{
  const double sigma = GetParam();
  cv::Mat image(kHeight, kWidth, CV_32FC1, 0.0f);
  std::mt19937 random(3);
  const cv::Rect middle(30, 25, 20, 20);
  for (int row = middle.y; row < middle.br().y; ++row)
  {
    for (int column = middle.x; column < middle.br().x; ++column)
    {
      image.at<float>(row, column) = uniform(random) + 1.0f;
    }
  }
  cv::Mat gaussian;
  const int reach = static_cast<int>(std::ceil(5.0 * sigma));
  cv::GaussianBlur(image, gaussian, cv::Size(2 * reach + 1, 2 * reach + 1), sigma, sigma, cv::BORDER_CONSTANT);
  const RunningBlur blur(sigma);
  blur(image);
  // Three means are within 3 % of the Gaussian's peak everywhere; of a square of 20 pixels less is left of that. The
  // sums are the same as long as nothing leaves the image.
  EXPECT_LT(cv::norm(image, gaussian, cv::NORM_INF), 0.03 * cv::norm(gaussian, cv::NORM_INF));
  EXPECT_NEAR(cv::sum(image)[0], cv::sum(gaussian)[0], 1e-3 * cv::sum(gaussian)[0]);
}

INSTANTIATE_TEST_SUITE_P(Widths, RunningBlurTest, testing::Values(1.0, 2.0, 2.3, 4.0, 6.4));

TEST(RunningBlur, VarianceIsMet)
{
  for (const double sigma : { 0.9, 1.5, 3.1, 5.7 })
  {
    cv::Mat image(kHeight, kWidth, CV_32FC1, 0.0f);
    image.at<float>(35, 41) = 1.0f;
    const RunningBlur blur(sigma);
    blur(image);
    double across = 0.0;
    double down = 0.0;
    for (int row = 0; row < kHeight; ++row)
    {
      for (int column = 0; column < kWidth; ++column)
      {
        across += image.at<float>(row, column) * std::pow(column - 41, 2);
        down += image.at<float>(row, column) * std::pow(row - 35, 2);
      }
    }
    EXPECT_NEAR(across, sigma * sigma, 1e-3 * sigma * sigma);
    EXPECT_NEAR(down, sigma * sigma, 1e-3 * sigma * sigma);
  }
}

TEST(RunningBlur, BeyondTheImageIsNothingAndEveryNumberIsForItself)
{
  std::mt19937 random(4);
  const PixelRows before = randomRows(kWidth * kHeight, random);
  const RunningBlur blur(3.7);
  const cv::Rect whole(0, 0, kWidth, kHeight);
  const cv::Mat ones(whole.size(), CV_32FC1, cv::Scalar(1.0));
  const PixelRows rows = before - blur.withoutMeans(before, whole.size(), ones, whole);
  for (int number = 0; number < kPixelRow; ++number)
  {
    // The same image with zeros around it.
    constexpr int kAround = 25;
    cv::Mat image(kHeight + 2 * kAround, kWidth + 2 * kAround, CV_32FC1, 0.0f);
    for (int n = 0; n < kWidth * kHeight; ++n)
    {
      image.at<float>(kAround + n / kWidth, kAround + n % kWidth) = before(n, number);
    }
    blur(image);
    float worst = 0.0f;
    for (int n = 0; n < kWidth * kHeight; ++n)
    {
      const float there = image.at<float>(kAround + n / kWidth, kAround + n % kWidth);
      worst = std::max(worst, std::abs(there - rows(n, number)));
    }
    // Passes that go on beyond the border come back from there: small beside the means of noise, 0.1.
    EXPECT_LT(worst, 0.1f) << "number " << number;
    const float inside = image.at<float>(kAround + 35, kAround + 41);
    EXPECT_NEAR(inside, rows(35 * kWidth + 41, number), 1e-5f);
  }
}

TEST(PixelRows, WithoutMeans)
{
  std::mt19937 random(5);
  const PixelRows rows = randomRows(12 * 9, random);
  cv::Mat factors(9, 12, CV_32FC1);
  cv::randu(factors, 0.0, 2.0);
  const RunningBlur blur(1.3);
  for (const cv::Rect& inner : { cv::Rect(2, 3, 7, 5), cv::Rect(3, 1, 4, 6), cv::Rect(0, 0, 12, 9) })
  {
    const PixelRows left = blur.withoutMeans(rows, cv::Size(12, 9), factors, inner);
    ASSERT_EQ(left.rows(), inner.area());
    for (int number = 0; number < kPixelRow; ++number)
    {
      cv::Mat means(9, 12, CV_32FC1);
      Eigen::Map<Eigen::VectorXf>(means.ptr<float>(), 12 * 9) = rows.col(number);
      blur(means);
      for (int n = 0; n < inner.area(); ++n)
      {
        const int row = inner.y + n / inner.width;
        const int column = inner.x + n % inner.width;
        const float expected =
            rows(row * 12 + column, number) - factors.at<float>(row, column) * means.at<float>(row, column);
        EXPECT_NEAR(left(n, number), expected, 1e-5f)
            << inner << ", number " << number << " at " << column << ", " << row;
      }
    }
  }
}

TEST(PixelRows, MadeOfTheirParts)
{
  std::mt19937 random(8);
  constexpr int kCount = 37;
  const Eigen::VectorXf twists = randomColumn(6 * kCount, random);
  const Eigen::VectorXf others = randomColumn(6 * kCount, random);
  const Eigen::VectorXf by_saturation = randomColumn(kCount, random);
  const Eigen::VectorXf image = randomColumn(kCount, random);
  const Eigen::VectorXf factors = randomColumn(kCount, random);
  const Eigen::VectorXf counts = randomColumn(kCount, random);
  for (const bool both : { false, true })
  {
    const PixelRows rows = makeRows({ twists.data(), both ? others.data() : nullptr, by_saturation.data(), image.data(),
                                      factors.data(), counts.data() },
                                    kCount);
    ASSERT_EQ(rows.rows(), kCount);
    for (int n = 0; n < kCount; ++n)
    {
      Eigen::Matrix<float, 1, kPixelRow> expected = Eigen::Matrix<float, 1, kPixelRow>::Zero();
      expected.head<6>() = factors[n] * twists.segment<6>(6 * n);
      if (both)
      {
        expected.segment<6>(6) = factors[n] * others.segment<6>(6 * n);
      }
      expected[both ? 12 : 6] = by_saturation[n];
      expected[kPixelRow - 1] = image[n];
      EXPECT_LT((rows.row(n) - counts[n] * expected).norm(), 1e-6f) << n;
    }
  }
}

TEST(PixelRows, ProjectOutLeavesWhatIsAcrossTheImageAndAConstant)
{
  std::mt19937 random(6);
  constexpr int kCount = 901;
  Eigen::VectorXf valid = Eigen::VectorXf::Ones(kCount);
  valid.segment(100, 57).setZero();
  Eigen::VectorXf image = randomColumn(kCount, random).cwiseProduct(valid);
  image -= image.sum() / valid.sum() * valid;
  image.normalize();
  PixelRows rows = valid.asDiagonal() * randomRows(kCount, random);
  const PixelRows before = rows;
  projectOut(image, valid, 3.0f, rows);
  EXPECT_LT((image.transpose() * rows).norm(), 1e-4f);
  EXPECT_LT((valid.transpose() * rows).norm(), 1e-3f);
  const PixelRows taken = rows / 3.0f - before;
  // What was taken is made of the two alone.
  const Eigen::VectorXf constant = valid.normalized();
  EXPECT_LT((taken - image * (image.transpose() * taken) - constant * (constant.transpose() * taken)).norm(), 1e-4f);
}

TEST(PixelRows, WeighedSums)
{
  std::mt19937 random(7);
  constexpr int kCount = 1237;
  const PixelRows rows = randomRows(kCount, random);
  const Eigen::VectorXf weights = randomColumn(kCount, random).cwiseAbs();
  const Eigen::VectorXf differences = randomColumn(kCount, random);
  const WeighedSums sums = weighedSums(rows, weights, differences);
  const Eigen::MatrixXd exact = rows.cast<double>();
  const Eigen::VectorXd by = weights.cast<double>();
  EXPECT_LT((sums.squares - exact.transpose() * by.asDiagonal() * exact).norm(), 1e-4 * sums.squares.norm());
  EXPECT_LT((sums.products - exact.transpose() * by.cwiseProduct(differences.cast<double>())).norm(), 1e-3);
}
}  // namespace xray_tracking
