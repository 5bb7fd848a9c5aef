#include "random_sequence.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>

#include "benchmark_registration/random_room.h"
#include "benchmark_registration/starts.h"
#include "make_sequences/sequence_files.h"
#include "xray_tracking_detector_simulator/simulated_motion.h"
#include "xray_tracking_tools/json_file.h"

namespace xray_tracking
{
namespace
{
constexpr std::array<std::pair<MotionType, const char*>, 6> kMotions{ {
    { MotionType::NONE, "none" },
    { MotionType::DRIFT, "drift" },
    { MotionType::BREATHING, "breathing" },
    { MotionType::SWALLOW, "swallow" },
    { MotionType::RANDOM_WALK, "random walk" },
    { MotionType::DRIFT_AND_BREATHING, "drift and breathing" },
} };

Start randomStart(std::mt19937& random)
{
  const double kind = between(random, 0.0, 1.0);
  return kind < 0.65   ? Start::RIGHT
         : kind < 0.77 ? Start::OFF
         : kind < 0.85 ? Start::NEXT_VERTEBRA
         : kind < 0.90 ? Start::EXCHANGED
         : kind < 0.95 ? Start::MIRRORED
                       : Start::OTHER_CT;
}

/// Mostly within the beam gate's bounds, or it would seldom be open.
MotionOptions randomMotion(std::mt19937& random, double interval, std::string& name)
{
  MotionOptions motion;
  std::tie(motion.type, name) = kMotions[random() % kMotions.size()];
  motion.amplitude_mm = betweenLog(random, 0.3, 6.0) * randomDirection(random);
  motion.amplitude_deg = between(random, 0.0, 2.5) * randomDirection(random);
  motion.period = between(random, 2.0, 8.0) / interval;
  motion.start = 1 + static_cast<int>(random() % 10);
  motion.rest_share = between(random, 0.2, 1.0);
  motion.rest_jitter_mm = between(random, 0.0, 0.5);
  return motion;
}

CtVolume scaled(CtVolume ct, const Eigen::Vector3d& centre, std::mt19937& random)
{
  Eigen::Vector3d factor;
  for (double& along : factor)
  {
    along = 1.0 + between(random, 0.1, 0.25) * (withProbability(random, 0.5) ? 1.0 : -1.0);
  }
  ct.grid.patient_from_index = Eigen::Translation3d(centre) * Eigen::Scaling(factor) * Eigen::Translation3d(-centre) *
                               ct.grid.patient_from_index;
  return ct;
}

/// What somebody who got it wrong writes into the setup file.
void misstate(Start start, std::mt19937& random, TreatmentSetup& setup)
{
  const Eigen::Vector3d centre = setup.room_from_patient * setup.targetCentre();
  const auto exchange = [](ProjectionGeometry& a, ProjectionGeometry& b)
  {
    DetectorDescription of_a = a.description();
    DetectorDescription of_b = b.description();
    std::swap(of_a.name, of_b.name);
    a = ProjectionGeometry::fromDescription(of_b);
    b = ProjectionGeometry::fromDescription(of_a);
  };
  switch (start)
  {
    case Start::OFF:
      setup.room_from_patient =
          motionAbout(centre, randomTwist(random, between(random, 0.0, 3.0) * kDegree, between(random, 0.0, 5.0))) *
          setup.room_from_patient;
      break;
    case Start::NEXT_VERTEBRA:
      setup.room_from_patient =
          motionAbout(centre, randomTwist(random, between(random, 0.0, 3.0) * kDegree, 2.0)) * setup.room_from_patient *
          Eigen::Translation3d(0.0, 0.0, between(random, 10.0, 25.0) * (withProbability(random, 0.5) ? 1.0 : -1.0));
      break;
    case Start::EXCHANGED:
      exchange(setup.detectors[0], setup.detectors[1]);
      break;
    case Start::MIRRORED:  // of the images, as no setup file may say so
    case Start::RIGHT:
    case Start::OTHER_CT:
      break;
  }
}
}  // namespace

const char* startName(Start start)
{
  static const char* const kNames[] = { "right", "off", "next vertebra", "exchanged", "mirrored", "other ct" };
  return kNames[static_cast<std::size_t>(start)];
}

void writeRandomSequence(const std::filesystem::path& folder, std::uint32_t seed, const Scans* scans, int exposures)
{
  constexpr RoomLimits kLimits{ 2, 512 };
  std::mt19937 random(seed);
  const bool scanned = scans && withProbability(random, 0.25);
  RandomScene scene(
      random,
      scanned ? scannedAnatomy(random, scans->all()[random() % scans->all().size()], true) : phantomAnatomy(random),
      kLimits);
  const Start start = randomStart(random);
  const double interval = 0.1 * (1 + random() % 5);
  std::string motion_name;
  const MotionOptions motion_options = randomMotion(random, interval, motion_name);
  const RigidTransform first = scene.setup().room_from_patient;
  const Eigen::Vector3d patient_centre = scene.anatomy().box.center();
  const Eigen::Vector3d centre = first * patient_centre;
  const SimulatedMotion motion(motion_options, first, patient_centre, seed);

  TreatmentSetup setup = scene.setup();
  std::filesystem::create_directories(folder);
  setup.ct_path = "ct.nrrd";
  writeCtVolume(start == Start::OTHER_CT ? scaled(scene.anatomy().ct, patient_centre, random) : scene.anatomy().ct,
                (folder / setup.ct_path).string());
  misstate(start, random, setup);
  // Images go by the names of those that took them.
  std::vector<std::string> names;
  for (const ProjectionGeometry& detector : scene.setup().detectors)
  {
    names.push_back(detector.name());
  }
  std::sort(setup.detectors.begin(), setup.detectors.end(),
            [&](const auto& a, const auto& b) {
              return std::find(names.begin(), names.end(), a.name()) < std::find(names.begin(), names.end(), b.name());
            });

  SequenceFiles files(folder, setup);
  const RigidTransform posture = first.inverse() * motionAbout(centre, scene.posture()) * first;
  for (int k = 0; k < exposures; ++k)
  {
    const BodyPoses poses = motion.poses(k);
    std::vector<cv::Mat> images = scene.images(poses.room_from_target, poses.room_from_rest * posture, k);
    if (start == Start::MIRRORED)
    {
      cv::flip(images[0], images[0], 1);
    }
    files.add(k * interval, poses.room_from_target, images);
  }
  files.close();
  writeJsonFile((folder / "scenario.json").string(),
                { { "seed", seed },
                  { "start", startName(start) },
                  { "anatomy", scene.anatomy().name },
                  { "views", setup.detectors.size() },
                  { "ct_spacing_mm", { scene.anatomy().ct.grid.spacing().x(), scene.anatomy().ct.grid.spacing().z() } },
                  { "interval_s", interval },
                  { "motion", motion_name },
                  { "motion_mm", motion_options.amplitude_mm.norm() },
                  { "rest_share", motion_options.rest_share },
                  { "rest_jitter_mm", motion_options.rest_jitter_mm },
                  { "posture_mm", scene.posture().tail<3>().norm() },
                  { "posture_degrees", scene.posture().head<3>().norm() / kDegree } });
}
}  // namespace xray_tracking
