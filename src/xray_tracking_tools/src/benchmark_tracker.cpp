#include <chrono>
#include <cmath>
#include <cstdio>
#include <limits>

#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"
#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/exposure_set.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
constexpr int kTrainings = 3;
constexpr std::size_t kTrackedFrames = 400;

template <typename Call>
double secondsOf(Call call)
{
  const auto start = std::chrono::steady_clock::now();
  call();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

cv::Rect trackedRegion(const TreatmentSetup& setup, const ProjectionGeometry& detector)
{
  const auto region = setup.regions.find(detector.name());
  return region != setup.regions.end() ? region->second : projectedTargetRegion(setup, detector);
}

void benchmarkDetector(const ExposureSet& exposures, std::size_t d)
{
  const ProjectionGeometry& detector = exposures.setup.detectors[d];
  const cv::Rect region = trackedRegion(exposures.setup, detector);
  HyperplaneTracker tracker(HyperplaneTrackerOptions(), exposures.setup.intensity);

  std::vector<double> training_s;
  for (int i = 0; i < kTrainings; ++i)
  {
    training_s.push_back(secondsOf([&] { tracker.train(exposures.images[0][d], region); }));
  }

  const Eigen::Vector3d centre = exposures.setup.targetCentre();
  const std::size_t count = exposures.images.size();
  std::vector<double> tracking_s;
  double squares = 0.0;
  int found = 0, judged = 0;
  for (std::size_t k = 0; k < std::max(kTrackedFrames, count); ++k)
  {
    const std::size_t index = backAndForth(k, count);
    tracking_s.push_back(secondsOf([&] { tracker.track(exposures.images[index][d]); }));
    if (k == 0 || k >= count)  // errors are those of one pass after the training exposure
    {
      continue;
    }
    ++judged;
    if (tracker.result().status == TrackResult::Status::TRACKED)
    {
      ++found;
      if (!exposures.room_from_patient.empty())
      {
        const Eigen::Vector2d gold = detector.project(exposures.room_from_patient[index] * centre) -
                                     detector.project(exposures.room_from_patient[0] * centre);
        squares += (tracker.result().displacement - gold).squaredNorm();
      }
    }
  }
  const bool has_error = found > 0 && !exposures.room_from_patient.empty();
  std::printf("%-14s %4d x %-4d %12.1f %11.1f %11.1f %7d / %-4d %10.3f\n", detector.name().c_str(), region.width,
              region.height, 1e3 * quantile(training_s, 0.5), 1e6 * quantile(tracking_s, 0.5),
              1e6 * quantile(tracking_s, 0.99), judged - found, judged,
              has_error ? std::sqrt(squares / found) : std::numeric_limits<double>::quiet_NaN());
}

int benchmarkTracker(const po::variables_map& arguments)
{
  const bool phantom = arguments.count("phantom") != 0;
  if (phantom == (arguments.count("SEQUENCE_DIR") != 0))
  {
    throw std::invalid_argument("expected either SEQUENCE_DIR or --phantom");
  }
  const ExposureSet exposures =
      loadExposureSet(phantom ? coreConfigPath("phantom_neck.yaml") : arguments["SEQUENCE_DIR"].as<std::string>());
  std::printf("%d points, translation, to convergence; one thread\n", HyperplaneTrackerOptions().points);
  std::printf("detector       region px   training ms   median us      p99 us        lost    RMSE px\n");
  for (std::size_t d = 0; d < exposures.setup.detectors.size(); ++d)
  {
    benchmarkDetector(exposures, d);
  }
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "SEQUENCE_DIR | --phantom";
  command_line.description =
      "Time and error of the tracker with its default options in every view: training, one track() to convergence, "
      "and\n"
      "the RMS distance of its displacements from the projected gold standard's.";
  command_line.optional_arguments = { "SEQUENCE_DIR" };
  command_line.options.add_options()("phantom", "the neck phantom instead of a sequence");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::benchmarkTracker);
}
