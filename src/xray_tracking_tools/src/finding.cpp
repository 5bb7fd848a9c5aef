#include "xray_tracking_tools/finding.h"

#include <algorithm>
#include <iostream>

#include <nlohmann/json.hpp>

namespace xray_tracking
{
namespace
{
const char* nameOf(Severity severity)
{
  return severity == Severity::ERROR ? "error" : "warning";
}
}  // namespace

std::string lineOf(const Finding& finding)
{
  std::string line = std::string(nameOf(finding.severity)) + " " + finding.code + ": " + finding.thing + ": " +
                     finding.value + "; expected " + finding.expected + "; " + finding.advice;
  std::replace(line.begin(), line.end(), '\n', ' ');
  return line;
}

int tellFindings(const std::vector<Finding>& findings, const std::string& recording, bool json)
{
  const bool errors = std::any_of(findings.begin(), findings.end(),
                                  [](const Finding& finding) { return finding.severity == Severity::ERROR; });
  const int status = errors ? 2 : findings.empty() ? 0 : 1;
  if (json)
  {
    const char* const words[] = { "good", "warnings", "errors" };
    nlohmann::json list = nlohmann::json::array();
    for (const Finding& finding : findings)
    {
      list.push_back({ { "code", finding.code },
                       { "severity", nameOf(finding.severity) },
                       { "thing", finding.thing },
                       { "value", finding.value },
                       { "expected", finding.expected },
                       { "advice", finding.advice } });
    }
    const nlohmann::json all{ { "recording", recording }, { "status", words[status] }, { "findings", list } };
    std::cout << all.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) << std::endl;
    return status;
  }
  for (const Finding& finding : findings)
  {
    std::cout << lineOf(finding) << '\n';
  }
  std::cout << recording << ": "
            << (findings.empty() ? "nothing wrong was found" : std::to_string(findings.size()) + " findings")
            << std::endl;
  return status;
}
}  // namespace xray_tracking
