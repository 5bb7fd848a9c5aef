#include "xray_tracking_core/volume/data_folder.h"

#include <unistd.h>

#include <filesystem>
#include <string>

#include "test_helpers.h"

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;

const std::string kMetaImage =
    "ObjectType = Image\nNDims = 3\nDimSize = 2 2 2\nElementSpacing = 1 1 1\nElementType = MET_SHORT\nElementDataFile "
    "= ";
const std::string kNrrd =
    "NRRD0004\ntype: short\ndimension: 3\nsizes: 2 2 2\nspacings: 1 1 1\nendian: little\nencoding: raw\n";

class DataFolderTest : public testing::Test
{
protected:
  void SetUp() override
  {
    for (const char* const name : { "data/series", "elsewhere/series" })
    {
      fs::create_directories(folder_.path(name));
      folder_.write(std::string(name) + "/1.dcm", "slice");
    }
    folder_.write("data/ct.nrrd", kNrrd + "\n");
    folder_.write("elsewhere/ct.nrrd", kNrrd + "\n");
  }

  void expectRefusedPath(const std::string& path, const std::string& reason = "leads out of the data folder") const
  {
    SCOPED_TRACE(path);
    expectError<std::runtime_error>([&] { ctBelow(path, data_); }, { reason });
  }

  TemporaryFolder folder_;
  std::string data_ = folder_.path("data");
};

TEST_F(DataFolderTest, WhatIsBelowIsTaken)
{
  const std::string expected = fs::canonical(folder_.path("data/ct.nrrd")).string();
  EXPECT_EQ(ctBelow(folder_.path("data/ct.nrrd"), data_), expected);
  EXPECT_EQ(ctBelow("ct.nrrd", data_), expected);
  EXPECT_EQ(ctBelow("series/../ct.nrrd", data_ + "/"), expected);
  EXPECT_EQ(ctBelow("series", data_), fs::canonical(folder_.path("data/series")).string());
  // Links within the folder, and to the folder, are ways like any other.
  fs::create_symlink("ct.nrrd", folder_.path("data/link.nrrd"));
  fs::create_directory_symlink(data_, folder_.path("link"));
  EXPECT_EQ(ctBelow("link.nrrd", data_), expected);
  EXPECT_EQ(ctBelow(folder_.path("link/ct.nrrd"), data_), expected);
  EXPECT_EQ(ctBelow("ct.nrrd", folder_.path("link")), expected);
}

TEST_F(DataFolderTest, WaysOutAreRefused)
{
  for (const std::string& path :
       { folder_.path("elsewhere/ct.nrrd"), std::string("../elsewhere/ct.nrrd"),
         std::string("series/../../elsewhere/series"), std::string(".."), std::string("/"), std::string("/etc/passwd"),
         data_ + "2", data_ + "/../elsewhere", std::string("ct.nrrd") + '\0' + "/../../elsewhere/ct.nrrd" })
  {
    expectRefusedPath(path);
  }
  // Whether it is there or not, the words are the same.
  expectRefusedPath("/nowhere/at/all");
  expectRefusedPath("nowhere.nrrd", "no such file or folder");
  expectRefusedPath(std::string(5000, 'x'), "name too long");
}

TEST_F(DataFolderTest, LinksOutAreRefused)
{
  fs::create_symlink(folder_.path("elsewhere/ct.nrrd"), folder_.path("data/out.nrrd"));
  fs::create_directory_symlink(folder_.path("elsewhere/series"), folder_.path("data/out"));
  fs::create_directory_symlink("..", folder_.path("data/up"));
  for (const char* const path : { "out.nrrd", "out", "up/elsewhere/ct.nrrd", "up/data/up/elsewhere/series" })
  {
    expectRefusedPath(path);
  }
  // One slice of a series.
  fs::create_symlink(folder_.path("elsewhere/series/1.dcm"), folder_.path("data/series/2.dcm"));
  expectRefusedPath("series", "its file series/2.dcm leads out");
}

TEST_F(DataFolderTest, VoxelsElsewhereAreRefused)
{
  folder_.write("elsewhere/ct.raw", std::string(16, '\0'));
  folder_.write("data/ct.raw", std::string(16, '\0'));
  for (const std::string& data : { folder_.path("elsewhere/ct.raw"), std::string("../elsewhere/ct.raw") })
  {
    for (const char* const field : { "data file: ", "datafile: ", "Data File: " })
    {
      folder_.write("data/ct.nhdr", kNrrd + field + data + "\n");
      expectRefusedPath("ct.nhdr");
    }
    for (const char* const name : { "ct.mhd", "ct.mha" })
    {
      folder_.write(std::string("data/") + name, kMetaImage + data + "\n");
      expectRefusedPath(name);
    }
  }
  folder_.write("data/ct.nhdr", kNrrd + "data file: ct.raw\n");
  folder_.write("data/ct.mhd", kMetaImage + "ct.raw\n");
  EXPECT_NO_THROW(ctBelow("ct.nhdr", data_));
  EXPECT_NO_THROW(ctBelow("ct.mhd", data_));
  fs::remove(folder_.path("data/ct.raw"));
  fs::create_symlink(folder_.path("elsewhere/ct.raw"), folder_.path("data/ct.raw"));
  expectRefusedPath("ct.nhdr");
  expectRefusedPath("ct.mhd");
  // Whose files cannot be told without reading as ITK does.
  folder_.write("data/ct.nhdr", kNrrd + "data file: LIST\nct.raw\n");
  expectRefusedPath("ct.nhdr", "expected one file");
  folder_.write("data/ct.mhd", kMetaImage + "slice%03d.raw 1 2 1\n");
  expectRefusedPath("ct.mhd", "expected one file");
  folder_.write("data/ct.mhd", "NDims = 3\n\nElementDataFile = " + folder_.path("elsewhere/ct.raw") + "\n");
  expectRefusedPath("ct.mhd", "expected one file");
  // Of NIfTI the other half of a pair.
  folder_.write("data/pair.hdr", std::string(348, '\0'));
  fs::create_symlink(folder_.path("elsewhere/ct.raw"), folder_.path("data/pair.img"));
  expectRefusedPath("pair.hdr");
}

TEST_F(DataFolderTest, WithoutTheFolderNothingIsRead)
{
  expectError<std::runtime_error>([&] { ctBelow("ct.nrrd", folder_.path("nowhere")); },
                                  { "ct.nrrd", "cannot be read" });
}

TEST_F(DataFolderTest, TheUsualFolder)
{
  TreatmentSetup setup;
  const std::string data = fs::canonical(data_).string();
  setup.ct_path = folder_.path("data/ct.nrrd");
  EXPECT_EQ(usualDataFolder(setup, "/nowhere/setup.yaml"), data);
  setup.ct_path = folder_.path("data/series");
  EXPECT_EQ(usualDataFolder(setup, "/nowhere/setup.yaml"), data) << "other series lie beside a series' folder";
  setup.ct_path.clear();
  EXPECT_EQ(usualDataFolder(setup, folder_.path("data/ct.nrrd")), data);
  expectError<std::runtime_error>([&] { usualDataFolder(setup, "/etc"); }, { "/etc", "parameter data_folder" });
  expectError<std::runtime_error>([&] { usualDataFolder(setup, "/nowhere.yaml"); },
                                  { "/nowhere.yaml", "No such file" });
}
}  // namespace
}  // namespace xray_tracking
