#include "image_similarity.h"

#include <cmath>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
/// All values are sums of few floats.
constexpr double kRounding = 1e-5;

TEST(NormalisedMutualInformation, isTwoWhereOneImageGivesTheOther)
{
  cv::Mat a(16, 16, CV_32FC1), permuted(16, 16, CV_32FC1);
  for (int i = 0; i < 256; ++i)
  {
    a.at<float>(i / 16, i % 16) = static_cast<float>(i % 8);
    permuted.at<float>(i / 16, i % 16) = static_cast<float>((3 * i + 5) % 8);  // any one-to-one change of grey values
  }
  NormalisedMutualInformation nmi(8);
  EXPECT_NEAR(nmi(a, a), 2.0, kRounding);
  EXPECT_NEAR(nmi(a, permuted), 2.0, kRounding);
}

TEST(NormalisedMutualInformation, isOneOfIndependentImages)
{
  // Every pair of values as often as any other.
  cv::Mat a(8, 8, CV_32FC1), b(8, 8, CV_32FC1);
  for (int y = 0; y < 8; ++y)
  {
    for (int x = 0; x < 8; ++x)
    {
      a.at<float>(y, x) = static_cast<float>(x);
      b.at<float>(y, x) = static_cast<float>(y);
    }
  }
  NormalisedMutualInformation nmi(8);
  EXPECT_NEAR(nmi(a, b), 1.0, kRounding);
  EXPECT_NEAR(nmi(cv::Mat::zeros(8, 8, CV_32FC1), cv::Mat::ones(8, 8, CV_32FC1)), 1.0, kRounding);
}

TEST(NormalisedMutualInformation, agreesWithAKnownHistogram)
{
  // Joint probabilities 3/8, 1/8, 0, 4/8: H(a) = H(b) ... by hand: p(a) = (1/2, 1/2), p(b) = (3/8, 5/8).
  cv::Mat a(1, 8, CV_32FC1, cv::Scalar(0.0)), b(1, 8, CV_32FC1, cv::Scalar(1.0));
  a(cv::Rect(4, 0, 4, 1)) = 1.0;
  b(cv::Rect(0, 0, 3, 1)) = 0.0;
  const auto plogp = [](double p) { return -p * std::log(p); };
  const double of_a = std::log(2.0);
  const double of_b = plogp(3.0 / 8.0) + plogp(5.0 / 8.0);
  const double joint = plogp(3.0 / 8.0) + plogp(1.0 / 8.0) + plogp(4.0 / 8.0);
  NormalisedMutualInformation nmi(2);
  EXPECT_NEAR(nmi(a, b), (of_a + of_b) / joint, kRounding);
}

TEST(NormalisedMutualInformation, sharesValuesBetweenBins)
{
  // b at 0.25 counts as 3/4 of bin 0 and 1/4 of bin 1 whatever a is: independent, until a decides it.
  cv::Mat a(1, 8, CV_32FC1, cv::Scalar(0.0)), b(1, 8, CV_32FC1, cv::Scalar(0.25));
  a(cv::Rect(4, 0, 4, 1)) = 1.0;
  NormalisedMutualInformation nmi(2);
  EXPECT_NEAR(nmi(a, b), 1.0, kRounding);
  b(cv::Rect(4, 0, 4, 1)) = 0.75;
  const auto plogp = [](double p) { return -p * std::log(p); };
  EXPECT_NEAR(nmi(a, b), 2.0 * std::log(2.0) / (2.0 * plogp(3.0 / 8.0) + 2.0 * plogp(1.0 / 8.0)), kRounding);
}

TEST(NormalisedMutualInformation, countsValuesBeyondItsBinsAtTheirEnds)
{
  cv::Mat a(1, 4, CV_32FC1), far(1, 4, CV_32FC1);
  a.at<float>(0) = a.at<float>(1) = 0.f;
  a.at<float>(2) = a.at<float>(3) = 3.f;
  far.at<float>(0) = far.at<float>(1) = -50.f;
  far.at<float>(2) = far.at<float>(3) = 1e6f;
  NormalisedMutualInformation nmi(4);
  EXPECT_NEAR(nmi(a, far), 2.0, kRounding);
  EXPECT_NEAR(nmi(far, a), 2.0, kRounding);
}

TEST(GradientCorrelation, ignoresGainAndOffsetAndSign)
{
  cv::Mat a(30, 40, CV_32FC1);
  cv::RNG(4).fill(a, cv::RNG::NORMAL, 0.0, 1.0);
  const cv::Mat scaled = 3.0 * a + 7.0, negative = -a;
  EXPECT_NEAR(gradientCorrelation(a, scaled), 1.0, kRounding);
  EXPECT_NEAR(gradientCorrelation(a, negative), -1.0, kRounding);
}

TEST(GradientCorrelation, isTheMeanOfBothDirections)
{
  // Along x the same wave, along y waves a quarter apart, over whole periods: correlations 1 and 0.
  constexpr int kPeriod = 8;
  cv::Mat a(4 * kPeriod + 2, 4 * kPeriod + 2, CV_32FC1), b(a.size(), CV_32FC1);
  for (int y = 0; y < a.rows; ++y)
  {
    for (int x = 0; x < a.cols; ++x)
    {
      const double wave = std::sin(2.0 * M_PI * x / kPeriod);
      a.at<float>(y, x) = static_cast<float>(wave + std::sin(2.0 * M_PI * y / kPeriod));
      b.at<float>(y, x) = static_cast<float>(wave + std::cos(2.0 * M_PI * y / kPeriod));
    }
  }
  EXPECT_NEAR(gradientCorrelation(a, b), 0.5, kRounding);
}

TEST(GradientCorrelation, isZeroWithoutGradients)
{
  const cv::Mat constant = cv::Mat::ones(10, 10, CV_32FC1);
  EXPECT_EQ(gradientCorrelation(constant, constant), 0.0);
}

TEST(Agreement, leavesOutWhatIsNotTheTemplate)
{
  cv::Mat a(60, 80, CV_32FC1), noise(60, 80, CV_32FC1);
  cv::RNG random(4);
  random.fill(a, cv::RNG::NORMAL, 0.0, 1.0);
  random.fill(noise, cv::RNG::NORMAL, 0.0, 0.5);
  cv::Mat b = 2.0 * a + noise + 0.3;
  const double correlation = 2.0 / std::sqrt(4.0 + 0.25);
  const Agreement whole = agreementOf(a, b);
  // 4800 values give a correlation of this size to (1 - 0.97^2) / sqrt(4800), 0.001; 0.3 % lie beyond three deviations.
  EXPECT_NEAR(whole.correlation, correlation, 0.005);
  EXPECT_NEAR(whole.share, 0.997, 0.003);
  const cv::Rect plate(10, 5, 40, 30);  // a quarter
  b(plate) = 25.0;
  const Agreement covered = agreementOf(a, b);
  EXPECT_NEAR(covered.correlation, correlation, 0.005);
  EXPECT_NEAR(covered.share, 0.75, 0.01);
  EXPECT_EQ(cv::countNonZero(covered.inliers(plate)), 0);
}

TEST(Agreement, isNoneOfConstantImages)
{
  const cv::Mat constant = cv::Mat::ones(10, 10, CV_32FC1);
  EXPECT_EQ(agreementOf(constant, constant).correlation, 0.0);
  EXPECT_EQ(agreementOf(constant, constant).share, 1.0);
}
}  // namespace
}  // namespace xray_tracking
