#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <functional>
#include <iostream>
#include <limits>
#include <memory>
#include <optional>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "evaluate_sequence/exposure_source.h"
#include "evaluate_sequence/method_record.h"
#include "evaluate_sequence/offline_run.h"
#include "evaluate_sequence/paper_registration.h"
#include "evaluate_sequence/processor_time.h"
#include "evaluate_sequence/run_description.h"
#include "evaluate_sequence/run_pictures.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_registration/registration.h"
#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/json_file.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
constexpr const char* kPaperTracking = "paper_tracking";
constexpr const char* kPaperRegistration = "paper_registration";
const std::vector<std::string> kMethods = { "tracking", "registration", "tracking_and_registration", kPaperTracking,
                                            kPaperRegistration };

/// Of which pictures are made: the first of them that was run.
const std::vector<std::string> kPictured = { "tracking_and_registration", "registration", "tracking",
                                             kPaperRegistration, kPaperTracking };

/// What a method made of an exposure.
struct Answer
{
  std::optional<RigidTransform> room_from_patient;
  ExposureRecord record;
};
using Method = std::function<Answer(std::int64_t stamp_ns, const std::vector<cv::Mat>& images)>;

/// `a,b` or `a b`, each of kMethods, none twice.
std::vector<std::string> methodsOf(const std::string& list)
{
  std::vector<std::string> methods;
  std::string spaced = list;
  std::replace(spaced.begin(), spaced.end(), ',', ' ');
  std::istringstream words(spaced);
  std::string known;
  for (const std::string& method : kMethods)
  {
    known += (known.empty() ? "" : ", ") + method;
  }
  for (std::string word; words >> word;)
  {
    if (std::find(kMethods.begin(), kMethods.end(), word) == kMethods.end() ||
        std::find(methods.begin(), methods.end(), word) != methods.end())
    {
      throw std::invalid_argument("--methods has '" + word + "', expected some of " + known + ", each once");
    }
    methods.push_back(word);
  }
  if (methods.empty())
  {
    throw std::invalid_argument("--methods is empty, expected some of " + known);
  }
  return methods;
}

bool needsCt(const std::string& method)
{
  return method != "tracking" && method != kPaperTracking;
}

ExposureSource sourceOf(const po::variables_map& arguments)
{
  const bool is_bag = arguments.count("bag") != 0;
  if (is_bag == (arguments.count("sequence") != 0))
  {
    throw std::invalid_argument("expected either --sequence or --bag");
  }
  if (!is_bag)
  {
    return sequenceSource(arguments["sequence"].as<std::string>());
  }
  return bagSource(arguments["bag"].as<std::string>(),
                   arguments.count("setup") != 0 ? arguments["setup"].as<std::string>() : "");
}

/// The CT's models, made when they are first needed.
class CtModels
{
public:
  explicit CtModels(const TreatmentSetup& setup) : setup_(setup) {}

  std::shared_ptr<const Registration> twoBodies()
  {
    if (!two_bodies_)
    {
      const BodyModel bodies = bodiesInCt(true);
      target_ = std::make_unique<const ShearWarpRenderer>(bodies.target);
      two_bodies_ = std::make_shared<const Registration>(bodies, setup_.target_box);
    }
    return two_bodies_;
  }
  BodyModel oneBody() { return bodiesInCt(false); }

  /// The target's DRRs; null if no method needed its bodies.
  const ShearWarpRenderer* target() const { return target_.get(); }

private:
  /// The CT is not kept: with the models made of it a large one would take more than a machine has.
  BodyModel bodiesInCt(bool two)
  {
    std::cerr << "reading " << setup_.ct_path << std::endl;
    const PatientCt ct = readPatientCt(setup_.ct_path, setup_.ct_content, setup_.ct_choice);
    return bodiesOf(ct, two ? std::optional<TargetMask>(targetMaskOf(ct, setup_.target_box)) : std::nullopt);
  }

  const TreatmentSetup& setup_;
  std::shared_ptr<const Registration> two_bodies_;
  std::unique_ptr<const ShearWarpRenderer> target_;
};

const char* nameOf(PoseSource source)
{
  return source == PoseSource::REGISTERED ? "registered" : source == PoseSource::TRACKED ? "tracked" : "none";
}

ExposureRecord recordOf(const MotionDecision& decision, const OfflineRun& run, bool registers)
{
  ExposureRecord record;
  const bool has_pose = decision.state == MotionState::OK;
  record.source = nameOf(decision.source);
  record.reason = !has_pose ? decision.reason : registers ? decision.not_registered : "";
  record.gate = gateReasonName(run.gate().reason());
  record.gate_text = run.gate().text();
  record.unverified = run.gate().verification().fault();
  if (decision.views > 0)
  {
    record.disagreement_px = decision.disagreement;
    record.chi_square = decision.chi_square;
    record.degrees_of_freedom = decision.degrees_of_freedom;
  }
  if (has_pose)
  {
    record.covariance = decision.pose_covariance;
  }
  record.views = run.lastViews();
  if (registers)
  {
    record.registration_cpu_s = run.registrationSeconds();
  }
  return record;
}

Method makeMethod(const std::string& name, const TreatmentSetup& setup, CtModels& models, int refine_every)
{
  if (name == kPaperRegistration)
  {
    const auto run = std::make_shared<PaperRegistration>(setup, models.oneBody());
    return [run](std::int64_t, const std::vector<cv::Mat>& images)
    {
      const double start = processorSeconds();
      Answer answer{ run->add(images), {} };
      answer.record.source = nameOf(answer.room_from_patient ? PoseSource::REGISTERED : PoseSource::NONE);
      answer.record.reason = answer.room_from_patient ? "" : "the registration found no pose";
      answer.record.registration_cpu_s = processorSeconds() - start;
      return answer;
    };
  }
  const bool paper = name == kPaperTracking;
  const PoseMethod method = paper ? PoseMethod::TRACKING : poseMethodFromName(name);
  const auto run =
      std::make_shared<OfflineRun>(setup, method, needsCt(name) ? models.twoBodies() : nullptr, refine_every, paper);
  return [run, method](std::int64_t stamp_ns, const std::vector<cv::Mat>& images)
  {
    const MotionDecision decision = run->add(stamp_ns, images);
    Answer answer{ std::nullopt, recordOf(decision, *run, method != PoseMethod::TRACKING) };
    if (decision.state == MotionState::OK)
    {
      answer.room_from_patient = decision.room_from_patient;
    }
    return answer;
  };
}

/// @param times whether the result has them, too
MethodResult runMethod(const std::string& name, const ExposureSource& source, CtModels& models, int refine_every,
                       bool times, RecordWriter& records, std::vector<std::string>& problems)
{
  MethodResult result;
  result.method = name;
  const Method method = makeMethod(name, source.setup, models, refine_every);
  bool verified = false;
  std::string doubt;
  Progress progress(name);
  for (std::size_t k = 0; k < source.stamps_ns.size(); ++k)
  {
    const std::vector<cv::Mat> images = source.images(k);
    const auto wall = std::chrono::steady_clock::now();
    const double cpu = processorSeconds();
    Answer answer = method(source.stamps_ns[k], images);
    answer.record.cpu_s = processorSeconds() - cpu;
    answer.record.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - wall).count();
    FrameResult frame;
    frame.cpu_s = times ? answer.record.cpu_s : std::numeric_limits<double>::quiet_NaN();
    frame.wall_s = times ? answer.record.wall_s : std::numeric_limits<double>::quiet_NaN();
    frame.status = answer.room_from_patient ? FrameStatus::OK : FrameStatus::LOST;
    frame.room_from_patient = answer.room_from_patient.value_or(RigidTransform::Identity());
    result.frames.push_back(frame);
    if (!answer.room_from_patient)
    {
      problems.push_back("frame " + std::to_string(k) + " of " + name + " lost: " + answer.record.reason);
    }
    verified = verified || answer.record.unverified.empty();
    doubt = answer.record.unverified;
    records.add(k, source.stamps_ns[k], name, answer.record);
    progress(k + 1, source.stamps_ns.size());
  }
  // Tracking alone verifies nothing, but beside a CT that can.
  if (!verified && (needsCt(name) || source.setup.ct_path.empty()))
  {
    problems.push_back("nothing was verified, the poses of " + name + " may all be wrong: " + doubt);
  }
  return result;
}

/// Writes report.html by the program of that name, which lies beside this one. @throws std::runtime_error if it fails
void writeReport(const std::string& folder)
{
  const std::string program = (std::filesystem::read_symlink("/proc/self/exe").parent_path() / "write_report").string();
  std::cout.flush();
  const pid_t child = fork();
  if (child == 0)
  {
    execl(program.c_str(), program.c_str(), folder.c_str(), static_cast<char*>(nullptr));
    std::cerr << program << ": " << std::strerror(errno) << std::endl;
    _exit(127);
  }
  int status = 0;
  if (child < 0 || waitpid(child, &status, 0) != child || status != 0)
  {
    throw std::runtime_error(folder + "/report.html was not written; all other results are there");
  }
}

int evaluateSequence(const po::variables_map& arguments)
{
  ExposureSource source = sourceOf(arguments);
  if (arguments.count("frames") != 0)
  {
    source.keepFirst(arguments["frames"].as<int>());
  }
  const int refine_every = arguments["refine_every"].as<int>();
  requireAtLeast("--refine_every", refine_every, 1);
  const bool has_ct = !source.setup.ct_path.empty();
  const std::vector<std::string> methods =
      methodsOf(arguments.count("methods") != 0 ? arguments["methods"].as<std::string>()
                : has_ct                        ? "tracking registration tracking_and_registration"
                                                : "tracking");
  for (const std::string& method : methods)
  {
    if (needsCt(method) && !has_ct)
    {
      throw std::invalid_argument("the setup has no ct, which the method " + method + " needs");
    }
  }
  Evaluation evaluation;
  evaluation.sequence = source.name;
  evaluation.stamps_ns = source.stamps_ns;
  evaluation.gold_standard = source.gold_standard;
  evaluation.target_box = source.setup.target_box;
  const std::string out = arguments["out"].as<std::string>();
  std::filesystem::create_directories(out);
  for (const char* name : { "run.json", "report.html" })
  {
    std::filesystem::remove(std::filesystem::path(out) / name);  // of an earlier run: the last that are written
  }
  std::vector<std::string> detectors;
  for (const ProjectionGeometry& detector : source.setup.detectors)
  {
    detectors.push_back(detector.name());
  }
  RecordWriter records(out, detectors);
  CtModels models(source.setup);
  std::vector<std::string> problems;
  for (const std::string& method : methods)
  {
    evaluation.methods.push_back(
        runMethod(method, source, models, refine_every, arguments.count("times") != 0, records, problems));
  }
  records.close();
  writeEvaluation(evaluation, out);
  writeGoldStandard(evaluation, out);
  nlohmann::json run = describeRun(source, methods);
  run["settings"]["registration asked every [exposures]"] = refine_every;
  const auto pictured = std::find_if(kPictured.begin(), kPictured.end(),
                                     [&methods](const std::string& method)
                                     { return std::find(methods.begin(), methods.end(), method) != methods.end(); });
  const auto shown = std::find(methods.begin(), methods.end(), *pictured) - methods.begin();
  run["pictures"] = drawPictures(source, evaluation.methods[static_cast<std::size_t>(shown)], models.target(), out);
  run["pictures_of"] = *pictured;
  writeJsonFile(out + "/run.json", run);
  if (arguments.count("no_report") == 0)
  {
    writeReport(out);
  }
  std::cout << formatTable(evaluation) << std::flush;
  for (const std::string& problem : problems)
  {
    std::cerr << problem << "\n";
  }
  return problems.empty() ? 0 : 1;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage =
      "--sequence DIR | --bag BAG [--setup SETUP.yaml] --out DIR [--methods LIST] [--frames N] "
      "[--refine_every 1] [--times] [--no_report]";
  command_line.description =
      "Runs methods over a sequence folder's or a bag's exposures without ROS, by the rules of the live graph and as\n"
      "fast as the machine goes, and judges them as evaluate_bag does: report.html, what it is made of, a table. The "
      "same\n"
      "exposures give the same files to the last bit, but for times.csv and the report. Exit status 0 only if every\n"
      "method has a pose of every exposure, and those that register had some verified (without a CT nothing can).";
  command_line.options.add_options()("sequence", po::value<std::string>(), "sequence folder")(
      "bag", po::value<std::string>(), "bag with image_raw and camera_info of every detector")(
      "setup", po::value<std::string>(), "of a bag: geometry, CT, initial pose, target box; default: the one in it")(
      "out", po::value<std::string>()->required(), "folder for the results")(
      "methods", po::value<std::string>(),
      "some of tracking, registration, tracking_and_registration, paper_tracking, paper_registration, with commas; "
      "default: the first three, without a CT the first")("frames", po::value<int>(), "the first N exposures alone")(
      "refine_every", po::value<int>()->default_value(1),
      "the registration is asked for every N-th exposure, as where it takes longer than an interval; those in between "
      "are tracked")("times", "tre.csv and summary.json have the times too, which differ from run to run")(
      "no_report", "of runs whose results are put together later: no report.html");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::evaluateSequence);
}
