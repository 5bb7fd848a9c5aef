#include "trial.h"

#include <sys/resource.h>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <stdexcept>

#include "starts.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_registration/usable_pixels.h"
#include "xray_tracking_tools/command_line.h"

namespace xray_tracking
{
namespace
{
constexpr double kNoRival = 100.0;  // the logarithm of such odds leaves no doubt

double cpuMilliseconds()
{
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  return 1e3 * (usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         1e-3 * (usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}
}  // namespace

RegistrationRequest requestFor(const ExposureSet& exposures, std::size_t index, const RigidTransform& start)
{
  RegistrationRequest request;
  for (std::size_t d = 0; d < exposures.setup.detectors.size(); ++d)
  {
    request.views.push_back({ exposures.setup.detectors[d], exposures.images[index][d] });
  }
  request.intensity = exposures.setup.intensity;
  request.room_from_patient = start;
  request.time_budget = std::chrono::minutes(5);  // how long it takes is what is measured
  return request;
}

Trial tryRegistration(const Registration& registration, RegistrationRequest request, const RigidTransform& gold,
                      const Eigen::AlignedBox3d& box)
{
  try
  {
    UsablePixels().apply(0, request);
  }
  catch (const std::invalid_argument& error)
  {
    throw std::runtime_error(error.what());
  }
  const double cpu = cpuMilliseconds();
  RegistrationResult result = registration.run(request);
  const double cpu_ms = cpuMilliseconds() - cpu;
  if (result.status == RegistrationStatus::INVALID)
  {
    throw std::runtime_error(result.reason);
  }
  const auto angle = [&](const RigidTransform& pose) { return rotationAngle(pose * gold.inverse()); };
  const double start_error = targetRegistrationError(request.room_from_patient, gold, box);
  const double error = targetRegistrationError(result.room_from_patient, gold, box);
  const double turned = angle(result.room_from_patient);
  return { "", "", start_error, angle(request.room_from_patient), error, turned, cpu_ms, std::move(result) };
}

std::vector<Trial> registerAll(const Subject& subject, const Registration& registration,
                               const std::vector<Twist>& starts, std::size_t first, const std::string& what)
{
  std::vector<Trial> trials;
  Progress progress(what);
  for (std::size_t n = 0; n < starts.size(); ++n)
  {
    const std::size_t index = (first + n) % subject.exposures.images.size();
    const RigidTransform& gold = subject.exposures.room_from_patient[index];
    try
    {
      trials.push_back(tryRegistration(
          registration, requestFor(subject.exposures, index, subject.moved(starts[n], gold)), gold, subject.box()));
    }
    catch (const std::runtime_error& error)
    {
      throw std::runtime_error("exposure " + std::to_string(index) + ": " + error.what());
    }
    trials.back().subject = subject.name;
    trials.back().kind = what;
    progress(n + 1, starts.size());
  }
  return trials;
}

void writeTrials(const std::vector<Trial>& trials, const std::string& path)
{
  std::ofstream file(path);
  file << "subject,kind,views,start_mm,start_deg,tre_mm,angle_deg,status,cpu_ms,probability,rival_odds,"
          "expected_error_mm,least_similarity,least_coarse_similarity,pull_mm,here,rival,distinctness,loss_aside\n";
  for (const Trial& trial : trials)
  {
    std::string subject = trial.subject;
    std::replace(subject.begin(), subject.end(), ',', ';');
    const RegistrationResult& result = trial.result;
    const BeliefFigures& figures = result.figures;
    double rival_odds = kNoRival;
    for (const Rival& rival : result.rivals)
    {
      rival_odds = std::min(rival_odds, rival.odds);
    }
    file << subject << ',' << trial.kind << ',' << result.views.size() << ',' << trial.start_error << ','
         << trial.start_angle / kDegree << ',' << trial.error << ',' << trial.angle / kDegree << ','
         << static_cast<int>(result.status) << ',' << trial.cpu_ms << ',' << result.probability << ',' << rival_odds
         << ',' << figures.expected_error_mm << ',' << figures.least_similarity << ','
         << figures.least_coarse_similarity << ',' << figures.pull_mm << ',' << figures.here << ',' << figures.rival
         << ',' << figures.distinctness << ',' << figures.loss_aside << '\n';
  }
  if (!file.flush())
  {
    throw std::runtime_error("cannot write " + path);
  }
}
}  // namespace xray_tracking
