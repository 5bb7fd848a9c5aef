#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <opencv2/core.hpp>

namespace xray_tracking
{
/// A number that tells images apart by every bit of every eighth row, which takes an eighth of the time of all: equal
/// for equal images, and for others that differ there but once in 2^64. Real ones differ there by their noise.
/// @param image of any type; size and type count too
std::uint64_t imageFingerprint(const cv::Mat& image);

/// Tells of an image that it was there before: real ones have noise, so a panel or a driver that delivers the same
/// pixels under a new stamp has stopped, and what they show is of the past.
class RepeatedImageCheck
{
public:
  /// Takes in the next image. @return the stamp of the earlier one that is the same, by imageFingerprint(), of the last
  /// kRemembered
  std::optional<std::int64_t> add(const cv::Mat& image, std::int64_t stamp_ns);
  void reset();

  static constexpr std::size_t kRemembered = 256;

private:
  struct Seen
  {
    std::uint64_t fingerprint;
    std::int64_t stamp_ns;
  };
  std::vector<Seen> seen_;  ///< a ring
  std::size_t next_ = 0;
};
}  // namespace xray_tracking
