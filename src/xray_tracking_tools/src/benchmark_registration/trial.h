#pragma once

#include <string>
#include <vector>

#include "subject.h"
#include "xray_tracking_registration/registration.h"
#include "xray_tracking_tools/figure_table.h"

namespace xray_tracking
{
/// What a result that claims success must not exceed [mm].
constexpr double kFalseSuccess = 1.5;

/// One registration and what is known of it.
struct Trial
{
  std::string subject;
  std::string kind;    ///< of its start
  double start_error;  ///< of the box [mm]
  double start_angle;  ///< [rad]
  double error;        ///< the result's, of the box [mm]; infinite where no result can be right
  double angle;        ///< the result's [rad]
  double cpu_ms;
  RegistrationResult result;

  bool believed() const { return result.status == RegistrationStatus::SUCCESS; }
};

/// The setup's views of one exposure, from a start.
RegistrationRequest requestFor(const ExposureSet& exposures, std::size_t index, const RigidTransform& start);

/// Registers, as the node does without what lies outside the X-ray field and with stuck pixels repaired, and judges.
/// @throws std::runtime_error if an image shows nothing or the request is INVALID
Trial tryRegistration(const Registration& registration, RegistrationRequest request, const RigidTransform& gold,
                      const Eigen::AlignedBox3d& box);

/// Registers exposures in turn from number `first` on, each from a start that is off by a twist of its own.
std::vector<Trial> registerAll(const Subject& subject, const Registration& registration,
                               const std::vector<Twist>& starts, std::size_t first, const std::string& what);

/// Writes one row a trial: what was registered from where, how far off it ended, and all that the result says of
/// itself. @throws std::runtime_error naming the file if it cannot be written
void writeTrials(const std::vector<Trial>& trials, const std::string& path);
}  // namespace xray_tracking
