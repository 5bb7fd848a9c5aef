#pragma once

#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
/// Registration of every exposure as it was published: the whole CT as one body, line integrals of an attenuation
/// field, normalised mutual information, from the last exposure's pose on. It believes all that it finds.
class PaperRegistration
{
public:
  /// @param ct of the setup
  PaperRegistration(const TreatmentSetup& setup, const BodyModel& body);

  /// @return nothing if it found no pose
  std::optional<RigidTransform> add(const std::vector<cv::Mat>& images);

private:
  TreatmentSetup setup_;
  Registration registration_;
  RigidTransform last_;
};
}  // namespace xray_tracking
