#include "xray_tracking_core/volume/data_folder.h"

#include <algorithm>
#include <filesystem>

#include "ct_error.h"
#include "text_header.h"

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;

bool isBelow(const fs::path& path, const fs::path& folder)
{
  return std::mismatch(folder.begin(), folder.end(), path.begin(), path.end()).first == folder.end();
}
}  // namespace

std::string usualDataFolder(const TreatmentSetup& setup, const std::string& setup_file)
{
  const std::string file = setup.ct_path.empty() ? setup_file : setup.ct_path;
  std::error_code error;
  const fs::path folder = fs::canonical(file, error).parent_path();
  if (error || folder == folder.root_path())
  {
    failCt(file, error
                     ? error.message() + ": expected it in the data folder"
                     : std::string("expected it in a folder, which is the data folder, or the parameter data_folder"));
  }
  return folder.string();
}

std::string ctBelow(const std::string& path, const std::string& folder)
{
  try
  {
    const fs::path root = fs::canonical(folder);
    const auto require = [&](const fs::path& file, const std::string& what)
    {
      // The same words whether it is there or not: nobody learns what is elsewhere.
      if (file.native().find('\0') != std::string::npos || !isBelow(fs::weakly_canonical(file), root))
      {
        failCt(path.c_str(), what + "leads out of the data folder " + root.string() +
                                 ", expected a CT below it (parameter data_folder)");
      }
    };
    require(root / path, "");
    const fs::path wanted = fs::weakly_canonical(root / path);
    for (const std::string& file : filesOfCt(wanted.string()))
    {
      require(file, "its file " + fs::path(file).lexically_relative(wanted.parent_path()).string() + " ");
    }
    return wanted.string();
  }
  catch (const fs::filesystem_error& error)
  {
    failCt(path, "cannot be read: " + error.code().message());
  }
}
}  // namespace xray_tracking
