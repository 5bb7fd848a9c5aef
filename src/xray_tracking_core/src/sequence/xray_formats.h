#pragma once

#include <string>

#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Pixel values of a TIFF file as they are stored, whatever its photometric interpretation says of their display.
/// @return one or more channels, of 8 or 16 bit without sign, CV_32SC1 or CV_64FC1 for other whole numbers, CV_32FC1
/// @throws std::runtime_error naming the file and what is wrong: several pages, a palette, turned, other kinds of
/// values, or another size than expected, for which nothing is allocated
cv::Mat readTiff(const std::string& path, const cv::Size& expected);

/// Pixel values of a DICOM X-ray image as they are stored, whatever its photometric interpretation says of their
/// display, rescaled as RescaleSlope and RescaleIntercept say. Slopes below a tenth, which would leave nothing of the
/// image in whole numbers, are divided out.
/// @return CV_64FC1
/// @throws std::runtime_error naming the file, the attribute and its value: several frames, colours, a pixel spacing
/// other than the detector's, a relation to the X-rays other than that of the setup's intensity
cv::Mat readDicomXray(const std::string& path, const ProjectionGeometry& detector, IntensityModel::Kind kind);
}  // namespace xray_tracking
