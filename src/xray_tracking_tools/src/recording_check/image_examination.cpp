#include "image_examination.h"

#include <algorithm>
#include <cstdio>

namespace xray_tracking
{
namespace
{
// Shares of what is seen of the target from which one is told of it; less than that trackers and registration leave out
// without harm.
constexpr double kSaturated = 0.02;
constexpr double kStuck = 0.01;
constexpr double kCollimated = 0.01;
constexpr double kDeadLine = 0.6;  // share of a line's pixels inside the field that are stuck

std::string percent(double share, const char* words)
{
  char text[80];
  std::snprintf(text, sizeof(text), "%.*g %% %s", share < 0.995 ? 2 : 3, 100.0 * share, words);
  return text;
}

/// Share of the flawed pixels of a part of the report's.
double shareOf(const ImageReport& report, const cv::Rect& part, std::uint8_t flaws, std::uint8_t unless = 0)
{
  const cv::Mat seen = report.flaws(part);
  int count = 0;
  for (int y = 0; y < seen.rows; ++y)
  {
    count += static_cast<int>(std::count_if(seen.ptr(y), seen.ptr(y) + seen.cols,
                                            [&](std::uint8_t f) { return (f & flaws) != 0 && (f & unless) == 0; }));
  }
  return static_cast<double>(count) / static_cast<double>(part.area());
}

/// "row 100, 101" of the lines that are stuck in most of the field; at most five are named.
std::string deadLines(const cv::Mat& flaws, const char* name, int& count)
{
  std::string words;
  for (int y = 0; y < flaws.rows; ++y)
  {
    const std::uint8_t* line = flaws.ptr(y);
    const auto inside = std::count_if(line, line + flaws.cols, [](std::uint8_t f) { return (f & BORDER) == 0; });
    const auto stuck = std::count_if(line, line + flaws.cols, [](std::uint8_t f) { return (f & kUnusable) == STUCK; });
    if (4 * inside >= flaws.cols && static_cast<double>(stuck) > kDeadLine * static_cast<double>(inside))
    {
      words += count > 5 ? "" : (words.empty() ? name : ", ") + std::to_string(y);
      ++count;
    }
  }
  return words;
}
}  // namespace

bool ImageExamination::add(const cv::Mat& image, std::int64_t stamp_ns, Tally& tally)
{
  const UsableImage seen = pixels_.look(image, intensity_, stamp_ns);
  switch (seen.kind)
  {
    case ImageFault::NONE:
      break;
    case ImageFault::NOTHING:
      tally.add("image_nothing", thing_, stamp_ns, seen.fault);
      return false;
    case ImageFault::REPEATED:
      tally.add("image_frozen", thing_, stamp_ns, seen.fault);
      return false;
    case ImageFault::MIXED_ROWS:
      tally.add("image_mixed_rows", thing_, stamp_ns, seen.fault);
      return false;
    case ImageFault::NO_IMAGE:
      tally.add("image_unreadable", thing_, stamp_ns, seen.fault);
      return false;
  }
  judge(inspector_.inspect(image, intensity_), stamp_ns, tally);
  return true;
}

void ImageExamination::judge(const ImageReport& report, std::int64_t stamp_ns, Tally& tally) const
{
  int dead = 0;
  const std::string rows = deadLines(report.flaws, "row ", dead);
  const std::string columns = deadLines(report.flaws.t(), "column ", dead);
  if (dead > 0)
  {
    tally.add("image_dead_lines", thing_, stamp_ns, rows + (rows.empty() || columns.empty() ? "" : ", ") + columns,
              dead);
  }
  const cv::Rect whole(cv::Point(), report.flaws.size());
  const cv::Rect part = target_.empty() ? whole : target_ & whole;
  if (part.empty())
  {
    return;
  }
  const double saturated = shareOf(report, part, SATURATED_BRIGHT | SATURATED_DARK, kUnusable);
  if (saturated > kSaturated)
  {
    tally.add("image_saturated", thing_, stamp_ns,
              percent(saturated, shareOf(report, part, SATURATED_BRIGHT, kUnusable) > 0.5 * saturated
                                     ? "saturated by too much light"
                                     : "saturated by too little light"),
              saturated);
  }
  const double stuck = shareOf(report, part, STUCK);
  if (stuck > kStuck && dead == 0)
  {
    tally.add("image_stuck", thing_, stamp_ns, percent(stuck, "stuck or written over"), stuck);
  }
  const double collimated = shareOf(report, part, BORDER);
  if (collimated > kCollimated && !target_.empty())
  {
    tally.add("image_collimated", thing_, stamp_ns,
              percent(collimated, "of what is seen of the target outside the field"), collimated);
  }
}
}  // namespace xray_tracking
