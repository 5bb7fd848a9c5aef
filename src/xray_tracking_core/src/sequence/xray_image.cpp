#include <array>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>

#include <itkGDCMImageIO.h>
#include <itkImage.h>
#include <itkImageFileReader.h>
#include <opencv2/imgcodecs.hpp>

#include "../volume/dicom_pixels.h"
#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
namespace
{
bool isPngOrTiff(const std::string& path)
{
  std::array<char, 4> start{};
  std::ifstream(path, std::ios::binary).read(start.data(), start.size());
  const std::string magic(start.data(), start.size());
  return magic == "\x89PNG" || magic == std::string("II*\0", 4) || magic == std::string("MM\0*", 4);
}

cv::Mat readPngOrTiff(const std::string& path)
{
  cv::Mat image;
  try
  {
    image = cv::imread(path, cv::IMREAD_UNCHANGED);
  }
  catch (const cv::Exception& error)
  {
    throw std::runtime_error(path + ": not readable: " + error.what());
  }
  if (image.empty())
  {
    throw std::runtime_error(path + ": not readable or truncated");
  }
  if (image.type() != CV_8UC1 && image.type() != CV_16UC1)
  {
    throw std::runtime_error(path + ": has " + std::to_string(image.channels()) + " channels of " +
                             std::to_string(8 * image.elemSize1()) +
                             " bit: expected one channel of 8 or 16 bit without sign");
  }
  return image;
}

cv::Mat readDicom(const std::string& path, itk::GDCMImageIO* io)
{
  // Wider than what the file may hold, so that a value that does not fit shows instead of wrapping around.
  using Image = itk::Image<int, 2>;
  auto reader = itk::ImageFileReader<Image>::New();
  reader->SetImageIO(io);
  reader->SetFileName(path);
  try
  {
    reader->UpdateOutputInformation();
    if (io->GetNumberOfComponents() != 1 || (io->GetNumberOfDimensions() > 2 && io->GetDimensions(2) != 1))
    {
      throw std::runtime_error(path + ": expected one frame with one channel");
    }
    requireAllDicomPixels(path);
    reader->Update();
  }
  catch (const itk::ExceptionObject& error)
  {
    throw std::runtime_error(path + ": not readable or truncated: " + error.GetDescription());
  }
  const auto size = reader->GetOutput()->GetLargestPossibleRegion().GetSize();
  const cv::Mat values(static_cast<int>(size[1]), static_cast<int>(size[0]), CV_32SC1,
                       reader->GetOutput()->GetBufferPointer());
  double min = 0.0;
  double max = 0.0;
  cv::minMaxLoc(values, &min, &max);
  if (min < 0.0 || max > 65535.0)
  {
    throw std::runtime_error(path + ": has values from " + std::to_string(int(min)) + " to " +
                             std::to_string(int(max)) + ": expected 0 to 65535");
  }
  return values.clone();
}
}  // namespace

cv::Mat readXrayImage(const std::string& path, const Eigen::Vector2i& expected_size)
{
  if (!std::filesystem::is_regular_file(path))
  {
    throw std::runtime_error(path + ": missing");
  }
  cv::Mat image;
  if (isPngOrTiff(path))
  {
    image = readPngOrTiff(path);
  }
  else
  {
    auto io = itk::GDCMImageIO::New();
    if (!io->CanReadFile(path.c_str()))
    {
      throw std::runtime_error(path + ": expected a PNG, TIFF or DICOM image");
    }
    image = readDicom(path, io);
  }
  if (image.cols != expected_size.x() || image.rows != expected_size.y())
  {
    throw std::runtime_error(path + ": is " + std::to_string(image.cols) + " x " + std::to_string(image.rows) +
                             ": expected " + std::to_string(expected_size.x()) + " x " +
                             std::to_string(expected_size.y()) + " pixels");
  }
  cv::Mat counts;
  image.convertTo(counts, CV_16U);
  return counts;
}
}  // namespace xray_tracking
