#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <new>
#include <sstream>
#include <type_traits>
#include <utility>

#include <itkImageFileWriter.h>
#include <itkMetaImageIO.h>
#include <itkNiftiImageIO.h>
#include <itkNrrdImageIO.h>

#include "ct_error.h"
#include "ct_file_checks.h"
#include "dicom_file.h"
#include "dicom_series.h"
#include "nifti_file.h"
#include "stored_volume.h"
#include "xray_tracking_core/volume/ct_volume.h"

// ITK's readers are named here one by one. Its object factories would have to be registered in every executable.

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;
using HuImage = itk::Image<std::int16_t, 3>;

template <typename Value>
void readVoxels(itk::ImageIOBase& format, const std::string& path, StoredVolume& stored)
{
  const std::size_t count = stored.volume.grid.voxelCount();
  std::vector<Value> values(count);
  format.Read(values.data());
  if constexpr (std::is_same_v<Value, std::int16_t>)
  {
    stored.volume.hu = std::move(values);
  }
  else
  {
    stored.volume.hu.reserve(count);
    std::vector<float> chunk;
    for (std::size_t done = 0; done < count; done += chunk.size())
    {
      const auto start = values.begin() + static_cast<std::ptrdiff_t>(done);
      chunk.assign(start, start + static_cast<std::ptrdiff_t>(std::min<std::size_t>(1 << 16, count - done)));
      appendRounded(chunk.data(), chunk.size(), path, stored);
    }
  }
}

/// As the file stores them: ITK's image reader would hold them twice.
void readVoxelsOfAnyType(itk::ImageIOBase& format, const std::string& path, StoredVolume& stored)
{
  using Type = itk::ImageIOBase;
  switch (format.GetComponentType())
  {
    case Type::UCHAR:
      return readVoxels<std::uint8_t>(format, path, stored);
    case Type::CHAR:
      return readVoxels<std::int8_t>(format, path, stored);
    case Type::USHORT:
      return readVoxels<std::uint16_t>(format, path, stored);
    case Type::SHORT:
      return readVoxels<std::int16_t>(format, path, stored);
    case Type::UINT:
      return readVoxels<unsigned int>(format, path, stored);
    case Type::INT:
      return readVoxels<int>(format, path, stored);
    case Type::ULONG:
      return readVoxels<unsigned long>(format, path, stored);
    case Type::LONG:
      return readVoxels<long>(format, path, stored);
    case Type::FLOAT:
      return readVoxels<float>(format, path, stored);
    case Type::DOUBLE:
      return readVoxels<double>(format, path, stored);
    default:
      failCt(path, "its values are " + Type::GetComponentTypeAsString(format.GetComponentType()) +
                       ", expected whole numbers or floating point");
  }
}

/// Of a NRRD or MetaImage file.
StoredVolume readByItk(itk::ImageIOBase& format, const std::string& path)
{
  StoredVolume stored;
  format.SetFileName(path);
  requireUsableTextHeader(format, path);
  try
  {
    format.ReadImageInformation();
    if (format.GetNumberOfDimensions() != 3)
    {
      failCt(path, "has " + std::to_string(format.GetNumberOfDimensions()) + " dimensions, expected 3");
    }
    if (format.GetNumberOfComponents() != 1)
    {
      failCt(path, "has " + std::to_string(format.GetNumberOfComponents()) + " values a voxel, expected 1");
    }
    stored.volume.grid = gridOf(format, path);
    requireUsableGrid(stored.volume.grid, path);
    requireAllVoxels(format, path);
    itk::ImageIORegion region(3);
    for (unsigned axis = 0; axis < 3; ++axis)
    {
      region.SetSize(axis, format.GetDimensions(axis));
    }
    format.SetIORegion(region);
    readVoxelsOfAnyType(format, path, stored);
  }
  catch (const itk::ExceptionObject& error)
  {
    failCt(path, std::string("cannot be read: ") + error.GetDescription());
  }
  catch (const std::bad_alloc&)
  {
    // Of MetaImage's headers ITK takes in more than is looked at here.
    failCt(path, "cannot be read: its header asks for more memory than there is");
  }
  return stored;
}

/// ITK would write NIfTI with the nearest axes at right angles, without a word.
void requireRightAngles(const VolumeGrid& grid, const std::string& path)
{
  const Eigen::Matrix3d axes = grid.patient_from_index.linear().colwise().normalized();
  if (!(axes.transpose() * axes).isIdentity(1e-5))
  {
    failCt(path, "NIfTI takes no sheared grid (tilted gantry); write NRRD");
  }
}

StoredVolume readFile(const std::string& path, const CtChoice& choice)
{
  if (isNifti(path))
  {
    return readNifti(path, choice.nifti_form);
  }
  for (const itk::ImageIOBase::Pointer& format :
       { itk::ImageIOBase::Pointer(itk::NrrdImageIO::New()), itk::ImageIOBase::Pointer(itk::MetaImageIO::New()) })
  {
    if (format->CanReadFile(path.c_str()))
    {
      return readByItk(*format, path);
    }
  }
  if (readDicomHeader(path))
  {
    return readDicomCt(path, choice.series);
  }
  failCt(path, "not a NRRD, MetaImage or NIfTI file, nor DICOM or a folder");
}
}  // namespace

void requireUsableGrid(const VolumeGrid& grid, const std::string& path)
{
  std::ostringstream message;
  if (grid.size.minCoeff() < 2)
  {
    message << "is " << grid.size.transpose() << " voxels, expected at least 2 along each of three axes";
    failCt(path, message.str());
  }
  if (grid.size.cast<double>().prod() > static_cast<double>(kMostVoxels))
  {
    message << "is " << grid.size.transpose() << " voxels, expected " << kMostVoxels << " at most";
    failCt(path, message.str());
  }
  // Outside these bounds the file is not in millimetres.
  const Eigen::Vector3d spacing = grid.spacing();
  if (!(spacing.minCoeff() >= 0.01 && spacing.maxCoeff() <= 100.0) || !grid.patient_from_index.matrix().allFinite())
  {
    message << "voxel spacing is " << spacing.transpose() << " mm, expected 0.01 to 100, and a finite origin";
    failCt(path, message.str());
  }
  // 1 for axes at right angles; a gantry tilts by up to 30 degrees, cosine 0.87.
  const double volume = grid.patient_from_index.linear().colwise().normalized().determinant();
  if (!(std::abs(volume) > 0.5))
  {
    message << "axes are\n" << grid.patient_from_index.linear() << "\nexpected axes nearly at right angles";
    failCt(path, message.str());
  }
}

void appendRounded(const float* values, std::size_t count, const std::string& path, StoredVolume& stored)
{
  for (std::size_t n = 0; n < count; ++n)
  {
    const float value = std::round(values[n]);
    // Negated so that NaN fails, too.
    if (!(value >= std::numeric_limits<std::int16_t>::min() && value <= std::numeric_limits<std::int16_t>::max()))
    {
      std::ostringstream message;
      message << "holds the value " << value << ", expected Hounsfield units or labels of -32768 to 32767";
      failCt(path, message.str());
    }
    if (value != values[n] && !stored.fraction)
    {
      stored.fraction = values[n];
    }
    stored.volume.hu.push_back(static_cast<std::int16_t>(value));
  }
}

StoredVolume readStoredVolume(const std::string& path, const CtChoice& choice)
{
  silenceImageLibraries();
  try
  {
    if (fs::is_directory(path))
    {
      return readDicomCt(path, choice.series);
    }
    // A pipe, for instance, would block the reader.
    if (!fs::is_regular_file(path))
    {
      failCt(path, fs::exists(path) ? "neither a file nor a folder" : "no such file or folder");
    }
    if (!std::ifstream(path))
    {
      failCt(path, "no permission to read it");
    }
    return readFile(path, choice);
  }
  catch (const fs::filesystem_error& error)
  {
    failCt(path, "cannot be read: " + error.code().message());
  }
}

std::string whyNotHu(const CtVolume& volume)
{
  const std::vector<std::int16_t>& values = volume.hu;
  constexpr int kTissue = 200;       // either side of water
  constexpr int kLowestAir = -1200;  // with noise; below it, values that fill up what was not scanned
  const auto [lowest, highest] = std::minmax_element(values.begin(), values.end());
  const bool tissue = std::any_of(values.begin(), values.end(), [](int value) { return std::abs(value) <= kTissue; });
  const bool air =
      std::any_of(values.begin(), values.end(), [](int value) { return value >= kLowestAir && value < -kTissue; });
  std::ostringstream message;
  if (*lowest == *highest)
  {
    message << "all voxels are " << *lowest;
  }
  else if (!air)
  {
    message << "the lowest value is " << *lowest << " and none lies between -1200 and -200, expected air, near -1000";
  }
  else if (!tissue)
  {
    message << "no value between -200 and 200, where soft tissue is; they run from " << *lowest << " to " << *highest;
  }
  return message.str();
}

CtVolume readCtVolume(const std::string& path, const CtChoice& choice)
{
  StoredVolume stored = readStoredVolume(path, choice);
  if (const std::string why = whyNotHu(stored.volume); !why.empty())
  {
    failCt(path, "not Hounsfield units" + std::string(whyNotLabels(stored).empty() ? ", but labels: " : ": ") + why);
  }
  return std::move(stored.volume);
}

CtVolume readLabelMap(const std::string& path, const CtChoice& choice)
{
  StoredVolume stored = readStoredVolume(path, choice);
  if (const std::string why = whyNotLabels(stored); !why.empty())
  {
    failCt(path, "no label map: " + why);
  }
  return std::move(stored.volume);
}

void writeCtVolume(const CtVolume& volume, const std::string& path)
{
  const VolumeGrid& grid = volume.grid;
  if (grid.voxelCount() == 0 || volume.hu.size() != grid.voxelCount())
  {
    failCt(path, "has " + std::to_string(volume.hu.size()) + " values, expected " + std::to_string(grid.voxelCount()));
  }
  const auto image = HuImage::New();
  HuImage::RegionType region;
  HuImage::SpacingType spacing;
  HuImage::PointType origin;
  HuImage::DirectionType direction;
  for (int axis = 0; axis < 3; ++axis)
  {
    region.SetSize(axis, grid.size[axis]);
    spacing[axis] = grid.spacing()[axis];
    origin[axis] = grid.patient_from_index.translation()[axis];
    for (int row = 0; row < 3; ++row)
    {
      direction(row, axis) = grid.patient_from_index.linear()(row, axis) / spacing[axis];
    }
  }
  try
  {
    image->SetRegions(region);
    image->SetSpacing(spacing);
    image->SetOrigin(origin);
    image->SetDirection(direction);
    // ITK takes no const buffer, but does not write to it either.
    image->GetPixelContainer()->SetImportPointer(const_cast<std::int16_t*>(volume.hu.data()), volume.hu.size(), false);
    for (const itk::ImageIOBase::Pointer& format :
         { itk::ImageIOBase::Pointer(itk::NrrdImageIO::New()), itk::ImageIOBase::Pointer(itk::MetaImageIO::New()),
           itk::ImageIOBase::Pointer(itk::NiftiImageIO::New()) })
    {
      if (format->CanWriteFile(path.c_str()))
      {
        if (dynamic_cast<itk::NiftiImageIO*>(format.GetPointer()))
        {
          requireRightAngles(grid, path);
        }
        const auto writer = itk::ImageFileWriter<HuImage>::New();
        writer->SetImageIO(format);
        writer->SetFileName(path);
        writer->SetInput(image);
        writer->Update();
        return;
      }
    }
  }
  catch (const itk::ExceptionObject& error)
  {
    failCt(path, std::string("cannot be written: ") + error.GetDescription());
  }
  failCt(path, "extension is not one of .nrrd, .nhdr, .mha, .mhd, .nii, .nii.gz");
}
}  // namespace xray_tracking
