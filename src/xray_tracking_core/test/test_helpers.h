#pragma once

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace xray_tracking
{
/// A folder of its own for one test, gone afterwards.
class TemporaryFolder
{
public:
  TemporaryFolder()
  {
    std::string name = (std::filesystem::temp_directory_path() / "xray_tracking_XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr)
    {
      throw std::runtime_error("no temporary folder " + name);
    }
    path_ = name;
  }
  ~TemporaryFolder() { std::filesystem::remove_all(path_); }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  std::string path(const std::string& name = "") const { return (path_ / name).string(); }

  void write(const std::string& name, const std::string& content) const
  {
    std::ofstream(path_ / name, std::ios::binary) << content;
  }

private:
  std::filesystem::path path_;
};

/// Expects that `call` throws an Error whose message has every one of `parts`.
template <typename Error, typename Call>
void expectError(Call call, const std::vector<std::string>& parts)
{
  try
  {
    call();
    ADD_FAILURE() << "expected an error that names '" << parts.front() << "'";
  }
  catch (const Error& error)
  {
    for (const std::string& part : parts)
    {
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos)
          << "'" << part << "' is missing in: " << error.what();
    }
  }
}
}  // namespace xray_tracking
