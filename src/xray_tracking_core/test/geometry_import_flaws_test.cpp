#include <limits>

#include <gtest/gtest.h>

#include "geometry_import_samples.h"

namespace xray_tracking
{
namespace
{
/// Something wrong with a file, and what the message names.
struct Flaw
{
  const char* name;
  std::string content;
  GeometryImportOptions options;
  std::vector<std::string> named;
};

std::ostream& operator<<(std::ostream& stream, const Flaw& flaw)
{
  return stream << flaw.name;
}

class BadFile : public GeometryImport, public testing::WithParamInterface<Flaw>
{
};

TEST_P(BadFile, isRefusedByName)
{
  const Flaw& flaw = GetParam();
  const std::string file = write("file", flaw.content);
  expectError<std::exception>([&] { importGeometry({ file, file }, flaw.options); }, flaw.named);
}

std::string replaced(std::string text, const std::string& what, const std::string& by)
{
  const std::size_t place = text.find(what);
  EXPECT_NE(std::string::npos, place) << what;
  return place == std::string::npos ? text : text.replace(place, what.size(), by);
}

std::vector<Flaw> flaws()
{
  const std::string maya = TestCamera(20.0).mayaCam();
  const std::string matrix = textOf(TestCamera(20.0).matrix());
  const RtkParameters projection{ 1000.0, 1536.0, 30.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 };
  const std::string distances =
      "<SourceToIsocenterDistance>1000</SourceToIsocenterDistance>\n"
      "<SourceToDetectorDistance>1536</SourceToDetectorDistance>\n";
  const std::string rtk = rtkFile(distances + projection.xml(true));
  GeometryImportOptions no_size = withPitch(), no_pitch = ofMatrices(), no_projection = ofRtk({});
  no_pitch.pixel_pitch.reset();
  const GeometryImportOptions first = ofRtk({ 0 });
  const auto xa = [](int group, int element, const std::string& value)
  {
    DicomElements elements = angiography("0", "0");
    elements[{ group, element }].second = value;
    return dicom(elements);
  };
  DicomElements empty_angle = angiography("", "0"), no_spacing = angiography("0", "0"), ct = angiography("0", "0"),
                dynamic = angiography("0", "0"), many = angiography("0", "0"), tilted = portal("0");
  no_spacing.erase({ 0x0018, 0x1164 });
  ct[{ 0x0008, 0x0060 }] = { "CS", "CT" };
  dynamic[{ 0x0018, 0x1500 }] = { "CS", "DYNAMIC" };
  many[{ 0x0028, 0x0008 }] = { "IS", "12" };
  tilted[{ 0x3002, 0x000c }] = { "CS", "NON_NORMAL" };
  DicomElements swapped = portal("0");
  swapped[{ 0x3002, 0x0022 }].second = "1500";
  swapped[{ 0x3002, 0x0026 }].second = "1000";
  return {
    { "empty", "", {}, { "file", "is empty", "MayaCam" } },
    { "blank", "\n  \n", {}, { "is empty" } },
    { "prose", "hello world\n", {}, { "file, line 1", "hello world", "MayaCam" } },
    { "binary", std::string("\0\1\2\3", 4), {}, { "file", "expected" } },
    { "mayaOnce", maya, withPitch(), { "file", "different places" } },
    { "mayaTruncated", maya.substr(0, maya.find("rotation")), withPitch(), { "file", "\"rotation\" is missing" } },
    { "mayaTruncatedInside",
      maya.substr(0, maya.find("translation") + 14),
      withPitch(),
      { "file, line 14", "translation has 1", "3 lines of 1" } },
    { "mayaWithoutHead", maya.substr(maya.find("camera matrix")), withPitch(), { "\"image size\" is missing" } },
    { "mayaNan", replaced(maya, "365.25", "nan"), withPitch(), { "file, line 5", "\"nan\"", "finite number" } },
    { "mayaNanLine", replaced(maya, "1100", "nan"), withPitch(), { "file, line 17", "\"nan\"" } },
    { "mayaHuge", replaced(maya, "365.25", "1e400"), withPitch(), { "file, line 5", "1e400" } },
    { "mayaWord", replaced(maya, "365.25", "12px"), withPitch(), { "file, line 5", "12px" } },
    { "mayaShortRow", replaced(maya, ",365.25", ""), withPitch(), { "file, line 4", "camera matrix has 8" } },
    { "mayaTwice", maya + maya, withPitch(), { "file, line 18", "second time" } },
    { "mayaUnknown", maya + "\nfocus\n1\n", withPitch(), { "file, line 19", "focus" } },
    { "mayaDistorted", maya + "\ndistortion\n0.1,0,0\n", withPitch(), { "file, line 19", "distortion has 3" } },
    { "mayaStretched", replaced(maya, "rotation\n0.9", "rotation\n1.9"), withPitch(), { "file, line 9", "identity" } },
    { "mayaSize", replaced(maya, "800,600", "800.5,600"), withPitch(), { "file, line 1", "800.5" } },
    { "mayaSizeZero", replaced(maya, "800,600", "0,600"), withPitch(), { "file, line 1", "image size is 0, 600" } },
    { "mayaRowsFirst", replaced(maya, "800,600", "350,800"), withPitch(), { "rows, columns", "--image_size 800 350" } },
    { "mayaOpen", maya, {}, { "different places" } },
    { "one",
      "image size\n800,600\ncamera matrix\n4000,0,0\n0,4000,0\n400,300,1\nrotation\n1,0,0\n0,1,0\n0,0,1\ntranslation\n"
      "0\n0\n1000\n",
      withPitch(),
      { "file, line 3", "transpose" } },
    { "mayaOne", "0,0,1\n1,2,3\n4,5,6\n7,8,9\n1,1024,1024\n", withPitch(), { "MayaCam 1.0" } },
    { "matrixTwice", matrix, ofMatrices(), { "different places" } },
    { "matrixSize", matrix, no_size, { "--image_size" } },
    { "matrixTruncated", matrix.substr(0, matrix.rfind('\n', matrix.size() - 2)), ofMatrices(), { "8 numbers" } },
    { "matrixRow", "1 2 3 4 5\n" + matrix, ofMatrices(), { "file, line 1", "5 numbers" } },
    { "dlt", "1 2 3 4 5 6 7 8 9 10 11\n", ofMatrices(), { "DLT", "put 1 behind" } },
    { "matrixTransposed", "1 2 3\n4 5 6\n7 8 9\n1 2 3\n", ofMatrices(), { "MATLAB", "3 lines of 4" } },
    { "matrixWord", "1 2 x 4\n" + matrix, ofMatrices(), { "file, line 1", "\"x\"" } },
    { "matrixZero", "0 0 0 0\n0 0 0 0\n0 0 0 0\n", ofMatrices(), { "third row", "parallel" } },
    { "matrixParallel", "1 0 0 0\n0 1 0 0\n0 0 0 1\n", ofMatrices(), { "third row", "parallel" } },
    { "matrixSingular", "1 0 0 5\n2 0 0 6\n0 0 1 7\n", ofMatrices(), { "no camera" } },
    { "matrixHuge", "1e15 0 0 5\n0 1e-15 0 6\n0 0 1 1e15\n", ofMatrices(), { "third row" } },
    { "rtkNoProjection", rtk, no_projection, { "1 projections", "--projections", "0 to 0" } },
    { "rtkBeyond", rtk, ofRtk({ 5 }), { "--projections: 5", "0 to 0" } },
    { "rtkTwice", rtk, ofRtk({ 0 }), { "different places" } },
    { "rtkTruncated", rtk.substr(0, rtk.size() - 40), first, { "file, line", "not XML" } },
    { "rtkOther",
      "<?xml version=\"1.0\"?>\n<Calibration/>\n",
      first,
      { "<Calibration>", "RTKThreeDCircularGeometry" } },
    { "rtkVersion", replaced(rtk, "\"3\"", "\"1\""), first, { "line 3", "version is 1" } },
    { "rtkNoAngle", replaced(rtk, "1000<", "<"), first, { "SourceToIsocenterDistance", "expected a number" } },
    { "rtkWord", replaced(rtk, ">1000<", ">far<"), first, { "line 4: SourceToIsocenterDistance", "\"far\"" } },
    { "rtkNoDistance",
      rtkFile(projection.xml(false)),
      first,
      { "projection 0", "SourceToIsocenterDistance is missing" } },
    { "rtkSwapped", replaced(replaced(rtk, ">1000<", ">9999<"), ">1536<", ">1000<"), first, { "9999", "swapped" } },
    { "rtkParallel", replaced(rtk, ">1536<", ">0<"), first, { "parallel" } },
    { "rtkUnknown", replaced(rtk, "InPlaneAngle>0</InPlaneAngle", "Tilt>0</Tilt"), first, { "Tilt", "unknown" } },
    { "rtkMatrixCount", replaced(rtk, "</Matrix>", " 7</Matrix>"), first, { "Matrix", "13 numbers" } },
    { "rtkEmpty", rtkFile(""), first, { "no <Projection>" } },
    { "dicomTwice", dicom(angiography("0", "0")), {}, { "different places" } },
    { "dicomEmptyAngle", dicom(empty_angle), {}, { "PositionerPrimaryAngle is absent" } },
    { "dicomWord", xa(0x0018, 0x1510, "left"), {}, { "PositionerPrimaryAngle is \"left\"" } },
    { "dicomSwapped", xa(0x0018, 0x1110, "500"), {}, { "DistanceSourceToDetector 500", "swapped" } },
    { "dicomNegative", xa(0x0018, 0x1110, "-500"), {}, { "DistanceSourceToDetector is -500", "positive" } },
    { "dicomNoSpacing", dicom(no_spacing), {}, { "ImagerPixelSpacing is absent", "--pitch" } },
    { "dicomCt", dicom(ct), {}, { "Modality is CT", "RTIMAGE" } },
    { "dicomDynamic", dicom(dynamic), {}, { "PositionerMotion is DYNAMIC" } },
    { "dicomFrames", dicom(many), {}, { "NumberOfFrames is 12" } },
    { "rtImageTilted", dicom(tilted), {}, { "RTImagePlane is NON_NORMAL" } },
    { "rtImageSwapped", dicom(swapped), {}, { "RTImageSID is 1000", "RadiationMachineSAD 1500", "swapped" } },
    { "listWithoutKey", "detectors:\n- {name: a}\n", {}, { "detectors[0].image_size is missing" } },
    { "listOfWords", "detectors: here\n", {}, { "detectors", "a list" } },
    { "listUseless", "detectors:\n" + detectorText(twoDetectors()[0]), withPitch(), { "--pitch" } },
  };
}

INSTANTIATE_TEST_SUITE_P(Flaws, BadFile, testing::ValuesIn(flaws()),
                         [](const testing::TestParamInfo<Flaw>& test) { return std::string(test.param.name); });

TEST_F(GeometryImport, otherFlaws)
{
  const TestCamera a(20.0), b(110.0);
  const std::vector<std::string> files{ write("a.txt", a.mayaCam()), write("b.txt", b.mayaCam()) };
  expectError<std::invalid_argument>([&] { importGeometry({ files[0] }, withPitch()); }, { "1 view", "two or more" });
  expectError<std::invalid_argument>([&] { importGeometry(files, {}); }, { "a.txt", "--pitch", "--sdd" });
  expectError<std::runtime_error>(
      [&] {
        importGeometry({ files[0], folder_.path("none") }, withPitch());
      },
      { "none: missing" });
  expectError<std::runtime_error>([&] { importGeometry({ files[0], folder_.path() }, withPitch()); }, { "not a file" });
  GeometryImportOptions options = withPitch();
  options.source_to_detector = 1000.0;
  expectError<std::invalid_argument>([&] { importGeometry(files, options); }, { "--pitch and --sdd" });
  for (const double pitch : { 0.0, -0.3, std::nan(""), std::numeric_limits<double>::infinity() })
  {
    expectError<std::invalid_argument>([&] { importGeometry(files, withPitch(pitch)); }, { "--pitch", "positive" });
  }
  options = withPitch();
  options.image_size = Eigen::Vector2i(0, 600);
  expectError<std::invalid_argument>([&] { importGeometry(files, options); }, { "--image_size", "16384" });
  options = withPitch();
  options.point = Eigen::Vector3d(0.0, std::nan(""), 0.0);
  expectError<std::invalid_argument>([&] { importGeometry(files, options); }, { "--point", "finite" });
  options = withPitch();
  options.names = { "a" };
  expectError<std::invalid_argument>([&] { importGeometry(files, options); }, { "--names has 1" });
  options.names = { "a", "a" };
  expectError<std::runtime_error>([&] { importGeometry(files, options); }, { "second detector 'a'" });
  options = withPitch();
  options.flip_rows = { "detector_c" };
  expectError<std::invalid_argument>([&] { importGeometry(files, options); }, { "--flip_rows: 'detector_c'" });
  options = withPitch();
  options.pixel_pitch = Eigen::Vector2d(0.3, 0.4);
  expectError<std::runtime_error>([&] { importGeometry(files, options); }, { "0.3 x 0.4", "to 1 %" });
}
}  // namespace
}  // namespace xray_tracking
