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
#include <random>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <ros/master.h>
#include <boost/crc.hpp>

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;

/// The first line: this, the content, the token, and the CRC-32 of these and what follows, between tabulators.
constexpr const char* kMagic = "xray_tracking restart file";
constexpr std::size_t kLongestHeader = 1000;
/// No image is larger [bytes].
constexpr std::uintmax_t kLargest = std::uintmax_t{ 1 } << 30;

std::string checksum(const std::string& head, const std::string& bytes)
{
  boost::crc_32_type crc;
  crc.process_bytes(head.data(), head.size());
  crc.process_bytes(bytes.data(), bytes.size());
  return std::to_string(crc.checksum());
}

/// Empty without ROS_HOME and HOME. Of two graphs at one time each has its master.
std::string pathOf(const ros::NodeHandle& pnh)
{
  const auto variable = [](const char* name)
  {
    const char* value = std::getenv(name);
    return std::string(value == nullptr ? "" : value);
  };
  std::string folder = variable("ROS_HOME");
  if (folder.empty() && !variable("HOME").empty())
  {
    folder = variable("HOME") + "/.ros";
  }
  std::string name = pnh.getNamespace().substr(1);
  std::replace(name.begin(), name.end(), '/', '-');
  const std::string master = ros::master::getHost() + '-' + std::to_string(ros::master::getPort());
  return folder.empty() ? folder : folder + "/xray_tracking/restart/" + master + '/' + name;
}

std::string errorText(const std::string& path, const std::string& what)
{
  return path + ": " + what + ": " + std::strerror(errno);
}
}  // namespace

RestartFile::RestartFile(const ros::NodeHandle& pnh, const std::string& content)
  : RestartFile(pathOf(pnh), content, "", false)
{
  succeeds_ = pnh.getParam(kToken, token_);
  if (!succeeds_)
  {
    std::random_device random;
    token_ = std::to_string(random()) + "-" + std::to_string(random()) + "-" + std::to_string(random());
    pnh.setParam(kToken, token_);
    remove();
    removeOld(fs::path(path_).parent_path().parent_path().string());
  }
}

RestartFile::RestartFile(std::string path, std::string content, std::string token, bool succeeds)
  : path_(std::move(path)), content_(std::move(content)), token_(std::move(token)), succeeds_(succeeds)
{
}

std::string RestartFile::read() const
{
  const auto refuse = [&](const std::string& why) { throw std::runtime_error(path_ + " " + why); };
  // A pipe would be waited for, for ever.
  std::error_code error;
  if (!fs::is_regular_file(path_, error))
  {
    refuse("is no file, expected what the node kept for this case");
  }
  if (fs::file_size(path_) > kLargest)
  {
    refuse("has more than " + std::to_string(kLargest) + " bytes, expected a restart file");
  }
  std::ifstream file(path_, std::ios::binary);
  const std::string all{ std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>() };
  const std::size_t line_end = all.find('\n');
  if (!file || line_end > kLongestHeader)
  {
    refuse("cannot be read, or does not begin with a line, expected a restart file");
  }
  std::istringstream line(all.substr(0, line_end));
  std::string magic, content, token, crc;
  std::getline(line, magic, '\t');
  std::getline(line, content, '\t');
  std::getline(line, token, '\t');
  std::getline(line, crc);
  std::string bytes = all.substr(line_end + 1);
  const std::string expected = checksum(magic + '\t' + content + '\t' + token, bytes);
  if (magic != kMagic || crc != expected)
  {
    refuse("is damaged: its CRC-32 is " + expected + ", expected '" + crc + "'");
  }
  if (token != token_)
  {
    refuse("is of another launch");
  }
  if (content != content_)
  {
    refuse("has '" + content + "', expected '" + content_ + "'");
  }
  return bytes;
}

void RestartFile::write(const std::string& bytes) const
{
  try
  {
    replace(bytes);
  }
  catch (const std::runtime_error&)
  {
    // Needs no room on a disk that is full.
    if (::truncate(path_.c_str(), 0) != 0)
    {
      remove();
    }
    throw;
  }
}

void RestartFile::replace(const std::string& bytes) const
{
  if (path_.empty())
  {
    throw std::runtime_error("neither ROS_HOME nor HOME is set, expected a folder to keep a restart file in");
  }
  const std::string head = std::string(kMagic) + '\t' + content_ + '\t' + token_;
  const std::string all = head + '\t' + checksum(head, bytes) + '\n' + bytes;
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

void RestartFile::removeOld(const std::string& folder)
{
  const auto oldest = fs::file_time_type::clock::now() - kLife;
  std::error_code error;
  for (fs::recursive_directory_iterator entry(folder, error), end; entry != end; entry.increment(error))
  {
    if (entry->is_regular_file(error) && entry->last_write_time(error) < oldest && !error)
    {
      fs::remove(entry->path(), error);
    }
  }
}
}  // namespace xray_tracking
