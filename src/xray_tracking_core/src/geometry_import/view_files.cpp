#include <algorithm>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <stdexcept>

#include "import_words.h"
#include "imported_view.h"

namespace xray_tracking
{
namespace
{
constexpr std::uintmax_t kMaxTextSize = 64U << 20U;

std::string readText(const std::string& path)
{
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error))
  {
    fail(path, "missing or not a file");
  }
  std::ifstream file(path, std::ios::binary);
  if (!file)
  {
    fail(path, "not readable");
  }
  std::string text(std::min<std::uintmax_t>(std::filesystem::file_size(path), kMaxTextSize), '\0');
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(file.gcount()));
  return text;
}
}  // namespace

std::vector<ImportedView> readViews(const std::string& path, const GeometryImportOptions& options)
{
  const std::string text = readText(path);
  if (text.size() > 132 && text.compare(128, 4, "DICM") == 0)
  {
    return readDicomGeometry(path, options);
  }
  const std::vector<TextLine> lines = linesOf(path, text);
  if (lines.empty())
  {
    fail(path, "is empty: expected MayaCam 2.0, 3 x 4 matrices, RTK's geometry, DICOM, or YAML with detectors");
  }
  const std::string& first = lines.front().text;
  if (first.front() == '<')
  {
    return readRtkGeometry(path, text, options);
  }
  const auto is_heading = [](const TextLine& line)
  {
    const char* const kHeadings[] = { "image size", "camera matrix", "rotation", "translation" };
    return std::any_of(std::begin(kHeadings), std::end(kHeadings),
                       [&](const char* heading)
                       {
                         const std::string wanted = heading;
                         return line.text.size() == wanted.size() &&
                                std::equal(wanted.begin(), wanted.end(), line.text.begin(),
                                           [](char a, char b) { return a == std::tolower(b); });
                       });
  };
  if (std::any_of(lines.begin(), lines.end(), is_heading))
  {
    return readMayaCam(path, text, options);
  }
  if (std::any_of(lines.begin(), lines.end(), [](const TextLine& line) { return line.text.find("detectors:") == 0; }))
  {
    return readDetectorList(path, options);
  }
  if (std::string("0123456789+-.[({#").find(first.front()) != std::string::npos)
  {
    return readMatrices(path, text, options);
  }
  fail(lines.front().where, quoted(first) +
                                ": expected MayaCam 2.0 (\"image size\"), 3 x 4 matrices, RTK's geometry (XML), DICOM "
                                "with its preamble, or YAML with detectors");
}

void refuseOptions(const std::string& path, const std::vector<std::pair<const char*, bool>>& given)
{
  for (const auto& [name, is_given] : given)
  {
    if (is_given)
    {
      throw std::invalid_argument(std::string(name) + ": " + path + " says it itself, or has no use for it");
    }
  }
}

Eigen::Vector2i imageSizeOf(const GeometryImportOptions& options, const std::string& path)
{
  if (!options.image_size)
  {
    throw std::invalid_argument(path + " has no image size: expected --image_size COLUMNS ROWS");
  }
  return *options.image_size;
}

Eigen::Vector2d pixelPitchOf(const GeometryImportOptions& options, const std::string& path)
{
  if (!options.pixel_pitch)
  {
    throw std::invalid_argument(path + " has no pixel pitch: expected --pitch MM");
  }
  return *options.pixel_pitch;
}
}  // namespace xray_tracking
