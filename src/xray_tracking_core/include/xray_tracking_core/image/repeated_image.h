#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Tells of an image that it, or a part of it, was there before: real ones have noise, so a panel or a driver that
/// delivers the same pixels under a new stamp has stopped, and what they show is of the past. A grabber that is too
/// slow leaves rows of the image before, below or between those of the new one.
///
/// By one of every eight rows, even and odd ones in turn, which takes an eighth of the time of all. Rows of which fewer
/// than 32 pixels differ from the one before them, as in saturated air, are alike by themselves.
class RepeatedImageCheck
{
public:
  /// Takes in the next image, of any type. @return the stamp of the last of the earlier images that it is the same as,
  /// or that two fifths of its rows are from; of the last kRemembered of its size and type
  std::optional<std::int64_t> add(const cv::Mat& image, std::int64_t stamp_ns);
  void reset();

  static constexpr std::size_t kRemembered = 256;

private:
  /// Of the ring's n-th image.
  std::uint32_t* rowsOf(std::size_t n) { return rows_.data() + n * count_; }

  std::size_t count_ = 0;            ///< rows of an image that are looked at
  std::vector<std::uint32_t> rows_;  ///< a ring: fingerprints of images' rows, 0 for those that are alike by themselves
  std::vector<std::uint64_t> whole_;  ///< fingerprints of images
  std::vector<std::int64_t> stamps_;
  std::size_t next_ = 0;
  cv::Size size_;
  int type_ = -1;
};
}  // namespace xray_tracking
