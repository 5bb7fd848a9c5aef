#include "xray_tracking_detector_simulator/detector_simulator.h"

#include <utility>

namespace xray_tracking
{
DetectorSimulator::DetectorSimulator(const TreatmentSetup& setup, std::unique_ptr<Anatomy> anatomy,
                                     const MotionOptions& motion, const ImageFormationOptions& image,
                                     std::uint64_t seed)
  : detectors_(setup.detectors),
    anatomy_(std::move(anatomy)),
    motion_(motion, setup.room_from_patient, setup.targetCentre(), seed),
    formation_(image, setup.intensity, seed)
{
}

void DetectorSimulator::expose(int exposure, std::vector<cv::Mat>& images)
{
  const BodyPoses poses = motion_.poses(exposure);
  images.resize(detectors_.size());
  for (std::size_t i = 0; i < detectors_.size(); ++i)
  {
    anatomy_->materials(detectors_[i], poses, soft_, bone_);
    formation_.form(soft_, bone_, static_cast<int>(i), exposure, images[i]);
  }
}
}  // namespace xray_tracking
