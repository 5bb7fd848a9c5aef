#include "xray_tracking_tools/command_line.h"

#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <iostream>
#include <sstream>
#include <stdexcept>

namespace po = boost::program_options;

namespace xray_tracking
{
int runCommand(int argc, char** argv, const CommandLine& command_line,
               const std::function<int(const po::variables_map&)>& body)
{
  const std::string program = std::filesystem::path(argc > 0 ? argv[0] : "").filename().string();
  const std::string usage = "usage: " + program + " " + command_line.usage;
  try
  {
    po::options_description all;
    all.add(command_line.options);
    all.add_options()("help", "prints this text");
    std::vector<std::string> arguments = command_line.arguments;
    arguments.insert(arguments.end(), command_line.optional_arguments.begin(), command_line.optional_arguments.end());
    po::positional_options_description positional;
    for (const std::string& argument : arguments)
    {
      all.add_options()(argument.c_str(), po::value<std::string>());
      positional.add(argument.c_str(), 1);
    }
    // Without short options "-25.0" is a value.
    const int style = po::command_line_style::default_style ^ po::command_line_style::allow_short;
    po::variables_map values;
    po::store(po::command_line_parser(argc, argv).options(all).positional(positional).style(style).run(), values);
    if (values.count("help") != 0)
    {
      std::cout << usage << "\n" << command_line.description << "\n" << command_line.options;
      return 0;
    }
    po::notify(values);  // asks for what is required
    for (const std::string& argument : command_line.arguments)
    {
      if (values.count(argument) == 0)
      {
        throw std::invalid_argument(argument + " is missing; " + usage);
      }
    }
    return body(values);
  }
  catch (const std::exception& e)
  {
    std::cerr << program << ": " << e.what() << std::endl;
    return command_line.failure;
  }
}

void requireAtLeast(const std::string& option, double value, double least)
{
  if (!(value >= least))
  {
    std::ostringstream text;
    text << option << " is " << value << ", expected " << least << " or more";
    throw std::invalid_argument(text.str());
  }
}

void Progress::operator()(std::size_t done, std::size_t total)
{
  constexpr std::size_t kBar = 30;           // characters
  constexpr double kTerminalInterval = 0.1;  // [s]
  const bool terminal = isatty(STDERR_FILENO) != 0;
  const double now_s = std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
  if (done != total && now_s - last_s_ < (terminal ? kTerminalInterval : 1.0))
  {
    return;
  }
  last_s_ = now_s;
  if (!terminal)
  {
    std::cerr << what_ << " " << done << " / " << total << std::endl;
    return;
  }
  const std::size_t filled = total > 0 ? kBar * done / total : kBar;
  std::cerr << '\r' << what_ << " [" << std::string(filled, '#') << std::string(kBar - filled, '.') << "] " << done
            << " / " << total << (done == total ? "\n" : "") << std::flush;
}
}  // namespace xray_tracking
