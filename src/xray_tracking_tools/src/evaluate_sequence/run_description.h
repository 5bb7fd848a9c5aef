#pragma once

#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "exposure_source.h"

namespace xray_tracking
{
/// What was evaluated, by what: program and versions, processor, the inputs' SHA-256, setup and settings.
/// docs/evaluation.md, "Files", tells of the members.
/// @throws std::runtime_error naming an input that cannot be read
nlohmann::json describeRun(const ExposureSource& source, const std::vector<std::string>& methods);
}  // namespace xray_tracking
