#pragma once

#include <functional>
#include <string>
#include <vector>

#include <boost/program_options.hpp>

namespace xray_tracking
{
/// What a command of this package takes.
struct CommandLine
{
  std::string usage;                                    ///< after the program's name, e.g. "SEQUENCE_DIR OUT.bag [...]"
  std::string description;                              ///< one or two sentences
  std::vector<std::string> arguments;                   ///< names of the positional arguments, all required
  std::vector<std::string> optional_arguments;          ///< of those that may follow
  boost::program_options::options_description options;  ///< `--name` options; `--help` is added
};

/// The body of `main`: parses the command line (numbers may be negative, there are no short options), and runs `body`.
/// Whatever goes wrong becomes one line on stderr, "<program>: <what>", and exit status 1.
int runCommand(int argc, char** argv, const CommandLine& command_line,
               const std::function<int(const boost::program_options::variables_map&)>& body);

/// Refuses an option below its least value. @throws std::invalid_argument naming option, value and bound
void requireAtLeast(const std::string& option, double value, double least);

/// Progress of long work on stderr: on a terminal a bar, elsewhere lines `what` done / total, not more than one a
/// second, and always the last one.
class Progress
{
public:
  explicit Progress(std::string what) : what_(std::move(what)) {}
  void operator()(std::size_t done, std::size_t total);

private:
  std::string what_;
  double last_s_ = 0.0;
};
}  // namespace xray_tracking
