#include <algorithm>
#include <filesystem>
#include <iostream>

#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/recording.h"
#include "xray_tracking_tools/sequence_bag.h"
#include "xray_tracking_tools/tracking_record.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
/// Name of a folder or file without its extension, also where the path ends in a slash.
std::string baseName(const std::string& path)
{
  return std::filesystem::canonical(path).stem().string();
}

void keepFirstFrames(Evaluation& evaluation, std::size_t frames)
{
  evaluation.stamps_ns.resize(std::min(frames, evaluation.stamps_ns.size()));
  evaluation.gold_standard.resize(std::min(frames, evaluation.gold_standard.size()));
  for (MethodResult& method : evaluation.methods)
  {
    method.frames.resize(std::min(frames, method.frames.size()));
  }
}

int evaluateBag(const po::variables_map& arguments)
{
  const std::string bag_path = arguments["BAG"].as<std::string>();
  TrackingRecord record;
  Evaluation evaluation;
  if (arguments.count("sequence") != 0)
  {
    const std::string folder = arguments["sequence"].as<std::string>();
    const Sequence sequence = loadSequence(folder);
    record = readTrackingRecord(bag_path, kPlaybackEpochNs);
    evaluation = evaluateRecord(record, baseName(folder), sequence);
  }
  else
  {
    const std::string setup_path = arguments.count("setup") != 0 ? arguments["setup"].as<std::string>() : "";
    const TreatmentSetup setup = Recording(bag_path).setup(setup_path);
    record = readTrackingRecord(bag_path, 0);
    evaluation = evaluateRecord(record, baseName(setup_path.empty() ? bag_path : setup_path), setup.target_box);
  }
  std::vector<std::string> problems;
  if (arguments.count("frames") != 0)
  {
    const int frames = arguments["frames"].as<int>();
    requireAtLeast("--frames", frames, 1);
    const std::size_t found = evaluation.stamps_ns.size();
    if (found < static_cast<std::size_t>(frames))
    {
      problems.push_back(std::to_string(found) + " exposures were found, expected " + std::to_string(frames));
    }
    keepFirstFrames(evaluation, frames);
  }
  if (arguments.count("name") != 0)
  {
    evaluation.sequence = arguments["name"].as<std::string>();
  }
  evaluation.gate = gateCounts(evaluation, record);
  writeEvaluation(evaluation, arguments["OUT_DIR"].as<std::string>());
  std::cout << formatTable(evaluation) << std::flush;

  for (const std::string& problem : problems)
  {
    std::cerr << problem << "\n";
  }
  for (const std::string& unanswered : unansweredExposures(evaluation, record))
  {
    std::cerr << unanswered << "\n";
  }
  const bool verified = evaluation.gate->verified > 0;
  if (!verified)
  {
    std::cerr << "nothing was verified, the poses may all be wrong: "
              << (record.unverified.empty() ? "the bag has no beam_gate" : record.unverified) << "\n";
  }
  // By what was published.
  const std::vector<FrameResult>& answers = evaluation.methods.front().frames;
  const bool all_answered = std::all_of(answers.begin(), answers.end(),
                                        [](const FrameResult& frame) { return frame.status == FrameStatus::OK; });
  return problems.empty() && all_answered && verified ? 0 : 1;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "BAG OUT_DIR [--setup SETUP.yaml] [--sequence DIR] [--frames N] [--name NAME]";
  command_line.description =
      "Compares the recorded patient poses with the gold standard; writes tre.csv, poses.csv and summary.json, prints\n"
      "the summary: of the poses that were published, by the run's method, and of what the registration said by "
      "itself.\n"
      "Exit status 0 only if every exposure has a pose, and the beam gate took that of some exposure for verified.";
  command_line.arguments = { "BAG", "OUT_DIR" };
  command_line.options.add_options()("setup", po::value<std::string>(),
                                     "setup file of a live run: the target box; default: the one in it")(
      "sequence", po::value<std::string>(), "the folder that was played: target box, exposures, gold standard")(
      "frames", po::value<int>(), "the first N exposures are judged, and there must be as many")(
      "name", po::value<std::string>(), "name of the sequence in the results");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::evaluateBag);
}
