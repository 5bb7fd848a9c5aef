#include "xray_tracking_registration/registration_parameters.h"

#include <cmath>
#include <filesystem>
#include <stdexcept>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
template <typename T>
void read(ParameterReader& reader, const std::string& key, T& value)
{
  value = reader.read(key, value);
}

void requireOneOf(const std::string& key, const std::string& value, const std::string& first, const std::string& second)
{
  requireOption(value == first || value == second, key, value, first + " or " + second);
}

/// A length parameter in m that the library wants in mm.
void readMetres(ParameterReader& reader, const std::string& key, double& millimetres)
{
  millimetres = reader.read(key, millimetres / kMillimetresPerMetre) * kMillimetresPerMetre;
}
}  // namespace

RegistrationParameters readRegistrationParameters(ParameterReader reader)
{
  RegistrationParameters parameters;
  read(reader, "setup_file", parameters.setup_file);
  read(reader, "data_folder", parameters.data_folder);
  requireOption(parameters.data_folder.empty() || std::filesystem::is_directory(parameters.data_folder), "data_folder",
                parameters.data_folder, "a folder, or none: the one that the setup's CT is in");
  read(reader, "source", parameters.source);
  requireOneOf("source", parameters.source, "phantom", "ct");
  read(reader, "bodies", parameters.bodies);
  requireOption(parameters.bodies == 1 || parameters.bodies == 2, "bodies", parameters.bodies, "1 or 2");
  read(reader, "mask/from", parameters.mask);
  requireOption(
      parameters.mask == "bone" || parameters.mask == "labels" || parameters.mask == "box" || parameters.mask == "roi",
      "mask/from", parameters.mask, "bone, labels, box or roi");
  read(reader, "mask/threshold_hu", parameters.mask_options.threshold_hu);
  read(reader, "mask/closing_mm", parameters.mask_options.closing_mm);
  read(reader, "mask/inner_mm", parameters.mask_options.inner_mm);
  read(reader, "mask/outer_mm", parameters.mask_options.outer_mm);
  parameters.mask_options.validate();
  read(reader, "mask/label_map", parameters.label_map);
  requireOption((parameters.mask == "labels") != parameters.label_map.empty(), "mask/label_map", parameters.label_map,
                "a volume file if mask/from is labels, else none");
  read(reader, "mask/label", parameters.label);
  requireInRange("mask/label", parameters.label, 1, 32767);
  read(reader, "mask/file", parameters.mask_file);
  read(reader, "min_probability", parameters.options.min_probability);
  parameters.options.validate();
  readMetres(reader, "max_translation", parameters.max_translation_mm);
  requireOption(parameters.max_translation_mm > 0.0, "max_translation",
                parameters.max_translation_mm / kMillimetresPerMetre, "more than 0 m");
  read(reader, "max_rotation", parameters.max_rotation_rad);
  requireOption(parameters.max_rotation_rad > 0.0 && parameters.max_rotation_rad <= M_PI, "max_rotation",
                parameters.max_rotation_rad, "more than 0, at most pi rad");
  readMetres(reader, "search/max_translation", parameters.search_max_translation_mm);
  requireOption(parameters.search_max_translation_mm > 0.0 && parameters.search_max_translation_mm <= kMaxSearch,
                "search/max_translation", parameters.search_max_translation_mm / kMillimetresPerMetre,
                "more than 0, at most 0.1 m");
  read(reader, "search/max_rotation", parameters.search_max_rotation_rad);
  requireOption(parameters.search_max_rotation_rad > 0.0 && parameters.search_max_rotation_rad <= kMaxSearchRotation,
                "search/max_rotation", parameters.search_max_rotation_rad, "more than 0, at most 0.8 rad");
  read(reader, "time_budget", parameters.time_budget_s);
  requireOption(parameters.time_budget_s > 0.0, "time_budget", parameters.time_budget_s, "more than 0 s");
  read(reader, "keep_for_restart", parameters.keep_for_restart);
  read(reader, "queue_size", parameters.queue_size);
  requireInRange("queue_size", parameters.queue_size, 1, 1000);
  reader.warnOfUnread();
  if (parameters.setup_file.empty())
  {
    throw std::invalid_argument("parameter " + reader.nameOf("setup_file") +
                                " is not set, expected the path of a setup file");
  }
  return parameters;
}
}  // namespace xray_tracking
