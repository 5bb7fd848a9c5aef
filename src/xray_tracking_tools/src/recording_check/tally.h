#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "xray_tracking_tools/finding.h"

namespace xray_tracking
{
/// "1003.250000000 s"
std::string secondsText(std::int64_t ns);

/// What is wrong with many messages in the same way, for one finding: how many, the first, and the worst in words.
class Tally
{
public:
  /// @param amount by which the worst is told
  void add(const std::string& code, const std::string& thing, std::int64_t stamp_ns, const std::string& words,
           double amount = 0.0);

  /// @param of how many messages of a thing there were in all
  std::vector<Finding> findings(const std::map<std::string, std::size_t>& of) const;

private:
  struct Entry
  {
    std::size_t count = 0;
    std::int64_t first_ns = 0;
    double worst = 0.0;
    std::string words;
  };
  std::map<std::pair<std::string, std::string>, Entry> entries_;  ///< by thing and code
};
}  // namespace xray_tracking
