#include <algorithm>
#include <array>
#include <cstddef>
#include <sstream>
#include <vector>

#include "stored_volume.h"

namespace xray_tracking
{
namespace
{
/// More than any atlas of bones and organs has; grey values of 8 bit are more.
constexpr int kMostLabels = 200;
/// Of a voxel's neighbours, the mean over all labels: thin sheets have 4 of 6, rods 2; grey values of a CT or a
/// probability next to none.
constexpr double kAlike = 1.0 / 3.0;

/// Labels by their values; others than 0 and above.
std::vector<std::size_t> countLabels(const CtVolume& volume)
{
  std::vector<std::size_t> counts(1 << 15);
  for (const std::int16_t value : volume.hu)
  {
    counts[std::max<int>(value, 0)] += value > 0 ? 1 : 0;
  }
  return counts;
}
}  // namespace

std::string whyNotLabels(const StoredVolume& stored)
{
  const std::vector<std::int16_t>& values = stored.volume.hu;
  const auto [lowest, highest] = std::minmax_element(values.begin(), values.end());
  const std::vector<std::size_t> counts = countLabels(stored.volume);
  const auto labels = std::count_if(counts.begin(), counts.end(), [](std::size_t count) { return count > 0; });
  std::ostringstream why;
  if (stored.fraction)
  {
    why << "holds the value " << *stored.fraction << ", expected whole numbers (of a probability, a threshold's)";
  }
  else if (*lowest == *highest)
  {
    why << "all voxels are " << *lowest << ", expected 0 for the background and labels above it";
  }
  else if (*lowest != 0)
  {
    why << "the lowest value is " << *lowest << ", expected 0 for the background and labels above it";
  }
  else if (labels > kMostLabels)
  {
    why << "holds " << labels << " values above 0, expected at most " << kMostLabels << " labels";
  }
  return why.str();
}

bool isPatchwork(const CtVolume& volume)
{
  const Eigen::Vector3i& size = volume.grid.size;
  const std::vector<std::size_t> counts = countLabels(volume);
  std::vector<std::size_t> alike(counts.size());
  const auto compare = [&](int value, std::size_t neighbour)
  {
    alike[value] += volume.hu[neighbour] == value ? 2 : 0;  // either is the other's neighbour
  };
  std::size_t n = 0;
  for (int k = 0; k < size.z(); ++k)
  {
    for (int j = 0; j < size.y(); ++j)
    {
      for (int i = 0; i < size.x(); ++i, ++n)
      {
        const int value = volume.hu[n];
        if (value <= 0)
        {
          continue;
        }
        if (i > 0)
        {
          compare(value, n - 1);
        }
        if (j > 0)
        {
          compare(value, volume.grid.offset(i, j - 1, k));
        }
        if (k > 0)
        {
          compare(value, volume.grid.offset(i, j, k - 1));
        }
      }
    }
  }
  int labels = 0;
  double share = 0.0;
  for (std::size_t value = 1; value < counts.size(); ++value)
  {
    if (counts[value] > 0)
    {
      ++labels;
      share += static_cast<double>(alike[value]) / (6.0 * static_cast<double>(counts[value]));
    }
  }
  return share >= kAlike * labels && labels > 0;
}
}  // namespace xray_tracking
