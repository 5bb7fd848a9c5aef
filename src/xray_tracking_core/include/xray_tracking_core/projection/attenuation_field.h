#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
/// A progressive attenuation field (Rohlfing et al., Med. Phys. 32(9), 2005): line integrals of a volume, kept as they
/// are asked for and found again by later poses, whose rays pass the same places of the CT.
///
/// A line is addressed by where it crosses two planes in CT coordinates, across its main axis at the volume's ends:
/// four numbers, each rounded to a multiple of the step. What is kept is the exact integral (integrateTrilinear) along
/// the line through the rounded places, so results depend neither on the order of calls nor on threads. Within the
/// volume that line is nowhere farther from the ray than half a step along either axis: for steps of half a voxel the
/// error is about that of a projection shifted by 0.14 voxel, root mean square.
///
/// Memory is fixed: a table of which a full bucket's entries are overwritten. Thread safe without locks.
class AttenuationField
{
public:
  struct Statistics
  {
    std::uint64_t lookups;
    std::uint64_t hits;
  };

  /// @param step of the crossings [mm], > 0
  /// @param max_bytes of the table, 64 or more; the largest power of two that fits is taken at once
  /// @throws std::invalid_argument for a missing volume, one not of its grid's size, or numbers out of range
  AttenuationField(std::shared_ptr<const ScalarVolume> volume, double step, std::size_t max_bytes);

  /// @param ray in the patient frame; its source outside of the volume, in front of it
  /// @return [value * mm]
  float lineIntegral(const Ray& ray) const;

  Statistics statistics() const { return { lookups_.load(), hits_.load() }; }
  /// Bytes of the table.
  std::size_t memory() const { return entries_.size() * sizeof(entries_.front()); }

private:
  /// A tag in the upper half, a float in the lower; 0 is free.
  using Entry = std::atomic<std::uint64_t>;

  std::shared_ptr<const ScalarVolume> volume_;
  double step_;
  Eigen::Vector3d low_;  ///< corners of the volume's bounding box, patient frame [mm]
  Eigen::Vector3d high_;
  std::uint64_t bucket_mask_;
  mutable std::vector<Entry> entries_;
  mutable std::atomic<std::uint64_t> lookups_{ 0 };
  mutable std::atomic<std::uint64_t> hits_{ 0 };
};
}  // namespace xray_tracking
