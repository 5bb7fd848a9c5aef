#include "xray_tracking_registration/sequence_registration.h"

#include <stdexcept>
#include <utility>

namespace xray_tracking
{
namespace
{
/// Of a start from the last believed pose: half of what the vertebrae of a neck are apart [mm].
constexpr double kSameVertebra = 9.0;
constexpr std::int64_t kShortly = 5000000000;  // after a believed pose, nobody has been set up anew [ns]
}  // namespace

void SequenceRegistration::setRegistration(std::shared_ptr<const Registration> registration)
{
  if (registration_ != registration)
  {
    registration_ = std::move(registration);
    forget();
  }
}

void SequenceRegistration::forget()
{
  target_from_rest_ = RigidTransform::Identity();
  believed_.reset();
  unbelieved_ = 0;
}

bool SequenceRegistration::followsFromBelieved(const RigidTransform& start, std::int64_t stamp_ns) const
{
  if (!believed_)
  {
    return false;
  }
  const std::int64_t since = stamp_ns - believed_->stamp_ns;
  const double moved = (start * target_centre_ - believed_->room_from_patient * target_centre_).norm();
  return since >= 0 && since <= kShortly && moved < kSameVertebra;
}

RegistrationResult SequenceRegistration::run(RegistrationRequest request, std::optional<std::int64_t> stamp_ns,
                                             bool unverified)
{
  if (!registration_)
  {
    throw std::logic_error("SequenceRegistration::run without a registration");
  }
  request.start_verified = stamp_ns && !unverified && followsFromBelieved(request.room_from_patient, *stamp_ns);
  // A rest that is not where it was, or never was there, lets the right pose be doubted again and again. Two tries
  // each, as who asks may have another start every other time.
  const bool as_in_ct = !request.start_verified && (unbelieved_ % 4 == 1 || unbelieved_ % 4 == 2);
  request.target_from_rest = as_in_ct ? RigidTransform::Identity() : target_from_rest_;
  if (request.start_verified)
  {
    for (RegistrationView& view : request.views)
    {
      const auto known = believed_->saturations.find(view.geometry.name());
      view.saturation = known == believed_->saturations.end() ? view.saturation : known->second;
    }
  }
  RegistrationResult result = registration_->run(request);
  if (stamp_ns && result.status == RegistrationStatus::SUCCESS)
  {
    unbelieved_ = 0;
    target_from_rest_ = result.target_from_rest;
    believed_ = BelievedPose{ result.room_from_patient, *stamp_ns, {} };
    for (std::size_t v = 0; v < request.views.size(); ++v)
    {
      believed_->saturations[request.views[v].geometry.name()] = result.views[v].saturation;
    }
  }
  else if (stamp_ns && !request.start_verified && result.status == RegistrationStatus::UNRELIABLE)
  {
    ++unbelieved_;
  }
  return result;
}
}  // namespace xray_tracking
