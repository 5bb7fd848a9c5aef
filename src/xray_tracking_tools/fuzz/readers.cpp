#include "readers.h"

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <typeinfo>

#include "reader_tools.h"

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;

/// A folder of this process, gone when it ends.
class Folder
{
public:
  Folder()
  {
    std::string name = (fs::temp_directory_path() / "xray_tracking_readers_XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr)
    {
      throw std::logic_error("no folder for temporary files");
    }
    path_ = name;
    for (const char* image : { "a_0.png", "a_1.png", "b_0.png", "b_1.png" })
    {
      std::ofstream(path_ + "/" + image);  // is only looked for
    }
  }
  ~Folder() { fs::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  const std::string& path() const { return path_; }

private:
  std::string path_;
};

}  // namespace

std::string expected_name;

const std::string& folder()
{
  static const Folder only;
  return only.path();
}

std::string writeFile(const std::string& name, const std::string& bytes)
{
  const std::string path = folder() + "/" + name;
  std::ofstream(path, std::ios::binary) << bytes;
  expected_name = path;
  return path;
}

std::string corpusFile(const std::string& name)
{
  std::ifstream file(std::string(FUZZ_FOLDER) + "/" + name, std::ios::binary);
  if (!file)
  {
    throw std::logic_error(name + " is missing");
  }
  return std::string(std::istreambuf_iterator<char>(file), {});
}

const TreatmentSetup& setup()
{
  static const TreatmentSetup only = treatmentSetupFromText(corpusFile("corpus/sequence/table.yaml"), "table.yaml");
  return only;
}

void require(bool holds, const char* what)
{
  if (!holds)
  {
    throw std::logic_error(std::string("read, but ") + what);
  }
}

const std::vector<Reader>& readers()
{
  static const std::vector<Reader> all = []
  {
    std::vector<Reader> readers = fileReaders();
    for (const auto& more : { messageReaders(), parameterReaders() })
    {
      readers.insert(readers.end(), more.begin(), more.end());
    }
    return readers;
  }();
  return all;
}

std::string refusalOf(const Reader& reader, const std::string& bytes)
{
  try
  {
    reader.read(bytes);
    return "";
  }
  catch (const std::exception& error)
  {
    const std::string message = error.what();
    // Those that derive from them are of libraries, which know nothing of the file.
    if (typeid(error) != typeid(std::runtime_error) && typeid(error) != typeid(std::invalid_argument))
    {
      throw std::logic_error(reader.name + " let through " + typeid(error).name() + ": " + message);
    }
    const bool of_option = message.compare(0, 2, "--") == 0;
    if (message.empty() || (!of_option && message.find(expected_name) == std::string::npos))
    {
      throw std::logic_error(reader.name + " names nothing: " + message);
    }
    return message;
  }
}
}  // namespace xray_tracking
