#include <filesystem>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

#include <itkGDCMImageIO.h>
#include <itkMetaDataObject.h>

#include "ct_samples.h"
#include "shared_data.h"

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;

class DicomSeriesTest : public testing::Test
{
protected:
  /// Writes one k-slice as DICOM, stored with rescale slope 2 and intercept -1024.
  void writeSlice(const CtVolume& volume, int k, const std::string& name, const std::string& series = "1.2.3.4",
                  const std::string& modality = "CT", bool compressed = false) const
  {
    CtVolume slice;
    slice.grid = volume.grid;
    slice.grid.size.z() = 1;
    slice.grid.patient_from_index.translation() = volume.grid.patient_from_index * Eigen::Vector3d(0, 0, k);
    slice.hu.assign(volume.hu.begin() + volume.grid.offset(0, 0, k),
                    volume.hu.begin() + volume.grid.offset(0, 0, k + 1));
    const HuImage::Pointer image = itkImage(slice);
    const std::vector<std::pair<std::string, std::string>> tags{ { "0008|0016", "1.2.840.10008.5.1.4.1.1.2" },
                                                                 { "0008|0060", modality },
                                                                 { "0008|103e", "series " + series },
                                                                 { "0020|000e", series },
                                                                 { "0028|1052", "-1024" },
                                                                 { "0028|1053", "2" } };
    for (const auto& [tag, value] : tags)
    {
      itk::EncapsulateMetaData<std::string>(image->GetMetaDataDictionary(), tag, value);
    }
    const auto format = itk::GDCMImageIO::New();
    format->KeepOriginalUIDOn();
    writeByItk(image.GetPointer(), format.GetPointer(), folder_.path(name), compressed);
  }

  /// Writes a series whose order by name is not its order in space.
  void writeSeries(const CtVolume& volume, const std::string& series = "1.2.3.4") const
  {
    for (int k = 0; k < volume.grid.size.z(); ++k)
    {
      writeSlice(volume, k, sliceName(k, series), series);
    }
  }

  /// 36 slices and 7 have no common factor, so every slice has its own name.
  static std::string sliceName(int k, const std::string& series = "1.2.3.4")
  {
    return series + "_" + std::to_string(100 + k * 7 % 36) + ".dcm";
  }

  TemporaryFolder folder_;
};

TEST_F(DicomSeriesTest, EveryDirection)
{
  for (const Eigen::Matrix3d& direction : directions())
  {
    SCOPED_TRACE(testing::Message() << "direction\n" << direction);
    CtVolume volume = sampled(direction);
    writeSeries(volume);
    writeSlice(volume, 0, "rtstruct.dcm", "9.9", "RTSTRUCT");
    std::ofstream(folder_.path("README.txt")) << "not a DICOM file";
    const CtVolume read = readCtVolume(folder_.path());
    expectObject(read);
    if (direction.determinant() < 0)
    {
      // Slices are put in order along rows x columns, which makes the grid right-handed: k is turned round.
      volume.grid.patient_from_index.translation() = volume.grid.patient_from_index * Eigen::Vector3d(0, 0, 35);
      volume.grid.patient_from_index.linear().col(2) *= -1;
    }
    expectSameGrid(read.grid, volume.grid);
  }
}

TEST_F(DicomSeriesTest, TiltedGantryIsAShearedGrid)
{
  CtVolume volume = sampled(Eigen::Matrix3d::Identity());
  volume.grid.patient_from_index.linear().col(2).y() = 0.8;
  volume.hu = sampled(Eigen::Matrix3d::Identity()).hu;
  writeSeries(volume);
  expectSameGrid(readCtVolume(folder_.path()).grid, volume.grid);
  EXPECT_THROW(writeCtVolume(volume, folder_.path("sheared.nii")), std::runtime_error);
  writeCtVolume(volume, folder_.path("sheared.nrrd"));
  expectSameGrid(readCtVolume(folder_.path("sheared.nrrd")).grid, volume.grid);
}

TEST_F(DicomSeriesTest, Errors)
{
  const CtVolume volume = sampled(Eigen::Matrix3d::Identity());
  expectRefused(folder_.path(), { "no DICOM CT image" });
  writeSlice(volume, 0, "rtstruct.dcm", "9.9", "RTSTRUCT");
  expectRefused(folder_.path(), { "no DICOM CT image", "RTSTRUCT" });
  writeSlice(volume, 10, "one.dcm");
  expectRefused(folder_.path(), { "only one CT slice" });
  fs::remove(folder_.path("one.dcm"));

  writeSeries(volume);
  readCtVolume(folder_.path());

  // Slice 17 lies at z = 250 + (17 - 17.5) * 2.5 mm, its neighbours at 246.25 and 251.25 mm.
  fs::remove(folder_.path(sliceName(17)));
  expectRefused(folder_.path(), { "a slice is missing", sliceName(16), sliceName(18), "246.25", "251.25", "5 mm apart",
                                  "expected 2.5" });
  writeSlice(volume, 17, sliceName(17));

  fs::copy(folder_.path(sliceName(17)), folder_.path("twice.dcm"));
  expectRefused(folder_.path(), { "not evenly spaced", "twice.dcm", sliceName(17) });
  fs::remove(folder_.path("twice.dcm"));

  CtVolume narrow = volume;
  narrow.grid.size = { 40, 40, 36 };
  writeSlice(narrow, 17, sliceName(17));
  expectRefused(folder_.path(), { sliceName(17), "40 x 40", "50 x 40" });
  CtVolume moved = volume;
  moved.grid.patient_from_index.translation().x() += 3.0;
  writeSlice(moved, 17, sliceName(17));
  expectRefused(folder_.path(), { sliceName(17), "on the line of the other slices" });
  writeSlice(volume, 17, sliceName(17));
  readCtVolume(folder_.path());

  for (const double share : { 0.999, 0.9, 0.3 })
  {
    truncate(folder_.path(sliceName(17)), share);
    expectRefused(folder_.path(), { sliceName(17), "truncated" });
    writeSlice(volume, 17, sliceName(17));
  }
  writeSlice(volume, 17, sliceName(17), "1.2.3.4", "CT", true);
  EXPECT_EQ(readCtVolume(folder_.path()).hu, volume.hu);
  truncate(folder_.path(sliceName(17)), 0.9);
  expectRefused(folder_.path(), { sliceName(17) });
  writeSlice(volume, 17, sliceName(17));

  // At the end of the series: no gap tells of it.
  truncate(folder_.path(sliceName(35)), 0.0);
  expectRefused(folder_.path(), { sliceName(35), "not a readable DICOM file" });
  std::ofstream(folder_.path(sliceName(35))) << "no slice";
  expectRefused(folder_.path(), { sliceName(35), "not a readable DICOM file" });
  fs::rename(folder_.path(sliceName(35)), folder_.path("notes.txt"));
  EXPECT_EQ(readCtVolume(folder_.path()).grid.size.z(), 35);
  fs::remove(folder_.path("notes.txt"));
  writeSlice(volume, 35, sliceName(35));

  writeSeries(volume, "5.6.7");
  expectRefused(folder_.path(), { "2 CT series", "ct_series: '1.2.3.4'", "ct_series: '5.6.7'", "36 slices" });
}

TEST_F(DicomSeriesTest, MessagesHaveNoUid)
{
  const std::string one = "1.2.840.113619.2.55.3.2831868886.123.1111111111.467";
  const std::string other = "1.2.840.113619.2.55.3.2831868886.123.2222222222.468";
  const CtVolume volume = sampled(Eigen::Matrix3d::Identity());
  writeSeries(volume, one);
  writeSeries(volume, other);
  try
  {
    readCtVolume(folder_.path());
    ADD_FAILURE() << "two series";
  }
  catch (const std::runtime_error& error)
  {
    const std::string message = error.what();
    EXPECT_EQ(message.find("2831868886"), std::string::npos) << message;
    EXPECT_NE(message.find("ct_series: '...1111.467'  # 36 slices"), std::string::npos) << message;
    EXPECT_NE(message.find("ct_series: '...2222.468'"), std::string::npos) << message;
  }
  EXPECT_EQ(readCtVolume(folder_.path(), { "...1111.467" }).hu, volume.hu) << "as the list has it";
  EXPECT_EQ(readCtVolume(folder_.path(), { other }).hu, volume.hu) << "in full";
}

TEST_F(SharedDataTest, LibrariesSayNothing)
{
  // GDCM has 218 warnings of one of them, ITK others: what is wrong with a file is in the exception.
  for (const char* const ct : { "/thorax_ct", "/rtstruct/ct" })
  {
    testing::internal::CaptureStderr();
    testing::internal::CaptureStdout();
    readCtVolume(folder_ + ct);
    EXPECT_EQ(testing::internal::GetCapturedStderr() + testing::internal::GetCapturedStdout(), "") << ct;
  }
}

TEST_F(SharedDataTest, Thorax)
{
  const CtVolume ct = readCtVolume(folder_ + "/thorax_ct");
  EXPECT_EQ(ct.grid.size, Eigen::Vector3i(512, 512, 170));
  EXPECT_TRUE(ct.grid.spacing().isApprox(Eigen::Vector3d(0.78125, 0.78125, 1.0), 1e-6));
  const Eigen::Vector3d origin = ct.grid.patient_from_index.translation();
  EXPECT_TRUE(origin.isApprox(Eigen::Vector3d(-201.0, -59.0, -629.8), 1e-3)) << origin.transpose();
  EXPECT_GT(huAt(ct, { -1, 220, -553 }), 50) << "the middle of a vertebra, by the data's description";
  const Eigen::Vector3d bone = findBonyTarget(ct, 50.0);
  EXPECT_LT(std::abs(bone.x()), 30.0) << "the spine is near the middle, not " << bone.transpose();
  EXPECT_GT(bone.y(), 170.0) << "the spine is posterior, not at " << bone.transpose();
}

TEST_F(SharedDataTest, CtBesideStructureSet)
{
  // The folder holds an RT structure set, too.
  const CtVolume ct = readCtVolume(folder_ + "/rtstruct/ct");
  EXPECT_EQ(ct.grid.size, Eigen::Vector3i(204, 201, 60));
  EXPECT_TRUE(ct.grid.spacing().isApprox(Eigen::Vector3d(0.977, 0.977, 3.0), 1e-3)) << ct.grid.spacing().transpose();
}
}  // namespace
}  // namespace xray_tracking
