#include "pose_readings.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "xray_tracking_core/geometry/geometry_import.h"

namespace xray_tracking
{
namespace
{
// Of the target's box that has to be seen.
constexpr double kSeen = 0.75;

/// Of one detector; nothing if it is behind the source.
double shareOf(const TreatmentSetup& setup, const RigidTransform& room_from_patient, const ProjectionGeometry& detector,
               bool& in_front)
{
  TreatmentSetup there = setup;
  there.room_from_patient = room_from_patient;
  Eigen::AlignedBox2d corners;
  in_front = true;
  for (int corner = 0; corner < 8; ++corner)
  {
    const auto type = static_cast<Eigen::AlignedBox3d::CornerType>(corner);
    const Eigen::Vector2d pixel = detector.project(room_from_patient * setup.target_box.corner(type));
    in_front = in_front && pixel.allFinite();
    corners.extend(pixel);
  }
  return in_front
             ? projectedTargetRegion(there, detector).area() / std::max(1.0, (corners.sizes().array() + 1.0).prod())
             : 0.0;
}
}  // namespace

std::pair<double, double> apart(const RigidTransform& a, const RigidTransform& b, const Eigen::Vector3d& centre)
{
  return { (a * centre - b * centre).norm(), rotationAngle(a.inverse() * b) };
}

std::vector<PoseReading> otherReadings(const TreatmentSetup& setup)
{
  const RigidTransform pose = setup.room_from_patient;
  const auto scaled = [](RigidTransform transform, double factor)
  {
    transform.translation() *= factor;
    return transform;
  };
  const Eigen::Quaterniond q(pose.linear());
  RigidTransform reordered = pose;
  reordered.linear() = Eigen::Quaterniond(q.x(), q.y(), q.z(), q.w()).toRotationMatrix();
  const RigidTransform half_turn(Eigen::AngleAxisd(boost::math::constants::pi<double>(), Eigen::Vector3d::UnitZ()));
  std::vector<PoseReading> readings{
    { "the inverse of it (it maps room to patient)", pose.inverse() },
    { "it in metres (translation_mm times 1000)", scaled(pose, 1000.0) },
    { "it by a thousand (millimetres were taken for metres)", scaled(pose, 0.001) },
    { "the inverse of it in metres", scaled(pose, 1000.0).inverse() },
    { "its quaternion with w first", reordered },
    { "it for RAS coordinates of the patient instead of LPS", pose * half_turn },
  };
  if (setup.detectors.size() == 2)
  {
    readings.push_back({ "it with the two detectors' images swapped", pose, true });
  }
  readings.push_back({ std::string("it with intensity.kind ") +
                           (setup.intensity.kind == IntensityModel::Kind::COUNTS ? "attenuation" : "counts"),
                       pose, false, true });
  // Those that say what the setup says, or another one before them.
  std::vector<PoseReading> different;
  for (const PoseReading& reading : readings)
  {
    const auto same = [&](const RigidTransform& other)
    {
      const auto [distance, angle] = apart(reading.room_from_patient, other, setup.targetCentre());
      return distance < kNearMm && angle < kNearRotation;
    };
    if (reading.swapped || reading.other_tone ||
        (!same(pose) && std::none_of(different.begin(), different.end(),
                                     [&](const PoseReading& other) { return same(other.room_from_patient); })))
    {
      different.push_back(reading);
    }
  }
  return different;
}

double targetShare(const TreatmentSetup& setup, const RigidTransform& room_from_patient)
{
  double least = 1.0;
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    bool in_front = true;
    least = std::min(least, shareOf(setup, room_from_patient, detector, in_front));
  }
  return least;
}

std::vector<Finding> checkRoom(const TreatmentSetup& setup)
{
  std::string fits;
  if (targetShare(setup, setup.room_from_patient) < kSeen)
  {
    for (const PoseReading& reading : otherReadings(setup))
    {
      if (!reading.swapped && !reading.other_tone && targetShare(setup, reading.room_from_patient) >= kSeen)
      {
        fits += (fits.empty() ? "" : ", or ") + reading.words;
      }
    }
  }
  std::vector<Finding> findings;
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    bool in_front = true;
    const double share = shareOf(setup, setup.room_from_patient, detector, in_front);
    const std::string doubt = implausibility(detector, setup.room_from_patient * setup.targetCentre());
    if (share >= kSeen)
    {
      if (!doubt.empty())
      {
        findings.push_back({ "geometry_implausible", Severity::WARNING, detector.name(), doubt,
                             "a room for patients, in mm", "look at it by show_setup" });
      }
      continue;
    }
    char text[80];
    std::snprintf(text, sizeof(text), "%.0f %% of it in the image at the initial pose", 100.0 * share);
    findings.push_back({ "target_outside_image", share > 0.0 ? Severity::WARNING : Severity::ERROR,
                         detector.name() + ", target_box_mm",
                         in_front ? text : "is behind the source at the initial pose", "all of it",
                         "look at initial_pose, target_box_mm (patient frame, LPS) and the detector's geometry" +
                             (doubt.empty() ? "" : ": " + doubt) +
                             (fits.empty() ? "" : "; of the pose, all detectors would see it by " + fits) });
  }
  return findings;
}
}  // namespace xray_tracking
