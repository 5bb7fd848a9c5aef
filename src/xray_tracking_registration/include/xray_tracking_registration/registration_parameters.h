#pragma once

#include <string>

#include "xray_tracking_conversions/parameters.h"
#include "xray_tracking_core/volume/target_mask.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
/// The node's parameters (README.md: units, defaults, ranges).
struct RegistrationParameters
{
  std::string setup_file;
  std::string data_folder;         ///< of CTs that are asked for; empty: usualDataFolder()
  std::string source = "phantom";  ///< or "ct"
  int bodies = 2;
  std::string mask = "bone";  ///< or "labels", "box" or "roi"
  TargetMaskOptions mask_options;
  std::string label_map;  ///< its path, for "labels"
  int label = 1;
  std::string mask_file;  ///< where to write the mask; empty: nowhere
  RegistrationOptions options;
  double max_translation_mm = 30.0;
  double max_rotation_rad = 0.26;
  double search_max_translation_mm = kUsualSearch;
  double search_max_rotation_rad = kUsualSearchRotation;
  double time_budget_s = 5.0;
  bool keep_for_restart = false;  ///< on disk, which CT a node in the place of this one loads
  int queue_size = 50;            ///< exposures
};

/// Reads and checks all; names that are none are warned of.
/// @throws std::invalid_argument naming the parameter, its value and what was expected
RegistrationParameters readRegistrationParameters(ParameterReader reader);
}  // namespace xray_tracking
