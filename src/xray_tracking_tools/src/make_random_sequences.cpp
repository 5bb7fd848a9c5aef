#include <filesystem>
#include <optional>
#include <string>

#include "make_random_sequences/random_sequence.h"
#include "xray_tracking_tools/command_line.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
int makeRandomSequences(const po::variables_map& arguments)
{
  const int seed = arguments["seed"].as<int>();
  const int count = arguments["count"].as<int>();
  const int exposures = arguments["exposures"].as<int>();
  requireAtLeast("--seed", seed, 0);
  requireAtLeast("--count", count, 1);
  requireAtLeast("--exposures", exposures, 1);
  std::optional<Scans> scans;
  if (arguments.count("scans") != 0)
  {
    scans.emplace(arguments["scans"].as<std::string>());
  }
  const std::filesystem::path out = arguments["OUT_DIR"].as<std::string>();
  Progress progress("random sequences");
  for (int n = 0; n < count; ++n)
  {
    writeRandomSequence(out / ("random_" + std::to_string(seed + n)), static_cast<std::uint32_t>(seed + n),
                        scans ? &*scans : nullptr, exposures);
    progress(static_cast<std::size_t>(n) + 1, static_cast<std::size_t>(count));
  }
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "OUT_DIR [--seed 1] [--count 1] [--exposures 40] [--scans DIR]";
  command_line.description =
      "Makes sequence folders random_SEED, random_SEED+1, ... whose anatomy, CT, room, detectors, posture, motion and "
      "start hang\non the seed alone; scenario.json in each says what was drawn.";
  command_line.arguments = { "OUT_DIR" };
  command_line.options.add_options()("seed", po::value<int>()->default_value(1), "of the first one")(
      "count", po::value<int>()->default_value(1), "number of sequences")(
      "exposures", po::value<int>()->default_value(40), "of each")(
      "scans", po::value<std::string>(),
      "folder with thorax_ct, lumbar_pelvis_ct or rtstruct, of which a fourth of the sequences are then made");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::makeRandomSequences);
}
