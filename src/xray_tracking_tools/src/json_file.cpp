#include "xray_tracking_tools/json_file.h"

#include <fstream>
#include <stdexcept>

#include <nlohmann/json.hpp>

namespace xray_tracking
{
void writeJsonFile(const std::string& path, const nlohmann::json& json)
{
  std::ofstream file(path);
  // Names may come from files, whose bytes need not be UTF-8.
  file << json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) << '\n';
  if (!file.flush())
  {
    throw std::runtime_error(path + ": cannot be written");
  }
}
}  // namespace xray_tracking
