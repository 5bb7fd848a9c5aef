#include <array>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <opencv2/imgcodecs.hpp>

#include "../volume/dicom_file.h"
#include "../volume/short_uids.h"
#include "xray_formats.h"
#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
namespace
{
/// Of line integrals in floating point: 16 bit hold up to 16 of them, a body's width of bone, in steps that are far
/// below what noise allows.
constexpr double kPerLineIntegral = 4096.0;
/// Noise of a line integral behind air alone may be negative; so far is none.
constexpr double kLeastLineIntegral = -1.0;
/// Counts in floating point up to here only are a fraction of something.
constexpr double kFewestCounts = 32.0;

[[noreturn]] void fail(const std::string& path, const std::string& what)
{
  throw std::runtime_error(withShortUids(path + ": " + what));
}

enum class Format
{
  PNG,
  TIFF,
  OTHER
};

Format formatOf(const std::string& path)
{
  std::array<char, 4> start{};
  std::ifstream(path, std::ios::binary).read(start.data(), start.size());
  const std::string magic(start.data(), start.size());
  if (magic == "\x89PNG")
  {
    return Format::PNG;
  }
  for (const char version : { '\x2a', '\x2b' })  // 2b: of files beyond 4 GB
  {
    if (magic == std::string{ 'I', 'I', version, '\0' } || magic == std::string{ 'M', 'M', '\0', version })
    {
      return Format::TIFF;
    }
  }
  return Format::OTHER;
}

/// Before anything is allocated for what a header claims.
void requireSize(const Eigen::Vector2i& size, const Eigen::Vector2i& expected, const std::string& path)
{
  if (size != expected)
  {
    fail(path, "is " + std::to_string(size.x()) + " x " + std::to_string(size.y()) + ": expected " +
                   std::to_string(expected.x()) + " x " + std::to_string(expected.y()) + " pixels");
  }
}

cv::Mat readPng(const std::string& path, const Eigen::Vector2i& expected)
{
  // Signature, length and name of the first chunk, width, height.
  std::array<unsigned char, 24> start{};
  std::ifstream file(path, std::ios::binary);
  file.read(reinterpret_cast<char*>(start.data()), start.size());
  const auto number = [&start](std::size_t at)
  {
    const std::uint32_t bytes = std::uint32_t{ start[at] } << 24 | std::uint32_t{ start[at + 1] } << 16 |
                                std::uint32_t{ start[at + 2] } << 8 | start[at + 3];
    return static_cast<int>(bytes & 0x7fffffffU);
  };
  if (!file || std::string(start.begin() + 12, start.begin() + 16) != "IHDR")
  {
    fail(path, "not readable or truncated");
  }
  requireSize({ number(16), number(20) }, expected, path);
  cv::Mat image;
  try
  {
    image = cv::imread(path, cv::IMREAD_UNCHANGED);
  }
  catch (const cv::Exception& error)
  {
    fail(path, std::string("not readable: ") + error.what());
  }
  if (image.empty())
  {
    fail(path, "not readable or truncated");
  }
  return image;
}

/// Grey values that are stored as colours, which are all the same, or with transparency, of which there is none.
cv::Mat greyOf(const cv::Mat& image, const std::string& path)
{
  const int channels = image.channels();
  if (channels == 1)
  {
    return image;
  }
  std::vector<cv::Mat> planes;
  cv::split(image, planes);
  if (channels % 2 == 0)
  {
    double opaque = 0.0;
    cv::minMaxLoc(planes.back(), &opaque);
    if (image.depth() > CV_16U || opaque != (image.depth() == CV_8U ? 255.0 : 65535.0))
    {
      fail(path, "has an alpha channel that is not opaque everywhere: expected one channel of grey values");
    }
    planes.pop_back();
  }
  for (const cv::Mat& plane : planes)
  {
    if (cv::norm(plane, planes.front(), cv::NORM_INF) > 0.0)
    {
      fail(path, "has " + std::to_string(channels) +
                     " channels that differ, colours: expected one channel of grey "
                     "values");
    }
  }
  return planes.front();
}

cv::Mat countsOf(const cv::Mat& values, IntensityModel::Kind kind, bool floating, const std::string& path)
{
  double scale = 1.0;
  double min = 0.0, max = 0.0;
  if (values.depth() != CV_8U && values.depth() != CV_16U)
  {
    if (!cv::checkRange(values))
    {
      fail(path, "has values that are not finite");
    }
    cv::minMaxLoc(values, &min, &max);
    std::ostringstream range;
    range << "has values from " << min << " to " << max << ": expected ";
    if (floating && kind == IntensityModel::Kind::ATTENUATION)
    {
      scale = kPerLineIntegral;
      if (min < kLeastLineIntegral || max * scale > 65535.0 || !(max > 0.0))
      {
        fail(path, range.str() + "line integrals (kind: attenuation in floating point), 0 to 16");
      }
    }
    else if (min < 0.0 || max > 65535.0 || (floating && max < kFewestCounts))
    {
      fail(path, range.str() + (floating ? "counts, 0 to 65535, not a share of something" : "0 to 65535"));
    }
  }
  cv::Mat counts;
  values.convertTo(counts, CV_16U, scale);
  return counts;
}
}  // namespace

cv::Mat readXrayImage(const std::string& path, const ProjectionGeometry& detector, const IntensityModel& intensity)
{
  if (!std::filesystem::is_regular_file(path))
  {
    fail(path, "missing");
  }
  const Eigen::Vector2i& expected = detector.imageSize();
  cv::Mat values;
  bool floating = false;
  switch (formatOf(path))
  {
    case Format::PNG:
      values = greyOf(readPng(path, expected), path);
      break;
    case Format::TIFF:
      values = greyOf(readTiff(path, { expected.x(), expected.y() }), path);
      floating = values.depth() >= CV_32F;
      break;
    case Format::OTHER:
      if (const auto header = readDicomHeader(path);
          !header || (header->fault.empty() && !header->data.has({ 0x0028, 0x0010 })))
      {
        fail(path, "expected a PNG, TIFF or DICOM image");
      }
      values = readDicomXray(path, detector, intensity.kind);
  }
  requireSize({ values.cols, values.rows }, expected, path);
  return countsOf(values, intensity.kind, floating, path);
}
}  // namespace xray_tracking
