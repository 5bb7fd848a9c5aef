#pragma once

#include <string>
#include <vector>

#include "trial.h"

namespace xray_tracking
{
/// Registers every exposure of the real sequences below a folder (sequence folders called *_real, or within one so
/// called) from `starts` starts of each size, the reference's pose of the exposure before among them, and judges by
/// their references: an independent registration, whose own uncertainty stands beside the figures. A second table says
/// how well folders agree that show the same thing in other views. The trials are added to `trials`.
/// @throws std::invalid_argument naming the folder if none is there
std::vector<FigureTable> measureRealSequences(const std::string& folder, const RegistrationOptions& options, int starts,
                                              std::vector<Trial>& trials);
}  // namespace xray_tracking
