#include <algorithm>
#include <cstring>
#include <fstream>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include <itkMetaImageIO.h>
#include <itkNiftiImageIO.h>
#include <itkNrrdImageIO.h>

#include "ct_samples.h"
#include "shared_data.h"
#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
class CtVolumeTest : public testing::Test
{
protected:
  std::string path(const std::string& name) const { return folder_.path(name); }

  TemporaryFolder folder_;
};

TEST_F(CtVolumeTest, FilesByItkComeOutAsWritten)
{
  for (const Eigen::Matrix3d& direction : directions())
  {
    const CtVolume volume = sampled(direction);
    const HuImage::Pointer image = itkImage(volume);
    writeByItk(image.GetPointer(), itk::NrrdImageIO::New().GetPointer(), path("ct.nrrd"), true);
    writeByItk(image.GetPointer(), itk::MetaImageIO::New().GetPointer(), path("ct.mha"), true);
    writeByItk(image.GetPointer(), itk::MetaImageIO::New().GetPointer(), path("ct.mhd"));
    writeByItk(image.GetPointer(), itk::NiftiImageIO::New().GetPointer(), path("ct.nii.gz"));
    for (const char* name : { "ct.nrrd", "ct.mha", "ct.mhd", "ct.nii.gz" })
    {
      SCOPED_TRACE(testing::Message() << name << ", direction\n" << direction);
      const CtVolume read = readCtVolume(path(name));
      expectObject(read);
      expectSameGrid(read.grid, volume.grid);
      EXPECT_EQ(read.hu, volume.hu);
    }
  }
}

TEST_F(CtVolumeTest, WriteThenReadIsTheSame)
{
  for (const Eigen::Matrix3d& direction : directions())
  {
    const CtVolume volume = sampled(direction);
    for (const char* name : { "ct.nrrd", "ct.nhdr", "ct.mha", "ct.mhd", "ct.nii", "ct.nii.gz", "ct.hdr" })
    {
      SCOPED_TRACE(testing::Message() << name << ", direction\n" << direction);
      writeCtVolume(volume, path(name));
      const CtVolume read = readCtVolume(path(name));
      expectSameGrid(read.grid, volume.grid);
      EXPECT_EQ(read.hu, volume.hu);
    }
  }
  EXPECT_THROW(writeCtVolume(sampled(directions().front()), path("ct.jpg")), std::runtime_error);
  EXPECT_THROW(writeCtVolume(sampled(directions().front()), path("no_such_folder/ct.nrrd")), std::runtime_error);
}

TEST_F(CtVolumeTest, LabelsAreTakenAsTheyAre)
{
  CtVolume labels = sampled(directions().front());
  std::fill(labels.hu.begin(), labels.hu.end(), std::int16_t{ 0 });
  labels.hu[7] = 300;
  for (const char* name : { "labels.nrrd", "labels.nii.gz" })
  {
    writeCtVolume(labels, path(name));
    EXPECT_EQ(readLabelMap(path(name)).hu, labels.hu);
    expectRefused(path(name), { "not Hounsfield units" });
  }
  EXPECT_THROW(readLabelMap(path("no_such.nrrd")), std::runtime_error);
}

/// The headers are written here, not by ITK, so that its reader cannot agree with its own writer in a mistake.
TEST_F(CtVolumeTest, RasHeadersComeOutAsLps)
{
  const Eigen::Affine3d ras_from_lps(Eigen::DiagonalMatrix<double, 3>(-1, -1, 1));
  for (const Eigen::Matrix3d& direction : directions())
  {
    SCOPED_TRACE(testing::Message() << "direction\n" << direction);
    const CtVolume volume = sampled(direction);
    const Eigen::Affine3d ras_from_index = ras_from_lps * volume.grid.patient_from_index;
    const Eigen::IOFormat vector(Eigen::FullPrecision, Eigen::DontAlignCols, ",", ",", "", "", "(", ")");
    const char* values = reinterpret_cast<const char*>(volume.hu.data());
    const std::streamsize bytes = 2 * volume.hu.size();

    std::ofstream nrrd(path("ras.nrrd"), std::ios::binary);
    nrrd << "NRRD0004\ntype: short\ndimension: 3\nspace: right-anterior-superior\nsizes: "
         << volume.grid.size.transpose() << "\nspace directions:";
    for (int axis = 0; axis < 3; ++axis)
    {
      nrrd << ' ' << ras_from_index.linear().col(axis).transpose().format(vector);
    }
    nrrd << "\nspace origin: " << ras_from_index.translation().transpose().format(vector)
         << "\nendian: little\nencoding: raw\n\n";
    nrrd.write(values, bytes);
    nrrd.close();

    std::vector<char> header(352, 0);
    const auto put = [&](std::size_t offset, auto value) { std::memcpy(&header[offset], &value, sizeof(value)); };
    put(0, std::int32_t{ 348 });
    put(40, std::int16_t{ 3 });  // dim
    put(70, std::int16_t{ 4 });  // signed short
    put(72, std::int16_t{ 16 });
    put(76, 1.0f);  // pixdim
    for (int axis = 0; axis < 3; ++axis)
    {
      put(42 + 2 * axis, static_cast<std::int16_t>(volume.grid.size[axis]));
      put(80 + 4 * axis, static_cast<float>(volume.grid.spacing()[axis]));
      for (int column = 0; column < 4; ++column)
      {
        put(280 + 16 * axis + 4 * column, static_cast<float>(ras_from_index(axis, column)));  // srow
      }
    }
    for (const int unused_dimension : { 48, 50, 52, 54 })
    {
      put(unused_dimension, std::int16_t{ 1 });
    }
    put(108, 352.0f);             // offset of the voxels
    put(112, 1.0f);               // slope
    put(123, char{ 2 });          // mm
    put(254, std::int16_t{ 1 });  // sform: scanner
    std::memcpy(&header[344], "n+1", 4);
    std::ofstream nifti(path("ras.nii"), std::ios::binary);
    nifti.write(header.data(), header.size());
    nifti.write(values, bytes);
    nifti.close();

    for (const char* name : { "ras.nrrd", "ras.nii" })
    {
      SCOPED_TRACE(name);
      const CtVolume read = readCtVolume(path(name));
      expectObject(read);
      expectSameGrid(read.grid, volume.grid);
    }
  }
}

TEST_F(CtVolumeTest, MissingAndForeignFiles)
{
  expectRefused(path("none.nrrd"), { "no such file" });
  std::ofstream(path("text.nrrd")) << "not a volume";
  expectRefused(path("text.nrrd"), {});
  std::ofstream(path("text.csv")) << "1,2,3";
  expectRefused(path("text.csv"), { "NRRD, MetaImage or NIfTI" });
  std::ofstream(path("empty.mha")).close();
  expectRefused(path("empty.mha"), {});
}

TEST_F(CtVolumeTest, TruncatedFiles)
{
  // Noise, so that compressed files have to be read to their ends.
  CtVolume volume = sampled(Eigen::Matrix3d::Identity());
  std::minstd_rand noise(1);
  for (std::int16_t& hu : volume.hu)
  {
    hu = static_cast<std::int16_t>(hu + noise() % 20);
  }
  const HuImage::Pointer image = itkImage(volume);
  for (const bool compressed : { false, true })
  {
    for (const double share : { 0.99, 0.5, 0.01 })
    {
      SCOPED_TRACE(testing::Message() << "compressed " << compressed << ", share " << share);
      writeByItk(image.GetPointer(), itk::NrrdImageIO::New().GetPointer(), path("ct.nrrd"), compressed);
      writeByItk(image.GetPointer(), itk::MetaImageIO::New().GetPointer(), path("ct.mha"), compressed);
      writeByItk(image.GetPointer(), itk::MetaImageIO::New().GetPointer(), path("ct.mhd"), compressed);
      writeByItk(image.GetPointer(), itk::NiftiImageIO::New().GetPointer(), path("ct.nii"));
      writeByItk(image.GetPointer(), itk::NiftiImageIO::New().GetPointer(), path("ct.nii.gz"), compressed);
      const std::string raw = compressed ? "ct.zraw" : "ct.raw";
      for (const std::string& name :
           { std::string("ct.nrrd"), std::string("ct.mha"), raw, std::string("ct.nii"), std::string("ct.nii.gz") })
      {
        truncate(path(name), share);
        expectRefused(path(name == raw ? "ct.mhd" : name), {});
      }
      std::filesystem::remove(path(raw));
      expectRefused(path("ct.mhd"), {});
    }
  }
}

TEST_F(CtVolumeTest, ValuesThatAreNotHounsfieldUnits)
{
  const CtVolume good = sampled(Eigen::Matrix3d::Identity());
  CtVolume grey = good;
  for (std::int16_t& hu : grey.hu)
  {
    hu = static_cast<std::int16_t>((hu + 1000) / 8);
  }
  writeCtVolume(grey, path("grey.nrrd"));
  expectRefused(path("grey.nrrd"), { "not Hounsfield units", "lowest value is 0", "-1000" });

  CtVolume constant = good;
  std::fill(constant.hu.begin(), constant.hu.end(), std::int16_t{ -1000 });
  writeCtVolume(constant, path("constant.nrrd"));
  expectRefused(path("constant.nrrd"), { "all voxels are -1000" });

  CtVolume hollow = good;
  std::replace(hollow.hu.begin(), hollow.hu.end(), std::int16_t{ 40 }, std::int16_t{ 300 });
  writeCtVolume(hollow, path("hollow.nrrd"));
  expectRefused(path("hollow.nrrd"), { "no value between -200 and 200" });

  using FloatImage = itk::Image<float, 3>;
  for (const float value : { 40000.0f, std::numeric_limits<float>::quiet_NaN() })
  {
    const auto image = FloatImage::New();
    image->SetRegions(FloatImage::SizeType{ { 4, 4, 4 } });
    image->Allocate();
    image->FillBuffer(-1000.0f);
    image->GetBufferPointer()[5] = 0.0f;
    image->GetBufferPointer()[7] = value;
    writeByItk(image.GetPointer(), itk::NrrdImageIO::New().GetPointer(), path("float.nrrd"));
    expectRefused(path("float.nrrd"), { "expected Hounsfield units", "-32768 to 32767" });
  }
}

TEST_F(CtVolumeTest, ShapesThatAreNoVolume)
{
  using Flat = itk::Image<std::int16_t, 2>;
  const auto flat = Flat::New();
  flat->SetRegions(Flat::SizeType{ { 8, 8 } });
  flat->Allocate(true);
  using Colour = itk::Image<itk::Vector<float, 3>, 3>;
  const auto colour = Colour::New();
  colour->SetRegions(Colour::SizeType{ { 4, 4, 4 } });
  colour->Allocate(true);
  writeByItk(flat.GetPointer(), itk::NrrdImageIO::New().GetPointer(), path("flat.nrrd"));
  writeByItk(flat.GetPointer(), itk::MetaImageIO::New().GetPointer(), path("flat.mha"));
  writeByItk(flat.GetPointer(), itk::NiftiImageIO::New().GetPointer(), path("flat.nii"));
  for (const char* name : { "flat.nrrd", "flat.mha", "flat.nii" })
  {
    expectRefused(path(name), { "2 dimensions, expected 3" });
  }
  writeByItk(colour.GetPointer(), itk::NrrdImageIO::New().GetPointer(), path("colour.nrrd"));
  expectRefused(path("colour.nrrd"), { "3 values a voxel, expected 1" });

  CtVolume metres = sampled(Eigen::Matrix3d::Identity());
  metres.grid.patient_from_index.linear() *= 1e-3;
  writeCtVolume(metres, path("metres.nrrd"));
  expectRefused(path("metres.nrrd"), { "spacing", "0.0015", "0.01 to 100" });

  std::ofstream(path("space.nrrd")) << "NRRD0004\ntype: uchar\ndimension: 3\nspace: scanner-xyz\nsizes: 2 2 2\n"
                                       "space directions: (1,0,0) (0,1,0) (0,0,1)\nencoding: raw\n\n12345678";
  expectRefused(path("space.nrrd"), { "space is scanner-xyz" });
}

TEST(AttenuationTest, MaterialsOfHu)
{
  EXPECT_DOUBLE_EQ(attenuationFromHu(-1000), 0.0);
  EXPECT_DOUBLE_EQ(attenuationFromHu(-2000), 0.0);
  EXPECT_DOUBLE_EQ(attenuationFromHu(0), kWaterAttenuation);
  EXPECT_NEAR(huFromMaterials({ 0.0, 1.0 }), 1592.0, 0.1);  // 0.0500 / 0.01929
  for (int hu = -1000; hu <= 4000; ++hu)
  {
    const Materials materials = materialsFromHu(hu);
    EXPECT_NEAR(huFromMaterials(materials), hu, 1e-9);
    EXPECT_GE(materials.soft, 0.0);
    EXPECT_GE(materials.bone, 0.0);
    EXPECT_EQ(materials.bone > 0.0, hu > 100) << hu;
  }
}

TEST(AttenuationTest, VolumeOfCt)
{
  const CtVolume ct = sampled(Eigen::Matrix3d::Identity());
  const ScalarVolume attenuation = attenuationVolume(ct);
  ASSERT_EQ(attenuation.values.size(), ct.hu.size());
  EXPECT_EQ(attenuation.grid.patient_from_index.matrix(), ct.grid.patient_from_index.matrix());
  for (std::size_t n = 0; n < ct.hu.size(); ++n)
  {
    ASSERT_FLOAT_EQ(attenuation.values[n], kWaterAttenuation * (1.0 + ct.hu[n] / 1000.0));
  }
}

TEST(BonyTargetTest, FindsTheBoneOnEveryGrid)
{
  for (const Eigen::Matrix3d& direction : directions())
  {
    // Of the balls over 200 HU two lie in the middle third of the height; a cube of 20 mm holds one of them.
    CtVolume volume = sampled(direction);
    std::replace(volume.hu.begin(), volume.hu.end(), std::int16_t{ 300 }, std::int16_t{ 100 });
    const Eigen::Vector3d found = findBonyTarget(volume, 20.0);
    EXPECT_LT((found - kMiddle - Eigen::Vector3d(0, 18, 0)).norm(), 2.5) << found.transpose();  // one voxel
    EXPECT_THROW(findBonyTarget(volume, 0.0), std::invalid_argument);
    std::fill(volume.hu.begin(), volume.hu.end(), std::int16_t{ 200 });
    EXPECT_THROW(findBonyTarget(volume, 20.0), std::runtime_error);
  }
}

TEST_F(SharedDataTest, LumbarPelvis)
{
  const CtVolume ct = readCtVolume(folder_ + "/lumbar_pelvis_ct/ct.nii.gz");
  EXPECT_EQ(ct.grid.size, Eigen::Vector3i(122, 101, 112));
  EXPECT_TRUE(ct.grid.spacing().isApprox(Eigen::Vector3d::Constant(3.0), 1e-4)) << ct.grid.spacing().transpose();
}

}  // namespace
}  // namespace xray_tracking
