#pragma once

#include <vector>

#include "descender.h"
#include "pose_search.h"

namespace xray_tracking
{
/// What a search of a neighbourhood came to.
struct Found
{
  Outcome answer;             ///< the most similar end; in doubt if another place is nearly as similar
  std::vector<Rival> rivals;  ///< other ends, most similar first
};

/// Searches the neighbourhood of a start exhaustively (PoseSearch), descends from the most
/// similar places, and compares where that ends.
/// @throws std::invalid_argument naming the view that does not see the neighbourhood
Found searchAround(const Run& run, const Bodies& bodies, const Descender& descender,
                   const Eigen::AlignedBox3d& target_box, const PosePair& start, const SearchBounds& bounds);
}  // namespace xray_tracking
