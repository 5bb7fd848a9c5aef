#include "dicom_series.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <locale>
#include <map>
#include <set>
#include <sstream>

#include <gdcmScanner.h>

#include "ct_error.h"
#include "dicom_pixels.h"

namespace xray_tracking
{
namespace
{
const gdcm::Tag kModality(0x0008, 0x0060);
const gdcm::Tag kSeriesDescription(0x0008, 0x103e);
const gdcm::Tag kSeriesUid(0x0020, 0x000e);
const gdcm::Tag kPosition(0x0020, 0x0032);
const gdcm::Tag kOrientation(0x0020, 0x0037);
const gdcm::Tag kRows(0x0028, 0x0010);
const gdcm::Tag kColumns(0x0028, 0x0011);
const gdcm::Tag kPixelSpacing(0x0028, 0x0030);

/// Positions and directions are written with few decimals.
constexpr double kDirectionTolerance = 1e-3;
/// Share of the slice distance by which a slice may be off its place.
constexpr double kPlaceTolerance = 0.05;

struct Slice
{
  std::string file;
  Eigen::Vector2i size;         ///< columns, rows
  Eigen::Vector2d spacing;      ///< between columns, between rows [mm]
  Eigen::Vector3d x_direction;  ///< along growing columns
  Eigen::Vector3d y_direction;  ///< along growing rows
  Eigen::Vector3d position;     ///< of the first voxel's centre [mm]
};

std::string baseName(const std::string& file)
{
  return std::filesystem::path(file).filename().string();
}

std::string text(const gdcm::Scanner& scanner, const std::string& file, const gdcm::Tag& tag)
{
  const char* value = scanner.GetValue(file.c_str(), tag);
  std::string trimmed = value ? value : "";
  trimmed.erase(trimmed.find_last_not_of(" \n\r\t") + 1);
  return trimmed;
}

/// A multi-valued number, "a\b\c", whatever the process' locale.
template <int SIZE>
Eigen::Matrix<double, SIZE, 1> numbers(const gdcm::Scanner& scanner, const std::string& file, const gdcm::Tag& tag,
                                       const char* name)
{
  const std::string value = text(scanner, file, tag);
  std::string spaced = value;
  std::replace(spaced.begin(), spaced.end(), '\\', ' ');
  std::istringstream stream(spaced);
  stream.imbue(std::locale::classic());
  Eigen::Matrix<double, SIZE, 1> result;
  for (int n = 0; n < SIZE; ++n)
  {
    if (!(stream >> result[n]))
    {
      failCt(file, std::string(name) + " is \"" + value + "\", expected " + std::to_string(SIZE) + " numbers");
    }
  }
  return result;
}

Slice readSlice(const gdcm::Scanner& scanner, const std::string& file)
{
  Slice slice;
  slice.file = file;
  slice.size.x() = static_cast<int>(numbers<1>(scanner, file, kColumns, "Columns")[0]);
  slice.size.y() = static_cast<int>(numbers<1>(scanner, file, kRows, "Rows")[0]);
  requireAllDicomPixels(file);
  slice.spacing = numbers<2>(scanner, file, kPixelSpacing, "PixelSpacing").reverse();
  slice.position = numbers<3>(scanner, file, kPosition, "ImagePositionPatient");
  const auto orientation = numbers<6>(scanner, file, kOrientation, "ImageOrientationPatient");
  slice.x_direction = orientation.head<3>();
  slice.y_direction = orientation.tail<3>();
  if (std::abs(slice.x_direction.norm() - 1.0) > kDirectionTolerance ||
      std::abs(slice.y_direction.norm() - 1.0) > kDirectionTolerance ||
      std::abs(slice.x_direction.dot(slice.y_direction)) > kDirectionTolerance)
  {
    failCt(file, "ImageOrientationPatient is " + text(scanner, file, kOrientation) +
                     ", expected two unit vectors at right angles");
  }
  slice.x_direction.normalize();
  slice.y_direction.normalize();
  return slice;
}

/// @throws if there is not exactly one CT series
std::vector<std::string> filesOfOneSeries(const gdcm::Scanner& scanner, const std::string& folder)
{
  std::map<std::string, std::vector<std::string>> series;
  std::string others;
  for (const std::string& file : scanner.GetKeys())
  {
    const std::string modality = text(scanner, file, kModality);
    if (modality == "CT")
    {
      series[text(scanner, file, kSeriesUid)].push_back(file);
    }
    else if (others.find(modality) == std::string::npos)
    {
      others += " " + modality;
    }
  }
  if (series.empty())
  {
    failCt(folder, "no DICOM CT image in this folder" + (others.empty() ? "" : "; modalities found:" + others));
  }
  if (series.size() > 1)
  {
    std::ostringstream message;
    message << series.size() << " CT series in this folder, expected one:";
    for (const auto& [uid, files] : series)
    {
      message << "\n  " << uid << " \"" << text(scanner, files.front(), kSeriesDescription) << "\", " << files.size()
              << " files, e.g. " << baseName(files.front());
    }
    failCt(folder, message.str());
  }
  return series.begin()->second;
}

/// An empty or cut-off slice at the end of a series would leave no gap that tells of it.
/// @param slices the files of the series
/// @throws if another file of the folder is named like them and is not DICOM
void requireReadable(const gdcm::Directory::FilenamesType& files, const std::vector<std::string>& slices,
                     const gdcm::Scanner& scanner, const std::string& folder)
{
  std::set<std::string> extensions;
  for (const std::string& slice : slices)
  {
    extensions.insert(std::filesystem::path(slice).extension());
  }
  for (const std::string& file : files)
  {
    if (!scanner.IsKey(file.c_str()) && extensions.count(std::filesystem::path(file).extension()) == 1)
    {
      failCt(folder, baseName(file) + " is not a readable DICOM file, but is named like the slices of the series");
    }
  }
}

void requireSameSlices(const std::vector<Slice>& slices, const std::string& folder)
{
  const Slice& first = slices.front();
  for (const Slice& slice : slices)
  {
    std::ostringstream message;
    if (slice.size != first.size)
    {
      message << "size is " << slice.size.x() << " x " << slice.size.y() << ", expected " << first.size.x() << " x "
              << first.size.y();
    }
    else if (!slice.spacing.isApprox(first.spacing, kDirectionTolerance))
    {
      message << "pixel spacing is " << slice.spacing.transpose() << " mm, expected " << first.spacing.transpose();
    }
    else if ((slice.x_direction - first.x_direction).norm() > kDirectionTolerance ||
             (slice.y_direction - first.y_direction).norm() > kDirectionTolerance)
    {
      message << "orientation is " << slice.x_direction.transpose() << ", " << slice.y_direction.transpose()
              << ", expected " << first.x_direction.transpose() << ", " << first.y_direction.transpose();
    }
    if (!message.str().empty())
    {
      failCt(folder, baseName(slice.file) + ": " + message.str() + " as in " + baseName(first.file));
    }
  }
}

/// @param slices sorted along the normal; @return from one slice's position to the next [mm]
Eigen::Vector3d requireEvenSteps(const std::vector<Slice>& slices, const Eigen::Vector3d& normal,
                                 const std::string& folder)
{
  std::vector<double> distances;
  for (std::size_t n = 1; n < slices.size(); ++n)
  {
    distances.push_back(normal.dot(slices[n].position - slices[n - 1].position));
  }
  std::vector<double> sorted = distances;
  std::nth_element(sorted.begin(), sorted.begin() + sorted.size() / 2, sorted.end());
  const double usual = sorted[sorted.size() / 2];
  for (std::size_t n = 0; n < distances.size(); ++n)
  {
    if (std::abs(distances[n] - usual) <= kPlaceTolerance * usual && distances[n] > 0.0)
    {
      continue;
    }
    const Slice& before = slices[n];
    const Slice& after = slices[n + 1];
    std::ostringstream message;
    message << (distances[n] > 1.5 * usual ? "a slice is missing" : "slices are not evenly spaced") << " between "
            << baseName(before.file) << " at " << before.position.transpose() << " mm and " << baseName(after.file)
            << " at " << after.position.transpose() << " mm: " << distances[n] << " mm apart, expected " << usual;
    failCt(folder, message.str());
  }

  const Eigen::Vector3d step = (slices.back().position - slices.front().position) / (slices.size() - 1.0);
  for (std::size_t n = 0; n < slices.size(); ++n)
  {
    const Eigen::Vector3d expected = slices.front().position + static_cast<double>(n) * step;
    // Twice, as both the slice and the ends of the series may be rounded.
    if ((slices[n].position - expected).norm() > 2.0 * kPlaceTolerance * usual)
    {
      std::ostringstream message;
      message << baseName(slices[n].file) << " is at " << slices[n].position.transpose()
              << " mm, expected on the line of the other slices at " << expected.transpose();
      failCt(folder, message.str());
    }
  }
  return step;
}
}  // namespace

DicomSeries findCtSeries(const std::string& folder)
{
  gdcm::Directory::FilenamesType files;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
  {
    if (entry.is_regular_file())
    {
      files.push_back(entry.path().string());
    }
  }
  gdcm::Scanner scanner;
  for (const gdcm::Tag& tag :
       { kModality, kSeriesDescription, kSeriesUid, kPosition, kOrientation, kRows, kColumns, kPixelSpacing })
  {
    scanner.AddTag(tag);
  }
  scanner.Scan(files);

  const std::vector<std::string> series_files = filesOfOneSeries(scanner, folder);
  requireReadable(files, series_files, scanner, folder);
  std::vector<Slice> slices;
  for (const std::string& file : series_files)
  {
    slices.push_back(readSlice(scanner, file));
  }
  if (slices.size() < 2)
  {
    failCt(folder, "only one CT slice in this folder, expected a series");
  }
  requireSameSlices(slices, folder);
  const Slice& any = slices.front();
  const Eigen::Vector3d normal = any.x_direction.cross(any.y_direction).normalized();
  std::sort(slices.begin(), slices.end(),
            [&](const Slice& a, const Slice& b) { return normal.dot(a.position) < normal.dot(b.position); });
  const Eigen::Vector3d step = requireEvenSteps(slices, normal, folder);

  DicomSeries series;
  const Slice& first = slices.front();
  series.grid.size = { first.size.x(), first.size.y(), static_cast<int>(slices.size()) };
  series.grid.patient_from_index.linear() << first.spacing.x() * first.x_direction,
      first.spacing.y() * first.y_direction, step;
  series.grid.patient_from_index.translation() = first.position;
  for (const Slice& slice : slices)
  {
    series.files.push_back(slice.file);
  }
  return series;
}
}  // namespace xray_tracking
