#include "ct_file_checks.h"

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <locale>
#include <optional>
#include <sstream>
#include <utility>
#include <vector>

#include <itkMetaImageIO.h>
#include <itkNrrdImageIO.h>

#include "ct_error.h"
#include "stored_volume.h"
#include "text_header.h"

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;
/// What deflate takes a byte for, at most: more than a file can hold is not even allocated.
constexpr std::uintmax_t kMostDeflated = 1032;

/// @param data file with the voxels, which begin at `start` there; `least` bytes of it [bytes]
void requireBytes(const std::string& path, const fs::path& data, std::uintmax_t start, std::uintmax_t least)
{
  const std::uintmax_t size = fs::file_size(data);
  const std::uintmax_t held = size - std::min(size, start);
  if (held < least)
  {
    failCt(path, "truncated: " + data.string() + " has " + std::to_string(held) + " bytes of voxels, expected " +
                     std::to_string(least));
  }
}

void requireAllOfMetaImage(const itk::ImageIOBase& format, const std::string& path)
{
  TextHeader header = readMetaImageHeader(path);
  const std::optional<std::string> data_file = metaImageDataFile(header, path);
  if (!data_file)
  {
    return;  // many files; ITK misses those that are not there
  }
  std::uintmax_t expected = static_cast<std::uintmax_t>(format.GetImageSizeInBytes());
  if (header.fields["CompressedData"] == "True")
  {
    const std::uintmax_t least = expected / kMostDeflated;
    expected = 0;  // some files do not say
    std::istringstream(header.fields["CompressedDataSize"]) >> expected;
    expected = std::max(expected, least);
  }
  requireBytes(path, *data_file, *data_file == path ? static_cast<std::uintmax_t>(header.end) : 0, expected);
}

void requireAllOfNrrd(const itk::ImageIOBase& format, const std::string& path)
{
  TextHeader header = readNrrdHeader(path);
  const std::string data = dataFileOf(header);
  const fs::path data_file = data.empty() ? fs::path(path) : fs::path(path).parent_path() / data;
  if (!fs::is_regular_file(data_file))
  {
    return;  // as above
  }
  const std::uintmax_t bytes = static_cast<std::uintmax_t>(format.GetImageSizeInBytes());
  const std::string encoding = header.fields["encoding"];
  requireBytes(path, data_file, data.empty() ? static_cast<std::uintmax_t>(header.end) : 0,
               encoding == "raw" ? bytes : bytes / kMostDeflated);
}

/// ITK holds ten, and takes no notice of how many a header has.
constexpr int kMostAxes = 10;

/// Before anything is allocated for them, and before ITK takes the numbers for what fits its own.
void requireBoundedSize(const TextHeader& header, const std::string& dimensions_field, const std::string& sizes_field,
                        const std::string& path)
{
  const auto field = [&header](const std::string& name)
  {
    const auto found = header.fields.find(name);
    return found == header.fields.end() ? std::string() : found->second;
  };
  std::istringstream sizes(field(sizes_field));
  sizes.imbue(std::locale::classic());
  std::size_t voxels = 1;
  int count = 0;
  for (std::size_t size = 0; sizes >> size; ++count)
  {
    voxels = size <= kMostVoxels && voxels <= kMostVoxels ? voxels * size : kMostVoxels + 1;
  }
  // How many there are to be, ITK says afterwards: voxels of several values are an axis more in NRRD.
  if (count < 2 || count > kMostAxes || field(dimensions_field) != std::to_string(count) || !sizes.eof() ||
      voxels > kMostVoxels)
  {
    failCt(path, dimensions_field + " is " + field(dimensions_field).substr(0, 80) + ", " + sizes_field + " " +
                     field(sizes_field).substr(0, 80) + ", expected 3 and as many whole numbers, of " +
                     std::to_string(kMostVoxels) + " voxels at most");
  }
}

void requireMillimetresOfNrrd(const std::string& path)
{
  TextHeader header = readNrrdHeader(path);
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
/// Signs that turn a NRRD's space into LPS; nothing for what is no space of a patient.
std::optional<Eigen::Vector3d> lpsFromSpace(const std::string& space)
{
  std::string letters;
  for (const char letter : space)
  {
    if (std::isalpha(static_cast<unsigned char>(letter)) != 0)
    {
      letters += static_cast<char>(std::tolower(static_cast<unsigned char>(letter)));
    }
  }
  if (letters.empty() || letters == "leftposteriorsuperior" || letters == "lps")
  {
    return Eigen::Vector3d(1, 1, 1);
  }
  if (letters == "rightanteriorsuperior" || letters == "ras")
  {
    return Eigen::Vector3d(-1, -1, 1);
  }
  if (letters == "leftanteriorsuperior" || letters == "las")
  {
    return Eigen::Vector3d(1, -1, 1);
  }
  return std::nullopt;
}

/// "(a,b,c)" by "(a,b,c)". @throws if there are not `count` of them
std::vector<Eigen::Vector3d> nrrdVectors(TextHeader& header, const std::string& field, std::size_t count,
                                         const std::string& path)
{
  std::string numbers = header.fields[field];
  std::replace_if(
      numbers.begin(), numbers.end(), [](char c) { return c == '(' || c == ')' || c == ','; }, ' ');
  std::istringstream stream(numbers);
  stream.imbue(std::locale::classic());
  std::vector<Eigen::Vector3d> vectors;
  for (Eigen::Vector3d vector; stream >> vector.x() >> vector.y() >> vector.z();)
  {
    vectors.push_back(vector);
  }
  if (vectors.size() != count || !stream.eof())
  {
    failCt(path,
           field + " is " + header.fields[field] + ", expected " + std::to_string(count) + " vectors of 3 numbers");
  }
  return vectors;
}

void requireUsableNrrdHeader(const std::string& path)
{
  TextHeader header = readNrrdHeader(path);
  requireBoundedSize(header, "dimension", "sizes", path);
  if (!lpsFromSpace(header.fields["space"]))
  {
    failCt(path, "space is " + header.fields["space"] +
                     ", expected left-posterior-superior, right-anterior-superior or left-anterior-superior");
  }
  if (header.fields.count("old min") + header.fields.count("oldmin") > 0)
  {
    failCt(path, "has quantised values (old min), expected Hounsfield units");
  }
  requireMillimetresOfNrrd(path);
}

/// Of an axis in MetaImage's letters, from where it comes (RAI: LPS), or where it goes to (LPS), as some write it.
std::string lettersOf(const Eigen::Matrix3d& axes, bool from)
{
  std::string letters;
  for (int axis = 0; axis < 3; ++axis)
  {
    Eigen::Index row = 0;
    axes.col(axis).cwiseAbs().maxCoeff(&row);
    const bool positive = axes(row, axis) > 0.0;
    letters += (positive != from ? "LPS" : "RAI")[row];
  }
  return letters;
}

/// ITK takes as much memory as CompressedDataSize says before it reads, whatever that is, and finds it in lines that
/// are none of a header to us.
/// @param data_file with the voxels, if that is one
void requireBoundedCompression(const std::optional<std::string>& data_file, const std::string& path)
{
  const std::uintmax_t most = std::max(fs::file_size(path), data_file ? fs::file_size(*data_file) : 0);
  std::ifstream file(path, std::ios::binary);
  const std::string key = "CompressedDataSize";
  for (std::string line; std::getline(file, line);)
  {
    const std::size_t at = line.find(key);
    if (at == std::string::npos)
    {
      continue;
    }
    const std::size_t begin = std::min(line.find_first_not_of(" \t:=", at + key.size()), line.size());
    const std::size_t end = line.find_last_not_of(" \t\r") + 1;
    const std::string stated = line.substr(begin, end - std::min(begin, end));
    if (stated.empty() || stated.size() > 18 || stated.find_first_not_of("0123456789") != std::string::npos ||
        std::stoull(stated) > most)
    {
      failCt(path, key + " is " + stated.substr(0, 80) + ", expected a number of bytes, " + std::to_string(most) +
                       " at most: that many has the file");
    }
  }
}

void requireUsableMetaImageHeader(const std::string& path)
{
  TextHeader header = readMetaImageHeader(path);
  requireBoundedSize(header, "NDims", "DimSize", path);
  const std::optional<std::string> data_file = metaImageDataFile(header, path);
  if (data_file && !fs::is_regular_file(*data_file))
  {
    failCt(path,
           "ElementDataFile is " + header.fields["ElementDataFile"].substr(0, 80) + ", which is no file in its folder");
  }
  requireBoundedCompression(data_file, path);
  const std::string unit = header.fields["DistanceUnits"];
  if (!unit.empty() && unit != "mm" && unit != "?")
  {
    failCt(path, "DistanceUnits is " + unit + ", expected mm");
  }
  if (header.fields["ElementSpacing"].empty() && header.fields["ElementSize"].empty())
  {
    failCt(path, "has neither ElementSpacing nor ElementSize: the size of a voxel is not known");
  }
  for (const auto& [field, neutral] : { std::make_pair("ElementToIntensityFunctionSlope", 1.0),
                                        std::make_pair("ElementToIntensityFunctionOffset", 0.0) })
  {
    double value = neutral;
    std::istringstream(header.fields[field]) >> value;
    if (value != neutral)
    {
      failCt(path, std::string(field) + " is " + header.fields[field] + ", expected Hounsfield units as they are");
    }
  }
  // ITK goes by the matrix alone.
  const std::string letters = header.fields["AnatomicalOrientation"];
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();
  std::string matrix = "absent";
  for (const char* field : { "TransformMatrix", "Rotation", "Orientation" })
  {
    std::istringstream numbers(header.fields[field]);
    numbers.imbue(std::locale::classic());
    Eigen::Matrix3d read;
    bool complete = true;
    for (int n = 0; n < 9; ++n)
    {
      complete = complete && static_cast<bool>(numbers >> read(n % 3, n / 3));
    }
    if (complete)
    {
      axes = read;
      matrix = header.fields[field];
    }
  }
  const bool along_patient = axes.cwiseAbs().colwise().maxCoeff().minCoeff() > 0.9;  // else no letters say it
  if (along_patient && letters.size() == 3 && letters.find('?') == std::string::npos &&
      letters != lettersOf(axes, true) && letters != lettersOf(axes, false))
  {
    failCt(path, "AnatomicalOrientation is " + letters + ", but TransformMatrix is " + matrix + ", which is " +
                     lettersOf(axes, true) + ": expected both to mean the same axes");
  }
}
}  // namespace

void requireUsableTextHeader(const itk::ImageIOBase& format, const std::string& path)
{
  if (dynamic_cast<const itk::NrrdImageIO*>(&format))
  {
    requireUsableNrrdHeader(path);
  }
  else
  {
    requireUsableMetaImageHeader(path);
  }
}

void requireAllVoxels(const itk::ImageIOBase& format, const std::string& path)
{
  if (dynamic_cast<const itk::MetaImageIO*>(&format))
  {
    requireAllOfMetaImage(format, path);
  }
  else
  {
    requireAllOfNrrd(format, path);
  }
}

VolumeGrid gridOf(const itk::ImageIOBase& format, const std::string& path)
{
  VolumeGrid grid;
  for (unsigned axis = 0; axis < 3; ++axis)
  {
    if (format.GetDimensions(axis) > kMostVoxels)
    {
      failCt(path, "is " + std::to_string(format.GetDimensions(axis)) + " voxels wide, expected " +
                       std::to_string(kMostVoxels) + " in all at most");
    }
    grid.size[axis] = static_cast<int>(format.GetDimensions(axis));
    grid.patient_from_index.translation()[axis] = format.GetOrigin(axis);
    grid.patient_from_index.linear().col(axis) =
        format.GetSpacing(axis) * Eigen::Vector3d(format.GetDirection(axis).data());
  }
  if (dynamic_cast<const itk::NrrdImageIO*>(&format))
  {
    TextHeader header = readNrrdHeader(path);
    if (header.fields.count("space directions") > 0)
    {
      const Eigen::Vector3d signs = lpsFromSpace(header.fields["space"]).value();
      const auto to_lps = signs.asDiagonal();
      const std::vector<Eigen::Vector3d> axes = nrrdVectors(header, "space directions", 3, path);
      for (int axis = 0; axis < 3; ++axis)
      {
        grid.patient_from_index.linear().col(axis) = to_lps * axes[static_cast<std::size_t>(axis)];
      }
      grid.patient_from_index.translation() = to_lps * nrrdVectors(header, "space origin", 1, path).front();
    }
  }
  return grid;
}
}  // namespace xray_tracking
