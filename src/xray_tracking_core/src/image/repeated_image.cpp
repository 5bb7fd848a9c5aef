#include "xray_tracking_core/image/repeated_image.h"

#include <algorithm>
#include <cstring>

namespace xray_tracking
{
namespace
{
/// The finaliser of MurmurHash3 (Appleby): a bijection in which every bit depends on every bit.
std::uint64_t mixed(std::uint64_t x)
{
  x = (x ^ (x >> 33)) * 0xff51afd7ed558ccdULL;
  x = (x ^ (x >> 33)) * 0xc4ceb9fe1a85ec53ULL;
  return x ^ (x >> 33);
}

constexpr int kEvery = 8;  // rows

/// Four sums side by side, as one has to wait for its last multiplication. Each step is a bijection of the sum.
struct Sums
{
  std::uint64_t lanes[4] = { 1, 2, 3, 4 };

  void add(const std::uint8_t* bytes, std::size_t count)
  {
    constexpr std::uint64_t kOdd = 0x9e3779b97f4a7c15ULL;  // 2^64 by the golden ratio
    std::size_t i = 0;
    for (; i + 32 <= count; i += 32)
    {
      std::uint64_t words[4];
      std::memcpy(words, bytes + i, sizeof(words));
      for (int lane = 0; lane < 4; ++lane)
      {
        const std::uint64_t sum = (lanes[lane] ^ words[lane]) * kOdd;
        lanes[lane] = sum ^ (sum >> 32);
      }
    }
    for (; i < count; ++i)
    {
      lanes[i % 4] = mixed(lanes[i % 4] ^ bytes[i]) + 1;
    }
  }
};
}  // namespace

std::uint64_t imageFingerprint(const cv::Mat& image)
{
  Sums sums;
  for (int row = 0; row < image.rows; row += kEvery)
  {
    sums.add(image.ptr(row), static_cast<std::size_t>(image.cols) * image.elemSize());
  }
  std::uint64_t all = mixed((static_cast<std::uint64_t>(image.rows) << 32) ^ static_cast<std::uint64_t>(image.cols));
  all = mixed(all ^ static_cast<std::uint64_t>(image.type()));
  for (const std::uint64_t lane : sums.lanes)
  {
    all = mixed(all ^ lane) + lane;
  }
  return all;
}

std::optional<std::int64_t> RepeatedImageCheck::add(const cv::Mat& image, std::int64_t stamp_ns)
{
  const std::uint64_t fingerprint = imageFingerprint(image);
  const auto same = std::find_if(seen_.begin(), seen_.end(),
                                 [fingerprint](const Seen& seen) { return seen.fingerprint == fingerprint; });
  if (same != seen_.end())
  {
    return same->stamp_ns;
  }
  if (seen_.capacity() < kRemembered)
  {
    seen_.reserve(kRemembered);
  }
  if (seen_.size() < kRemembered)
  {
    seen_.push_back({ fingerprint, stamp_ns });
  }
  else
  {
    seen_[next_] = { fingerprint, stamp_ns };
    next_ = (next_ + 1) % kRemembered;
  }
  return std::nullopt;
}

void RepeatedImageCheck::reset()
{
  seen_.clear();
  next_ = 0;
}
}  // namespace xray_tracking
