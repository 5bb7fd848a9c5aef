#pragma once

#include <opencv2/core.hpp>

namespace xray_tracking
{
/// @throws std::invalid_argument unless the region lies inside the image and has 16 px or more both ways
void requireRegionInside(const cv::Rect& region, const cv::Size& image);

/// @throws std::invalid_argument naming both sizes and types if the image differs from the template's
void requireTemplatesKind(const cv::Mat& image, const cv::Size& size, int type);
}  // namespace xray_tracking
