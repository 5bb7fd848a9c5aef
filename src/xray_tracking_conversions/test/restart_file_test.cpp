#include "xray_tracking_conversions/restart_file.h"

#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <random>
#include <stdexcept>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;

class RestartFileTest : public testing::Test
{
protected:
  RestartFileTest()
  {
    folder_ = fs::temp_directory_path() / ("restart_file_test_" + std::to_string(::getpid()));
    fs::create_directories(folder_);
    file = std::make_unique<RestartFile>((folder_ / "below" / "node").string(), "motion 1", "token", true);
  }
  ~RestartFileTest() override { fs::remove_all(folder_); }

  std::string raw() const
  {
    std::ifstream in(file->path(), std::ios::binary);
    return { std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>() };
  }
  void setRaw(const std::string& bytes) const { std::ofstream(file->path(), std::ios::binary) << bytes; }

  RestartFile other(const std::string& content, const std::string& token) const
  {
    return { file->path(), content, token, true };
  }

  fs::path folder_;
  std::unique_ptr<RestartFile> file;
};

TEST_F(RestartFileTest, GivesBackWhatWasWritten)
{
  EXPECT_THROW(file->read(), std::runtime_error) << "none is there";
  const std::string bytes("with\0zeros\tand\nlines", 20);
  for (const std::string& written : { bytes, std::string(), std::string(3000000, 'x') })
  {
    file->write(written);
    EXPECT_EQ(file->read(), written);
  }
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_ / "below"), fs::directory_iterator()), 1) << "partial files";
  file->remove();
  file->remove();
  EXPECT_THROW(file->read(), std::runtime_error);
}

TEST_F(RestartFileTest, IsForTheUsersEyesAlone)
{
  file->write("pixels");
  struct stat status;
  ASSERT_EQ(::stat(file->path().c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0600);
}

TEST_F(RestartFileTest, WhatIsOfAnotherLaunchKindOrVersionIsRefused)
{
  file->write("pose");
  EXPECT_THROW(other("motion 1", "another token").read(), std::runtime_error);
  EXPECT_THROW(other("motion 2", "token").read(), std::runtime_error);
  EXPECT_THROW(other("template 1", "token").read(), std::runtime_error);
  EXPECT_EQ(other("motion 1", "token").read(), "pose");
}

/// Every bit of it counts: no single altered byte and no cut is taken for what was written.
TEST_F(RestartFileTest, DamageIsFound)
{
  file->write("the pose of the patient, 1.25 mm and so on");
  const std::string good = raw();
  std::mt19937 random(7);
  for (std::size_t i = 0; i < good.size(); ++i)
  {
    std::string bad = good;
    bad[i] = static_cast<char>(bad[i] ^ (1 + random() % 255));
    setRaw(bad);
    EXPECT_THROW(file->read(), std::runtime_error) << "byte " << i;
    setRaw(good.substr(0, i));
    EXPECT_THROW(file->read(), std::runtime_error) << "cut at " << i;
  }
  setRaw(good + "x");
  EXPECT_THROW(file->read(), std::runtime_error);
}

TEST_F(RestartFileTest, WhatIsNoFileIsRefused)
{
  file->write("");
  file->remove();
  fs::create_directory(file->path());
  EXPECT_THROW(file->read(), std::runtime_error);
  fs::remove(file->path());
  ASSERT_EQ(::mkfifo(file->path().c_str(), 0600), 0);
  EXPECT_THROW(file->read(), std::runtime_error);
}

TEST_F(RestartFileTest, WhereNothingCanBeWrittenItSaysSo)
{
  std::ofstream(folder_ / "in_the_way") << "x";
  const RestartFile blocked((folder_ / "in_the_way" / "node").string(), "motion 1", "token", true);
  try
  {
    blocked.write("pose");
    ADD_FAILURE();
  }
  catch (const std::runtime_error& error)
  {
    EXPECT_NE(std::string(error.what()).find("in_the_way"), std::string::npos) << error.what();
  }
  EXPECT_THROW(RestartFile("", "motion 1", "token", true).write("pose"), std::runtime_error);
}

/// What was true before is not any more.
TEST_F(RestartFileTest, AFailedWriteLeavesNothingOfBefore)
{
  file->write("not held");
  struct rlimit before;
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  const struct rlimit full = { 10, before.rlim_max };
  ::signal(SIGXFSZ, SIG_IGN);
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &full), 0);
  EXPECT_THROW(file->write("held"), std::runtime_error);
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &before), 0);
  EXPECT_THROW(file->read(), std::runtime_error);
  file->write("held");
  EXPECT_EQ(file->read(), "held");
}

/// Of launches that nothing has ended in order, and whose master has not been there again.
TEST_F(RestartFileTest, WhatIsOldGoes)
{
  file->write("new");
  const fs::path old = folder_ / "master" / "node";
  fs::create_directories(old.parent_path());
  std::ofstream(old) << "somebody's image";
  const auto now = fs::file_time_type::clock::now();
  fs::last_write_time(old, now - RestartFile::kLife + std::chrono::minutes(1));
  RestartFile::removeOld(folder_.string());
  EXPECT_TRUE(fs::exists(old));
  fs::last_write_time(old, now - RestartFile::kLife - std::chrono::minutes(1));
  RestartFile::removeOld(folder_.string());
  EXPECT_FALSE(fs::exists(old));
  EXPECT_EQ(file->read(), "new");
  RestartFile::removeOld((folder_ / "nowhere").string());
  RestartFile::removeOld("");
}
}  // namespace
}  // namespace xray_tracking
