#include <iostream>

#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/sequence_bag.h"

namespace po = boost::program_options;

int main(int argc, char** argv)
{
  using namespace xray_tracking;

  CommandLine command_line;
  command_line.usage = "SEQUENCE_DIR OUT.bag [--frames N]";
  command_line.description = "Turns a sequence folder into a bag of what a detector driver would have published.";
  command_line.arguments = { "SEQUENCE_DIR", "OUT.bag" };
  command_line.options.add_options()("frames", po::value<int>(), "only the first N exposures");
  return runCommand(argc, argv, command_line,
                    [](const po::variables_map& arguments)
                    {
                      Sequence sequence = loadSequence(arguments["SEQUENCE_DIR"].as<std::string>());
                      if (arguments.count("frames") != 0)
                      {
                        keepFirstExposures(sequence, arguments["frames"].as<int>());
                      }
                      writeSequenceBag(sequence, arguments["OUT.bag"].as<std::string>(), Progress("exposure"));
                      const std::vector<Exposure>& exposures = sequence.exposures;
                      std::cout << exposures.size() << " exposures, "
                                << 1e-9 * (exposures.back().stamp_ns - exposures.front().stamp_ns) << " s, detectors";
                      for (const ProjectionGeometry& detector : sequence.setup.detectors)
                      {
                        std::cout << ' ' << detector.name();
                      }
                      std::cout << std::endl;
                      return 0;
                    });
}
