#pragma once

#include <string>
#include <vector>

#include "xray_tracking_core/sequence/sequence.h"
#include "yaml_field.h"

namespace xray_tracking
{
/// The rows that `frames: {rate: Hz, files: {DETECTOR: PATTERN, ...}}` stands for: the k-th file of each pattern (*, ?
/// and [..]) at k / rate, in the order of the numbers in their names.
/// @param directory where patterns start
/// @throws std::runtime_error naming file, key and value: a pattern without files, detectors of unlike many files,
/// names that are alike but for zeros in front of their numbers
std::vector<FrameRow> frameFiles(const YamlField& frames, const std::string& directory);
}  // namespace xray_tracking
