#include "xray_tracking_core/projection/attenuation_field.h"

#include <array>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>

#include "xray_tracking_core/projection/exact_projection.h"

namespace xray_tracking
{
namespace
{
constexpr std::size_t kBucket = 4;  // entries
constexpr int kCellBits = 15;

/// A bijection that spreads keys evenly (the finaliser of MurmurHash3).
std::uint64_t mixed(std::uint64_t key)
{
  key = (key ^ (key >> 33)) * 0xff51afd7ed558ccdULL;
  key = (key ^ (key >> 33)) * 0xc4ceb9fe1a85ec53ULL;
  return key ^ (key >> 33);
}

std::size_t bucketCount(std::size_t max_bytes)
{
  std::size_t buckets = 1;
  while (2 * buckets * kBucket * sizeof(std::uint64_t) <= max_bytes)
  {
    buckets *= 2;
  }
  return buckets;
}
}  // namespace

AttenuationField::AttenuationField(std::shared_ptr<const ScalarVolume> volume, double step, std::size_t max_bytes)
  : volume_(std::move(volume)), step_(step)
{
  if (!volume_ || volume_->grid.size.minCoeff() < 1 || volume_->values.size() != volume_->grid.voxelCount())
  {
    throw std::invalid_argument("attenuation field: the volume is missing, empty or not of its grid's size");
  }
  if (!(step > 0.0) || !std::isfinite(step))
  {
    throw std::invalid_argument("attenuation field: step is " + std::to_string(step) + " mm: expected more than 0");
  }
  if (max_bytes < 64)
  {
    throw std::invalid_argument("attenuation field: max_bytes is " + std::to_string(max_bytes) +
                                ": expected 64 or more");
  }
  Eigen::AlignedBox3d box;
  for (int corner = 0; corner < 8; ++corner)
  {
    // Interpolated values fall to zero one voxel outside the outermost centres.
    const Eigen::Vector3i upper(corner & 1, corner >> 1 & 1, corner >> 2);
    const Eigen::Vector3i outer = upper.cwiseProduct(volume_->grid.size + Eigen::Vector3i::Ones());
    box.extend(volume_->grid.patient_from_index * (outer - Eigen::Vector3i::Ones()).cast<double>().eval());
  }
  low_ = box.min();
  high_ = box.max();
  const std::size_t buckets = bucketCount(max_bytes);
  bucket_mask_ = buckets - 1;
  entries_ = std::vector<Entry>(buckets * kBucket);
}

float AttenuationField::lineIntegral(const Ray& ray) const
{
  int main;
  ray.direction.cwiseAbs().maxCoeff(&main);
  const std::array<int, 2> across{ (main + 1) % 3, (main + 2) % 3 };
  Eigen::Vector3d places[2];
  std::uint64_t key = static_cast<std::uint64_t>(main) + 1;
  bool addressed = true;
  for (int plane = 0; plane < 2; ++plane)
  {
    Eigen::Vector3d& place = places[plane];
    place[main] = plane == 0 ? low_[main] : high_[main];
    const double distance = (place[main] - ray.source[main]) / ray.direction[main];
    for (const int axis : across)
    {
      const double middle = 0.5 * (low_[axis] + high_[axis]);
      const double cell = std::round((ray.source[axis] + distance * ray.direction[axis] - middle) / step_);
      constexpr double kHalf = 1 << (kCellBits - 1);
      addressed = addressed && cell >= -kHalf && cell < kHalf;
      place[axis] = middle + cell * step_;
      key = key << kCellBits | (addressed ? static_cast<std::uint64_t>(cell + kHalf) : 0);
    }
  }
  if (!addressed)
  {
    return static_cast<float>(integrateTrilinear(*volume_, ray));
  }
  lookups_.fetch_add(1, std::memory_order_relaxed);
  const std::uint64_t hash = mixed(key);
  const std::uint64_t tag = hash >> 32 | 1;  // never 0, so that no entry looks free
  Entry* bucket = entries_.data() + (hash & bucket_mask_) * kBucket;
  // An entry is whole in itself, so that threads need no order.
  Entry* free = bucket + (hash >> 40) % kBucket;
  for (Entry* entry = bucket; entry != bucket + kBucket; ++entry)
  {
    const std::uint64_t held = entry->load(std::memory_order_relaxed);
    if (held >> 32 == tag)
    {
      hits_.fetch_add(1, std::memory_order_relaxed);
      const auto bits = static_cast<std::uint32_t>(held);
      float value;
      std::memcpy(&value, &bits, sizeof(value));
      return value;
    }
    if (held == 0)
    {
      free = entry;
      break;
    }
  }
  const Eigen::Vector3d along = (places[1] - places[0]).normalized();
  // From before the volume.
  const double before = 1.0 + (high_ - low_).norm();
  const float value = static_cast<float>(integrateTrilinear(*volume_, { places[0] - before * along, along }));
  std::uint32_t bits;
  std::memcpy(&bits, &value, sizeof(bits));
  free->store(tag << 32 | bits, std::memory_order_relaxed);
  return value;
}
}  // namespace xray_tracking
