#include "xray_tracking_core/image/repeated_image.h"

#include <algorithm>
#include <cstring>

#include "pixel_type.h"

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

constexpr int kEvery = 8;        // rows
constexpr int kLeastSteps = 32;  // of a row that noise tells from others
constexpr double kShare = 0.4;   // of its rows; a burnt-in clock and a few lines of text have less

/// Four sums side by side, as one has to wait for its last multiplication. Each step is a bijection of the sum.
struct Sums
{
  std::uint64_t lanes[4] = { 1, 2, 3, 4 };

  std::uint64_t all() const
  {
    std::uint64_t sum = 0;
    for (const std::uint64_t lane : lanes)
    {
      sum = mixed(sum ^ lane) + lane;
    }
    return sum;
  }

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

/// Whether enough pixels differ from the one before them.
template <typename Pixel>
bool isLively(const Pixel* row, int count)
{
  int steps = 0;
  for (int x = 1; x < count && steps < kLeastSteps; ++x)
  {
    steps += row[x] != row[x - 1];
  }
  return steps >= kLeastSteps;
}
}  // namespace

std::optional<std::int64_t> RepeatedImageCheck::add(const cv::Mat& image, std::int64_t stamp_ns)
{
  if (image.size() != size_ || image.type() != type_)
  {
    reset();
    size_ = image.size();
    type_ = image.type();
    count_ = static_cast<std::size_t>((image.rows + kEvery - 1) / kEvery);
    // The place after the last one is the new image's.
    rows_.resize((kRemembered + 1) * count_);
    whole_.reserve(kRemembered);
    stamps_.reserve(kRemembered);
  }
  std::uint32_t* rows = rowsOf(kRemembered);
  std::uint64_t whole = 0;
  std::size_t lively = 0;
  for (std::size_t n = 0; n < count_; ++n)
  {
    const int y = std::min(static_cast<int>(n) * kEvery + static_cast<int>(n % 2), image.rows - 1);
    Sums sums;
    sums.add(image.ptr(y), static_cast<std::size_t>(image.cols) * image.elemSize());
    const std::uint64_t row = sums.all();
    whole = mixed(whole ^ row) + row;
    bool is_lively = false;
    if (isPixelType(image))
    {
      withPixelType(image, [&](auto pixel) { is_lively = isLively(image.ptr<decltype(pixel)>(y), image.cols); });
    }
    // Zero is none: once in 2^32 a row counts as alike by itself.
    rows[n] = is_lively ? static_cast<std::uint32_t>(row) : 0U;
    lively += is_lively;
  }
  const auto is_of = [&](std::size_t image_before)
  {
    const std::uint32_t* before = rowsOf(image_before);
    std::uint32_t same = 0;  // as wide as what is compared, for vectors
    for (std::size_t n = 0; n < count_; ++n)
    {
      same += static_cast<std::uint32_t>(rows[n] == before[n]) & static_cast<std::uint32_t>(rows[n] != 0);
    }
    return whole == whole_[image_before] ||
           (same > 0 && static_cast<double>(same) >= kShare * static_cast<double>(lively));
  };
  for (std::size_t n = 0; n < stamps_.size(); ++n)
  {
    // From the last one on.
    const std::size_t before = (next_ + stamps_.size() - 1 - n) % stamps_.size();
    if (is_of(before))
    {
      return stamps_[before];
    }
  }
  if (stamps_.size() < kRemembered)
  {
    whole_.push_back(whole);
    stamps_.push_back(stamp_ns);
    std::copy_n(rows, count_, rowsOf(stamps_.size() - 1));
    return std::nullopt;
  }
  whole_[next_] = whole;
  stamps_[next_] = stamp_ns;
  std::copy_n(rows, count_, rowsOf(next_));
  next_ = (next_ + 1) % kRemembered;
  return std::nullopt;
}

void RepeatedImageCheck::reset()
{
  whole_.clear();
  stamps_.clear();
  next_ = 0;
  size_ = cv::Size();
}
}  // namespace xray_tracking
