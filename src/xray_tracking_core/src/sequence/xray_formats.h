#pragma once

#include <cstdint>
#include <string>

#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Before anything is read that a file claims to hold: it may claim any size.
/// @throws std::runtime_error naming the file if the image is not of the detector's size
void requireSize(const std::string& path, std::uint32_t columns, std::uint32_t rows,
                 const ProjectionGeometry& detector);

/// Pixel values of a TIFF file as they are stored, whatever its photometric interpretation says of their display.
/// @return one or more channels, of 8 or 16 bit without sign, CV_32SC1 or CV_64FC1 for other whole numbers, CV_32FC1
/// @throws std::runtime_error naming the file and what is wrong: several pages, a palette, turned, other kinds of
/// values, another size than the detector's
cv::Mat readTiff(const std::string& path, const ProjectionGeometry& detector);

/// Pixel values of a DICOM X-ray image as they are stored, whatever its photometric interpretation says of their
/// display, rescaled as RescaleSlope and RescaleIntercept say. Slopes below a tenth, which would leave nothing of the
/// image in whole numbers, are divided out.
/// @return CV_64FC1
/// @throws std::runtime_error naming the file, the attribute and its value: several frames, colours, a pixel spacing
/// other than the detector's, a relation to the X-rays other than that of the setup's intensity
cv::Mat readDicomXray(const std::string& path, const ProjectionGeometry& detector, IntensityModel::Kind kind);
}  // namespace xray_tracking
