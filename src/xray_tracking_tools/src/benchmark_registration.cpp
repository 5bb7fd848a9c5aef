#include <iostream>
#include <optional>
#include <stdexcept>

#include "benchmark_registration/capture_range.h"
#include "benchmark_registration/mask_picture.h"
#include "benchmark_registration/random_trials.h"
#include "benchmark_registration/real_sequences.h"
#include "benchmark_registration/wide_starts.h"
#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_core/volume/target_mask.h"
#include "xray_tracking_tools/command_line.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
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
  throw std::invalid_argument("optimiser is " + name + ", expected gauss_newton or bobyqa");
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

std::string textOf(const po::variables_map& arguments, const std::string& option)
{
  return arguments.count(option) != 0 ? arguments[option].as<std::string>() : "";
}

PhantomCase phantomCase(const po::variables_map& arguments)
{
  const PhantomCase phantom_case{ arguments["target"].as<std::string>(), arguments["room"].as<std::string>(),
                                  arguments["voxel"].as<double>(), arguments["rest_mm"].as<double>(),
                                  arguments["rest_degrees"].as<double>() };
  if (!(phantom_case.voxel >= 0.5 && phantom_case.voxel <= 4.0))
  {
    throw std::invalid_argument("voxel is " + std::to_string(phantom_case.voxel) + ", expected 0.5 to 4 mm");
  }
  return phantom_case;
}

std::vector<FigureTable> measureSubject(Subject subject, const po::variables_map& arguments,
                                        const RegistrationOptions& options, std::vector<Trial>& trials)
{
  const int starts = arguments["starts"].as<int>();
  const int bodies = arguments["bodies"].as<int>();
  requireAtLeast("starts", starts, 8);
  if (bodies != 1 && bodies != 2)
  {
    throw std::invalid_argument("bodies is " + std::to_string(bodies) + ", expected 1 or 2");
  }
  if (const std::string picture = textOf(arguments, "mask_picture"); !picture.empty())
  {
    drawMask(subject, targetMaskOf(subject.ct, subject.box()), picture);
  }
  std::optional<TargetMask> mask;
  if (bodies == 2)
  {
    mask = targetMaskOf(subject.ct, subject.box());
  }
  const Registration registration(bodiesOf(subject.ct, mask), subject.box(), options);
  subject.ct = PatientCt();
  std::cout << subject.name << ", " << subject.exposures.images.size() << " exposures, " << bodies
            << (bodies == 1 ? " body" : " bodies") << "; errors in mm\n";
  if (arguments.count("wide") != 0)
  {
    return { measureWideStarts(subject, registration, starts, trials) };
  }
  std::vector<FigureTable> tables{ measureRefinement(subject, registration, starts / 2, trials),
                                   measureCaptureRange(subject, registration, starts, trials) };
  if (options.projector == Projector::ATTENUATION_FIELD)
  {
    const AttenuationField::Statistics statistics = registration.fieldStatistics();
    tables.emplace_back("attenuation field");
    tables.back().beginRow();
    tables.back().add("lookups", static_cast<double>(statistics.lookups), 0);
    tables.back().add("hits %", 100.0 * static_cast<double>(statistics.hits) / statistics.lookups, 1);
    tables.back().add("memory MB", 1e-6 * static_cast<double>(registration.memory()), 0);
  }
  return tables;
}

int benchmarkRegistration(const po::variables_map& arguments)
{
  constexpr int kPhantomExposures = 25;
  const bool phantom = arguments.count("phantom") != 0;
  const bool real = arguments.count("real") != 0;
  const bool random = arguments.count("random") != 0;
  if (phantom + real + random + (arguments.count("SEQUENCE_DIR") != 0) != 1)
  {
    throw std::invalid_argument("expected one of SEQUENCE_DIR, --phantom, --real and --random");
  }
  RegistrationOptions options;
  options.optimiser = optimiserNamed(arguments["optimiser"].as<std::string>());
  options.similarity = arguments["similarity"].as<std::string>();
  options.projector = projectorNamed(arguments["projector"].as<std::string>());
  std::vector<Trial> trials;
  std::vector<FigureTable> tables;
  if (real)
  {
    tables = measureRealSequences(arguments["real"].as<std::string>(), options, arguments["starts"].as<int>(), trials);
  }
  else if (random)
  {
    tables = measureRandomSubjects(arguments["random"].as<std::string>(), arguments["seed"].as<int>(),
                                   arguments["subjects"].as<int>(), trials);
  }
  else
  {
    tables = measureSubject(phantom ? phantomSubject(kPhantomExposures, phantomCase(arguments))
                                    : sequenceSubject(arguments["SEQUENCE_DIR"].as<std::string>()),
                            arguments, options, trials);
  }
  report(tables, textOf(arguments, "json"));
  if (const std::string csv = textOf(arguments, "csv"); !csv.empty())
  {
    writeTrials(trials, csv);
  }
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage =
      "SEQUENCE_DIR | --phantom [--target c4] [--room cyberknife] [--voxel 1] [--rest_mm 4] [--rest_degrees 2]\n"
      "       | --real DIR | --random DIR [--seed 1] [--subjects 20]\n"
      "       [--bodies 2] [--starts 200] [--optimiser gauss_newton] [--similarity gradient_correlation]\n"
      "       [--projector shear_warp] [--mask_picture FILE] [--json FILE] [--csv FILE]\n"
      "       [--wide]";
  command_line.description =
      "Registers exposures from wrong starts. A sequence's, or closed-form ones of the neck phantom whose rest moves\n"
      "otherwise, as van de Kraats et al. (IEEE TMI 24(9), 2005): success by the start's distance, capture range, "
      "error\n"
      "and time; and from starts of 2 mm and 1 degree, 5 and 3, 10 and 5. --real: all real sequences below a folder, "
      "by\n"
      "their references. --random: subjects of random anatomy, physics, room and posture, from right and from wrong\n"
      "starts, for which the belief in a result is learnt and judged.";
  command_line.optional_arguments = { "SEQUENCE_DIR" };
  const xray_tracking::PhantomCase usual;
  command_line.options.add_options()("phantom", "the neck phantom instead of a sequence")(
      "real", po::value<std::string>(), "folder with real sequences")(
      "random", po::value<std::string>(), "folder with thorax_ct, lumbar_pelvis_ct and rtstruct, those that are there")(
      "seed", po::value<int>()->default_value(1), "of the first random subject; the next has the next")(
      "subjects", po::value<int>()->default_value(20), "random ones")(
      "target", po::value<std::string>()->default_value(usual.target), "the phantom's vertebra: c3, c4, c5 or c6")(
      "room", po::value<std::string>()->default_value(usual.room), "its detectors: cyberknife or orthogonal_linac")(
      "voxel", po::value<double>()->default_value(usual.voxel), "of its CT, in plane [mm]")(
      "rest_mm", po::value<double>()->default_value(usual.rest_mm), "how far its rest is from the CT's posture")(
      "rest_degrees", po::value<double>()->default_value(usual.rest_degrees), "the same")(
      "bodies", po::value<int>()->default_value(2), "1 or 2")("starts", po::value<int>()->default_value(200),
                                                              "spread over all distances, 8 or more")(
      "optimiser", po::value<std::string>()->default_value("gauss_newton"), "gauss_newton or bobyqa")(
      "similarity", po::value<std::string>()->default_value("gradient_correlation"),
      "of the derivative-free optimisers")("projector", po::value<std::string>()->default_value("shear_warp"),
                                           "shear_warp, ray_casting or attenuation_field")(
      "wide",
      "of a sequence or the phantom, instead: wide searches from starts up to 25 mm and 10 degrees off along "
      "and about every axis")("mask_picture", po::value<std::string>(), "draws the target's mask to this image file")(
      "json", po::value<std::string>(), "writes the figures to this file")(
      "csv", po::value<std::string>(), "writes one row a registration to this file, for fit_belief.py");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::benchmarkRegistration);
}
