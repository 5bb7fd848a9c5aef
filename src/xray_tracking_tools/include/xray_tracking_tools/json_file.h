#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

namespace xray_tracking
{
/// @throws std::runtime_error naming the file if it cannot be written
void writeJsonFile(const std::string& path, const nlohmann::json& json);
}  // namespace xray_tracking
