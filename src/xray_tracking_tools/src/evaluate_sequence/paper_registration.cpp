#include "paper_registration.h"

namespace xray_tracking
{
namespace
{
constexpr double kTimeBudget = 600.0;  // [s]

RegistrationOptions paperOptions()
{
  RegistrationOptions options;
  options.optimiser = Optimiser::BOBYQA;
  options.similarity = "normalised_mutual_information";
  options.projector = Projector::ATTENUATION_FIELD;
  return options;
}
}  // namespace

PaperRegistration::PaperRegistration(const TreatmentSetup& setup, const BodyModel& body)
  : setup_(setup), registration_(body, setup.target_box, paperOptions()), last_(setup.room_from_patient)
{
}

std::optional<RigidTransform> PaperRegistration::add(const std::vector<cv::Mat>& images)
{
  RegistrationRequest request;
  request.intensity = setup_.intensity;
  request.room_from_patient = last_;
  request.time_budget = std::chrono::duration<double>(kTimeBudget);
  for (std::size_t d = 0; d < images.size(); ++d)
  {
    request.views.push_back({ setup_.detectors[d], images[d] });
  }
  const RegistrationResult result = registration_.run(request);
  if (result.status != RegistrationStatus::SUCCESS && result.status != RegistrationStatus::UNRELIABLE)
  {
    return std::nullopt;
  }
  last_ = result.room_from_patient;
  return last_;
}
}  // namespace xray_tracking
