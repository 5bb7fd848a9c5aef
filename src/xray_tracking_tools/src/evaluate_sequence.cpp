#include <algorithm>
#include <chrono>
#include <ctime>
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

#include "evaluate_sequence/exposure_source.h"
#include "evaluate_sequence/offline_run.h"
#include "evaluate_sequence/paper_registration.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_registration/registration.h"
#include "xray_tracking_tools/command_line.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
constexpr const char* kPaperTracking = "paper_tracking";
constexpr const char* kPaperRegistration = "paper_registration";
const std::vector<std::string> kMethods = { "tracking", "registration", "tracking_and_registration", kPaperTracking,
                                            kPaperRegistration };

/// What a method made of an exposure, and why there is no pose.
struct Answer
{
  std::optional<RigidTransform> room_from_patient;
  std::string reason;
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
      two_bodies_ = std::make_shared<const Registration>(bodiesOf(ct(), targetMaskOf(ct(), setup_.target_box)),
                                                         setup_.target_box);
    }
    return two_bodies_;
  }
  BodyModel oneBody() { return bodiesOf(ct(), std::nullopt); }

private:
  const PatientCt& ct()
  {
    if (!ct_)
    {
      std::cerr << "reading " << setup_.ct_path << std::endl;
      ct_ = readPatientCt(setup_.ct_path, setup_.ct_content);
    }
    return *ct_;
  }

  const TreatmentSetup& setup_;
  std::optional<PatientCt> ct_;
  std::shared_ptr<const Registration> two_bodies_;
};

Method makeMethod(const std::string& name, const TreatmentSetup& setup, CtModels& models)
{
  if (name == kPaperRegistration)
  {
    const auto run = std::make_shared<PaperRegistration>(setup, models.oneBody());
    return [run](std::int64_t, const std::vector<cv::Mat>& images) {
      return Answer{ run->add(images), "the registration found no pose" };
    };
  }
  const bool paper = name == kPaperTracking;
  const PoseMethod method = paper ? PoseMethod::TRACKING : poseMethodFromName(name);
  const auto run = std::make_shared<OfflineRun>(setup, method, needsCt(name) ? models.twoBodies() : nullptr, paper);
  return [run](std::int64_t stamp_ns, const std::vector<cv::Mat>& images)
  {
    const MotionDecision decision = run->add(stamp_ns, images);
    return decision.state == MotionState::OK ? Answer{ decision.room_from_patient, "" }
                                             : Answer{ std::nullopt, decision.reason };
  };
}

double processorSeconds()
{
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

/// @param times whether the result has them
MethodResult runMethod(const std::string& name, const ExposureSource& source, CtModels& models, bool times,
                       std::vector<std::string>& problems)
{
  MethodResult result;
  result.method = name;
  const Method method = makeMethod(name, source.setup, models);
  Progress progress(name);
  for (std::size_t k = 0; k < source.stamps_ns.size(); ++k)
  {
    const std::vector<cv::Mat> images = source.images(k);
    const auto wall = std::chrono::steady_clock::now();
    const double cpu = processorSeconds();
    const Answer answer = method(source.stamps_ns[k], images);
    FrameResult frame;
    frame.cpu_s = times ? processorSeconds() - cpu : std::numeric_limits<double>::quiet_NaN();
    frame.wall_s = times ? std::chrono::duration<double>(std::chrono::steady_clock::now() - wall).count()
                         : std::numeric_limits<double>::quiet_NaN();
    frame.status = answer.room_from_patient ? FrameStatus::OK : FrameStatus::LOST;
    frame.room_from_patient = answer.room_from_patient.value_or(RigidTransform::Identity());
    result.frames.push_back(frame);
    if (!answer.room_from_patient)
    {
      problems.push_back("frame " + std::to_string(k) + " of " + name + " lost: " + answer.reason);
    }
    progress(k + 1, source.stamps_ns.size());
  }
  return result;
}

int evaluateSequence(const po::variables_map& arguments)
{
  ExposureSource source = sourceOf(arguments);
  if (arguments.count("frames") != 0)
  {
    source.keepFirst(arguments["frames"].as<int>());
  }
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
  CtModels models(source.setup);
  std::vector<std::string> problems;
  for (const std::string& method : methods)
  {
    evaluation.methods.push_back(runMethod(method, source, models, arguments.count("times") != 0, problems));
  }
  writeEvaluation(evaluation, arguments["out"].as<std::string>());
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
      "--sequence DIR | --bag BAG [--setup SETUP.yaml] --out DIR [--methods LIST] [--frames N] [--times]";
  command_line.description =
      "Runs methods over a sequence folder's or a bag's exposures without ROS, by the rules of the live graph and as\n"
      "fast as the machine goes, and judges them as evaluate_bag does: tre.csv, poses.csv, summary.json, a table. The\n"
      "same exposures give the same files to the last bit. Exit status 0 only if every method has a pose of every "
      "exposure.";
  command_line.options.add_options()("sequence", po::value<std::string>(), "sequence folder")(
      "bag", po::value<std::string>(), "bag with image_raw and camera_info of every detector")(
      "setup", po::value<std::string>(), "of a bag: geometry, CT, initial pose, target box; default: the one in it")(
      "out", po::value<std::string>()->required(), "folder for the results")(
      "methods", po::value<std::string>(),
      "some of tracking, registration, tracking_and_registration, paper_tracking, paper_registration, with commas; "
      "default: the first three, without a CT the first")("frames", po::value<int>(), "the first N exposures alone")(
      "times", "the files have the times too, which differ from run to run");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::evaluateSequence);
}
