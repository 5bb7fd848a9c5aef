#include "pose_check.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <boost/math/constants/constants.hpp>

#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_registration/registration.h"
#include "xray_tracking_registration/usable_pixels.h"

namespace xray_tracking
{
namespace
{
constexpr double kDegree = boost::math::constants::degree<double>();
// What the graph asks of an initial pose (docs/playback.md).
constexpr double kNearMm = 10.0;
constexpr double kNearRotation = 5.0 * kDegree;
// Of the target's box that has to be seen.
constexpr double kSeen = 0.75;
/// No right pose of the registration's own measurements has less (docs/registration_measurements.md).
constexpr double kLikeNothing = 0.31;
constexpr double kTimeBudget = 20.0;  // [s] of one registration; nothing waits

std::string printed(const char* format, double a, double b = 0.0)
{
  char text[160];
  std::snprintf(text, sizeof(text), format, a, b);
  return text;
}

/// Another meaning of what is written in a setup.
struct Reading
{
  std::string words;
  RigidTransform room_from_patient;
  bool swapped = false;     ///< the first two detectors
  bool other_tone = false;  ///< the other kind of intensity
};

/// How far apart two poses put the target: distance of its centre, angle.
std::pair<double, double> apart(const RigidTransform& a, const RigidTransform& b, const Eigen::Vector3d& centre)
{
  return { (a * centre - b * centre).norm(), rotationAngle(a.inverse() * b) };
}

std::vector<Reading> otherReadings(const TreatmentSetup& setup)
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
  std::vector<Reading> readings{
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
  std::vector<Reading> different;
  for (const Reading& reading : readings)
  {
    const auto same = [&](const RigidTransform& other)
    {
      const auto [distance, angle] = apart(reading.room_from_patient, other, setup.targetCentre());
      return distance < kNearMm && angle < kNearRotation;
    };
    if (reading.swapped || reading.other_tone ||
        (!same(pose) && std::none_of(different.begin(), different.end(),
                                     [&](const Reading& other) { return same(other.room_from_patient); })))
    {
      different.push_back(reading);
    }
  }
  return different;
}

bool targetIsSeen(const TreatmentSetup& setup, const RigidTransform& room_from_patient)
{
  TreatmentSetup there = setup;
  there.room_from_patient = room_from_patient;
  return std::none_of(there.detectors.begin(), there.detectors.end(),
                      [&](const ProjectionGeometry& detector)
                      { return projectedTargetRegion(there, detector).empty(); });
}

RegistrationResult registered(const Registration& registration, const TreatmentSetup& setup,
                              const std::vector<cv::Mat>& images, const Reading& reading)
{
  RegistrationRequest request;
  request.intensity = setup.intensity;
  if (reading.other_tone)
  {
    const bool counts = setup.intensity.kind == IntensityModel::Kind::COUNTS;
    request.intensity.kind = counts ? IntensityModel::Kind::ATTENUATION : IntensityModel::Kind::COUNTS;
    request.intensity.air_counts.reset();
  }
  request.room_from_patient = reading.room_from_patient;
  request.time_budget = std::chrono::duration<double>(kTimeBudget);
  for (std::size_t d = 0; d < images.size(); ++d)
  {
    request.views.push_back({ setup.detectors[d], images[reading.swapped ? 1 - d : d] });
  }
  try
  {
    UsablePixels().apply(0, request);
  }
  catch (const std::invalid_argument& error)
  {
    RegistrationResult none;
    none.reason = error.what();
    return none;
  }
  return registration.run(request);
}

class PoseCheck
{
public:
  PoseCheck(const TreatmentSetup& setup, const std::vector<cv::Mat>& images) : setup_(setup), images_(images) {}

  std::vector<Finding> run(const std::optional<RigidTransform>& gold_standard)
  {
    const bool seen = checkTargetSeen();
    if (gold_standard)
    {
      checkGoldStandard(*gold_standard);
    }
    if (setup_.ct_path.empty())
    {
      tell("ct_missing", Severity::WARNING, "ct", "is absent", "the path of the planning CT",
           "name it: without, there is no registration, and nothing confirms the pose");
      return findings_;
    }
    try
    {
      checkCt(seen);
    }
    catch (const std::exception& error)
    {
      tell("ct_unreadable", Severity::ERROR, setup_.ct_path, error.what(), "a CT in HU, or a label map",
           "export it again, or mend the path");
    }
    return findings_;
  }

private:
  void tell(const char* code, Severity severity, const std::string& thing, const std::string& value,
            const std::string& expected, const std::string& advice)
  {
    findings_.push_back({ code, severity, thing, value, expected, advice });
  }

  bool checkTargetSeen()
  {
    bool all = true;
    for (const ProjectionGeometry& detector : setup_.detectors)
    {
      Eigen::AlignedBox2d corners;
      bool in_front = true;
      for (int corner = 0; corner < 8; ++corner)
      {
        const auto type = static_cast<Eigen::AlignedBox3d::CornerType>(corner);
        const Eigen::Vector2d pixel = detector.project(setup_.room_from_patient * setup_.target_box.corner(type));
        in_front = in_front && pixel.allFinite();
        corners.extend(pixel);
      }
      const double share = in_front ? projectedTargetRegion(setup_, detector).area() /
                                          std::max(1.0, (corners.sizes().array() + 1.0).prod())
                                    : 0.0;
      if (share < kSeen)
      {
        all = all && share > 0.0;
        tell("target_outside_image", share > 0.0 ? Severity::WARNING : Severity::ERROR,
             detector.name() + ", target_box_mm",
             !in_front ? "is behind the source at the initial pose"
                       : printed("%.0f %% of it in the image at the initial pose", 100.0 * share),
             "all of it", "look at initial_pose, target_box_mm (patient frame, LPS) and the detector's geometry");
      }
    }
    return all;
  }

  void checkGoldStandard(const RigidTransform& gold)
  {
    const auto [distance, angle] = apart(setup_.room_from_patient, gold, setup_.targetCentre());
    if (distance <= kNearMm && angle <= kNearRotation)
    {
      return;
    }
    std::string fits;
    for (const Reading& reading : otherReadings(setup_))
    {
      const auto [other_distance, other_angle] = apart(reading.room_from_patient, gold, setup_.targetCentre());
      if (fits.empty() && other_distance <= kNearMm && other_angle <= kNearRotation)
      {
        fits = reading.words;
      }
    }
    tell("initial_pose_off_gold_standard", Severity::WARNING, "initial_pose",
         printed("%.1f mm and %.1f degrees from the first pose of the gold standard", distance, angle / kDegree) +
             (fits.empty() ? "" : ", which " + fits + " would fit"),
         "within 10 mm and 5 degrees",
         fits.empty() ? "look which of both is wrong, or find the pose by align_sequence" : "mend the setup");
  }

  void checkCt(bool seen)
  {
    const PatientCt ct = readPatientCt(setup_.ct_path, setup_.ct_content, setup_.ct_choice);
    // A voxel more than its centres: boxes are given to the CT's edge, and rounded.
    const Eigen::AlignedBox3d centres = ct.volume.grid.extent();
    const Eigen::Vector3d voxel = Eigen::Vector3d::Constant(ct.volume.grid.spacing().maxCoeff());
    const Eigen::AlignedBox3d extent(centres.min() - voxel, centres.max() + voxel);
    if (!extent.contains(setup_.target_box))
    {
      const bool any = extent.intersects(setup_.target_box);
      std::ostringstream box, whole;
      box << setup_.target_box.min().transpose() << " to " << setup_.target_box.max().transpose()
          << (any ? " mm, partly outside" : " mm, outside");
      whole << "inside the CT's " << extent.min().transpose() << " to " << extent.max().transpose() << " mm";
      tell("target_outside_ct", any ? Severity::WARNING : Severity::ERROR, "target_box_mm", box.str(), whole.str(),
           "give it in the patient frame, LPS mm as the CT has them");
      if (!any)
      {
        return;
      }
    }
    std::unique_ptr<const Registration> registration;
    try
    {
      registration =
          std::make_unique<const Registration>(bodiesOf(ct, targetMaskOf(ct, setup_.target_box)), setup_.target_box);
    }
    catch (const std::exception& error)
    {
      tell("target_without_bone", Severity::ERROR, "target_box_mm", error.what(), "a box with bone or a label in it",
           "look at the box in the CT, patient frame, LPS mm");
      return;
    }
    if (images_.empty())
    {
      tell("initial_pose_unchecked", Severity::WARNING, "initial_pose", "there is nothing to compare it with",
           "an exposure of which every detector has a good image", "mend what else is named here");
      return;
    }
    checkImages(*registration, seen);
  }

  void checkImages(const Registration& registration, bool seen)
  {
    RegistrationResult given;
    given.reason = "the target is outside the images";
    if (seen)
    {
      given = registered(registration, setup_, images_, { "", setup_.room_from_patient });
    }
    const std::string alike = given.views.empty() ? given.reason
                                                  : printed("similarity %.2f there, %.2f at best nearby, ",
                                                            given.similarity_before, given.similarity_after) +
                                                        given.reason;
    if (given.status == RegistrationStatus::SUCCESS)
    {
      const auto [distance, angle] = apart(setup_.room_from_patient, given.room_from_patient, setup_.targetCentre());
      if (distance > kNearMm || angle > kNearRotation)
      {
        tell(
            "initial_pose_far", Severity::WARNING, "initial_pose",
            printed("%.1f mm and %.1f degrees from where the registration finds the target", distance, angle / kDegree),
            "within 10 mm and 5 degrees", "find it by align_sequence");
      }
      return;
    }
    std::string fits;
    double probability = 0.0;
    for (const Reading& reading : otherReadings(setup_))
    {
      if (!targetIsSeen(setup_, reading.room_from_patient))
      {
        continue;
      }
      const RegistrationResult result = registered(registration, setup_, images_, reading);
      // Else the target was found by searching, and the reading says nothing.
      const auto [distance, angle] = apart(reading.room_from_patient, result.room_from_patient, setup_.targetCentre());
      if (result.status == RegistrationStatus::SUCCESS && result.probability > probability && distance <= kNearMm &&
          angle <= kNearRotation)
      {
        probability = result.probability;
        fits = reading.words + printed(" fits, with a similarity of %.2f and a probability of %.3f",
                                       result.similarity_after, result.probability);
      }
    }
    const bool nothing = given.views.empty() || given.similarity_after < kLikeNothing;
    if (!fits.empty())
    {
      tell("initial_pose_wrong", Severity::ERROR, "initial_pose", "DRRs do not look like the images: " + alike,
           "room_T_patient in mm at the first exposure: " + fits, "mend the setup so");
    }
    else
    {
      tell(nothing ? "initial_pose_wrong" : "initial_pose_doubtful", nothing ? Severity::ERROR : Severity::WARNING,
           "initial_pose",
           (nothing ? "DRRs look like nothing in the images: " : "the registration does not believe it: ") + alike,
           "room_T_patient in mm at the first exposure, to 10 mm and 5 degrees",
           "find it by align_sequence; look whether CT, detectors' geometry and images belong together");
    }
  }

  const TreatmentSetup& setup_;
  const std::vector<cv::Mat>& images_;
  std::vector<Finding> findings_;
};
}  // namespace

std::vector<Finding> checkPose(const TreatmentSetup& setup, const std::vector<cv::Mat>& images,
                               const std::optional<RigidTransform>& gold_standard)
{
  return PoseCheck(setup, images).run(gold_standard);
}
}  // namespace xray_tracking
