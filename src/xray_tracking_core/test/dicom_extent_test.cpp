#include "../src/volume/dicom_extent.h"

#include <filesystem>
#include <random>

#include "dicom_samples.h"
#include "rt_samples.h"
#include "test_helpers.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
namespace
{
using State = DicomExtent::State;

class DicomExtentTest : public testing::Test
{
protected:
  DicomExtent extentOf(const std::string& bytes) const
  {
    folder_.write("file.dcm", bytes);
    return dicomExtent(folder_.path("file.dcm"));
  }

  static std::string number(std::uint32_t value) { return bytesOf({ value }); }
  static std::string tag(int group, int element) { return us(group) + us(element); }

  /// Two points of a structure set with sequences of undefined length, implicit VR.
  static std::string implicitFile()
  {
    const std::string meta = dicomData({ { { 2, 0x0010 }, { "UI", "1.2.840.10008.1.2" } } });
    const std::string item = tag(0xFFFE, 0xE000) + number(0xFFFFFFFF) + tag(0x3006, 0x0026) + number(4) + "bone" +
                             tag(0xFFFE, 0xE00D) + number(0);
    return std::string(128, '\0') + "DICM" + meta + tag(8, 0x0060) + number(8) + "RTSTRUCT" + tag(0x3006, 0x0020) +
           number(0xFFFFFFFF) + item + item + tag(0xFFFE, 0xE0DD) + number(0);
  }

  TemporaryFolder folder_;
};

TEST_F(DicomExtentTest, EveryCutIsFound)
{
  const std::string explicit_file =
      structureSetFile({ { 1, "bone", { { circle({ 0, 0, 0 }, 5.0, { 1, 0, 0 }, { 0, 1, 0 }, 5) } } } });
  // Between two elements of the file itself nothing tells of a cut.
  for (const auto& [whole, between] : { std::pair(explicit_file, 4), std::pair(implicitFile(), 1) })
  {
    EXPECT_EQ(extentOf(whole).state, State::WHOLE) << extentOf(whole).why;
    int whole_too = 0;
    for (std::size_t size = 132; size < whole.size(); ++size)
    {
      const DicomExtent extent = extentOf(whole.substr(0, size));
      whole_too += extent.state == State::WHOLE ? 1 : 0;
      EXPECT_TRUE(extent.state == State::WHOLE || (extent.state == State::CUT && extent.before_pixels))
          << size << ": " << extent.why;
    }
    EXPECT_EQ(whole_too, between);
  }
}

TEST_F(DicomExtentTest, LengthsBeyondTheFileAndDeepSequences)
{
  const std::string head =
      std::string(128, '\0') + "DICM" + dicomData({ { { 2, 0x0010 }, { "UI", "1.2.840.10008.1.2.1" } } });
  const DicomExtent huge =
      extentOf(head + tag(0x3006, 0x0050) + "UN" + std::string(2, '\0') + number(0xFFFFFFF0) + "1\\2");
  EXPECT_EQ(huge.state, State::CUT);
  EXPECT_NE(huge.why.find("(3006,0050)"), std::string::npos) << huge.why;
  EXPECT_NE(huge.why.find("truncated"), std::string::npos) << huge.why;

  std::string nested;
  for (int depth = 0; depth < 1000; ++depth)
  {
    nested += tag(0x3006, 0x0020) + "SQ" + std::string(2, '\0') + number(0xFFFFFFFF) + tag(0xFFFE, 0xE000) +
              number(0xFFFFFFFF);
  }
  EXPECT_EQ(extentOf(head + nested).state, State::CUT);
  // GDCM would take the value for a length, and meta information that is none for the end of the process.
  EXPECT_EQ(extentOf(head + tag(0x3006, 0x0020) + "??" + us(0)).state, State::UNSAFE);
  EXPECT_EQ(extentOf(head + tag(0x3006, 0x0020) + std::string(2, '\0') + us(0)).state, State::IRREGULAR);
  std::string meta = head;
  meta[meta.find("UI")] = '#';
  EXPECT_EQ(extentOf(meta).state, State::UNSAFE);
  // GDCM ends the process by an assertion.
  meta = head;
  meta.replace(meta.find("UI"), 2, "SQ");
  EXPECT_EQ(extentOf(meta).state, State::UNSAFE);
  for (const auto& [vr, state] : { std::pair("OB", State::WHOLE), std::pair("OD", State::UNSAFE) })
  {
    EXPECT_EQ(extentOf(head + tag(0x7FE0, 0x0010) + vr + std::string(2, '\0') + number(0xFFFFFFFF) +
                       tag(0xFFFE, 0xE000) + number(0) + tag(0xFFFE, 0xE0DD) + number(0))
                  .state,
              state)
        << vr;
  }
  EXPECT_EQ(extentOf("no DICOM").state, State::NO_DICOM);
  EXPECT_EQ(extentOf("").state, State::NO_DICOM);
  EXPECT_EQ(dicomExtent(folder_.path("absent")).state, State::NO_DICOM);
}

/// GDCM's assertions ended the process for most of these.
TEST_F(DicomExtentTest, ASliceThatEndsInItsHeaderIsRefused)
{
  VolumeGrid grid;
  grid.size = { 8, 8, 6 };
  for (int k = 0; k < 6; ++k)
  {
    folder_.write("slice" + std::to_string(k) + ".dcm", ctSliceFile(grid, k));
  }
  const std::string whole = ctSliceFile(grid, 3);
  for (std::size_t size = 0; size < whole.size(); ++size)
  {
    folder_.write("slice3.dcm", whole.substr(0, size));
    // Before the modality is told it is something else, and the slice is missing.
    expectError<std::runtime_error>([&] { readCtVolume(folder_.path()); }, { folder_.path(), "slice" });
  }
}
}  // namespace
}  // namespace xray_tracking
