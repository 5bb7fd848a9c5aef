#include "xray_tracking_conversions/restart_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <ros/param.h>
#include <boost/crc.hpp>

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;

/// The first line: this, the content, the run, the length of what follows [bytes] and its CRC-32, between tabulators.
constexpr const char* kMagic = "xray_tracking restart file";
constexpr std::size_t kLongestHeader = 1000;
/// No image is larger [bytes].
constexpr std::uintmax_t kLargest = std::uintmax_t{ 1 } << 30;

std::uint32_t crc32(const std::string& bytes)
{
  boost::crc_32_type crc;
  crc.process_bytes(bytes.data(), bytes.size());
  return crc.checksum();
}

std::string homeOfRos()
{
  if (const char* home = std::getenv("ROS_HOME"); home != nullptr && *home != '\0')
  {
    return home;
  }
  const char* home = std::getenv("HOME");
  if (home == nullptr || *home == '\0')
  {
    throw std::runtime_error("neither ROS_HOME nor HOME is set, expected a folder to keep a restart file in");
  }
  return std::string(home) + "/.ros";
}

std::string pathOf(const ros::NodeHandle& pnh)
{
  std::string name = pnh.getNamespace().substr(1);
  std::replace(name.begin(), name.end(), '/', '-');
  return homeOfRos() + "/xray_tracking/restart/" + name;
}

std::string runOfMaster()
{
  std::string run;
  if (!ros::param::get("/run_id", run) || run.empty())
  {
    throw std::runtime_error("the parameter /run_id is not set, expected the one that roscore and roslaunch set");
  }
  return run;
}

std::string errorText(const std::string& path, const std::string& what)
{
  return path + ": " + what + ": " + std::strerror(errno);
}
}  // namespace

RestartFile::RestartFile(const ros::NodeHandle& pnh, const std::string& content)
  : RestartFile(pathOf(pnh), content, runOfMaster())
{
}

RestartFile::RestartFile(std::string path, std::string content, std::string run)
  : path_(std::move(path)), content_(std::move(content)), run_(std::move(run))
{
  const auto in_a_line = [](char c) { return c >= ' '; };
  if (!std::all_of(run_.begin(), run_.end(), in_a_line) || run_.size() > kLongestHeader / 2)
  {
    throw std::runtime_error("the parameter /run_id is '" + run_ + "', expected a short line of text");
  }
}

std::optional<std::string> RestartFile::read() const
{
  std::error_code none;
  if (!fs::exists(path_, none))
  {
    return std::nullopt;
  }
  const auto refuse = [&](const std::string& why) { throw std::runtime_error(path_ + " " + why); };
  // A pipe would be waited for, for ever.
  if (!fs::is_regular_file(path_) || fs::file_size(path_) > kLargest)
  {
    refuse("is no file, or one of more than " + std::to_string(kLargest) + " bytes, expected a restart file");
  }
  std::ifstream file(path_, std::ios::binary);
  const std::string all{ std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>() };
  const std::size_t line_end = all.find('\n');
  if (!file || line_end > kLongestHeader)
  {
    refuse("cannot be read, or does not begin with a line, expected a restart file");
  }
  std::istringstream line(all.substr(0, line_end));
  std::string magic, content, run, length, crc;
  std::getline(line, magic, '\t');
  std::getline(line, content, '\t');
  std::getline(line, run, '\t');
  std::getline(line, length, '\t');
  std::getline(line, crc);
  if (magic != kMagic)
  {
    refuse("begins with '" + magic.substr(0, 60) + "', expected '" + kMagic + "'");
  }
  if (run != run_)
  {
    return std::nullopt;
  }
  if (content != content_)
  {
    refuse("has '" + content.substr(0, 60) + "', expected '" + content_ + "'");
  }
  std::string bytes = all.substr(line_end + 1);
  if (length != std::to_string(bytes.size()))
  {
    refuse("has " + std::to_string(bytes.size()) + " bytes, expected '" + length + "'");
  }
  if (crc != std::to_string(crc32(bytes)))
  {
    refuse("is damaged: its CRC-32 is " + std::to_string(crc32(bytes)) + ", expected '" + crc + "'");
  }
  return bytes;
}

void RestartFile::write(const std::string& bytes) const
{
  const std::string header = std::string(kMagic) + '\t' + content_ + '\t' + run_ + '\t' + std::to_string(bytes.size()) +
                             '\t' + std::to_string(crc32(bytes)) + '\n';
  std::error_code error;
  fs::create_directories(fs::path(path_).parent_path(), error);
  const std::string partial = path_ + ".partial";
  // Not a link that somebody has laid there.
  ::unlink(partial.c_str());
  const int file = ::open(partial.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, S_IRUSR | S_IWUSR);
  if (file < 0)
  {
    throw std::runtime_error(errorText(partial, "cannot be made"));
  }
  const std::string all = header + bytes;
  std::size_t written = 0;
  while (written < all.size())
  {
    const ssize_t count = ::write(file, all.data() + written, all.size() - written);
    if (count < 0 && errno == EINTR)
    {
      continue;
    }
    if (count <= 0)
    {
      const std::string why = errorText(partial, "cannot be written");
      ::close(file);
      ::unlink(partial.c_str());
      throw std::runtime_error(why);
    }
    written += static_cast<std::size_t>(count);
  }
  if (::close(file) != 0 || ::rename(partial.c_str(), path_.c_str()) != 0)
  {
    throw std::runtime_error(errorText(path_, "cannot be replaced"));
  }
}

void RestartFile::remove() const
{
  ::unlink(path_.c_str());
}
}  // namespace xray_tracking
