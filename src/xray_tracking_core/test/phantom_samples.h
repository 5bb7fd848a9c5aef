#pragma once

#include <filesystem>

#include <opencv2/imgproc.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_core/volume/neck_phantom.h"

namespace xray_tracking
{
inline const NeckPhantom& phantom()
{
  static const NeckPhantom neck;
  return neck;
}

inline const TreatmentSetup& setup()
{
  static const TreatmentSetup setup =
      loadTreatmentSetup((std::filesystem::path(__FILE__).parent_path() / "../config/phantom_neck.yaml").string());
  return setup;
}

inline double correlation(const cv::Mat& a, const cv::Mat& b)
{
  cv::Mat result;
  cv::matchTemplate(a, b, result, cv::TM_CCOEFF_NORMED);
  return result.at<float>(0, 0);
}

/// What is smaller than about 10 mm in the patient.
inline cv::Mat detail(const cv::Mat& image)
{
  cv::Mat smooth;
  cv::GaussianBlur(image, smooth, cv::Size(), 12.0);
  return image - smooth;
}
}  // namespace xray_tracking
