#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <sstream>
#include <utility>

#include <itkGDCMImageIO.h>
#include <itkImageFileReader.h>
#include <itkImageFileWriter.h>
#include <itkMetaDataObject.h>
#include <itkMetaImageIO.h>
#include <itkNiftiImageIO.h>
#include <itkNrrdImageIO.h>

#include "ct_error.h"
#include "ct_file_checks.h"
#include "dicom_series.h"
#include "stored_volume.h"
#include "xray_tracking_core/volume/ct_volume.h"

// ITK's readers are named here one by one. Its object factories would have to be registered in every executable.

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;
using FloatImage = itk::Image<float, 3>;
using HuImage = itk::Image<std::int16_t, 3>;

std::array<itk::ImageIOBase::Pointer, 3> fileFormats()
{
  return { itk::NrrdImageIO::New().GetPointer(), itk::MetaImageIO::New().GetPointer(),
           itk::NiftiImageIO::New().GetPointer() };
}

FloatImage::Pointer readImage(itk::ImageIOBase* format, const std::string& path)
{
  const auto reader = itk::ImageFileReader<FloatImage>::New();
  reader->SetImageIO(format);
  reader->SetFileName(path);
  if (dynamic_cast<itk::NiftiImageIO*>(format))
  {
    requireUsableNiftiHeader(path);
  }
  try
  {
    reader->UpdateOutputInformation();
    if (format->GetNumberOfDimensions() != 3)
    {
      failCt(path, "has " + std::to_string(format->GetNumberOfDimensions()) + " dimensions, expected 3");
    }
    if (format->GetNumberOfComponents() != 1)
    {
      failCt(path, "has " + std::to_string(format->GetNumberOfComponents()) + " values a voxel, expected 1");
    }
    requireMillimetres(*format, path);
    requireAllVoxels(*format, path);
    reader->Update();
  }
  catch (const itk::ExceptionObject& error)
  {
    failCt(path, std::string("cannot be read: ") + error.GetDescription());
  }
  return reader->GetOutput();
}

VolumeGrid gridOf(const FloatImage& image)
{
  const auto& region = image.GetLargestPossibleRegion();
  VolumeGrid grid;
  for (int axis = 0; axis < 3; ++axis)
  {
    grid.size[axis] = static_cast<int>(region.GetSize(axis));
    grid.patient_from_index.translation()[axis] = image.GetOrigin()[axis];
    for (int row = 0; row < 3; ++row)
    {
      grid.patient_from_index.linear()(row, axis) = image.GetDirection()(row, axis) * image.GetSpacing()[axis];
    }
  }
  return grid;
}

void requireUsableGrid(const VolumeGrid& grid, const std::string& path)
{
  std::ostringstream message;
  if (grid.size.minCoeff() < 2)
  {
    message << "is " << grid.size.transpose() << " voxels, expected at least 2 along each of three axes";
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

/// ITK would write NIfTI with the nearest axes at right angles, without a word.
void requireRightAngles(const VolumeGrid& grid, const std::string& path)
{
  const Eigen::Matrix3d axes = grid.patient_from_index.linear().colwise().normalized();
  if (!(axes.transpose() * axes).isIdentity(1e-5))
  {
    failCt(path, "NIfTI takes no sheared grid (tilted gantry); write NRRD");
  }
}

/// Rounds to whole numbers.
StoredVolume rounded(const VolumeGrid& grid, const float* values, const std::string& path)
{
  StoredVolume stored;
  stored.volume.grid = grid;
  stored.volume.hu.resize(grid.voxelCount());
  for (std::size_t n = 0; n < stored.volume.hu.size(); ++n)
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
    stored.volume.hu[n] = static_cast<std::int16_t>(value);
  }
  return stored;
}

void requireKnownSpace(const itk::ImageIOBase& format, const std::string& path)
{
  // ITK converts RAS and LAS to LPS and says so here; other spaces it leaves as they are.
  std::string space;
  if (itk::ExposeMetaData<std::string>(format.GetMetaDataDictionary(), "NRRD_space", space) &&
      space != "left-posterior-superior")
  {
    failCt(path, "space is " + space + ", expected left-posterior-superior, right- or left-anterior-superior");
  }
}

StoredVolume readFile(const std::string& path)
{
  for (const itk::ImageIOBase::Pointer& format : fileFormats())
  {
    if (format->CanReadFile(path.c_str()))
    {
      const FloatImage::Pointer image = readImage(format, path);
      requireKnownSpace(*format, path);
      const VolumeGrid grid = gridOf(*image);
      requireUsableGrid(grid, path);
      return rounded(grid, image->GetBufferPointer(), path);
    }
  }
  failCt(path, "not a NRRD, MetaImage or NIfTI file, nor a folder");
}

StoredVolume readFolder(const std::string& path)
{
  const DicomSeries series = findCtSeries(path);
  requireUsableGrid(series.grid, path);
  std::vector<float> values;
  values.reserve(series.grid.voxelCount());
  for (const std::string& file : series.files)
  {
    const FloatImage::Pointer slice = readImage(itk::GDCMImageIO::New(), file);
    const Eigen::Vector3i size = gridOf(*slice).size;
    if (size.z() != 1)
    {
      failCt(file, "holds " + std::to_string(size.z()) + " slices, expected 1");
    }
    values.insert(values.end(), slice->GetBufferPointer(),
                  slice->GetBufferPointer() + static_cast<std::size_t>(size.x()) * size.y());
  }
  return rounded(series.grid, values.data(), path);
}
}  // namespace

StoredVolume readStoredVolume(const std::string& path)
{
  try
  {
    if (fs::is_directory(path))
    {
      return readFolder(path);
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
    return readFile(path);
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

CtVolume readCtVolume(const std::string& path)
{
  StoredVolume stored = readStoredVolume(path);
  if (const std::string why = whyNotHu(stored.volume); !why.empty())
  {
    failCt(path, "not Hounsfield units" + std::string(whyNotLabels(stored).empty() ? ", but labels: " : ": ") + why);
  }
  return std::move(stored.volume);
}

CtVolume readLabelMap(const std::string& path)
{
  StoredVolume stored = readStoredVolume(path);
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
    for (const itk::ImageIOBase::Pointer& format : fileFormats())
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
