#include "look_alikes.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include <tbb/parallel_for.h>

namespace xray_tracking
{
namespace
{
constexpr double kEdge = 2.0;  // of the cells that are compared [mm]
constexpr int kFarthest = 23;  // along the axis; lumbar vertebrae are up to 45 mm apart [cells]
constexpr int kLateral = 4;    // to either side, as a spine bends [cells]
/// Least correlation, and what it has to climb from the valley between the target and there. Neighbours in a thorax
/// have 0.20 to 0.34, what is no neighbour there and in a head 0.06 at most.
constexpr double kAlike = 0.15;
constexpr double kClimbs = 0.1;
constexpr int kMean = 8;        // to either side along the axis, of what is taken away: what does not repeat [cells]
constexpr double kFlat = 1e-3;  // standard deviation of what is nothing but rounding, where water has 0.16
constexpr int kRowStep = 2;     // of the cells that are compared
constexpr double kAllInside = 0.9;  // of a shifted box, that the CT has to hold

/// Attenuation in cubic cells along the patient's axes.
struct Cells
{
  Eigen::Vector3i size;
  std::vector<float> values;
  std::vector<char> inside;

  int at(const Eigen::Vector3i& cell) const { return (cell.z() * size.y() + cell.y()) * size.x() + cell.x(); }
};

/// Value of the voxel at a point, if the volume has one there.
std::optional<float> valueAt(const ScalarVolume& volume, const Eigen::Affine3d& index_from_patient,
                             const Eigen::Vector3d& point)
{
  const Eigen::Vector3i index = (index_from_patient * point).array().round().cast<int>();
  if ((index.array() < 0).any() || (index.array() >= volume.grid.size.array()).any())
  {
    return std::nullopt;
  }
  return volume.values[volume.grid.offset(index.x(), index.y(), index.z())];
}

Cells cellsOf(const BodyModel& bodies, const Eigen::Vector3d& first, const Eigen::Vector3i& size)
{
  Cells cells{ size, std::vector<float>(size.prod()), std::vector<char>(size.prod()) };
  const Eigen::Affine3d target_from_patient = bodies.target.grid.patient_from_index.inverse();
  const bool one = bodies.rest.values.empty();
  const Eigen::Affine3d rest_from_patient = one ? target_from_patient : bodies.rest.grid.patient_from_index.inverse();
  tbb::parallel_for(
      0, size.z(),
      [&](int z)
      {
        for (int n = z * size.x() * size.y(); n < (z + 1) * size.x() * size.y(); ++n)
        {
          const Eigen::Vector3d corner = first + kEdge * Eigen::Vector3d(n % size.x(), n / size.x() % size.y(), z);
          float sum = 0.0f;
          bool inside = true;
          for (int part = 0; part < 8; ++part)
          {
            const Eigen::Vector3d point =
                corner + kEdge * (0.25 + 0.5 * Eigen::Array3d(part & 1, part >> 1 & 1, part >> 2)).matrix();
            const auto target = valueAt(bodies.target, target_from_patient, point);
            const auto rest = one ? std::nullopt : valueAt(bodies.rest, rest_from_patient, point);
            sum += target.value_or(0.0f) + rest.value_or(0.0f);
            inside = inside && (target || rest);
          }
          cells.values[n] = sum;
          cells.inside[n] = inside ? 1 : 0;
        }
      });
  return cells;
}

/// Takes the means along the axis away, of what the CT holds; what has nothing around it stays as it is.
void highPass(Cells& cells)
{
  const Cells before = cells;
  tbb::parallel_for(0, cells.size.x() * cells.size.y(),
                    [&](int column)
                    {
                      const int slice = cells.size.x() * cells.size.y();
                      for (int z = 0; z < cells.size.z(); ++z)
                      {
                        float sum = 0.0f;
                        int count = 0;
                        for (int k = std::max(0, z - kMean); k < std::min(cells.size.z(), z + kMean + 1); ++k)
                        {
                          sum += before.inside[k * slice + column] ? before.values[k * slice + column] : 0.0f;
                          count += before.inside[k * slice + column];
                        }
                        cells.values[z * slice + column] -= count > 0 ? sum / static_cast<float>(count) : 0.0f;
                      }
                    });
}

/// Correlation of a box of the cells with the same shifted, over what the CT holds of both; none if that is too little.
std::optional<double> correlation(const Cells& cells, const Eigen::Vector3i& first, const Eigen::Vector3i& size,
                                  const Eigen::Vector3i& shift)
{
  double a = 0.0;
  double b = 0.0;
  double aa = 0.0;
  double bb = 0.0;
  double ab = 0.0;
  int count = 0;
  for (int z = 0; z < size.z(); ++z)
  {
    for (int y = 0; y < size.y(); y += kRowStep)
    {
      const int here = cells.at(first + Eigen::Vector3i(0, y, z));
      const int there = cells.at(first + shift + Eigen::Vector3i(0, y, z));
      for (int x = 0; x < size.x(); ++x)
      {
        if (cells.inside[here + x] && cells.inside[there + x])
        {
          const double v = cells.values[here + x];
          const double w = cells.values[there + x];
          a += v;
          b += w;
          aa += v * v;
          bb += w * w;
          ab += v * w;
          ++count;
        }
      }
    }
  }
  const double n = count;
  const double variance = aa - a * a / n;
  const double variance_there = bb - b * b / n;
  if (count * kRowStep < kAllInside * size.prod() || std::min(variance, variance_there) < n * kFlat * kFlat)
  {
    return std::nullopt;
  }
  return (ab - a * b / n) / std::sqrt(variance * variance_there);
}
}  // namespace

std::vector<Eigen::Vector3d> lookAlikes(const BodyModel& bodies, const Eigen::AlignedBox3d& target_box)
{
  Eigen::AlignedBox3d ct = bodies.target.grid.extent();
  if (!bodies.rest.values.empty())
  {
    ct.extend(bodies.rest.grid.extent());
  }
  // A box may be far larger than the CT, as one given in the wrong unit.
  const Eigen::AlignedBox3d box = target_box.intersection(ct);
  if (box.isEmpty())
  {
    return {};
  }
  const Eigen::Vector3i size = (box.sizes() / kEdge).array().ceil().cast<int>().max(1);
  const Eigen::Vector3i around(kLateral, kLateral, kFarthest);
  Cells cells = cellsOf(bodies, box.min() - kEdge * around.cast<double>(), size + 2 * around);
  highPass(cells);
  std::vector<Eigen::Vector3d> found;
  for (const int side : { -1, 1 })
  {
    std::vector<double> most(kFarthest + 1, -1.0);
    std::vector<Eigen::Vector3i> where(most.size(), Eigen::Vector3i::Zero());
    tbb::parallel_for(0, kFarthest + 1,
                      [&](int steps)
                      {
                        for (int x = -kLateral; x <= kLateral; ++x)
                        {
                          for (int y = -kLateral; y <= kLateral; ++y)
                          {
                            const Eigen::Vector3i shift(x, y, side * steps);
                            const double there = correlation(cells, around, size, shift).value_or(-1.0);
                            if (there > most[steps])
                            {
                              most[steps] = there;
                              where[steps] = shift;
                            }
                          }
                        }
                      });
    double valley = 1.0;
    for (int steps = 1; steps < kFarthest; ++steps)
    {
      const bool peak = most[steps] >= most[steps - 1] && most[steps] >= most[steps + 1] && most[steps + 1] > -1.0;
      if (peak && most[steps] > kAlike && most[steps] > valley + kClimbs)
      {
        found.push_back(kEdge * where[steps].cast<double>());
        break;
      }
      valley = most[steps] > -1.0 ? std::min(valley, most[steps]) : valley;
    }
  }
  return found;
}
}  // namespace xray_tracking
