#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
/// Registers the exposures of a sequence, one after the other, and carries from each to the next what helps there:
/// where the rest of the body lies against the target, how the views saturate, and the last believed pose. What of the
/// detectors' images is of use, DetectorPixels finds beforehand. Without ROS; the same live and offline.
///
/// Not thread-safe; what `registration` holds is shared, as it does not change.
class SequenceRegistration
{
public:
  /// @param target_centre of the target box, patient frame [mm]
  explicit SequenceRegistration(const Eigen::Vector3d& target_centre) : target_centre_(target_centre) {}

  /// Registers with this CT from now on; what was found with another one is forgotten.
  /// @param registration not null
  void setRegistration(std::shared_ptr<const Registration> registration);

  /// Registers an exposure. Never throws for bad requests: they give INVALID and the reason.
  /// @param request all but the rest's start, and whether the start is verified, which are set here
  /// @param stamp_ns of the exposure; nothing: the images belong to no sequence, and what comes of them says nothing of
  ///        the next exposure
  /// @param unverified who asks has nothing that confirms the start; else it is verified where it follows from a
  ///        believed pose of shortly before
  /// @throws std::logic_error without a registration
  RegistrationResult run(RegistrationRequest request, std::optional<std::int64_t> stamp_ns, bool unverified);

  /// The next exposure is the first one, as of another run.
  void forget();

private:
  struct BelievedPose
  {
    RigidTransform room_from_patient;
    std::int64_t stamp_ns = 0;
    std::map<std::string, double> saturations;  ///< by the views' names
  };

  bool followsFromBelieved(const RigidTransform& start, std::int64_t stamp_ns) const;

  Eigen::Vector3d target_centre_;
  std::shared_ptr<const Registration> registration_;
  RigidTransform target_from_rest_ = RigidTransform::Identity();
  int unbelieved_ = 0;                    ///< results in a row that were not, of starts that nothing verified
  std::optional<BelievedPose> believed_;  ///< of the last exposure that was registered with success
};
}  // namespace xray_tracking
