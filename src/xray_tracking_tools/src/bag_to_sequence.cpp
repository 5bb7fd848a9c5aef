#include <iostream>

#include "xray_tracking_tools/bag_sequence.h"
#include "xray_tracking_tools/command_line.h"

namespace po = boost::program_options;

int main(int argc, char** argv)
{
  using namespace xray_tracking;

  CommandLine command_line;
  command_line.usage = "BAG SEQUENCE_DIR [--setup SETUP.yaml]";
  command_line.description =
      "Turns a recording into a sequence folder, from which sequence_to_bag makes the same bag again. A recording that "
      "was\nsplit is named by its first part, x_0.bag.";
  command_line.arguments = { "BAG", "SEQUENCE_DIR" };
  command_line.options.add_options()("setup", po::value<std::string>()->default_value(""),
                                     "detectors, CT, initial pose, target box; default: the setup in the recording");
  return runCommand(argc, argv, command_line,
                    [](const po::variables_map& arguments)
                    {
                      const ExtractedSequence result = writeSequenceFolder(
                          Recording(arguments["BAG"].as<std::string>()), arguments["setup"].as<std::string>(),
                          arguments["SEQUENCE_DIR"].as<std::string>());
                      if (result.incomplete > 0)
                      {
                        std::cerr << "left out: " << result.incomplete
                                  << " exposures without an image of every detector (check_bag says more)\n";
                      }
                      std::cout << result.exposures << " exposures, " << (result.gold_standard ? "with" : "without")
                                << " gold standard" << std::endl;
                      return 0;
                    });
}
