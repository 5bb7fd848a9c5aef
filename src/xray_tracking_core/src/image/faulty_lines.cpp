#include "faulty_lines.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>

#include "xray_tracking_core/image/image_inspector.h"

namespace xray_tracking
{
namespace
{
constexpr int kReach = 3;   // [px]
constexpr int kBehind = 2;  // [px]: of what goes on behind what is beside a line
/// Of a line's pixels, those on one side of both neighbours: by chance a third, within 0.05 of 100 pixels.
constexpr double kShare = 0.85;
constexpr std::size_t kFewest = 100;
constexpr double kMostOdd = 0.25;  // of all lines
/// Of the step from a faulty line to what is beside it, what goes on behind that. A detector's line is a step and
/// nothing else; what is thin in a patient is as blurred as all that a detector shows: with a blur of 0.8 px a thread
/// one pixel wide has 0.8, the ridge of a cortex 2.
constexpr float kGoesOn = 0.4f;
constexpr int kEvery = 8;  // of the lines that tell what is usual

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

float FaultyLines::rise(const cv::Mat& values, const cv::Mat& flaws, const cv::Range& columns, int from, int to)
{
  apart_.clear();
  const float* first = values.ptr<float>(from);
  const float* second = values.ptr<float>(to);
  const std::uint8_t* flawed[] = { flaws.ptr(from), flaws.ptr(to) };
  for (int x = columns.start; x < columns.end; ++x)
  {
    if (((flawed[0][x] | flawed[1][x]) & kUnusable) == 0)
    {
      apart_.push_back(second[x] - first[x]);
    }
  }
  if (apart_.empty())
  {
    return 0.f;
  }
  // The median of an image of 8 bit would be a whole number.
  const auto quarter = static_cast<std::ptrdiff_t>(apart_.size() / 4);
  std::nth_element(apart_.begin(), apart_.begin() + quarter, apart_.end());
  std::nth_element(apart_.begin() + quarter, apart_.end() - 1 - quarter, apart_.end());
  return std::accumulate(apart_.begin() + quarter, apart_.end() - quarter, 0.f) /
         static_cast<float>(apart_.size() - 2 * static_cast<std::size_t>(quarter));
}

bool FaultyLines::isStep(const cv::Mat& values, const cv::Mat& flaws, const cv::Range& columns, const cv::Range& group)
{
  const int before = group.start - 1, behind = group.end;
  const int far_before = std::max(0, before - kBehind), far_behind = std::min(values.rows - 1, behind + kBehind);
  if (group.size() > kReach)
  {
    return false;
  }
  const float first = rise(values, flaws, columns, before, group.start);
  const float last = rise(values, flaws, columns, behind, group.end - 1);
  // On a slope both sides together.
  const float beyond =
      rise(values, flaws, columns, far_before, before) + rise(values, flaws, columns, far_behind, behind);
  return first * last > 0.f && beyond / (first + last) < kGoesOn;
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
        for (auto line = odd_.begin(); line != odd_.end();)
        {
          cv::Range group(line->y, line->y);
          while (line != odd_.end() && line->y == group.end)
          {
            ++group.end;
            ++line;
          }
          if (isStep(values, flaws, columns, group))
          {
            faulty(group, columns).setTo(STUCK);
          }
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
