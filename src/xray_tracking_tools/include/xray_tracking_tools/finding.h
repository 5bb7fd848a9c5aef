#pragma once

#include <string>
#include <vector>

namespace xray_tracking
{
enum class Severity
{
  WARNING,  ///< can be worked with, by one who knows
  ERROR     ///< what comes of it is wrong, or nothing does
};

/// Something that is wrong with a recording.
struct Finding
{
  std::string code;  ///< one of docs/playback.md's table
  Severity severity = Severity::ERROR;
  std::string thing;     ///< topic, file or key
  std::string value;     ///< what it is
  std::string expected;  ///< what it should be
  std::string advice;    ///< what to do
};

/// "error image_frozen: detector_a/image_raw: is ...; expected ...; do ...", one line.
std::string lineOf(const Finding& finding);

/// Prints the findings, a line each, or as JSON: {"recording", "status", "findings": [{"code", "severity", "thing",
/// "value", "expected", "advice"}]}, status "good", "warnings" or "errors".
/// @return exit status: 0 there is none, 1 warnings alone, 2 errors
int tellFindings(const std::vector<Finding>& findings, const std::string& recording, bool json);
}  // namespace xray_tracking
