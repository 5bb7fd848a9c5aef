#include "frame_files.h"

#include <glob.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <tuple>

namespace xray_tracking
{
namespace
{
constexpr double kMaxRate = 10000.0;  // [Hz]

/// A name in pieces that are compared one by one: texts as they are, numbers by their digits without zeros in front, of
/// which more are larger.
std::vector<std::tuple<bool, std::size_t, std::string>> piecesOf(const std::string& name)
{
  std::vector<std::tuple<bool, std::size_t, std::string>> pieces;
  for (std::size_t at = 0; at < name.size();)
  {
    const bool digits = std::isdigit(static_cast<unsigned char>(name[at])) != 0;
    std::size_t end = at;
    while (end < name.size() && (std::isdigit(static_cast<unsigned char>(name[end])) != 0) == digits)
    {
      ++end;
    }
    std::string piece = name.substr(at, end - at);
    if (digits)
    {
      piece.erase(0, std::min(piece.find_first_not_of('0'), piece.size() - 1));
    }
    pieces.emplace_back(!digits, digits ? piece.size() : 0, piece);
    at = end;
  }
  return pieces;
}

/// Where names tell one number each, and step from one to the next by the same but for gaps, of whole steps: files are
/// missing, and those behind would be paired with another moment's. Numbers that step otherwise are no counters.
void requireNoGaps(const std::vector<std::string>& files, const YamlField& pattern)
{
  constexpr std::size_t kDigits = 18;  // of what a long long holds
  std::optional<std::size_t> counter;
  std::vector<std::vector<std::tuple<bool, std::size_t, std::string>>> names;
  for (const std::string& file : files)
  {
    names.push_back(piecesOf(file));
    if (names.back().size() != names.front().size())
    {
      return;
    }
    for (std::size_t piece = 0; piece < names.back().size(); ++piece)
    {
      if (names.back()[piece] == names.front()[piece])
      {
        continue;
      }
      if ((counter && *counter != piece) || std::get<1>(names.back()[piece]) == 0 ||
          std::get<1>(names.back()[piece]) > kDigits)
      {
        return;
      }
      counter = piece;
    }
  }
  if (!counter)
  {
    return;
  }
  std::vector<long long> steps;
  for (std::size_t k = 1; k < names.size(); ++k)
  {
    steps.push_back(std::stoll(std::get<2>(names[k][*counter])) - std::stoll(std::get<2>(names[k - 1][*counter])));
  }
  const long long step = *std::min_element(steps.begin(), steps.end());
  const auto gap = std::max_element(steps.begin(), steps.end());
  if (*gap > step && std::all_of(steps.begin(), steps.end(), [step](long long each) { return each % step == 0; }))
  {
    const auto before = static_cast<std::size_t>(gap - steps.begin());
    pattern.fail("numbers without gaps, but between " + files[before] + " and " + files[before + 1] + " " +
                 std::to_string(*gap / step - 1) + " are missing; give a table frames.csv of those that are there");
  }
}

std::vector<std::string> filesOf(const YamlField& pattern, const std::string& directory)
{
  const std::string path = (std::filesystem::path(directory) / pattern.text()).string();
  glob_t found{};
  const int fault = glob(path.c_str(), GLOB_NOSORT, nullptr, &found);
  std::vector<std::string> files(found.gl_pathv, found.gl_pathv + found.gl_pathc);
  globfree(&found);
  if (fault != 0 || files.empty())
  {
    pattern.fail("a pattern of files that are there (" + path + ")");
  }
  std::sort(files.begin(), files.end(),
            [](const std::string& a, const std::string& b) { return piecesOf(a) < piecesOf(b); });
  for (std::size_t k = 1; k < files.size(); ++k)
  {
    if (piecesOf(files[k - 1]) == piecesOf(files[k]))
    {
      pattern.fail("names whose numbers tell their order, not " + files[k - 1] + " and " + files[k]);
    }
  }
  requireNoGaps(files, pattern);
  return files;
}
}  // namespace

std::vector<FrameRow> frameFiles(const YamlField& frames, const std::string& directory)
{
  frames.refuseMisspelt({ "rate", "files" });
  const YamlField rate = frames.get("rate");
  const auto frequency = rate.number<double>();
  if (!(frequency > 0.0 && frequency <= kMaxRate))
  {
    rate.fail("exposures a second, more than 0 and at most 10000");
  }
  std::vector<FrameRow> rows;
  std::string first;
  std::size_t count = 0;
  frames.get("files").forEachEntry(
      [&](const std::string& detector, const YamlField& pattern)
      {
        const std::vector<std::string> files = filesOf(pattern, directory);
        if (first.empty())
        {
          first = detector;
          count = files.size();
        }
        else if (files.size() != count)
        {
          pattern.fail("as many files as " + first + " has, " + std::to_string(count) + ", not " +
                       std::to_string(files.size()));
        }
        for (std::size_t k = 0; k < files.size(); ++k)
        {
          rows.push_back({ std::llround(static_cast<double>(k) / frequency * 1e9), detector,
                           std::filesystem::path(files[k]).lexically_normal().string(), pattern.where() });
        }
      });
  std::stable_sort(rows.begin(), rows.end(),
                   [](const FrameRow& a, const FrameRow& b) { return a.stamp_ns < b.stamp_ns; });
  return rows;
}
}  // namespace xray_tracking
