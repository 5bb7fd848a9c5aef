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

/// Of the header that a PNG file begins with.
std::uint32_t pngNumber(const std::string& header, std::size_t at)
{
  std::uint32_t number = 0;
  for (std::size_t n = at; n < at + 4; ++n)
  {
    number = number << 8 | static_cast<unsigned char>(header[n]);
  }
  return number;
}

cv::Mat readPng(const std::string& path, const ProjectionGeometry& detector)
{
  std::string header(24, '\0');
  if (!std::ifstream(path, std::ios::binary).read(header.data(), static_cast<std::streamsize>(header.size())))
  {
    fail(path, "not readable or truncated");
  }
  requireSize(path, pngNumber(header, 16), pngNumber(header, 20), detector);
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

void requireSize(const std::string& path, std::uint32_t columns, std::uint32_t rows, const ProjectionGeometry& detector)
{
  const Eigen::Vector2i& expected = detector.imageSize();
  if (columns != static_cast<std::uint32_t>(expected.x()) || rows != static_cast<std::uint32_t>(expected.y()))
  {
    fail(path, "is " + std::to_string(columns) + " x " + std::to_string(rows) + ": expected " +
                   std::to_string(expected.x()) + " x " + std::to_string(expected.y()) + " pixels");
  }
}

cv::Mat readXrayImage(const std::string& path, const ProjectionGeometry& detector, const IntensityModel& intensity)
{
  if (!std::filesystem::is_regular_file(path))
  {
    fail(path, "missing");
  }
  cv::Mat values;
  bool floating = false;
  switch (formatOf(path))
  {
    case Format::PNG:
      values = greyOf(readPng(path, detector), path);
      break;
    case Format::TIFF:
      values = greyOf(readTiff(path, detector), path);
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
  return countsOf(values, intensity.kind, floating, path);
}
}  // namespace xray_tracking
