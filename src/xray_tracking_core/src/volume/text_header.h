#pragma once

#include <ios>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace xray_tracking
{
/// The fields of a NRRD's or MetaImage's header up to what ends it; without the spaces around them.
struct TextHeader
{
  std::map<std::string, std::string> fields;
  std::streamoff end = 0;  ///< where the header's last line ends [bytes]
};

/// Of a file that need not be one. @throws std::runtime_error naming the file if the header is longer than any is
TextHeader readNrrdHeader(const std::string& path);
TextHeader readMetaImageHeader(const std::string& path);

/// What the header of a NRRD says of a file with its voxels; empty if they follow the header.
std::string dataFileOf(const TextHeader& nrrd);

/// The file with a MetaImage's voxels, which need not be there; the header's own where they follow it, nothing where a
/// list or a pattern tells of many. @param path of the header
std::optional<std::string> metaImageDataFile(const TextHeader& header, const std::string& path);

/// All files that reading a CT opens: those of a folder, a header and its voxels', or the one file.
/// @throws std::runtime_error naming the path if it is not there, or if its voxels' files are told by a list or a
/// pattern
std::vector<std::string> filesOfCt(const std::string& path);
}  // namespace xray_tracking
