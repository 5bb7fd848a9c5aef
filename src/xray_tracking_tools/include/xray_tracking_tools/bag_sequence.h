#pragma once

#include <cstddef>
#include <string>

#include "xray_tracking_tools/recording.h"

namespace xray_tracking
{
/// What became of a recording's exposures.
struct ExtractedSequence
{
  std::size_t exposures = 0;
  std::size_t incomplete = 0;  ///< left out, as not every detector has an image
  bool gold_standard = false;
};

/// Makes a sequence folder of a recording: sequence.yaml, frames.csv, images as PNG of 8 or 16 bit, and the gold
/// standard, if there is one for every exposure. What sequence_to_bag has put into a bag comes back to the last bit:
/// pixels, stamps, geometry, poses. Poses of `patient_ground_truth` are written with 17 digits. Images are held one
/// exposure at a time, so are those of exposures that wait for a view.
/// @param setup_path empty: the setup in the recording
/// @throws std::runtime_error naming what is wrong: no setup, no complete exposure, an image of another encoding or
/// size, a folder that is there already or cannot be written
ExtractedSequence writeSequenceFolder(const Recording& recording, const std::string& setup_path,
                                      const std::string& folder);
}  // namespace xray_tracking
