#include <cstring>
#include <filesystem>
#include <functional>
#include <iomanip>
#include <sstream>
#include <string>
#include <vector>

#include "ct_samples.h"
#include "dicom_samples.h"

// Every form of file that a CT comes in, written here by hand, of one object that no flip or permutation leaves alike:
// no library that reads them has written them.

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;
const Eigen::Vector3d kRas(-1, -1, 1);

/// All permutations and flips of the axes, right- and left-handed, and two oblique grids.
std::vector<Eigen::Matrix3d> allDirections()
{
  std::vector<Eigen::Matrix3d> all;
  Eigen::Vector3i order(0, 1, 2);
  do
  {
    for (int signs = 0; signs < 8; ++signs)
    {
      Eigen::Matrix3d direction = Eigen::Matrix3d::Zero();
      for (int axis = 0; axis < 3; ++axis)
      {
        direction(order[axis], axis) = (signs >> axis & 1) != 0 ? -1.0 : 1.0;
      }
      all.push_back(direction);
    }
  } while (std::next_permutation(order.data(), order.data() + 3));
  all.push_back(directions()[4]);
  all.push_back(directions()[5]);
  return all;
}

std::string valuesOf(const CtVolume& volume)
{
  return { reinterpret_cast<const char*>(volume.hu.data()), 2 * volume.hu.size() };
}

std::string text(const Eigen::MatrixXd& numbers, const char* separator = " ", const char* open = "",
                 const char* close = "")
{
  std::ostringstream stream;
  stream << numbers.format(
      Eigen::IOFormat(Eigen::FullPrecision, Eigen::DontAlignCols, separator, separator, "", "", open, close));
  return stream.str();
}

/// @param to_space from LPS
std::string nrrd(const CtVolume& volume, const std::string& space, const Eigen::Vector3d& to_space)
{
  const Eigen::Matrix<double, 3, 4> axes = to_space.asDiagonal() * volume.grid.patient_from_index.affine();
  std::ostringstream header;
  header << "NRRD0004\ntype: short\ndimension: 3\nspace: " << space << "\nsizes: " << volume.grid.size.transpose()
         << "\nspace directions:";
  for (int axis = 0; axis < 3; ++axis)
  {
    header << ' ' << text(axes.col(axis).transpose(), ",", "(", ")");
  }
  header << "\nspace origin: " << text(axes.col(3).transpose(), ",", "(", ")") << "\nendian: little\nencoding: raw\n\n";
  return header.str() + valuesOf(volume);
}

std::string metaImage(const CtVolume& volume)
{
  const Eigen::Matrix3d direction = volume.grid.patient_from_index.linear().colwise().normalized();
  std::ostringstream header;
  header << "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nTransformMatrix = "
         << text(direction.transpose())
         << "\nOffset = " << text(volume.grid.patient_from_index.translation().transpose())
         << "\nElementSpacing = " << text(volume.grid.spacing().transpose())
         << "\nDimSize = " << volume.grid.size.transpose() << "\nElementType = MET_SHORT\nElementDataFile = LOCAL\n";
  return header.str() + valuesOf(volume);
}

struct NiftiForms
{
  bool qform, sform;
  Eigen::Affine3d q, s;  ///< LPS
};

std::string nifti(const CtVolume& volume, const NiftiForms& forms)
{
  std::string header(352, '\0');
  const auto put = [&](std::size_t offset, auto value) { std::memcpy(&header[offset], &value, sizeof(value)); };
  put(0, std::int32_t{ 348 });
  put(40, std::int16_t{ 3 });  // dimensions
  put(70, std::int16_t{ 4 });  // signed short
  put(72, std::int16_t{ 16 });
  Eigen::Matrix3d rotation = kRas.asDiagonal() * forms.q.linear();
  rotation.colwise().normalize();
  const float handedness = rotation.determinant() < 0.0 ? -1.0f : 1.0f;
  rotation.col(2) *= handedness;
  Eigen::Quaterniond quaternion(rotation);
  quaternion.coeffs() *= quaternion.w() < 0.0 ? -1.0 : 1.0;
  put(76, handedness);
  const Eigen::Vector3d offset = kRas.asDiagonal() * forms.q.translation();
  const Eigen::Matrix<double, 3, 4> rows = kRas.asDiagonal() * forms.s.affine();
  for (int axis = 0; axis < 3; ++axis)
  {
    put(42 + 2 * axis, static_cast<std::int16_t>(volume.grid.size[axis]));
    put(80 + 4 * axis, static_cast<float>(volume.grid.spacing()[axis]));
    put(256 + 4 * axis, static_cast<float>(quaternion.coeffs()[axis]));
    put(268 + 4 * axis, static_cast<float>(offset[axis]));
    for (int column = 0; column < 4; ++column)
    {
      put(280 + 16 * axis + 4 * column, static_cast<float>(rows(axis, column)));
    }
  }
  put(108, 352.0f);  // offset of the voxels
  put(112, 1.0f);    // slope
  put(123, char{ 2 });
  put(252, static_cast<std::int16_t>(forms.qform));
  put(254, static_cast<std::int16_t>(forms.sform));
  std::memcpy(&header[344], "n+1", 4);
  return header + valuesOf(volume);
}

/// A slice of a CT as a scanner stores it: 12 bits, HU + 1024.
DicomElements ctSlice(const CtVolume& volume, int k, const std::string& series = "1.2.3")
{
  const Eigen::Matrix3d direction = volume.grid.patient_from_index.linear().colwise().normalized();
  Eigen::Matrix<double, 1, 6> orientation;
  orientation << direction.col(0).transpose(), direction.col(1).transpose();
  std::vector<std::int16_t> stored(volume.hu.begin() + static_cast<std::ptrdiff_t>(volume.grid.offset(0, 0, k)),
                                   volume.hu.begin() + static_cast<std::ptrdiff_t>(volume.grid.offset(0, 0, k + 1)));
  for (std::int16_t& value : stored)
  {
    value = static_cast<std::int16_t>(value + 1024);
  }
  const std::string pixels(reinterpret_cast<const char*>(stored.data()), 2 * stored.size());
  const auto position = [&](int slice)
  { return text((volume.grid.patient_from_index * Eigen::Vector3d(0, 0, slice)).transpose(), "\\"); };
  return { { { 8, 0x0008 }, { "CS", "ORIGINAL\\PRIMARY\\AXIAL" } },
           { { 8, 0x0016 }, { "UI", "1.2.840.10008.5.1.4.1.1.2" } },
           { { 8, 0x0018 }, { "UI", series + "." + std::to_string(k) } },
           { { 8, 0x0060 }, { "CS", "CT" } },
           { { 8, 0x103e }, { "LO", "description of " + series } },
           { { 0x20, 0x000e }, { "UI", series } },
           { { 0x20, 0x0012 }, { "IS", "1" } },
           { { 0x20, 0x0032 }, { "DS", position(k) } },
           { { 0x20, 0x0037 }, { "DS", text(orientation, "\\") } },
           { { 0x28, 0x0002 }, { "US", us(1) } },
           { { 0x28, 0x0004 }, { "CS", "MONOCHROME2" } },
           { { 0x28, 0x0010 }, { "US", us(volume.grid.size.y()) } },
           { { 0x28, 0x0011 }, { "US", us(volume.grid.size.x()) } },
           { { 0x28, 0x0030 }, { "DS", text(volume.grid.spacing().head<2>().reverse().transpose(), "\\") } },
           { { 0x28, 0x0100 }, { "US", us(16) } },
           { { 0x28, 0x0101 }, { "US", us(12) } },
           { { 0x28, 0x0102 }, { "US", us(11) } },
           { { 0x28, 0x0103 }, { "US", us(0) } },
           { { 0x28, 0x1052 }, { "DS", "-1024" } },
           { { 0x28, 0x1053 }, { "DS", "1" } },
           { { 0x7FE0, 0x0010 }, { "OW", pixels } } };
}

class CtFormsTest : public testing::Test
{
protected:
  using Change = std::function<void(DicomElements&, int k)>;

  std::string path(const std::string& name = "") const { return folder_.path(name); }

  /// @param change of every slice before it is written
  void writeSeries(const CtVolume& volume, const std::string& folder, const std::string& series = "1.2.3",
                   const Change& change = {}) const
  {
    fs::create_directories(path(folder));
    for (int k = 0; k < volume.grid.size.z(); ++k)
    {
      DicomElements slice = ctSlice(volume, k, series);
      if (change)
      {
        change(slice, k);
      }
      folder_.write(folder + "/" + series + "_" + std::to_string(k * 7 % 36) + ".dcm", dicomFile(slice));
    }
  }

  /// The object, and its balls where they are, whatever the order of the slices.
  void expectRead(const std::string& name, const CtChoice& choice = {}) const
  {
    SCOPED_TRACE(name);
    try
    {
      expectObject(readCtVolume(path(name), choice));
    }
    catch (const std::runtime_error& error)
    {
      ADD_FAILURE() << error.what();
    }
  }

  TemporaryFolder folder_;
  CtVolume volume_ = sampled(Eigen::Matrix3d::Identity());
};

TEST_F(CtFormsTest, EveryDirectionIsTheSamePatient)
{
  for (const Eigen::Matrix3d& direction : allDirections())
  {
    SCOPED_TRACE(testing::Message() << "direction\n" << direction);
    const CtVolume volume = sampled(direction);
    const Eigen::Affine3d& axes = volume.grid.patient_from_index;
    const Eigen::Affine3d nowhere = Eigen::Translation3d(500, 0, 0) * axes;
    folder_.write("lps.nrrd", nrrd(volume, "left-posterior-superior", { 1, 1, 1 }));
    folder_.write("ras.nrrd", nrrd(volume, "RAS", kRas));
    folder_.write("las.nrrd", nrrd(volume, "left-anterior-superior", { 1, -1, 1 }));
    folder_.write("ct.mha", metaImage(volume));
    folder_.write("q.nii", nifti(volume, { true, false, axes, nowhere }));
    folder_.write("s.nii", nifti(volume, { false, true, nowhere, axes }));
    folder_.write("both.nii", nifti(volume, { true, true, axes, axes }));
    for (const char* name : { "lps.nrrd", "ras.nrrd", "las.nrrd", "ct.mha", "q.nii", "s.nii", "both.nii" })
    {
      SCOPED_TRACE(name);
      const CtVolume read = readCtVolume(path(name));
      expectSameGrid(read.grid, volume.grid);
      EXPECT_EQ(read.hu, volume.hu);
    }
    writeSeries(volume, "series");
    expectRead("series");
  }
}

TEST_F(CtFormsTest, SpacesThatAreNoPatients)
{
  for (const char* space : { "scanner-xyz", "3D-right-handed", "3D-left-handed", "left-posterior-inferior",
                             "right-posterior-superior", "left-anterior-superior-time" })
  {
    folder_.write("ct.nrrd", nrrd(volume_, space, { 1, 1, 1 }));
    expectRefused(path("ct.nrrd"), { std::string("space is ") + space, "expected left-posterior-superior" });
  }
}

TEST_F(CtFormsTest, NiftiFormsThatDisagree)
{
  const Eigen::Affine3d& axes = volume_.grid.patient_from_index;
  const Eigen::Affine3d moved = Eigen::Translation3d(0, 20, 0) * axes;
  folder_.write("ct.nii", nifti(volume_, { true, true, axes, moved }));
  expectRefused(path("ct.nii"),
                { "qform and sform", "20 mm apart", "-24.75 -69 206.25", "-24.75 -49 206.25", "ct_nifti_form" });
  expectSameGrid(readCtVolume(path("ct.nii"), { "", NiftiForm::QFORM }).grid, volume_.grid);
  const VolumeGrid by_sform = readCtVolume(path("ct.nii"), { "", NiftiForm::SFORM }).grid;
  EXPECT_TRUE(by_sform.patient_from_index.isApprox(moved, 1e-6));

  Eigen::Affine3d sheared = axes;
  sheared.linear().col(2).y() = 0.8;
  for (const bool qform : { true, false })
  {
    folder_.write("ct.nii", nifti(volume_, { qform, true, axes, sheared }));
    expectRefused(path("ct.nii"), { "sform is sheared", "0.8", qform ? "qform has" : "no qform", "ct_nifti_form" });
    EXPECT_TRUE(readCtVolume(path("ct.nii"), { "", NiftiForm::SFORM }).grid.patient_from_index.isApprox(sheared, 1e-6));
  }
  expectError<std::runtime_error>(
      [&] {
        readCtVolume(path("ct.nii"), { "", NiftiForm::QFORM });
      },
      { "qform_code is 0" });
  Eigen::Affine3d template_space = axes;
  template_space.linear() *= 1.1;
  folder_.write("ct.nii", nifti(volume_, { false, true, axes, template_space }));
  expectRefused(path("ct.nii"), { "voxels of", "pixdim" });
}

TEST_F(CtFormsTest, MetaImageLettersThatContradictTheMatrix)
{
  const std::string file = metaImage(volume_);
  for (const char* letters : { "RAI", "LPS", "???" })
  {
    folder_.write("ct.mha", std::string("AnatomicalOrientation = ") + letters + "\n" + file);
    expectRead("ct.mha");
  }
  folder_.write("ct.mha", "AnatomicalOrientation = LAI\n" + file);
  expectRefused(path("ct.mha"), { "AnatomicalOrientation is LAI", "TransformMatrix is 1", "RAI" });
  folder_.write("ct.mha", "ElementToIntensityFunctionOffset = -1024\n" + file);
  expectRefused(path("ct.mha"), { "ElementToIntensityFunctionOffset is -1024" });
}

TEST_F(CtFormsTest, DicomPixelsAsTheStandardHasThem)
{
  const std::vector<std::pair<const char*, Change>> changes{
    { "in the upper bits",
      [](DicomElements& slice, int)
      {
        slice[{ 0x28, 0x0102 }].second = us(15);
        std::string& pixels = slice[{ 0x7FE0, 0x0010 }].second;
        for (std::size_t n = 0; n < pixels.size(); n += 2)
        {
          std::uint16_t value;
          std::memcpy(&value, &pixels[n], 2);
          value = static_cast<std::uint16_t>(value << 4 | 5);  // what is below is not the image's
          std::memcpy(&pixels[n], &value, 2);
        }
      } },
    { "an overlay in unused bits",
      [](DicomElements& slice, int)
      {
        std::string& pixels = slice[{ 0x7FE0, 0x0010 }].second;
        for (std::size_t n = 1; n < pixels.size(); n += 6)
        {
          pixels[n] = static_cast<char>(pixels[n] | 0x10);
        }
      } },
    { "12 bits with sign",
      [](DicomElements& slice, int)
      {
        slice[{ 0x28, 0x0103 }].second = us(1);
        slice[{ 0x28, 0x1052 }].second = "0";
        std::string& pixels = slice[{ 0x7FE0, 0x0010 }].second;
        for (std::size_t n = 0; n < pixels.size(); n += 2)
        {
          std::int16_t value;
          std::memcpy(&value, &pixels[n], 2);
          value = static_cast<std::int16_t>((value - 1024) & 0xFFF);
          std::memcpy(&pixels[n], &value, 2);
        }
      } },
    { "displayed white on black",
      [](DicomElements& slice, int) {
        slice[{ 0x28, 0x0004 }].second = "MONOCHROME1";
      } },
    { "a slope of each slice's own",
      [](DicomElements& slice, int k)
      {
        slice[{ 0x28, 0x1053 }].second = k % 2 == 0 ? "0.5" : "1";
        std::string& pixels = slice[{ 0x7FE0, 0x0010 }].second;
        for (std::size_t n = 0; k % 2 == 0 && n < pixels.size(); n += 2)
        {
          std::uint16_t value;
          std::memcpy(&value, &pixels[n], 2);
          value = static_cast<std::uint16_t>(2 * value);
          std::memcpy(&pixels[n], &value, 2);
        }
      } },
    { "padding",
      [](DicomElements& slice, int)
      {
        slice[{ 0x28, 0x0120 }] = { "US", us(4095) };
        std::memcpy(slice[{ 0x7FE0, 0x0010 }].second.data(), us(4095).data(), 2);
      } },
    { "a range of padding",
      [](DicomElements& slice, int)
      {
        slice[{ 0x28, 0x0120 }] = { "US", us(4095) };
        slice[{ 0x28, 0x0121 }] = { "US", us(4090) };
        std::memcpy(slice[{ 0x7FE0, 0x0010 }].second.data(), us(4092).data(), 2);
      } },
  };
  for (const auto& [name, change] : changes)
  {
    SCOPED_TRACE(name);
    writeSeries(volume_, "series", "1.2.3", change);
    const CtVolume read = readCtVolume(path("series"));
    EXPECT_EQ(read.hu, volume_.hu) << name;
  }
  // Negative padding in the VR of values without sign, as scanners write it.
  writeSeries(volume_, "series", "1.2.3",
              [](DicomElements& slice, int)
              {
                slice[{ 0x28, 0x0101 }].second = us(16);
                slice[{ 0x28, 0x0102 }].second = us(15);
                slice[{ 0x28, 0x0103 }].second = us(1);
                slice[{ 0x28, 0x0120 }] = { "US", us(-2000) };
                std::memcpy(slice[{ 0x7FE0, 0x0010 }].second.data(), us(-2000).data(), 2);
              });
  EXPECT_EQ(readCtVolume(path("series")).hu, volume_.hu);

  const std::vector<std::pair<Change, std::vector<std::string>>> refused{
    { [](DicomElements& slice, int) {
       slice[{ 0x28, 0x3000 }] = { "SQ", dicomItem({}) };
     },
      { "ModalityLUTSequence" } },
    { [](DicomElements& slice, int) {
       slice[{ 0x28, 0x1054 }] = { "LO", "Z_EFF" };
     },
      { "RescaleType is Z_EFF" } },
    { [](DicomElements& slice, int) {
       slice[{ 0x28, 0x1053 }].second = "0";
     },
      { "RescaleSlope is \"0\"" } },
    { [](DicomElements& slice, int) {
       slice[{ 0x28, 0x1053 }].second = "2,0000";
     },
      { "RescaleSlope is \"2,0000" } },
    { [](DicomElements& slice, int k)
      {
        if (k == 1)
        {
          slice.erase({ 0x28, 0x1052 });
          slice.erase({ 0x28, 0x1053 });
        }
      },
      { "RescaleSlope" } },
    { [](DicomElements& slice, int) {
       slice[{ 0x28, 0x0030 }].second = "-1\\1";
     },
      { "PixelSpacing is -1\\1", "0.01 to 20" } },
    { [](DicomElements& slice, int) {
       slice[{ 0x28, 0x0030 }].second = "0.001\\0.001";
     },
      { "PixelSpacing is 0.001" } },
    { [](DicomElements& slice, int) {
       slice[{ 0x28, 0x0004 }].second = "PALETTE COLOR";
     },
      { "PALETTE COLOR" } },
    { [](DicomElements& slice, int) {
       slice[{ 0x28, 0x0101 }].second = us(17);
     },
      { "BitsStored 17" } },
    { [](DicomElements& slice, int) {
       slice[{ 0x10, 0x2210 }] = { "CS", "QUADRUPED" };
     },
      { "QUADRUPED" } },
  };
  for (const auto& [change, parts] : refused)
  {
    writeSeries(volume_, "refused", "1.2.3", change);
    expectRefused(path("refused"), parts);
  }
}

TEST_F(CtFormsTest, RoundedPositionsAreEvenSlices)
{
  CtVolume fine = volume_;
  fine.grid.patient_from_index.linear().col(2).z() = 0.625;
  fine.grid.patient_from_index.translation().z() = 250.3;
  writeSeries(fine, "rounded", "1.2.3",
              [&](DicomElements& slice, int k)
              {
                std::ostringstream z;
                z << std::fixed << std::setprecision(1) << 250.3 + 0.625 * k;
                slice[{ 0x20, 0x0032 }].second = "-24.75\\-69.0\\" + z.str();
              });
  const VolumeGrid grid = readCtVolume(path("rounded")).grid;
  EXPECT_NEAR(grid.spacing().z(), 0.625, 0.1 / 35);
  EXPECT_NEAR(grid.patient_from_index.translation().z(), 250.3, 0.03) << "36 slices average the rounding out";

  fs::remove(path("rounded/1.2.3_" + std::to_string(17 * 7 % 36) + ".dcm"));
  expectRefused(path("rounded"), { "a slice is missing" });
}
/// All slices in one file, last one first, with what a frame does not share in its own functional group.
std::string enhancedCt(const CtVolume& volume)
{
  DicomElements file = ctSlice(volume, 0);
  const auto group = [](int number, const DicomElements& elements)
  { return std::make_pair(std::make_pair(number >> 16, number & 0xFFFF), std::make_pair("SQ", dicomItem(elements))); };
  const auto taken = [&](int g, int e)
  {
    const auto element = *file.find({ g, e });
    file.erase({ g, e });
    return element;
  };
  file[{ 8, 0x0016 }].second = "1.2.840.10008.5.1.4.1.1.2.1";
  const DicomElements shared{ group(0x00289110, { taken(0x28, 0x0030) }), group(0x00209116, { taken(0x20, 0x0037) }) };
  file.erase({ 0x20, 0x0032 });
  file.erase({ 0x28, 0x1052 });
  file.erase({ 0x28, 0x1053 });
  std::string frames, pixels;
  for (int k = volume.grid.size.z() - 1; k >= 0; --k)
  {
    const DicomElements slice = ctSlice(volume, k);
    frames += dicomItem({ group(0x00209113, { *slice.find({ 0x20, 0x0032 }) }),
                          group(0x00289145, { *slice.find({ 0x28, 0x1052 }), *slice.find({ 0x28, 0x1053 }) }) });
    pixels += slice.at({ 0x7FE0, 0x0010 }).second;
  }
  file[{ 0x28, 0x0008 }] = { "IS", std::to_string(volume.grid.size.z()) };
  file[{ 0x5200, 0x9229 }] = { "SQ", dicomItem(shared) };
  file[{ 0x5200, 0x9230 }] = { "SQ", frames };
  file[{ 0x7FE0, 0x0010 }].second = pixels;
  return dicomFile(file);
}

TEST_F(CtFormsTest, EnhancedMultiFrame)
{
  for (const Eigen::Matrix3d& direction : directions())
  {
    const CtVolume volume = sampled(direction);
    fs::create_directories(path("folder"));
    folder_.write("folder/enhanced.dcm", enhancedCt(volume));
    expectRead("folder/enhanced.dcm");
    expectRead("folder");
  }
  truncate(path("folder/enhanced.dcm"), 0.9);
  expectRefused(path("folder/enhanced.dcm"), { "truncated" });
}

TEST_F(CtFormsTest, OrdinaryFolders)
{
  const auto isScout = [](DicomElements& slice, int)
  {
    slice[{ 8, 0x0008 }].second = "ORIGINAL\\PRIMARY\\LOCALIZER";
    slice[{ 0x20, 0x0037 }].second = "1\\0\\0\\0\\0\\-1";
  };
  // A scout in the series itself and one of its own, a screenshot, a dose report, in sub-folders.
  writeSeries(volume_, "export/series");
  DicomElements scout = ctSlice(volume_, 3);
  isScout(scout, 0);
  folder_.write("export/series/scout.dcm", dicomFile(scout));
  fs::create_directories(path("export/other"));
  scout[{ 0x20, 0x000e }].second = "9.9";
  folder_.write("export/other/scout.dcm", dicomFile(scout));
  DicomElements screenshot = ctSlice(volume_, 3);
  screenshot[{ 8, 0x0016 }].second = "1.2.840.10008.5.1.4.1.1.7";
  screenshot.erase({ 0x20, 0x0032 });
  screenshot.erase({ 0x20, 0x0037 });
  folder_.write("export/series/screenshot.dcm", dicomFile(screenshot));
  DicomElements report = ctSlice(volume_, 3);
  report[{ 8, 0x0060 }].second = "SR";
  folder_.write("export/other/report.dcm", dicomFile(report));
  folder_.write("export/viewer.exe", "MZ");
  folder_.write("export/series/README.TXT", "an export");
  expectRead("export");

  // Another series: a list, each line of which is the answer.
  CtVolume moved = volume_;
  moved.grid.patient_from_index.translation().y() += 50.0;
  writeSeries(moved, "export/second", "5.6.7");
  expectRefused(path("export"), { "2 CT series", "ct_series: '1.2.3'", "ct_series: '5.6.7'", "36 slices", "axial",
                                  "1.5 x 2 x 2.5 mm", "acquisition 1", "2 CT localizer", "1 SR" });
  expectRead("export", { "1.2.3" });
  expectSameGrid(readCtVolume(path("export"), { "5.6.7" }).grid, moved.grid);
  expectError<std::runtime_error>([&] { readCtVolume(path("export"), { "8" }); },
                                  { "no series 8", "ct_series: '5.6.7'" });
  expectError<std::runtime_error>([&] { readCtVolume(path("export"), { "1.2" }); }, { "no series 1.2" });
}

TEST_F(CtFormsTest, VolumesUnderOneUid)
{
  CtVolume second = volume_;
  for (std::int16_t& hu : second.hu)
  {
    hu = static_cast<std::int16_t>(hu == 40 ? 45 : hu);
  }
  struct Case
  {
    std::pair<int, int> tag;
    const char* vr;
    const char* name;
    const char* values[2];
  };
  for (const Case& one : { Case{ { 0x20, 0x0012 }, "IS", "AcquisitionNumber", { "1", "2" } },
                           Case{ { 0x18, 0x1210 }, "SH", "ConvolutionKernel", { "B30f", "B70f" } },
                           Case{ { 0x20, 0x0100 }, "IS", "TemporalPositionIdentifier", { "1", "2" } },
                           Case{ { 8, 0x0032 }, "TM", "AcquisitionTime", { "101112.5", "101500" } } })
  {
    SCOPED_TRACE(one.name);
    for (const int n : { 0, 1 })
    {
      writeSeries(n == 0 ? volume_ : second, n == 0 ? "one" : "two", "1.2.3",
                  [&](DicomElements& slice, int) {
                    slice[one.tag] = { one.vr, one.values[n] };
                  });
    }
    fs::create_directories(path("both"));
    fs::rename(path("one"), path("both/one"));
    fs::rename(path("two"), path("both/two"));
    const auto label = [&](int n) { return std::string("1.2.3 ") + one.name + "=" + one.values[n]; };
    expectRefused(path("both"), { "2 CT series or volumes", "'" + label(0) + "'", "'" + label(1) + "'" });
    EXPECT_EQ(readCtVolume(path("both"), { label(0) }).hu, volume_.hu);
    EXPECT_EQ(readCtVolume(path("both"), { label(1) }).hu, second.hu);
    expectError<std::runtime_error>([&] { readCtVolume(path("both"), { "1.2.3" }); }, { label(0), label(1) });
    fs::remove_all(path("both"));
  }
  // Scanners number every turn: no reason to ask, nor to take a gap between turns for two volumes.
  writeSeries(volume_, "turns", "1.2.3",
              [](DicomElements& slice, int k) {
                slice[{ 0x20, 0x0012 }].second = std::to_string(k / 4);
              });
  expectRead("turns");
  fs::remove(path("turns/1.2.3_" + std::to_string(16 * 7 % 36) + ".dcm"));
  expectRefused(path("turns"), { "a slice is missing" });
}

/// A spine of vertebrae that are nearly alike: which one has most bone hangs on little, but not on the file.
TEST_F(CtFormsTest, TargetIsTheSameInEveryForm)
{
  const auto hu = [](const Eigen::Vector3d& point)
  {
    const double along = std::remainder(point.z(), 30.0);
    const Eigen::Vector2d across = point.head<2>() - Eigen::Vector2d(5, 20);
    return std::abs(along) < 11.0 && across.norm() < 18.0 + 0.002 * point.z() ? 700 : across.norm() < 60.0 ? 40 : -1000;
  };
  std::vector<Eigen::Vector3d> found;
  for (const Eigen::Matrix3d& direction : allDirections())
  {
    if (direction.determinant() < 0.0)
    {
      continue;
    }
    CtVolume spine;
    const Eigen::Vector3d extent = (direction.transpose() * Eigen::Vector3d(130, 130, 200)).cwiseAbs();
    const bool oblique = direction.cwiseAbs().maxCoeff() < 0.99;
    const Eigen::Vector3d spacing = (direction.transpose() * Eigen::Vector3d(2, 2, 2.5)).cwiseAbs();
    if (oblique)
    {
      continue;
    }
    spine.grid.size = (extent.array() / spacing.array()).round().cast<int>();
    spine.grid.patient_from_index.linear() = direction * spacing.asDiagonal();
    spine.grid.patient_from_index.translation() = Eigen::Vector3d(0.1, 0.3, 100.7) - spine.grid.centre();
    for (int k = 0; k < spine.grid.size.z(); ++k)
    {
      for (int j = 0; j < spine.grid.size.y(); ++j)
      {
        for (int i = 0; i < spine.grid.size.x(); ++i)
        {
          spine.hu.push_back(static_cast<std::int16_t>(hu(spine.grid.patient_from_index * Eigen::Vector3d(i, j, k))));
        }
      }
    }
    found.push_back(findBonyTarget(spine, 50.0));
    // What files round by.
    spine.grid.patient_from_index.translation() += Eigen::Vector3d(1e-5, -1e-5, 1e-5);
    found.push_back(findBonyTarget(spine, 50.0));
  }
  for (const Eigen::Vector3d& target : found)
  {
    EXPECT_LT((target - found.front()).norm(), 1e-3) << target.transpose() << " and " << found.front().transpose();
  }
}
}  // namespace
}  // namespace xray_tracking
