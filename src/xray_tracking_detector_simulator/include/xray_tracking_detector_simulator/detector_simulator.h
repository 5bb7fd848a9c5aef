#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_detector_simulator/anatomy.h"
#include "xray_tracking_detector_simulator/image_formation.h"
#include "xray_tracking_detector_simulator/simulated_motion.h"

namespace xray_tracking
{
/// Exposures of a moving patient on all detectors of a treatment room. An exposure depends on the setup, the anatomy,
/// the options, the seed and its index alone.
class DetectorSimulator
{
public:
  /// @throws std::invalid_argument or std::runtime_error as SimulatedMotion's and ImageFormation's constructors
  DetectorSimulator(const TreatmentSetup& setup, std::unique_ptr<Anatomy> anatomy, const MotionOptions& motion,
                    const ImageFormationOptions& image, std::uint64_t seed);

  /// @param exposure index, from 0
  BodyPoses poses(int exposure) const { return motion_.poses(exposure); }

  /// Makes an exposure's images, on all cores. Uses buffers of its own: one call at a time.
  /// @param images out, one CV_16UC1 a detector in the setup's order; re-used where size and type fit
  void expose(int exposure, std::vector<cv::Mat>& images);

private:
  std::vector<ProjectionGeometry> detectors_;
  std::unique_ptr<Anatomy> anatomy_;
  SimulatedMotion motion_;
  ImageFormation formation_;
  cv::Mat soft_;
  cv::Mat bone_;
};
}  // namespace xray_tracking
