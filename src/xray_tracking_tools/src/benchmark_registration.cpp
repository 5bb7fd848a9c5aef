#include <sys/resource.h>
#include <algorithm>
#include <chrono>
#include <iostream>
#include <limits>
#include <map>
#include <random>
#include <stdexcept>

#include <boost/math/constants/constants.hpp>
#include <opencv2/imgcodecs.hpp>

#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_detector_simulator/anatomy.h"
#include "xray_tracking_detector_simulator/image_formation.h"
#include "xray_tracking_registration/registration.h"
#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/exposure_set.h"
#include "xray_tracking_tools/figure_table.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
constexpr double kDegree = boost::math::constants::degree<double>();
/// van de Kraats et al., IEEE TMI 24(9), 2005: a registration below this error [mm] has succeeded.
constexpr double kSuccess = 2.0;
/// What a result that claims success must not exceed [mm].
constexpr double kFalseSuccess = 1.5;
constexpr double kBandWidth = 2.0;  ///< of the starts' distances [mm]

Eigen::Vector3d randomDirection(std::mt19937& random)
{
  std::normal_distribution<double> normal;
  Eigen::Vector3d direction;
  for (double& component : direction)
  {
    component = normal(random);
  }
  return direction.normalized();
}

/// A motion about the target's centre.
Twist randomTwist(std::mt19937& random, double angle, double translation)
{
  Twist twist;
  twist << angle * randomDirection(random), translation * randomDirection(random);
  return twist;
}

/// What is registered, and where it really is.
struct Subject
{
  std::string name;
  CtVolume ct;
  ExposureSet exposures;

  const Eigen::AlignedBox3d& box() const { return exposures.setup.target_box; }
  RigidTransform moved(const Twist& twist, const RigidTransform& pose) const
  {
    return motionAbout(pose * box().center(), twist) * pose;
  }
};

Subject sequenceSubject(const std::string& path)
{
  Subject subject;
  subject.name = path;
  subject.exposures = loadExposureSet(path);
  const TreatmentSetup& setup = subject.exposures.setup;
  if (setup.ct_path.empty() || subject.exposures.room_from_patient.empty())
  {
    throw std::invalid_argument(path + ": expected a sequence with a CT and a gold standard");
  }
  subject.ct = readCtVolume(setup.ct_path);
  return subject;
}

/// Which vertebra of the phantom is registered, how it was scanned and how the rest moves.
struct PhantomCase
{
  std::string target = "c4";
  std::string room = "cyberknife";
  double voxel = 1.0;  ///< [mm]
  double rest_mm = 4.0;
  double rest_degrees = 2.0;
};

/// Boxes around other vertebrae of the phantom than C4, patient frame [mm].
Eigen::AlignedBox3d boxAround(const std::string& vertebra, const Eigen::AlignedBox3d& c4)
{
  const std::map<std::string, std::pair<double, double>> places{
    { "c3", { 0.0, 16.0 } }, { "c4", { 0.0, 0.0 } }, { "c5", { 2.5, -18.0 } }, { "c6", { 5.5, -35.0 } }
  };
  const auto place = places.find(vertebra);
  if (place == places.end())
  {
    throw std::invalid_argument("target is " + vertebra + ", expected c3, c4, c5 or c6");
  }
  const Eigen::Vector3d shift(0.0, place->second.first, place->second.second);
  return { c4.min() + shift, c4.max() + shift };
}

/// Closed-form X-rays of the phantom with the simulator's physics, of a CT of it: the target anywhere up to 12 mm and 4
/// degrees, the rest of the body somewhere else. C3 to C5 move as one, C6 with the phantom's rest.
Subject phantomSubject(int count, const PhantomCase& what)
{
  Subject subject;
  subject.name = "phantom, " + what.target + ", " + what.room;
  PhantomCtOptions scan;
  scan.size = (scan.size.cast<double>().cwiseProduct(scan.spacing) / what.voxel).cast<int>();
  scan.slice_thickness = 1.25 * what.voxel;
  scan.spacing = { what.voxel, what.voxel, scan.slice_thickness };
  scan.size.z() = static_cast<int>(scan.size.z() / 1.25);
  subject.ct = NeckPhantom().sampleCt(scan);
  ExposureSet& exposures = subject.exposures;
  exposures.setup = loadTreatmentSetup(coreConfigPath("phantom_neck.yaml"));
  exposures.setup.detectors = loadDetectors(coreConfigPath("geometry/" + what.room + ".yaml"));
  exposures.setup.target_box = boxAround(what.target, exposures.setup.target_box);
  RigidTransform& start = exposures.setup.room_from_patient;
  start.translation() = -(start.linear() * subject.box().center());
  const PhantomAnatomy anatomy;
  ImageFormation formation(ImageFormationOptions(), exposures.setup.intensity, 1);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> share;
  Progress progress("exposure");
  for (int n = 0; n < count; ++n)
  {
    const double angle = 4.0 * kDegree * share(random);
    const RigidTransform gold = subject.moved(randomTwist(random, angle, 12.0 * share(random)), start);
    const RigidTransform rest = subject.moved(randomTwist(random, what.rest_degrees * kDegree, what.rest_mm), gold);
    std::vector<cv::Mat> images;
    for (std::size_t d = 0; d < exposures.setup.detectors.size(); ++d)
    {
      cv::Mat soft, bone, counts;
      anatomy.materials(exposures.setup.detectors[d],
                        what.target == "c6" ? BodyPoses{ rest, gold } : BodyPoses{ gold, rest }, soft, bone);
      formation.form(soft, bone, static_cast<int>(d), n, counts);
      images.push_back(counts);
    }
    exposures.images.push_back(images);
    exposures.room_from_patient.push_back(gold);
    progress(n + 1, count);
  }
  return subject;
}

/// Draws the CT's axial and sagittal slice through the target's centre, the mask's weight in red, the box in yellow.
void drawMask(const Subject& subject, const TargetMask& mask, const std::string& path)
{
  constexpr double kPixel = 0.5;  // [mm]
  constexpr int kEdge = 280;
  const Eigen::Affine3d ct_index = subject.ct.grid.patient_from_index.inverse();
  const Eigen::Affine3d mask_index = mask.grid.patient_from_index.inverse();
  const auto voxel = [](const VolumeGrid& grid, const Eigen::Vector3d& index)
  {
    const Eigen::Vector3i nearest = index.array().round().cast<int>();
    const bool inside = nearest.minCoeff() >= 0 && (nearest.array() < grid.size.array()).all();
    return inside ? static_cast<std::ptrdiff_t>(grid.offset(nearest.x(), nearest.y(), nearest.z())) : -1;
  };
  cv::Mat picture(kEdge, 2 * kEdge, CV_8UC3);
  for (int row = 0; row < kEdge; ++row)
  {
    for (int column = 0; column < 2 * kEdge; ++column)
    {
      const double across = kPixel * (column % kEdge - kEdge / 2);
      const double down = kPixel * (row - kEdge / 2);
      const Eigen::Vector3d point = subject.box().center() + (column < kEdge ? Eigen::Vector3d(across, down, 0.0)
                                                                             : Eigen::Vector3d(0.0, across, -down));
      const std::ptrdiff_t in_ct = voxel(subject.ct.grid, ct_index * point);
      const std::ptrdiff_t in_mask = voxel(mask.grid, mask_index * point);
      const double grey = in_ct < 0 ? 0.0 : std::clamp((subject.ct.hu[in_ct] + 300.0) / 1200.0, 0.0, 1.0);
      const double weight = in_mask < 0 ? 0.0 : mask.values[in_mask];
      Eigen::AlignedBox3d inner = subject.box();
      inner.min().array() += kPixel;
      inner.max().array() -= kPixel;
      const bool edge = subject.box().contains(point) && !inner.contains(point);
      picture.at<cv::Vec3b>(row, column) =
          edge ? cv::Vec3b(0, 220, 220)
               : cv::Vec3b(cv::saturate_cast<std::uint8_t>(255.0 * grey * (1.0 - 0.6 * weight)),
                           cv::saturate_cast<std::uint8_t>(255.0 * grey * (1.0 - 0.6 * weight)),
                           cv::saturate_cast<std::uint8_t>(255.0 * (grey + 0.35 * weight * (1.0 - grey))));
    }
  }
  if (!cv::imwrite(path, picture))
  {
    throw std::runtime_error("cannot write " + path);
  }
}

/// One registration.
struct Outcome
{
  double start_error;
  double error;
  bool believed;
  double wall_ms;
  double cpu_ms;
};

double cpuMilliseconds()
{
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  return 1e3 * (usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         1e-3 * (usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}

/// Registers exposures in turn from number `first` on, each from a start that is off by a twist of its own.
std::vector<Outcome> registerAll(const Subject& subject, const Registration& registration,
                                 const std::vector<Twist>& starts, std::size_t first, const std::string& what)
{
  std::vector<Outcome> outcomes;
  Progress progress(what);
  for (std::size_t n = 0; n < starts.size(); ++n)
  {
    const std::size_t index = (first + n) % subject.exposures.images.size();
    const RigidTransform& gold = subject.exposures.room_from_patient[index];
    RegistrationRequest request;
    for (std::size_t d = 0; d < subject.exposures.setup.detectors.size(); ++d)
    {
      request.views.push_back({ subject.exposures.setup.detectors[d], subject.exposures.images[index][d] });
    }
    request.intensity = subject.exposures.setup.intensity;
    request.room_from_patient = subject.moved(starts[n], gold);
    request.time_budget = std::chrono::minutes(5);  // how long it takes is what is measured
    const double cpu = cpuMilliseconds();
    const RegistrationResult result = registration.run(request);
    if (result.status == RegistrationStatus::INVALID)
    {
      throw std::runtime_error("exposure " + std::to_string(index) + ": " + result.reason);
    }
    outcomes.push_back({ targetRegistrationError(request.room_from_patient, gold, subject.box()),
                         targetRegistrationError(result.room_from_patient, gold, subject.box()),
                         result.status == RegistrationStatus::SUCCESS, 1e3 * result.duration.count(),
                         cpuMilliseconds() - cpu });
    progress(n + 1, starts.size());
  }
  return outcomes;
}

void addFigures(FigureTable& table, const std::vector<Outcome>& outcomes)
{
  std::vector<double> errors, successes, wall, cpu;
  int within = 0, believed = 0, falsely = 0;
  for (const Outcome& outcome : outcomes)
  {
    errors.push_back(outcome.error);
    wall.push_back(outcome.wall_ms);
    cpu.push_back(outcome.cpu_ms);
    within += outcome.error < 1.0;
    believed += outcome.believed;
    falsely += outcome.believed && outcome.error > kFalseSuccess;
    if (outcome.error < kSuccess)
    {
      successes.push_back(outcome.error);
    }
  }
  const double count = static_cast<double>(outcomes.size());
  table.add("starts", count, 0);
  table.add("success %", 100.0 * successes.size() / count, 1);
  table.add("mean TRE of successes",
            successes.empty() ? std::numeric_limits<double>::quiet_NaN() : cv::mean(successes)[0]);
  table.add("TRE median", quantile(errors, 0.5));
  table.add("p95", quantile(errors, 0.95));
  table.add("max", quantile(errors, 1.0));
  table.add("< 1 mm %", 100.0 * within / count, 1);
  table.add("believed %", 100.0 * believed / count, 1);
  table.add("believed > 1.5 mm", falsely, 0);
  table.add("wall ms", quantile(wall, 0.5), 1);
  table.add("wall p95", quantile(wall, 0.95), 1);
  table.add("CPU ms", quantile(cpu, 0.5), 1);
  table.add("CPU p95", quantile(cpu, 0.95), 1);
}

/// Starts whose root mean square distance over the target's box lies in [low, high], turned by 0 to `max_angle` as far
/// as that allows. About the box's centre, rotation and translation add as squares.
std::vector<Twist> startsOfBand(const Subject& subject, double low, double high, double max_angle, int count,
                                std::mt19937& random)
{
  std::uniform_real_distribution<double> share;
  std::vector<Twist> starts;
  while (static_cast<int>(starts.size()) < count)
  {
    const double distance = low + (high - low) * share(random);
    const double angle = max_angle * share(random);
    Twist twist = randomTwist(random, angle, 0.0);
    const RigidTransform identity = RigidTransform::Identity();
    const double turned = targetRegistrationError(subject.moved(twist, identity), identity, subject.box());
    if (turned <= distance)
    {
      twist.tail<3>() = std::sqrt(distance * distance - turned * turned) * randomDirection(random);
      starts.push_back(twist);
    }
  }
  return starts;
}

FigureTable measureCaptureRange(const Subject& subject, const Registration& registration, int count)
{
  constexpr double kMaxDistance = 16.0;
  constexpr double kMaxAngle = 10.0 * kDegree;
  constexpr int kBands = static_cast<int>(kMaxDistance / kBandWidth);
  std::mt19937 random(1);
  FigureTable table("starts of 0 to 16 mm and 0 to 10 degrees, success below 2 mm");
  std::vector<Outcome> all;
  double capture_range = 0.0;
  bool captured = true;
  for (int band = 0; band < kBands; ++band)
  {
    const double low = band * kBandWidth;
    const std::string name =
        std::to_string(static_cast<int>(low)) + " to " + std::to_string(static_cast<int>(low + kBandWidth)) + " mm";
    const std::vector<Outcome> outcomes =
        registerAll(subject, registration,
                    startsOfBand(subject, low, low + kBandWidth, kMaxAngle, (count + kBands - 1) / kBands, random),
                    all.size(), name);
    table.beginRow();
    table.add("start", name);
    addFigures(table, outcomes);
    const auto successes = std::count_if(outcomes.begin(), outcomes.end(),
                                         [](const Outcome& outcome) { return outcome.error < kSuccess; });
    captured = captured && successes >= 0.95 * static_cast<double>(outcomes.size());
    capture_range = captured ? low + kBandWidth : capture_range;
    all.insert(all.end(), outcomes.begin(), outcomes.end());
  }
  table.beginRow();
  table.add("start", std::string("all"));
  addFigures(table, all);
  table.add("capture range 95 % [mm]", capture_range, 0);
  return table;
}

FigureTable measureRefinement(const Subject& subject, const Registration& registration, int count)
{
  FigureTable table("starts of one size");
  std::mt19937 random(2);
  for (const auto& [millimetres, degrees] : { std::pair(2, 1), std::pair(5, 3), std::pair(10, 5) })
  {
    std::vector<Twist> starts;
    for (int n = 0; n < count; ++n)
    {
      starts.push_back(randomTwist(random, degrees * kDegree, millimetres));
    }
    const std::string name = std::to_string(millimetres) + " mm, " + std::to_string(degrees) + " degrees";
    table.beginRow();
    table.add("start", name);
    addFigures(table, registerAll(subject, registration, starts, 0, name));
  }
  return table;
}

Optimiser optimiserNamed(const std::string& name)
{
  if (name == "gauss_newton")
  {
    return Optimiser::GAUSS_NEWTON;
  }
  if (name == "bobyqa")
  {
    return Optimiser::BOBYQA;
  }
  if (name == "nelder_mead")
  {
    return Optimiser::NELDER_MEAD;
  }
  throw std::invalid_argument("optimiser is " + name + ", expected gauss_newton, bobyqa or nelder_mead");
}

Projector projectorNamed(const std::string& name)
{
  if (name == "shear_warp")
  {
    return Projector::SHEAR_WARP;
  }
  if (name == "ray_casting")
  {
    return Projector::RAY_CASTING;
  }
  if (name == "attenuation_field")
  {
    return Projector::ATTENUATION_FIELD;
  }
  throw std::invalid_argument("projector is " + name + ", expected shear_warp, ray_casting or attenuation_field");
}

int benchmarkRegistration(const po::variables_map& arguments)
{
  constexpr int kPhantomExposures = 25;
  const int starts = arguments["starts"].as<int>();
  const int bodies = arguments["bodies"].as<int>();
  requireAtLeast("starts", starts, 8);
  if (bodies != 1 && bodies != 2)
  {
    throw std::invalid_argument("bodies is " + std::to_string(bodies) + ", expected 1 or 2");
  }
  const bool phantom = arguments.count("phantom") != 0;
  if (phantom == (arguments.count("SEQUENCE_DIR") != 0))
  {
    throw std::invalid_argument("expected either SEQUENCE_DIR or --phantom");
  }
  RegistrationOptions options;
  options.optimiser = optimiserNamed(arguments["optimiser"].as<std::string>());
  options.similarity = arguments["similarity"].as<std::string>();
  options.projector = projectorNamed(arguments["projector"].as<std::string>());
  const PhantomCase phantom_case{ arguments["target"].as<std::string>(), arguments["room"].as<std::string>(),
                                  arguments["voxel"].as<double>(), arguments["rest_mm"].as<double>(),
                                  arguments["rest_degrees"].as<double>() };
  if (!(phantom_case.voxel >= 0.5 && phantom_case.voxel <= 4.0))
  {
    throw std::invalid_argument("voxel is " + std::to_string(phantom_case.voxel) + ", expected 0.5 to 4 mm");
  }
  Subject subject = phantom ? phantomSubject(kPhantomExposures, phantom_case)
                            : sequenceSubject(arguments["SEQUENCE_DIR"].as<std::string>());
  if (arguments.count("mask_picture") != 0)
  {
    drawMask(subject, targetMaskFromBone(subject.ct, subject.box()), arguments["mask_picture"].as<std::string>());
  }
  const Registration registration(
      bodies == 1 ? oneBody(subject.ct) : splitBodies(subject.ct, targetMaskFromBone(subject.ct, subject.box())),
      subject.box(), options);
  subject.ct = CtVolume();
  std::cout << subject.name << ", " << subject.exposures.images.size() << " exposures, " << bodies
            << (bodies == 1 ? " body" : " bodies") << "; errors in mm\n";
  std::vector<FigureTable> tables{ measureRefinement(subject, registration, starts / 2),
                                   measureCaptureRange(subject, registration, starts) };
  if (options.projector == Projector::ATTENUATION_FIELD)
  {
    const AttenuationField::Statistics statistics = registration.fieldStatistics();
    tables.emplace_back("attenuation field");
    tables.back().beginRow();
    tables.back().add("lookups", static_cast<double>(statistics.lookups), 0);
    tables.back().add("hits %", 100.0 * static_cast<double>(statistics.hits) / statistics.lookups, 1);
    tables.back().add("memory MB", 1e-6 * static_cast<double>(registration.memory()), 0);
  }
  report(tables, arguments.count("json") != 0 ? arguments["json"].as<std::string>() : "");
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage =
      "SEQUENCE_DIR | --phantom [--target c4] [--room cyberknife] [--voxel 1] [--rest_mm 4] [--rest_degrees 2]\n"
      "       [--bodies 2] [--starts 200] [--optimiser gauss_newton]\n"
      "       [--similarity gradient_correlation] [--projector shear_warp] [--mask_picture FILE] [--json FILE]";
  command_line.description =
      "Registers every exposure from wrong starts, as van de Kraats et al. (IEEE TMI 24(9), 2005): success by the "
      "start's\n"
      "distance, capture range, error and time; and from starts of 2 mm and 1 degree, 5 and 3, 10 and 5. X-rays are a\n"
      "sequence's, or closed-form ones of the neck phantom with scatter and noise, whose rest moves otherwise.";
  command_line.optional_arguments = { "SEQUENCE_DIR" };
  const xray_tracking::PhantomCase usual;
  command_line.options.add_options()("phantom", "the neck phantom instead of a sequence")(
      "target", po::value<std::string>()->default_value(usual.target), "the phantom's vertebra: c3, c4, c5 or c6")(
      "room", po::value<std::string>()->default_value(usual.room), "its detectors: cyberknife or orthogonal_linac")(
      "voxel", po::value<double>()->default_value(usual.voxel), "of its CT, in plane [mm]")(
      "rest_mm", po::value<double>()->default_value(usual.rest_mm), "how far its rest is from the CT's posture")(
      "rest_degrees", po::value<double>()->default_value(usual.rest_degrees), "the same")(
      "bodies", po::value<int>()->default_value(2), "1 or 2")("starts", po::value<int>()->default_value(200),
                                                              "spread over all distances, 8 or more")(
      "optimiser", po::value<std::string>()->default_value("gauss_newton"), "gauss_newton, bobyqa or nelder_mead")(
      "similarity", po::value<std::string>()->default_value("gradient_correlation"),
      "of the derivative-free optimisers")("projector", po::value<std::string>()->default_value("shear_warp"),
                                           "shear_warp, ray_casting or attenuation_field")(
      "mask_picture", po::value<std::string>(), "draws the target's mask to this image file")(
      "json", po::value<std::string>(), "writes the figures to this file");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::benchmarkRegistration);
}
