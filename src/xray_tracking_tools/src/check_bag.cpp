#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/recording_check.h"

namespace po = boost::program_options;

int main(int argc, char** argv)
{
  using namespace xray_tracking;

  CommandLine command_line;
  command_line.usage = "BAG [--setup SETUP.yaml] [--json]";
  command_line.description =
      "Says what is wrong with a recording, a line each with what to do. A recording that was split is named by its "
      "first\npart, x_0.bag. Exit status: 0 nothing is, 1 warnings alone, 2 errors, or it could not be examined.";
  command_line.arguments = { "BAG" };
  command_line.failure = 2;
  command_line.options.add_options()("setup", po::value<std::string>()->default_value(""),
                                     "what it is compared with; default: the setup in the recording")(
      "json", "findings as JSON");
  return runCommand(argc, argv, command_line,
                    [](const po::variables_map& arguments)
                    {
                      const std::string path = arguments["BAG"].as<std::string>();
                      return tellFindings(checkBag(path, arguments["setup"].as<std::string>()), path,
                                          arguments.count("json") != 0);
                    });
}
