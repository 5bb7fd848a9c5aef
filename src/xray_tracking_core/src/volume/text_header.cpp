#include "text_header.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "ct_error.h"
#include "nifti_file.h"

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;
/// Lists of files are the longest.
constexpr std::size_t kLongestHeader = 1 << 20;
/// Of a folder: some series of some hundred slices.
constexpr std::size_t kMostFiles = 50000;

std::string lowerCase(std::string text)
{
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

TextHeader readTextHeader(const std::string& path, char separator, const std::string& last_field)
{
  const auto trimmed = [](const std::string& text)
  {
    const auto first = text.find_first_not_of(" \t\r");
    return first == std::string::npos ? "" : text.substr(first, text.find_last_not_of(" \t\r") - first + 1);
  };
  TextHeader header;
  std::string start(kLongestHeader, '\0');
  std::ifstream file(path, std::ios::binary);
  file.read(start.data(), static_cast<std::streamsize>(start.size()));
  start.resize(static_cast<std::size_t>(file.gcount()));
  std::istringstream text(start);
  bool ended = false;
  for (std::string line; !ended && std::getline(text, line);)
  {
    header.end = text.eof() ? static_cast<std::streamoff>(start.size()) : std::streamoff(text.tellg());
    ended = trimmed(line).empty();
    const std::size_t at = line.find(separator);
    if (at != std::string::npos && line[0] != '#')
    {
      const std::string key = trimmed(line.substr(0, at));
      header.fields[key] = trimmed(line.substr(at + 1));
      ended = ended || key == last_field;
    }
  }
  if (!ended && start.size() == kLongestHeader)
  {
    failCt(path, "its header has no end within " + std::to_string(kLongestHeader) + " bytes");
  }
  return header;
}

std::string startOf(const std::string& path)
{
  std::array<char, 4> start{};
  std::ifstream(path, std::ios::binary).read(start.data(), start.size());
  return std::string(start.data(), start.size());
}

/// @param data what a header names as the file with its voxels
bool areManyFiles(const std::string& data)
{
  return data.find('%') != std::string::npos || lowerCase(data).compare(0, 4, "list") == 0;
}

/// @param data as above
std::vector<std::string> withData(const std::string& path, const std::string& data)
{
  if (data.empty() || areManyFiles(data))
  {
    failCt(path, "its voxels are in '" + data + "': expected one file");
  }
  return { path, (fs::path(path).parent_path() / data).string() };
}
}  // namespace

TextHeader readNrrdHeader(const std::string& path)
{
  // The names of its fields are the same in capitals.
  TextHeader header = readTextHeader(path, ':', "");
  std::map<std::string, std::string> fields;
  for (auto& [key, value] : header.fields)
  {
    fields[lowerCase(key)] = std::move(value);
  }
  header.fields = std::move(fields);
  return header;
}

TextHeader readMetaImageHeader(const std::string& path)
{
  return readTextHeader(path, '=', "ElementDataFile");
}

std::string dataFileOf(const TextHeader& nrrd)
{
  for (const char* const name : { "data file", "datafile" })
  {
    if (const auto found = nrrd.fields.find(name); found != nrrd.fields.end())
    {
      return found->second;
    }
  }
  return "";
}

std::optional<std::string> metaImageDataFile(const TextHeader& header, const std::string& path)
{
  const auto found = header.fields.find("ElementDataFile");
  const std::string data = found == header.fields.end() ? "" : found->second;
  if (lowerCase(data) == "local")
  {
    return path;
  }
  return areManyFiles(data) ? std::nullopt : std::make_optional((fs::path(path).parent_path() / data).string());
}

std::vector<std::string> filesOfCt(const std::string& path)
{
  if (fs::is_directory(path))
  {
    std::vector<std::string> files;
    for (const auto& entry : fs::recursive_directory_iterator(path))
    {
      if (entry.is_regular_file())
      {
        files.push_back(entry.path().string());
      }
      if (files.size() > kMostFiles)
      {
        failCt(path, "has more than " + std::to_string(kMostFiles) + " files, expected the folder of a DICOM series");
      }
    }
    return files;
  }
  if (!fs::is_regular_file(path))
  {
    failCt(path, fs::exists(path) ? "neither a file nor a folder" : "no such file or folder");
  }
  if (startOf(path) == "NRRD")
  {
    const std::string data = dataFileOf(readNrrdHeader(path));
    return data.empty() ? std::vector<std::string>{ path } : withData(path, data);
  }
  const std::string extension = lowerCase(fs::path(path).extension().string());
  if (extension == ".mha" || extension == ".mhd")
  {
    const std::string data = readMetaImageHeader(path).fields["ElementDataFile"];
    return lowerCase(data) == "local" ? std::vector<std::string>{ path } : withData(path, data);
  }
  return niftiFiles(path);
}
}  // namespace xray_tracking
