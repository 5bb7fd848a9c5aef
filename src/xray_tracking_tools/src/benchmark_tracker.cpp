#include <array>
#include <iostream>
#include <set>

#include <nlohmann/json.hpp>

#include "benchmark_tracker/contestant.h"
#include "benchmark_tracker/follow.h"
#include "benchmark_tracker/scene_benchmark.h"
#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/exposure_set.h"
#include "xray_tracking_tools/json_file.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
KnownSequence knownSequence(const ExposureSet& exposures, std::size_t d)
{
  constexpr int kWindowMargin = 75;
  const TreatmentSetup& setup = exposures.setup;
  const ProjectionGeometry& detector = setup.detectors[d];
  const auto region = setup.regions.find(detector.name());
  KnownSequence sequence;
  sequence.view.intensity = setup.intensity;
  sequence.view.region = region != setup.regions.end() ? region->second : projectedTargetRegion(setup, detector);
  const cv::Point margin(kWindowMargin, kWindowMargin);
  sequence.view.window = cv::Rect(sequence.view.region.tl() - margin, sequence.view.region.br() + margin) &
                         cv::Rect(cv::Point(), exposures.images[0][d].size());
  const Eigen::Vector3d centre = setup.targetCentre();
  for (std::size_t k = 0; k < exposures.images.size(); ++k)
  {
    sequence.frames.push_back(makeFrame(exposures.images[k][d], sequence.view));
    sequence.displacements.push_back(detector.project(exposures.room_from_patient[k] * centre) -
                                     detector.project(exposures.room_from_patient[0] * centre));
  }
  return sequence;
}

constexpr std::array<MotionModel, 4> kModels{ MotionModel::TRANSLATION, MotionModel::EUCLIDEAN, MotionModel::SIMILARITY,
                                              MotionModel::AFFINE };

/// Of every model, those without one once.
Contestants makeAllContestants(const IntensityModel& intensity)
{
  Contestants all;
  std::set<std::string> names;
  for (const MotionModel model : kModels)
  {
    for (auto& contestant : makeContestants(model, intensity))
    {
      if (names.insert(contestant->name()).second)
      {
        all.push_back(std::move(contestant));
      }
    }
  }
  return all;
}

BenchmarkTable benchmarkExposures(const std::string& path)
{
  // What surrounds the target draws any 2D tracker away by pixels; beyond, it follows something else.
  constexpr double kLostError = 10.0;
  const ExposureSet exposures = loadExposureSet(path);
  if (exposures.room_from_patient.empty())
  {
    throw std::runtime_error(path + ": has no gold standard to judge by");
  }
  BenchmarkTable table;
  table.title = path + ", " + std::to_string(exposures.images.size() - 1) + " exposures, against the projected target";
  const Contestants contestants = makeAllContestants(exposures.setup.intensity);
  for (const auto& contestant : contestants)
  {
    table.rows.emplace_back(contestant->name(), std::vector<double>());
  }
  for (std::size_t d = 0; d < exposures.setup.detectors.size(); ++d)
  {
    const std::string& name = exposures.setup.detectors[d].name();
    table.columns.insert(table.columns.end(), { name + " us", name + " px", name + " lost" });
    const KnownSequence sequence = knownSequence(exposures, d);
    for (std::size_t i = 0; i < contestants.size(); ++i)
    {
      const FollowScore score = follow(*contestants[i], { sequence }, kLostError);
      std::vector<double>& row = table.rows[i].second;
      row.insert(row.end(), { score.median_us, score.rmse, static_cast<double>(score.lost) });
    }
  }
  return table;
}

int benchmarkTracker(const po::variables_map& arguments)
{
  cv::setNumThreads(1);
  std::vector<BenchmarkTable> tables;
  const auto report = [&tables](const BenchmarkTable& table)
  {
    printTable(std::cout, table);
    tables.push_back(table);
  };
  std::cout << "One thread; median processor time a frame; the others' frames are prepared for them before the clock "
               "starts."
            << std::endl;
  const std::string phantom = coreConfigPath("phantom_neck.yaml");
  const PlanarScene scene(phantom);
  for (const MotionModel model : kModels)
  {
    report(benchmarkModel(scene, model));
  }
  report(benchmarkConditions(scene));
  report(benchmarkExposures(phantom));
  if (arguments.count("sequences") != 0)
  {
    for (const std::string& path : arguments["sequences"].as<std::vector<std::string>>())
    {
      report(benchmarkExposures(path));
    }
  }
  if (arguments.count("json") != 0)
  {
    writeJsonFile(arguments["json"].as<std::string>(), toJson(tables));
  }
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "[--sequences DIR ...] [--json FILE]";
  command_line.description =
      "The tracker beside 2D registration of its template, OpenCV's and (if the build has it) ViSP's trackers: times,\n"
      "errors, lost exposures and capture ranges on a region of the neck phantom with exactly known motion, on the\n"
      "phantom's exposures and on sequences.";
  command_line.options.add_options()("sequences", po::value<std::vector<std::string>>()->multitoken(),
                                     "folders of sequences with a gold standard")("json", po::value<std::string>(),
                                                                                  "writes the figures to this file");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::benchmarkTracker);
}
