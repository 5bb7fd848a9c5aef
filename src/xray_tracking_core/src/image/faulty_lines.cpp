#include "faulty_lines.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "xray_tracking_core/image/image_inspector.h"

namespace xray_tracking
{
namespace
{
constexpr int kReach = 3;  // [px]
/// Of a line's pixels, those on one side of both neighbours: by chance a third, within 0.05 of 100 pixels.
constexpr double kShare = 0.85;
constexpr std::size_t kFewest = 100;
constexpr double kMostOdd = 0.25;  // of all lines
constexpr int kEvery = 8;          // of the lines that tell what is usual

float medianOf(std::vector<float>& values)
{
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}
}  // namespace

void FaultyLines::compare(const cv::Mat& values, const cv::Mat& flaws, const cv::Mat& faulty, const cv::Range& columns,
                          int y, int reach)
{
  const float* rows[] = { values.ptr<float>(y - reach), values.ptr<float>(y), values.ptr<float>(y + reach) };
  const std::uint8_t* flawed[] = { flaws.ptr(y - reach), flaws.ptr(y), flaws.ptr(y + reach) };
  // What is next to a faulty line on a slope would seem odd against it.
  if ((faulty.at<std::uint8_t>(y - reach, columns.start) | faulty.at<std::uint8_t>(y + reach, columns.start)) != 0)
  {
    return;
  }
  std::size_t pixels = 0, brighter = 0, darker = 0;
  const auto for_pixels = [&](auto visit)
  {
    for (int x = columns.start; x < columns.end; ++x)
    {
      if ((flawed[0][x] | (flawed[1][x] & BORDER) | flawed[2][x]) == 0)
      {
        visit(rows[1][x] - rows[0][x], rows[1][x] - rows[2][x]);
      }
    }
  };
  for_pixels(
      [&](float before, float behind)
      {
        ++pixels;
        brighter += before > 0.f && behind > 0.f;
        darker += before < 0.f && behind < 0.f;
      });
  if (pixels < kFewest)
  {
    return;
  }
  if (y % kEvery == 0)
  {
    apart_.clear();
    for_pixels([&](float before, float) { apart_.push_back(std::abs(before)); });
    usual_.push_back(medianOf(apart_));
  }
  if (static_cast<double>(std::max(brighter, darker)) > kShare * static_cast<double>(pixels))
  {
    apart_.clear();
    across_.clear();
    for_pixels(
        [&](float before, float behind)
        {
          apart_.push_back(std::min(std::abs(before), std::abs(behind)));
          across_.push_back(std::abs(before - behind));
        });
    odd_.push_back({ y, medianOf(apart_), medianOf(across_) });
  }
}

void FaultyLines::markRows(const cv::Mat& values, const cv::Mat& flaws, cv::Mat& faulty)
{
  faulty.create(values.size(), CV_8UC1);
  faulty.setTo(0);
  for (const cv::Range& columns : { cv::Range(0, values.cols / 2), cv::Range(values.cols / 2, values.cols) })
  {
    for (int reach = 1; reach <= kReach; ++reach)
    {
      odd_.clear();
      usual_.clear();
      for (int y = reach; y + reach < values.rows; ++y)
      {
        compare(values, flaws, faulty, columns, y, reach);
      }
      const float usual = usual_.empty() ? 0.f : medianOf(usual_);
      const auto is_common = [usual](const Line& line) { return line.apart <= std::max(usual, line.across); };
      odd_.erase(std::remove_if(odd_.begin(), odd_.end(), is_common), odd_.end());
      if (static_cast<double>(odd_.size()) < kMostOdd * values.rows)
      {
        for (const Line& line : odd_)
        {
          faulty(cv::Range(line.y, line.y + 1), columns).setTo(STUCK);
        }
      }
    }
  }
}

void FaultyLines::mark(const cv::Mat& image, const cv::Rect& part, cv::Mat& flaws)
{
  image(part).convertTo(values_, CV_32F);
  markRows(values_, flaws, faulty_);
  cv::transpose(values_, turned_values_);
  cv::transpose(flaws, turned_flaws_);
  markRows(turned_values_, turned_flaws_, turned_faulty_);
  for (int y = 0; y < flaws.rows; ++y)
  {
    std::uint8_t* flaw = flaws.ptr(y);
    const std::uint8_t* faulty = faulty_.ptr(y);
    for (int x = 0; x < flaws.cols; ++x)
    {
      const bool border = (flaw[x] & BORDER) != 0;
      flaw[x] |= border ? 0 : static_cast<std::uint8_t>(faulty[x] | turned_faulty_.at<std::uint8_t>(x, y));
    }
  }
}
}  // namespace xray_tracking
