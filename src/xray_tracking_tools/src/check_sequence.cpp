#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/recording_check.h"

namespace po = boost::program_options;

int main(int argc, char** argv)
{
  using namespace xray_tracking;

  CommandLine command_line;
  command_line.usage = "SEQUENCE_DIR [--json]";
  command_line.description =
      "Says what is wrong with a sequence folder, a line each with what to do. Exit status: 0 nothing is, 1 warnings "
      "alone,\n2 errors, or it could not be examined.";
  command_line.arguments = { "SEQUENCE_DIR" };
  command_line.failure = 2;
  command_line.options.add_options()("json", "findings as JSON");
  return runCommand(argc, argv, command_line,
                    [](const po::variables_map& arguments)
                    {
                      const std::string folder = arguments["SEQUENCE_DIR"].as<std::string>();
                      return tellFindings(checkSequence(folder), folder, arguments.count("json") != 0);
                    });
}
