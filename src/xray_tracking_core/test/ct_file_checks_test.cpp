#include <sys/resource.h>
#include <sys/stat.h>

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>

#include "ct_samples.h"

namespace xray_tracking
{
namespace
{
class CtFileChecksTest : public testing::Test
{
protected:
  std::string path(const std::string& name) const { return folder_.path(name); }

  /// Writes the sample, then bytes of its file's header.
  template <typename Value>
  void writePatched(const std::string& name, std::streamoff offset, Value value) const
  {
    writeCtVolume(volume_, path(name));
    std::fstream file(path(name), std::ios::binary | std::ios::in | std::ios::out);
    file.seekp(offset);
    file.write(reinterpret_cast<const char*>(&value), sizeof(value));
  }

  /// A header written here, followed by the sample's values.
  void writeWithHeader(const std::string& name, const std::string& header) const
  {
    folder_.write(name, header + std::string(reinterpret_cast<const char*>(volume_.hu.data()), 2 * volume_.hu.size()));
  }

  TemporaryFolder folder_;
  CtVolume volume_ = sampled(Eigen::Matrix3d::Identity());
};

TEST_F(CtFileChecksTest, NiftiHeadersThatAreNotFinite)
{
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  for (const char* name : { "ct.nii", "ct.hdr" })
  {
    writePatched(name, 80, nan);
    expectRefused(path(name), { "pixdim", "not finite" });
    writePatched(name, 260, infinity);
    expectRefused(path(name), { "quatern", "not finite" });
    writePatched(name, 276, nan);
    expectRefused(path(name), { "qoffset", "not finite" });
    writePatched(name, 280, nan);
    expectRefused(path(name), { "srow", "not finite" });
    writePatched(name, 324, -infinity);
    expectRefused(path(name), { "srow", "not finite" });
  }
  writeCtVolume(volume_, path("ct.hdr"));
  expectObject(readCtVolume(path("ct.img")));
}

TEST_F(CtFileChecksTest, NiftiHeadersThatLeaveTheAxesOpen)
{
  writePatched("ct.nii", 252, std::int32_t{ 0 });
  expectRefused(path("ct.nii"), { "qform_code and sform_code are 0" });
  writePatched("ct.hdr", 344, std::int32_t{ 0 });
  expectRefused(path("ct.hdr"), { "Analyze" });
  writePatched("ct.nii", 123, char{ 3 });
  expectRefused(path("ct.nii"), { "is in um, expected mm" });
  writePatched("ct.nii", 123, char{ 0 });
  expectObject(readCtVolume(path("ct.nii")));
}

TEST_F(CtFileChecksTest, NiftiValuesStoredWithAnIntercept)
{
  for (std::int16_t& hu : volume_.hu)
  {
    hu = static_cast<std::int16_t>(hu + 1024);
  }
  writePatched("ct.nii", 116, -1024.0f);  // slope 1 stands before it
  expectObject(readCtVolume(path("ct.nii")));
  truncate(path("ct.nii"), 0.999);
  expectRefused(path("ct.nii"), { "truncated" });
}

TEST_F(CtFileChecksTest, NiftiOfMoreDimensions)
{
  const std::int16_t two_volumes[] = { 4, 50, 40, 18, 2 };
  std::uint64_t dimensions;
  std::memcpy(&dimensions, two_volumes, sizeof(dimensions));
  writePatched("ct.nii", 40, dimensions);
  std::fstream(path("ct.nii"), std::ios::binary | std::ios::in | std::ios::out).seekp(48).write("\2", 1);
  expectRefused(path("ct.nii"), { "4 dimensions, expected 3" });
}

TEST_F(CtFileChecksTest, OtherUnitsThanMillimetres)
{
  const std::string nrrd = "NRRD0004\ntype: short\ndimension: 3\nsizes: 50 40 36\nendian: little\nencoding: raw\n";
  const std::string directions =
      "space: left-posterior-superior\nspace directions: (1.5,0,0) (0,2,0) (0,0,2.5)\n"
      "space origin: (-24.75,-69,206.25)\n";
  for (const char* unit : { "\"mm\" \"mm\" \"mm\"", "\"millimeters\" \"millimeters\" \"millimeters\"" })
  {
    writeWithHeader("ct.nrrd", nrrd + directions + "space units: " + unit + "\n\n");
    expectObject(readCtVolume(path("ct.nrrd")));
  }
  writeWithHeader("ct.nrrd", nrrd + directions + "space units: \"mm\" \"mm\" \"cm\"\r\n\n");
  expectRefused(path("ct.nrrd"), { "space units", "cm", "expected \"mm\"" });
  writeWithHeader("ct.nrrd", nrrd + "spacings: 1.5 2 2.5\nunits: \"cm\" \"cm\" \"cm\"\n\n");
  expectRefused(path("ct.nrrd"), { "units", "cm", "expected \"mm\"" });
  writeWithHeader("ct.nrrd", nrrd + "spacings: 1.5 2 2.5\n\n");
  EXPECT_TRUE(readCtVolume(path("ct.nrrd")).grid.spacing().isApprox(Eigen::Vector3d(1.5, 2.0, 2.5)));
  writeWithHeader("ct.nrrd", nrrd + "\n");
  expectRefused(path("ct.nrrd"), { "neither space directions nor spacings" });

  const std::string meta =
      "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n"
      "Offset = -24.75 -69 206.25\nElementSpacing = 1.5 2 2.5\nDimSize = 50 40 36\n";
  const std::string end = "ElementType = MET_SHORT\nElementDataFile = LOCAL\n";
  writeWithHeader("ct.mha", meta + "DistanceUnits = mm\n" + end);
  expectObject(readCtVolume(path("ct.mha")));
  writeWithHeader("ct.mha", meta + "DistanceUnits = cm\n" + end);
  expectRefused(path("ct.mha"), { "DistanceUnits is cm", "expected mm" });
}

TEST_F(CtFileChecksTest, AxesThatHardlySpanSpace)
{
  volume_.grid.patient_from_index.linear().col(2) = Eigen::Vector3d(0.0, 2.5, 0.01);
  writeCtVolume(volume_, path("flat.nrrd"));
  expectRefused(path("flat.nrrd"), { "axes", "right angles" });
}

TEST_F(CtFileChecksTest, ScannersFillUpWhatTheyDidNotScan)
{
  for (const int padding : { -2000, -3024, -32768 })
  {
    std::fill(volume_.hu.begin(), volume_.hu.begin() + 50 * 40, static_cast<std::int16_t>(padding));
    writeCtVolume(volume_, path("ct.nrrd"));
    const CtVolume read = readCtVolume(path("ct.nrrd"));
    expectObject(read);
    EXPECT_EQ(read.hu.front(), padding);
  }
  // Such values are no air: stored with an offset that the file does not tell, the body's own air is at 24.
  for (std::size_t n = 50 * 40; n < volume_.hu.size(); ++n)
  {
    volume_.hu[n] = static_cast<std::int16_t>(volume_.hu[n] + 1024);
  }
  writeCtVolume(volume_, path("ct.nrrd"));
  expectRefused(path("ct.nrrd"), { "not Hounsfield units", "-32768", "air, near -1000" });
}

TEST_F(CtFileChecksTest, WhatIsNoVolumeFile)
{
  for (const char* name : { "text.nii", "text.nii.gz", "text.mha", "text.hdr" })
  {
    folder_.write(name, "a text that is longer than a header is long\n" + std::string(1000, 'x'));
    expectRefused(path(name), {});
  }
  ASSERT_EQ(mkfifo(path("pipe.nrrd").c_str(), 0600), 0);
  expectRefused(path("pipe.nrrd"), { "neither a file nor a folder" });
  std::filesystem::create_directory(path("empty"));
  expectRefused(path("empty"), { "no DICOM CT image" });
}

/// The most memory that this process has had [MB].
long mostMemory()
{
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_maxrss >> 10;
}

TEST_F(CtFileChecksTest, SizesThatAFileOnlyClaims)
{
  const long before = mostMemory();
  const std::string nrrd = "NRRD0004\ntype: double\ndimension: 3\nendian: little\nspacings: 1 1 1\n";
  const std::string meta = "ObjectType = Image\nNDims = 3\nElementSpacing = 1 1 1\nElementType = MET_DOUBLE\n";
  // Far too many; more than a number of voxels, of bytes or of an axis can be; as many as wrap around to 2 x 2 x 2.
  for (const char* const sizes :
       { "10000 10000 10000", "2000000000 2000000000 2000000000", "1 1 99999999999999999999999",
         "4294967298 4294967298 4294967298", "-2 -2 2", "2 2", "2 2 2 2", "nan 2 2", "" })
  {
    writeWithHeader("ct.nrrd", nrrd + "encoding: raw\nsizes: " + sizes + "\n\n");
    expectRefused(path("ct.nrrd"), { "dimension is 3, sizes " + std::string(sizes), "1073741824 voxels at most" });
    writeWithHeader("ct.mha", meta + "DimSize = " + sizes + "\nElementDataFile = LOCAL\n");
    expectRefused(path("ct.mha"), { "NDims is 3, DimSize " + std::string(sizes), "1073741824 voxels at most" });
  }
  // A number that is allowed, of a file that cannot hold it, compressed or not.
  for (const char* const encoding : { "raw", "gzip" })
  {
    writeWithHeader("ct.nrrd", nrrd + "encoding: " + encoding + "\nsizes: 1000 1000 1000\n\n");
    expectRefused(path("ct.nrrd"), { "truncated" });
  }
  for (const char* const compressed : { "False", "True" })
  {
    writeWithHeader("ct.mha",
                    meta + "CompressedData = " + compressed + "\nDimSize = 1000 1000 1000\nElementDataFile = LOCAL\n");
    expectRefused(path("ct.mha"), { "truncated" });
  }
  const std::int16_t largest[] = { 32767, 32767, 32767, 1 };  // of NIfTI, from its second dimension on
  std::uint64_t dimensions;
  std::memcpy(&dimensions, largest, sizeof(dimensions));
  writePatched("ct.nii", 42, dimensions);
  expectRefused(path("ct.nii"), { "32767 32767 32767 voxels", "1073741824 at most" });
  // More dimensions than ITK holds.
  writeWithHeader("ct.mha", "ObjectType = Image\nNDims = 400\nDimSize = 2 2 2\nElementDataFile = LOCAL\n");
  expectRefused(path("ct.mha"), { "NDims is 400" });
  // A header without end.
  folder_.write("ct.nrrd", "NRRD0004\n" + std::string(3 << 20, 'x'));
  expectRefused(path("ct.nrrd"), { "its header has no end" });
  EXPECT_LT(mostMemory() - before, 50) << "MB were taken for what is not there";
}

TEST_F(CtFileChecksTest, WithoutPermission)
{
  writeCtVolume(volume_, path("locked.nrrd"));
  std::filesystem::create_directory(path("locked"));
  std::filesystem::permissions(path("locked.nrrd"), std::filesystem::perms::none);
  std::filesystem::permissions(path("locked"), std::filesystem::perms::none);
  if (std::ifstream(path("locked.nrrd")))
  {
    GTEST_SKIP() << "this user may read everything";
  }
  expectRefused(path("locked.nrrd"), { "no permission" });
  expectRefused(path("locked"), { "Permission denied" });
  std::filesystem::permissions(path("locked"), std::filesystem::perms::owner_all);
}
}  // namespace
}  // namespace xray_tracking
