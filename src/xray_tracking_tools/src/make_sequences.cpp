#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "make_sequences/sequence_files.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_detector_simulator/anatomy.h"
#include "xray_tracking_detector_simulator/image_formation.h"
#include "xray_tracking_detector_simulator/simulated_motion.h"
#include "xray_tracking_tools/command_line.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
constexpr double kDegree = EIGEN_PI / 180.0;
constexpr double kInterval = 0.2;              // [s]
constexpr double kSourceToIsocentre = 2600.0;  // as cyberknife.yaml [mm]
constexpr double kPanelToIsocentre = 1200.0;   // [mm]
constexpr int kPixels = 512;                   // columns and rows
constexpr double kPitch = 0.4;                 // [mm]

/// A wire of metal that moves with the rest of the body.
struct Wire
{
  std::size_t detector;       ///< that it lies before
  double distance = 50.0;     ///< from the target's centre, towards that detector's source [mm]
  double radius = 1.25;       ///< [mm]
  double half_length = 25.0;  ///< [mm]
  double bone = 8.0;          ///< cortical bone that steel of the same thickness attenuates as much as, about
};

/// What a sequence of the standard set shows.
struct Scenario
{
  explicit Scenario(std::string its_name, std::uint64_t its_seed) : name(std::move(its_name)), seed(its_seed)
  {
    motion.period = 9.0;
    motion.max_shift_mm = 30.0;
    motion.max_rotation_deg = 10.0;
  }

  std::string name;
  std::uint64_t seed;  ///< of motion and noise
  MotionOptions motion;
  ImageFormationOptions image;
  std::vector<ProjectionGeometry> detectors;
  double slice_mm = 1.25;         ///< distance and thickness of the CT's slices
  Twist posture = Twist::Zero();  ///< of the rest about the target's centre, room axes: how else than in the CT it lies
  std::optional<Wire> wire;
};

/// A panel opposite a source at an angle about room x from the vertical, turned about its own middle by a rotation
/// vector [rad]; at 45 and -45 degrees and unturned those of cyberknife.yaml.
ProjectionGeometry panel(const std::string& name, double angle, const Eigen::Vector3d& turn = Eigen::Vector3d::Zero())
{
  const Eigen::Vector3d to_source(0.0, std::sin(angle), std::cos(angle));
  const Eigen::Matrix3d turned = rotationFromVector(turn);
  DetectorDescription description;
  description.name = name;
  description.image_size = { kPixels, kPixels };
  description.pixel_pitch = { kPitch, kPitch };
  description.source = kSourceToIsocentre * to_source;
  description.x_direction = turned * Eigen::Vector3d::UnitX();
  description.y_direction = turned * Eigen::Vector3d(0.0, -std::cos(angle), std::sin(angle));
  description.origin = -kPanelToIsocentre * to_source -
                       0.5 * (kPixels - 1) * kPitch * (description.x_direction + description.y_direction);
  return ProjectionGeometry::fromDescription(description);
}

Scenario shifting(const std::string& name, std::uint64_t seed)
{
  Scenario scenario(name, seed);
  scenario.detectors = { panel("detector_a", 45.0 * kDegree), panel("detector_b", -45.0 * kDegree) };
  return scenario;
}

Scenario rotating(const std::string& name, std::uint64_t seed, double degrees)
{
  Scenario scenario = shifting(name, seed);
  // Oblique, so that each view sees a part of it in its plane and the rest out of it.
  scenario.motion.amplitude_deg = degrees * Eigen::Vector3d(1.5, -2.0, 1.5).normalized();
  return scenario;
}

std::vector<Scenario> standardSet()
{
  std::vector<Scenario> set;
  set.push_back(shifting("translation", 1));
  set.push_back(rotating("rotation_1_degree", 2, 1.0));
  set.push_back(rotating("rotation_2_degrees", 3, 2.0));
  set.push_back(rotating("rotation_3_degrees", 4, 3.0));

  set.push_back(shifting("large_shift_late", 5));
  set.back().motion.type = MotionType::STEP;
  set.back().motion.start = 7;
  set.back().motion.amplitude_mm = { -9.0, 7.0, 8.0 };

  set.push_back(shifting("breathing", 6));
  set.back().motion.type = MotionType::BREATHING;
  set.back().motion.period = 6.0;
  set.back().motion.amplitude_mm = { 5.0, 1.0, 4.0 };
  set.back().motion.rest_share = 0.7;

  set.push_back(shifting("swallow", 7));
  set.back().motion.type = MotionType::SWALLOW;
  set.back().motion.period = 5.0;
  set.back().motion.start = 3;
  set.back().motion.amplitude_mm = { 4.0, 0.5, 2.0 };
  set.back().motion.rest_share = 0.3;

  set.push_back(shifting("gain_drift", 8));
  set.back().image.gain_drift = 0.2;
  set.back().image.offset_drift = 200.0;

  set.push_back(shifting("metal", 9));
  set.back().wire = Wire{ 0 };

  set.push_back(shifting("views_60_degrees", 10));
  set.back().detectors = { panel("detector_a", 30.0 * kDegree), panel("detector_b", -30.0 * kDegree) };

  set.push_back(shifting("three_views", 11));
  set.back().detectors.push_back(panel("detector_c", 0.0));

  set.push_back(shifting("tilted_panels", 12));
  set.back().detectors = { panel("detector_a", 45.0 * kDegree, kDegree * Eigen::Vector3d(12.0, 8.0, 5.0)),
                           panel("detector_b", -45.0 * kDegree, kDegree * Eigen::Vector3d(8.0, -12.0, -7.0)) };

  set.push_back(shifting("other_posture", 13));
  set.back().posture << kDegree * Eigen::Vector3d(2.0, 4.0, -2.0), 1.0, -2.0, 1.5;

  // One motion and noise, three CTs.
  for (const int slice_mm : { 1, 2, 3 })
  {
    set.push_back(shifting("slices_" + std::to_string(slice_mm) + "_mm", 14));
    set.back().slice_mm = slice_mm;
  }
  return set;
}

/// Adds the bone that a wire amounts to along every ray that meets it.
void addWire(const Wire& wire, const ProjectionGeometry& detector, const RigidTransform& room_from_rest,
             const RigidTransform& rest_from_wire, cv::Mat& bone)
{
  const Solid solid(Solid::Shape::CYLINDER, rest_from_wire, { wire.radius, wire.radius, wire.half_length },
                    { 0.0, wire.bone });
  const RigidTransform rest_from_room = room_from_rest.inverse();
  for (int row = 0; row < bone.rows; ++row)
  {
    for (int column = 0; column < bone.cols; ++column)
    {
      const Ray ray = detector.backProject({ column, row });
      const double length =
          solid.intersect({ rest_from_room * ray.source, rest_from_room.linear() * ray.direction }).length();
      bone.at<float>(row, column) += static_cast<float>(wire.bone * length);
    }
  }
}

/// Where the wire lies in the rest's frame: its axis across the ray to the target, oblique to rows and columns.
RigidTransform wirePose(const Wire& wire, const TreatmentSetup& setup)
{
  const ProjectionGeometry& detector = setup.detectors.at(wire.detector);
  const Eigen::Vector3d centre = setup.room_from_patient * setup.targetCentre();
  const Eigen::Vector3d to_source = (detector.source() - centre).normalized();
  const Eigen::Vector3d axis = (detector.xDirection() + 0.5 * detector.yDirection()).normalized();
  RigidTransform room_from_wire = RigidTransform::Identity();
  room_from_wire.linear() = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), axis).toRotationMatrix();
  room_from_wire.translation() = centre + wire.distance * to_source;
  return setup.room_from_patient.inverse() * room_from_wire;
}

class SequenceWriter
{
public:
  SequenceWriter(const Scenario& scenario, const std::filesystem::path& root, int frames)
    : scenario_(scenario), folder_(root / scenario.name), frames_(frames)
  {
    std::ostringstream ct_name;
    ct_name << "ct_" << scenario.slice_mm << "mm.nrrd";
    setup_.ct_path = "../" + ct_name.str();  // beside the folders, as most have the same one
    setup_.ct_content = CtContent::FULL;
    setup_.intensity.offset = 100.0;
    setup_.intensity.air_counts = 60000.0;
    setup_.detectors = scenario.detectors;
    setup_.room_from_patient = makeRigidTransform(Eigen::Vector3d::Zero(), Eigen::Quaterniond(-0.5, 0.5, -0.5, 0.5));
    setup_.target_box = phantom_.targetBox();
    ct_file_ = (root / ct_name.str()).string();
  }

  void write(const std::function<void(std::size_t, std::size_t)>& progress)
  {
    std::filesystem::create_directories(folder_);
    writeCt();
    SequenceFiles files(folder_, setup_);
    const SimulatedMotion motion(scenario_.motion, setup_.room_from_patient, setup_.targetCentre(), scenario_.seed);
    ImageFormation formation(scenario_.image, setup_.intensity, scenario_.seed);
    for (int k = 0; k < frames_; ++k)
    {
      const BodyPoses poses = motion.poses(k);
      std::vector<cv::Mat> images;
      for (std::size_t d = 0; d < setup_.detectors.size(); ++d)
      {
        images.push_back(image(poses, d, k, formation));
      }
      files.add(k * kInterval, poses.room_from_target, images);
      progress(static_cast<std::size_t>(k) + 1, static_cast<std::size_t>(frames_));
    }
    files.close();
  }

private:
  void writeCt() const
  {
    if (std::filesystem::exists(ct_file_))
    {
      return;
    }
    PhantomCtOptions options;
    options.spacing.z() = scenario_.slice_mm;
    options.slice_thickness = scenario_.slice_mm;
    options.size.z() = static_cast<int>(std::lround(200.0 / scenario_.slice_mm));
    // Complete or not there, whoever else makes it at the same time.
    const std::string partial = ct_file_.substr(0, ct_file_.rfind('.')) + "_" + scenario_.name + ".partial.nrrd";
    writeCtVolume(phantom_.sampleCt(options), partial);
    std::filesystem::rename(partial, ct_file_);
  }

  cv::Mat image(const BodyPoses& poses, std::size_t d, int k, ImageFormation& formation)
  {
    const ProjectionGeometry& detector = setup_.detectors[d];
    const Eigen::Vector3d centre = setup_.room_from_patient * setup_.targetCentre();
    const RigidTransform room_from_rest = poses.room_from_rest * setup_.room_from_patient.inverse() *
                                          motionAbout(centre, scenario_.posture) * setup_.room_from_patient;
    phantom_.lineIntegrals(detector, poses.room_from_target, room_from_rest, soft_, bone_);
    if (scenario_.wire)
    {
      addWire(*scenario_.wire, detector, room_from_rest, wirePose(*scenario_.wire, setup_), bone_);
    }
    cv::Mat counts;
    formation.form(soft_, bone_, static_cast<int>(d), k, counts);
    return counts;
  }

  const Scenario& scenario_;
  std::filesystem::path folder_;
  int frames_;
  NeckPhantom phantom_;
  TreatmentSetup setup_;
  std::string ct_file_;
  cv::Mat soft_, bone_;
};

int makeSequences(const po::variables_map& arguments)
{
  const int frames = arguments["frames"].as<int>();
  requireAtLeast("--frames", frames, 1);
  const std::vector<Scenario> set = standardSet();
  std::vector<const Scenario*> chosen;
  std::string known;
  for (const Scenario& scenario : set)
  {
    known += (known.empty() ? "" : ", ") + scenario.name;
  }
  if (arguments.count("sequences") == 0)
  {
    std::transform(set.begin(), set.end(), std::back_inserter(chosen), [](const Scenario& s) { return &s; });
  }
  else
  {
    std::string list = arguments["sequences"].as<std::string>();
    std::replace(list.begin(), list.end(), ',', ' ');
    std::istringstream words(list);
    for (std::string word; words >> word;)
    {
      const auto found = std::find_if(set.begin(), set.end(), [&](const Scenario& s) { return s.name == word; });
      if (found == set.end())
      {
        throw std::invalid_argument("--sequences has '" + word + "', expected some of " + known);
      }
      chosen.push_back(&*found);
    }
  }
  for (const Scenario* scenario : chosen)
  {
    Progress progress(scenario->name);
    SequenceWriter(*scenario, arguments["OUT_DIR"].as<std::string>(), frames).write(progress);
  }
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "OUT_DIR [--sequences LIST] [--frames 10]";
  command_line.description =
      "Makes the standard set of sequence folders, of the neck phantom's exact line integrals: the same files every "
      "time.\ndocs/reproduction.md tells what each one shows.";
  command_line.arguments = { "OUT_DIR" };
  command_line.options.add_options()("sequences", po::value<std::string>(), "some of them, with commas; default: all")(
      "frames", po::value<int>()->default_value(10), "exposures of each");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::makeSequences);
}
