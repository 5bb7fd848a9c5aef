#include <algorithm>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <vector>

#include <tiffio.h>

#include "xray_formats.h"

namespace xray_tracking
{
namespace
{
using TiffFile = std::unique_ptr<TIFF, void (*)(TIFF*)>;

struct Layout
{
  std::uint32_t columns = 0, rows = 0;
  std::uint16_t bits = 1, samples = 1, format = SAMPLEFORMAT_UINT, photometric = PHOTOMETRIC_MINISBLACK;
  std::uint16_t orientation = ORIENTATION_TOPLEFT, planar = PLANARCONFIG_CONTIG;
};

[[noreturn]] void fail(const std::string& path, const std::string& what)
{
  throw std::runtime_error(path + ": " + what);
}

Layout layoutOf(TIFF* tiff)
{
  Layout layout;
  TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &layout.columns);
  TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &layout.rows);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &layout.bits);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &layout.samples);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &layout.format);
  TIFFGetField(tiff, TIFFTAG_PHOTOMETRIC, &layout.photometric);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_ORIENTATION, &layout.orientation);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_PLANARCONFIG, &layout.planar);
  return layout;
}

/// Not counting thumbnails and masks.
int pagesOf(TIFF* tiff)
{
  int pages = 0;
  do
  {
    std::uint32_t kind = 0;
    TIFFGetField(tiff, TIFFTAG_SUBFILETYPE, &kind);
    pages += (kind & (FILETYPE_REDUCEDIMAGE | FILETYPE_MASK)) == 0 ? 1 : 0;
  } while (TIFFReadDirectory(tiff) != 0);
  TIFFSetDirectory(tiff, 0);
  return pages;
}

int pixelType(const Layout& layout, const std::string& path)
{
  if (layout.format == SAMPLEFORMAT_IEEEFP && (layout.bits == 32 || layout.bits == 64))
  {
    return CV_MAKETYPE(layout.bits == 32 ? CV_32F : CV_64F, layout.samples);
  }
  const bool is_signed = layout.format == SAMPLEFORMAT_INT;
  if (layout.format == SAMPLEFORMAT_UINT || layout.format == SAMPLEFORMAT_VOID || is_signed)
  {
    if (layout.bits == 8)
    {
      return CV_MAKETYPE(is_signed ? CV_8S : CV_8U, layout.samples);
    }
    if (layout.bits == 16 || (layout.bits > 1 && layout.bits < 16 && layout.samples == 1 && !is_signed))
    {
      return CV_MAKETYPE(is_signed ? CV_16S : CV_16U, layout.samples);
    }
    if (layout.bits == 32)
    {
      return CV_MAKETYPE(CV_32S, layout.samples);
    }
  }
  fail(path, "has values of " + std::to_string(layout.bits) + " bit, sample format " + std::to_string(layout.format) +
                 ": expected whole numbers of 2 to 16 or 32 bit, or floating point of 32 or 64");
}

/// Values packed without gaps, the highest bit first.
void unpack(const std::vector<std::uint8_t>& packed, int bits, std::uint16_t* values, int count)
{
  std::size_t at = 0;
  for (int n = 0; n < count; ++n)
  {
    unsigned value = 0;
    for (int bit = 0; bit < bits; ++bit, ++at)
    {
      value = value << 1 | (packed[at / 8] >> (7 - at % 8) & 1u);
    }
    values[n] = static_cast<std::uint16_t>(value);
  }
}

void readRows(TIFF* tiff, const Layout& layout, const std::string& path, cv::Mat& image)
{
  const bool packed = layout.bits < 16 && layout.bits != 8;
  std::vector<std::uint8_t> row(static_cast<std::size_t>(TIFFScanlineSize(tiff)));
  if (row.size() < (static_cast<std::size_t>(layout.columns) * layout.samples * layout.bits + 7) / 8)
  {
    fail(path, "not readable");
  }
  for (int y = 0; y < image.rows; ++y)
  {
    if (TIFFReadScanline(tiff, row.data(), static_cast<std::uint32_t>(y)) < 0)
    {
      fail(path, "not readable or truncated");
    }
    if (packed)
    {
      unpack(row, layout.bits, image.ptr<std::uint16_t>(y), image.cols);
    }
    else
    {
      std::copy_n(row.begin(), image.cols * image.elemSize(), image.ptr<std::uint8_t>(y));
    }
  }
}

void readTiles(TIFF* tiff, const std::string& path, cv::Mat& image)
{
  std::uint32_t columns = 0, rows = 0;
  TIFFGetField(tiff, TIFFTAG_TILEWIDTH, &columns);
  TIFFGetField(tiff, TIFFTAG_TILELENGTH, &rows);
  // A file may claim any size; one tile, in steps of 16, is enough for the image.
  const auto most = static_cast<std::uint32_t>(std::max({ image.cols, image.rows, 1024 })) + 16;
  if (columns < 1 || rows < 1 || columns > most || rows > most)
  {
    fail(path, "has tiles of " + std::to_string(columns) + " x " + std::to_string(rows) + " pixels, expected 1 to " +
                   std::to_string(most));
  }
  cv::Mat tile(static_cast<int>(rows), static_cast<int>(columns), image.type());
  if (static_cast<std::size_t>(TIFFTileSize(tiff)) != tile.total() * tile.elemSize())
  {
    fail(path, "has tiles of values that are packed, expected 8, 16 or 32 bit");
  }
  for (int y = 0; y < image.rows; y += tile.rows)
  {
    for (int x = 0; x < image.cols; x += tile.cols)
    {
      if (TIFFReadTile(tiff, tile.data, static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y), 0, 0) < 0)
      {
        fail(path, "not readable or truncated");
      }
      const cv::Rect place = cv::Rect(x, y, tile.cols, tile.rows) & cv::Rect({}, image.size());
      tile(cv::Rect({}, place.size())).copyTo(image(place));
    }
  }
}
}  // namespace

cv::Mat readTiff(const std::string& path, const ProjectionGeometry& detector)
{
  // They print; what matters is thrown here.
  TIFFSetWarningHandler(nullptr);
  TIFFSetErrorHandler(nullptr);
  const TiffFile tiff(TIFFOpen(path.c_str(), "r"), TIFFClose);
  if (!tiff)
  {
    fail(path, "not readable or truncated");
  }
  if (const int pages = pagesOf(tiff.get()); pages != 1)
  {
    fail(path, "has " + std::to_string(pages) + " pages, expected 1: a file for each exposure");
  }
  const Layout layout = layoutOf(tiff.get());
  if (layout.photometric != PHOTOMETRIC_MINISBLACK && layout.photometric != PHOTOMETRIC_MINISWHITE &&
      layout.photometric != PHOTOMETRIC_RGB)
  {
    fail(path, "PhotometricInterpretation is " + std::to_string(layout.photometric) +
                   (layout.photometric == PHOTOMETRIC_PALETTE ? ", a palette" : "") +
                   ": expected 0 or 1, the detector's own grey values");
  }
  if (layout.orientation != ORIENTATION_TOPLEFT)
  {
    fail(path, "Orientation is " + std::to_string(layout.orientation) + ", expected 1: first row on top, not turned");
  }
  if (layout.samples > 4 || (layout.samples > 1 && layout.planar != PLANARCONFIG_CONTIG))
  {
    fail(path, "has " + std::to_string(layout.samples) + " channels, expected one");
  }
  requireSize(path, layout.columns, layout.rows, detector);
  cv::Mat image(static_cast<int>(layout.rows), static_cast<int>(layout.columns), pixelType(layout, path));
  if (TIFFIsTiled(tiff.get()) != 0)
  {
    readTiles(tiff.get(), path, image);
  }
  else
  {
    readRows(tiff.get(), layout, path, image);
  }
  if (image.depth() == CV_32S && layout.format != SAMPLEFORMAT_INT)
  {
    // What is beyond the signed range comes out of the range of counts either way.
    image = cv::max(image, -1);
  }
  return image;
}
}  // namespace xray_tracking
