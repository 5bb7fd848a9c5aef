#pragma once

#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// What is shown beside the setup itself; whatever is not known is empty.
struct SetupPictureContent
{
  std::string title;
  std::vector<std::string> faults;          ///< in words, a line each or more
  std::vector<cv::Mat> xrays;               ///< of the setup's detectors, as their files have them
  std::vector<cv::Mat> drrs;                ///< line integrals at the initial pose, CV_32FC1
  std::vector<double> likeness;             ///< of X-rays and DRRs
  std::vector<Eigen::Vector3d> ct_corners;  ///< eight, bit n of the index: the upper end of axis n; patient frame [mm]
};

/// A picture of a setup, to be looked at by a person: the room from three sides (sources, panels, rays, isocentre, CT,
/// target, patient's axes), and of every detector X-ray, DRR and both, with the target's box, the patient's directions
/// and lengths. @return CV_8UC3, BGR
cv::Mat drawSetup(const TreatmentSetup& setup, const SetupPictureContent& content);
}  // namespace xray_tracking
