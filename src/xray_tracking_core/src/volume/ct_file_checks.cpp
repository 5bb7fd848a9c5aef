#include "ct_file_checks.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <map>
#include <memory>
#include <sstream>

#include <itkMetaDataObject.h>
#include <itkMetaImageIO.h>
#include <itkNiftiImageIO.h>
#include <itkNrrdImageIO.h>
#include <zlib.h>

#include "ct_error.h"

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;
using GzFile = std::unique_ptr<gzFile_s, int (*)(gzFile)>;

/// Reads files that are not compressed, too.
GzFile openGz(const std::string& path)
{
  return { gzopen(path.c_str(), "rb"), gzclose };
}

/// The file of a NIfTI pair with the header or the voxels, `part` being .hdr or .img; a single file is both.
std::string niftiPart(std::string path, const std::string& part)
{
  for (const char* extension : { ".hdr", ".img" })
  {
    for (const char* compression : { "", ".gz" })
    {
      const std::string ending = std::string(extension) + compression;
      if (path.size() > ending.size() && path.compare(path.size() - ending.size(), ending.size(), ending) == 0)
      {
        return path.replace(path.size() - ending.size(), part.size(), part);
      }
    }
  }
  return path;
}

/// The fields of a text header up to the one that ends it, or to an empty line; without the spaces around them.
struct TextHeader
{
  std::map<std::string, std::string> fields;
  std::streamoff end = 0;  ///< where the header's last line ends [bytes]
};

TextHeader readTextHeader(const std::string& path, char separator, const std::string& last_field)
{
  const auto trimmed = [](const std::string& text)
  {
    const auto first = text.find_first_not_of(" \t\r");
    return first == std::string::npos ? "" : text.substr(first, text.find_last_not_of(" \t\r") - first + 1);
  };
  TextHeader header;
  std::ifstream file(path, std::ios::binary);
  for (std::string line; std::getline(file, line) && !trimmed(line).empty();)
  {
    header.end = file.eof() ? static_cast<std::streamoff>(fs::file_size(path)) : std::streamoff(file.tellg());
    const std::size_t at = line.find(separator);
    if (at != std::string::npos && line[0] != '#')
    {
      const std::string key = trimmed(line.substr(0, at));
      header.fields[key] = trimmed(line.substr(at + 1));
      if (key == last_field)
      {
        break;
      }
    }
  }
  return header;
}

TextHeader readMetaImageHeader(const std::string& path)
{
  return readTextHeader(path, '=', "ElementDataFile");
}

void requireAllOfMetaImage(const itk::ImageIOBase& format, const std::string& path)
{
  TextHeader header = readMetaImageHeader(path);
  const std::string data = header.fields["ElementDataFile"];
  const fs::path data_file = data == "LOCAL" ? fs::path(path) : fs::path(path).parent_path() / data;
  if (!fs::is_regular_file(data_file))
  {
    return;  // many files, by a list or a pattern; ITK misses those that are not there
  }
  std::uintmax_t expected = format.GetImageSizeInBytes();
  if (header.fields["CompressedData"] == "True")
  {
    expected = 0;  // some files do not say
    std::istringstream(header.fields["CompressedDataSize"]) >> expected;
  }
  const std::uintmax_t start = data == "LOCAL" ? static_cast<std::uintmax_t>(header.end) : 0;
  if (fs::file_size(data_file) < start + expected)
  {
    failCt(path, "truncated: " + data_file.string() + " has " + std::to_string(fs::file_size(data_file)) +
                     " bytes, expected " + std::to_string(start + expected));
  }
}

void requireAllOfNifti(const itk::ImageIOBase& format, const std::string& path)
{
  std::string offset = "0";
  std::string bits = "0";
  itk::ExposeMetaData<std::string>(format.GetMetaDataDictionary(), "vox_offset", offset);
  // As stored: ITK's own size is that of the rescaled values.
  itk::ExposeMetaData<std::string>(format.GetMetaDataDictionary(), "bitpix", bits);
  const auto end = static_cast<z_off_t>(std::stoll(offset) + format.GetImageSizeInPixels() * std::stoll(bits) / 8);
  const GzFile file = openGz(niftiPart(path, ".img"));
  if (!file || gzseek(file.get(), end - 1, SEEK_SET) != end - 1 || gzgetc(file.get()) == -1)
  {
    failCt(path, "truncated: its data end before the last voxel");
  }
}

void requireMillimetresOfNrrd(const std::string& path)
{
  TextHeader header = readTextHeader(path, ':', "");
  if (header.fields.count("space directions") == 0 && header.fields.count("spacings") == 0)
  {
    failCt(path, "has neither space directions nor spacings: the size of a voxel is not known");
  }
  for (const char* field : { "space units", "units" })
  {
    // One quoted text an axis.
    std::istringstream units(header.fields[field]);
    for (std::string unit; std::getline(units, unit, '"') && std::getline(units, unit, '"');)
    {
      if (!unit.empty() && unit != "mm" && unit.compare(0, 7, "millime") != 0)
      {
        failCt(path, std::string(field) + " are " + header.fields[field] + ", expected \"mm\"");
      }
    }
  }
}
}  // namespace

void requireUsableNiftiHeader(const std::string& path)
{
  struct Field
  {
    const char* name;
    std::size_t offset;
    std::size_t count;  ///< floats
  };
  constexpr std::array<Field, 4> kFields{
    { { "pixdim", 80, 3 }, { "quatern", 256, 3 }, { "qoffset", 268, 3 }, { "srow", 280, 12 } }
  };
  constexpr std::uint32_t kNotFinite = 0x7f800000;  // exponent of NaN and infinity

  std::array<char, 348> header{};
  const GzFile file = openGz(niftiPart(path, ".hdr"));
  if (!file || gzread(file.get(), header.data(), header.size()) != static_cast<int>(header.size()))
  {
    failCt(path, "truncated: its header ends early");
  }
  const std::string magic(&header[344], 3);
  const bool has_form = header[252] != 0 || header[253] != 0 || header[254] != 0 || header[255] != 0;
  if ((magic != "n+1" && magic != "ni1") || !has_form)
  {
    failCt(path, "its header does not say where its axes run: qform_code and sform_code are 0, or it is Analyze");
  }
  // ITK scales the spacing, but not the position.
  const int unit = header[123] & 7;
  if (unit != 0 && unit != 2)
  {
    failCt(path, std::string("is in ") + (unit == 1 ? "m" : unit == 3 ? "um" : "unknown units") + ", expected mm");
  }
  std::int32_t header_size = 0;
  std::memcpy(&header_size, header.data(), sizeof(header_size));
  const bool swapped = header_size != static_cast<std::int32_t>(header.size());
  for (const Field& field : kFields)
  {
    for (std::size_t n = 0; n < field.count; ++n)
    {
      std::array<char, 4> bytes{};
      std::copy_n(header.begin() + field.offset + 4 * n, bytes.size(), bytes.begin());
      if (swapped)
      {
        std::reverse(bytes.begin(), bytes.end());
      }
      std::uint32_t bits = 0;
      std::memcpy(&bits, bytes.data(), sizeof(bits));
      if ((bits & kNotFinite) == kNotFinite)
      {
        failCt(path, std::string("field ") + field.name + " of its header is not finite");
      }
    }
  }
}

void requireMillimetres(const itk::ImageIOBase& format, const std::string& path)
{
  if (dynamic_cast<const itk::NrrdImageIO*>(&format))
  {
    requireMillimetresOfNrrd(path);
  }
  else if (dynamic_cast<const itk::MetaImageIO*>(&format))
  {
    const std::string unit = readMetaImageHeader(path).fields["DistanceUnits"];
    if (!unit.empty() && unit != "mm" && unit != "?")
    {
      failCt(path, "DistanceUnits is " + unit + ", expected mm");
    }
  }
}

void requireAllVoxels(const itk::ImageIOBase& format, const std::string& path)
{
  if (dynamic_cast<const itk::MetaImageIO*>(&format))
  {
    requireAllOfMetaImage(format, path);
  }
  else if (dynamic_cast<const itk::NiftiImageIO*>(&format))
  {
    requireAllOfNifti(format, path);
  }
}
}  // namespace xray_tracking
