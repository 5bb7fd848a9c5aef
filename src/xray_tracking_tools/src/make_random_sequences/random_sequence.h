#pragma once

#include <cstdint>
#include <filesystem>

#include "benchmark_registration/random_subject.h"

namespace xray_tracking
{
/// What the setup says of the first exposure.
enum class Start
{
  RIGHT,          ///< where the patient is
  OFF,            ///< up to 5 mm and 3 degrees from there
  NEXT_VERTEBRA,  ///< 10 to 25 mm along the patient's long axis from there
  EXCHANGED,      ///< two detectors' names exchanged
  MIRRORED,       ///< one panel's columns mirrored
  OTHER_CT        ///< the CT of a patient of another size: 10 to 25 % longer or shorter along every axis
};

/// As in the enumeration, in lower case.
const char* startName(Start start);

/// A sequence folder of a random anatomy, room, detector, posture, motion and start, all of which hang on the seed:
/// what random registrations are judged on (docs/belief.md), moving. Two or three detectors of 256 to 512 pixels a
/// side. `scenario.json` beside the tables says what was drawn.
/// @param scans of which a fourth of the sequences are; null: of the neck phantom alone
/// @param exposures 1 or more
void writeRandomSequence(const std::filesystem::path& folder, std::uint32_t seed, const Scans* scans, int exposures);
}  // namespace xray_tracking
