#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include "geometry_import_samples.h"
#include "shared_data.h"
#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
namespace
{
constexpr double kExact = 1e-6;  // px

/// Points around the middle of the room [mm].
std::vector<Eigen::Vector3d> points()
{
  std::mt19937 random(7);
  std::uniform_real_distribution<double> coordinate(-80.0, 80.0);
  std::vector<Eigen::Vector3d> points(30);
  for (Eigen::Vector3d& point : points)
  {
    point = { coordinate(random), coordinate(random), coordinate(random) };
  }
  return points;
}

/// Pixels of a projection matrix, as it is defined.
Eigen::Vector2d pixelOf(const Matrix34& matrix, const Eigen::Vector3d& point)
{
  const Eigen::Vector4d p(point.x(), point.y(), point.z(), 1.0);
  return { matrix.row(0).dot(p) / matrix.row(2).dot(p), matrix.row(1).dot(p) / matrix.row(2).dot(p) };
}

template <typename Project>
void expectSame(const ProjectionGeometry& detector, Project project, double tolerance = kExact)
{
  for (const Eigen::Vector3d& point : points())
  {
    const Eigen::Vector2d expected = project(point);
    const Eigen::Vector2d found = detector.project(point);
    EXPECT_NEAR(expected.x(), found.x(), tolerance) << detector.name();
    EXPECT_NEAR(expected.y(), found.y(), tolerance) << detector.name();
  }
}

TEST_F(GeometryImport, mayaCam)
{
  const TestCamera a(20.0), b(110.0);
  std::string other_ends = b.mayaCam();  // another machine's line ends
  for (std::size_t n = 0; (n = other_ends.find('\n', n)) != std::string::npos; n += 2)
  {
    other_ends.replace(n, 1, "\r\n");
  }
  const auto imported = importGeometry({ write("a.txt", a.mayaCam()), write("b.txt", other_ends) }, withPitch());
  ASSERT_EQ(2U, imported.detectors.size());
  for (std::size_t n = 0; n < 2; ++n)
  {
    const TestCamera& camera = n == 0 ? a : b;
    const ProjectionGeometry& detector = imported.detectors[n];
    EXPECT_EQ(camera.size, detector.imageSize());
    EXPECT_NEAR(0.3, detector.pixelPitch().x(), 1e-12);
    EXPECT_NEAR(0.3 * 4210.5, detector.sourceToDetector(), 1e-9);
    expectSame(detector,
               [&](const Eigen::Vector3d& point)
               {
                 const Eigen::Vector3d p = camera.rotation * point + camera.translation;
                 return Eigen::Vector2d(4210.5 * p.x() / p.z() + 365.25, 4198.25 * p.y() / p.z() + 331.75);
               });
  }
  EXPECT_EQ("detector_b", imported.detectors[1].name());
}

class SharedWrist : public SharedDataTest
{
};

TEST_F(SharedWrist, mayaCamsAsSomebodyElseReadThem)
{
  const std::string calibration = folder_ + "/wrist_biplane/calibration/xr_calib_wrist_cam0";
  const auto imported = importGeometry({ calibration + "1.txt", calibration + "2.txt" }, withPitch(0.2));
  const auto expected = loadDetectors(folder_ + "/sequences/wrist_real/sequence.yaml");
  for (std::size_t n = 0; n < 2; ++n)
  {
    EXPECT_LT((imported.detectors[n].source() - expected[n].source()).norm(), 1e-5);
    EXPECT_LT((imported.detectors[n].origin() - expected[n].origin()).norm(), 1e-5);
    // The sequence has 9 digits.
    expectSame(
        imported.detectors[n], [&](const Eigen::Vector3d& point) { return expected[n].project(point); }, 1e-4);
  }
}

TEST_F(GeometryImport, matricesOfAnyScaleAndSign)
{
  const TestCamera a(-15.0), b(75.0);
  for (const double scale : { 1.0, -1.0, 3e-4, -250.0 })
  {
    const auto imported = importGeometry(
        { write("a.txt", textOf(scale * a.matrix())), write("b.txt", textOf(b.matrix())) }, ofMatrices());
    expectSame(imported.detectors[0], [&](const Eigen::Vector3d& point) { return pixelOf(a.matrix(), point); });
    expectSame(imported.detectors[1], [&](const Eigen::Vector3d& point) { return pixelOf(b.matrix(), point); });
  }
}

TEST_F(GeometryImport, matricesInOneFileAsPeopleWriteThem)
{
  const TestCamera a(-15.0), b(75.0);
  std::ostringstream text;
  text << "# two views\n[[" << a.matrix().format(Eigen::IOFormat(17, Eigen::DontAlignCols, ", ", "],\n [")) << "]]\n\n"
       << b.matrix().format(Eigen::IOFormat(17, Eigen::DontAlignCols, ";", ";"));  // 12 a line
  GeometryImportOptions options = ofMatrices();
  options.pixel_pitch.reset();
  options.source_to_detector = 1400.0;
  const auto imported = importGeometry({ write("both.txt", text.str()) }, options);
  ASSERT_EQ(2U, imported.detectors.size());
  EXPECT_NEAR(1400.0, imported.detectors[1].sourceToDetector(), 1e-9);
  EXPECT_NEAR(1400.0 / 4198.25, imported.detectors[1].pixelPitch().y(), 1e-12);
  expectSame(imported.detectors[0], [&](const Eigen::Vector3d& point) { return pixelOf(a.matrix(), point); });
  expectSame(imported.detectors[1], [&](const Eigen::Vector3d& point) { return pixelOf(b.matrix(), point); });
}

/// What was done to the first view's matrix: the images' columns and rows turned about, its sign.
class Handedness : public GeometryImport, public testing::WithParamInterface<std::tuple<bool, bool, double>>
{
};

TEST_P(Handedness, isRightOrRefusedWithWhatMendsIt)
{
  const auto [columns, rows, sign] = GetParam();
  const TestCamera a(30.0), b(-60.0);
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  if (columns)
  {
    turn.row(0) << -1.0, 0.0, 799.0;
  }
  if (rows)
  {
    turn.row(1) << 0.0, -1.0, 599.0;
  }
  const Matrix34 matrix = sign * turn * a.matrix();
  const std::vector<std::string> files{ write("a.txt", textOf(matrix)), write("b.txt", textOf(b.matrix())) };
  GeometryImportOptions options = ofMatrices();
  if (columns == rows)  // as it is, or turned by half
  {
    expectSame(importGeometry(files, options).detectors[0],
               [&](const Eigen::Vector3d& point) { return pixelOf(turn * a.matrix(), point); });
    return;
  }
  expectError<std::runtime_error>([&] { importGeometry(files, options); },
                                  { "a.txt", "left-handed", "--flip_rows detector_a", "--flip_columns detector_a" });
  options.flip_columns = { "detector_a" };
  expectSame(importGeometry(files, options).detectors[0],
             [&](const Eigen::Vector3d& point)
             {
               const Eigen::Vector2d pixel = pixelOf(matrix, point);
               return Eigen::Vector2d(799.0 - pixel.x(), pixel.y());
             });
  options.flip_columns.clear();
  options.flip_rows = { "detector_a" };
  expectSame(importGeometry(files, options).detectors[0],
             [&](const Eigen::Vector3d& point)
             {
               const Eigen::Vector2d pixel = pixelOf(matrix, point);
               return Eigen::Vector2d(pixel.x(), 599.0 - pixel.y());
             });
}

INSTANTIATE_TEST_SUITE_P(All, Handedness,
                         testing::Combine(testing::Bool(), testing::Bool(), testing::Values(1.0, -1.0)));

TEST_F(GeometryImport, skewIsLeftOutAndToldOrRefused)
{
  const TestCamera b(75.0);
  const auto files = [&](double skew) {
    return std::vector<std::string>{ write("a.txt", TestCamera(-15.0, skew).mayaCam()), write("b.txt", b.mayaCam()) };
  };
  // 331.7 px from the foot to the farthest edge: 4 * 331.7 / 4198.25 = 0.316 px.
  const auto imported = importGeometry(files(4.0), withPitch());
  EXPECT_NE(std::string::npos, imported.remarks[0].find("a skew of 0.316")) << imported.remarks[0];
  expectSame(
      imported.detectors[0],
      [&](const Eigen::Vector3d& point) { return pixelOf(TestCamera(-15.0, 4.0).matrix(), point); }, 0.32);
  expectError<std::runtime_error>([&] { importGeometry(files(8.0), withPitch()); },
                                  { "a.txt", "skewed", "0.63", "0.5" });
}

TEST_F(GeometryImport, unitsAndWhatNoRoomHas)
{
  TestCamera a(-15.0), b(75.0);
  a.translation /= 1000.0;
  b.translation /= 1000.0;
  const std::vector<std::string> files{ write("a.txt", a.mayaCam()), write("b.txt", b.mayaCam()) };
  expectError<std::runtime_error>([&] { importGeometry(files, withPitch()); }, { "a.txt", "in metres?", "--unit m" });
  GeometryImportOptions options = withPitch();
  options.unit = 1000.0;
  const TestCamera in_mm(-15.0);
  expectSame(importGeometry(files, options).detectors[0],
             [&](const Eigen::Vector3d& point) { return pixelOf(in_mm.matrix(), point); });
  a.translation *= 100.0;
  b.translation *= 100.0;
  expectError<std::runtime_error>(
      [&] {
        importGeometry({ write("a.txt", a.mayaCam()), write("b.txt", b.mayaCam()) }, withPitch());
      },
      { "in centimetres?", "--unit m or cm" });
  // The panel would be at 421 mm, the patient is at 1100 mm.
  expectError<std::runtime_error>(
      [&] {
        importGeometry({ write("a.txt", in_mm.mayaCam()), write("b.txt", TestCamera(75.0).mayaCam()) }, withPitch(0.1));
      },
      { "nearer than", "more than 0.26" });
  expectError<std::runtime_error>(
      [&] {
        importGeometry({ write("a.txt", in_mm.mayaCam()), write("b.txt", TestCamera(75.0).mayaCam()) }, withPitch(300));
      },
      { "is the pitch in mm?" });
}

TEST_F(GeometryImport, theCamerasPoseForItsInverse)
{
  TestCamera a(-15.0), b(75.0);
  for (TestCamera* camera : { &a, &b })
  {
    camera->translation = -camera->rotation.transpose() * camera->translation;
    camera->rotation.transposeInPlace();
  }
  expectError<std::runtime_error>(
      [&] {
        importGeometry({ write("a.txt", a.mayaCam()), write("b.txt", b.mayaCam()) }, withPitch());
      },
      { "camera to room", "invert" });
}

TEST_F(GeometryImport, aPointDecidesWhereRaysDoNotMeet)
{
  // Side by side: parallel rays through the middles.
  TestCamera a(0.0), b(0.0);
  b.translation.x() += 100.0;
  const std::vector<std::string> files{ write("a.txt", textOf(-a.matrix())), write("b.txt", textOf(b.matrix())) };
  expectError<std::runtime_error>([&] { importGeometry(files, ofMatrices()); }, { "parallel", "--point" });
  GeometryImportOptions options = ofMatrices();
  options.point = Eigen::Vector3d(-10.0, 0.0, 0.0);
  expectSame(importGeometry(files, options).detectors[0],
             [&](const Eigen::Vector3d& point) { return pixelOf(a.matrix(), point); });
  options.point = Eigen::Vector3d(900.0, 0.0, 0.0);
  expectError<std::invalid_argument>([&] { importGeometry(files, options); }, { "--point", "900" });
}

/// Pixel of images stored from the largest v down, whose middle is RTK's origin.
Eigen::Vector2d rtkPixel(const Matrix34& matrix, const Eigen::Vector3d& point)
{
  const Eigen::Vector2d mm = pixelOf(matrix, point);
  return { mm.x() / 0.8 + 255.5, 383.0 - (mm.y() / 0.776 + 191.5) };
}

TEST_F(GeometryImport, rtkOfObliqueProjections)
{
  const RtkParameters a{ 1000.0, 1536.0, 31.5, 12.25, -7.5, 3.5, -8.25, 21.0, -13.5 };
  const RtkParameters unused{ 1000.0, 1536.0, 200.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 };
  const RtkParameters b{ 1000.0, 1536.0, 283.0, -20.5, 15.0, -4.0, 6.0, -117.0, 9.0 };
  const std::string file =
      write("geometry.xml", rtkFile("  <SourceToIsocenterDistance>1000</SourceToIsocenterDistance>\n"
                                    "  <SourceToDetectorDistance>1536</SourceToDetectorDistance>\n" +
                                    a.xml(true) + unused.xml(false) + b.xml(true)));
  const auto imported = importGeometry({ file }, ofRtk({ 0, 2 }));
  ASSERT_EQ(2U, imported.detectors.size());
  EXPECT_NEAR(1536.0, imported.detectors[0].sourceToDetector(), 1e-9);
  expectSame(imported.detectors[0], [&](const Eigen::Vector3d& point) { return rtkPixel(a.matrix(), point); });
  expectSame(imported.detectors[1], [&](const Eigen::Vector3d& point) { return rtkPixel(b.matrix(), point); });

  GeometryImportOptions as_stored = ofRtk({ 0, 2 });
  as_stored.flip_rows.clear();
  expectError<std::runtime_error>([&] { importGeometry({ file }, as_stored); },
                                  { "projection 0", "left-handed", "--flip_rows detector_a detector_b" });
}

/// The example of RTK's documentation, without its cylindrical detector.
TEST_F(GeometryImport, rtkAsItsOwnWriterDoes)
{
  const std::string head =
      "<SourceToIsocenterDistance>1000</SourceToIsocenterDistance>"
      "<SourceToDetectorDistance>1536</SourceToDetectorDistance>";
  const std::string first =
      "<Projection><GantryAngle>271.847274780273</GantryAngle><ProjectionOffsetX>-117.056503295898</ProjectionOffsetX>"
      "<ProjectionOffsetY>-1.01195001602173</ProjectionOffsetY><Matrix>\n"
      " -166.5093078829 0 -1531.42837748039 -117056.503295898\n"
      " -1.01142410874151 -1536 0.0326206557691505 -1011.95001602173\n"
      " -0.999480303105996 0 0.0322354417240802 -1000\n</Matrix></Projection>";
  const std::string second =
      "<Projection><GantryAngle>0</GantryAngle><ProjectionOffsetX>0</ProjectionOffsetX>"
      "<ProjectionOffsetY>0</ProjectionOffsetY></Projection>";
  Matrix34 matrix;
  matrix << -166.5093078829, 0, -1531.42837748039, -117056.503295898, -1.01142410874151, -1536, 0.0326206557691505,
      -1011.95001602173, -0.999480303105996, 0, 0.0322354417240802, -1000;
  const auto imported = importGeometry({ write("g.xml", rtkFile(head + first + second)) }, ofRtk({ 0, 1 }));
  expectSame(imported.detectors[0], [&](const Eigen::Vector3d& point) { return rtkPixel(matrix, point); });

  const std::string cylinder = "<RadiusCylindricalDetector>1536</RadiusCylindricalDetector>";
  expectError<std::runtime_error>(
      [&] {
        importGeometry({ write("g.xml", rtkFile(head + cylinder + first + second)) }, ofRtk({ 0, 1 }));
      },
      { "g.xml, line 4: RadiusCylindricalDetector", "1536", "flat panel" });
  std::string other = first;
  other.replace(other.find("271.8"), 5, "270.8");
  expectError<std::runtime_error>(
      [&] {
        importGeometry({ write("g.xml", rtkFile(head + other + second)) }, ofRtk({ 0, 1 }));
      },
      { "g.xml, line 4: Matrix", "the parameters make" });
}

TEST_F(GeometryImport, positionerAnglesOfAngiography)
{
  const double angles[2][2] = { { -31.0, 17.0 }, { 58.5, -24.0 } };
  std::vector<std::string> files;
  for (const auto& [primary, secondary] : angles)
  {
    files.push_back(write("xa" + std::to_string(files.size()) + ".dcm",
                          dicom(angiography(std::to_string(primary), std::to_string(secondary)))));
  }
  GeometryImportOptions options;
  expectError<std::runtime_error>([&] { importGeometry(files, options); },
                                  { "xa0.dcm", "left-handed", "--flip_columns detector_a detector_b" });
  options.flip_columns = { "detector_a", "detector_b" };
  const auto imported = importGeometry(files, options);
  for (std::size_t n = 0; n < 2; ++n)
  {
    // A frontal C-arm in axes left, posterior, superior, tilted towards the head, then turned towards the left: the
    // detector's axes as a viewer in front of the patient has them are left, inferior.
    const Eigen::Matrix3d turned = rotationZ(angles[n][0]) * rotationX(-angles[n][1]);
    const Eigen::Vector3d source = turned * Eigen::Vector3d(0.0, 780.5, 0.0);
    const Eigen::Vector3d panel = turned * Eigen::Vector3d(0.0, 780.5 - 1200.0, 0.0);
    const Eigen::Vector3d normal = turned * Eigen::Vector3d(0.0, -1.0, 0.0);
    expectSame(imported.detectors[n],
               [&](const Eigen::Vector3d& room)
               {
                 // docs/frames.md: room x is superior, y right, z anterior.
                 const Eigen::Vector3d point(-room.y(), -room.z(), room.x());
                 const Eigen::Vector3d hit =
                     source + (point - source) * (panel - source).dot(normal) / (point - source).dot(normal) - panel;
                 const double column = hit.dot(turned * Eigen::Vector3d(1.0, 0.0, 0.0)) / 0.5 + 199.5;
                 const double row = hit.dot(turned * Eigen::Vector3d(0.0, 0.0, -1.0)) / 0.4 + 149.5;
                 return Eigen::Vector2d(399.0 - column, row);
               });
  }
  // In the flipped frontal image what is left in the patient is left: it is seen from the source, behind him.
  EXPECT_LT(imported.detectors[0].project({ 0.0, -30.0, 0.0 }).x(), imported.detectors[0].project({ 0, 0, 0 }).x());
}

TEST_F(GeometryImport, positionerImagesThatAreMirroredAlready)
{
  DicomElements frontal = angiography("0", "0"), lateral = angiography("90", "0");
  frontal[{ 0x0020, 0x0020 }] = { "CS", "R\\F" };
  lateral[{ 0x0020, 0x0020 }] = { "CS", "A\\F" };
  const std::vector<std::string> files{ write("f.dcm", dicom(frontal)), write("l.dcm", dicom(lateral)) };
  // Left is -y, anterior z, superior x in the room.
  const auto imported = importGeometry(files, {});
  EXPECT_LT((imported.detectors[0].xDirection() - Eigen::Vector3d(0, 1, 0)).norm(), 1e-9);
  EXPECT_LT((imported.detectors[0].source() - Eigen::Vector3d(0, 0, -780.5)).norm(), 1e-9);
  EXPECT_LT((imported.detectors[1].xDirection() - Eigen::Vector3d(0, 0, 1)).norm(), 1e-9);
  EXPECT_LT((imported.detectors[1].source() - Eigen::Vector3d(0, 780.5, 0)).norm(), 1e-9);
  lateral[{ 0x0020, 0x0020 }] = { "CS", "L\\F" };
  expectError<std::runtime_error>(
      [&] {
        importGeometry({ files[0], write("l.dcm", dicom(lateral)) }, {});
      },
      { "l.dcm", "PatientOrientation is L\\F", "90" });
}

TEST_F(GeometryImport, rtImages)
{
  const double gantry[2] = { 340.0, 90.0 };
  const auto imported =
      importGeometry({ write("0.dcm", dicom(portal("340"))), write("1.dcm", dicom(portal("90"))) }, {});
  for (std::size_t n = 0; n < 2; ++n)
  {
    expectSame(imported.detectors[n],
               [&](const Eigen::Vector3d& room)
               {
                 // docs/frames.md; then into the gantry's system, turned back, and to the plane 500 mm below.
                 const Eigen::Vector3d fixed(-room.y(), room.x(), room.z());
                 const Eigen::Vector3d p = rotationY(-gantry[n]) * fixed;
                 const Eigen::Vector3d hit = Eigen::Vector3d(p.x(), p.y(), 0.0) * 1500.0 / (1000.0 - p.z());
                 const Eigen::Vector3d receptor = rotationZ(-7.5) * (hit - Eigen::Vector3d(12.0, -20.0, 0.0));
                 return Eigen::Vector2d((receptor.x() + 90.5) / 0.5, (61.25 - receptor.y()) / 0.4);
               });
  }
  // IEC 61217: the source of a gantry at 90 degrees is at the left of a supine patient, head first: -y in the room.
  EXPECT_LT((imported.detectors[1].source() - Eigen::Vector3d(0, -1000, 0)).norm(), 1e-9);

  DicomElements scaled = portal("340");
  scaled[{ 0x3002, 0x0026 }] = { "DS", "1400" };
  expectError<std::runtime_error>(
      [&] {
        importGeometry({ write("0.dcm", dicom(scaled)), folder_.path("1.dcm") }, {});
      },
      { "0.dcm", "XRayImageReceptorTranslation", "-500", "-400" });
}

TEST_F(GeometryImport, detectorsAsTheyAre)
{
  const auto write_list = [&](const std::vector<DetectorDescription>& list)
  { return write("list.yaml", "detectors:\n" + detectorText(list[0]) + detectorText(list[1])); };
  auto list = twoDetectors();
  const auto imported = importGeometry({ write_list(list) }, {});
  EXPECT_EQ("side", imported.detectors[1].name());
  EXPECT_LT((imported.detectors[0].origin() - list[0].origin).norm(), 1e-9);

  // Mirrored, with the flip that makes it what it was.
  list[0].origin.y() = 60.0 - 299 * 0.4;
  list[0].y_direction = -list[0].y_direction;
  const std::string mirrored = write_list(list);
  expectError<std::runtime_error>([&] { importGeometry({ mirrored }, {}); },
                                  { "list.yaml, line 2: detectors[0]", "left-handed", "--flip_rows top" });
  GeometryImportOptions options;
  options.flip_rows = { "top" };
  const auto flipped = importGeometry({ mirrored }, options);
  expectSame(flipped.detectors[0], [&](const Eigen::Vector3d& point) { return imported.detectors[0].project(point); });

  // Source and panel swapped; metres.
  list = twoDetectors();
  for (DetectorDescription& d : list)
  {
    const Eigen::Vector3d middle = d.origin + d.x_direction * 199.5 * 0.5 + d.y_direction * 149.5 * 0.4;
    d.origin += d.source - middle;
    d.source = middle;
  }
  expectError<std::runtime_error>([&] { importGeometry({ write_list(list) }, {}); },
                                  { "source and panel are swapped", "all views see 500", "swap them. Else" });
  list = twoDetectors();
  for (DetectorDescription& d : list)
  {
    d.source /= 1000.0;
    d.origin /= 1000.0;
    d.pixel_pitch /= 1000.0;
  }
  expectError<std::runtime_error>([&] { importGeometry({ write_list(list) }, {}); }, { "list.yaml", "in metres?" });
}

TEST_F(GeometryImport, roundTripThroughASetupWhoseOtherKeysAreKept)
{
  const TestCamera a(20.0), b(110.0);
  const auto imported = importGeometry({ write("a.txt", a.mayaCam()), write("b.txt", b.mayaCam()) }, withPitch());
  std::filesystem::create_directories(folder_.path("other"));
  const std::string setup = write("setup.yaml",
                                  "ct: ct.nrrd\ncomment: kept\ndetectors: old.yaml\n"
                                  "initial_pose: {translation_mm: [0.1, 2, 3], rotation_xyzw: [0, 0, 0, 1]}\n"
                                  "target_box_mm: {min: [-1, -1, -1], max: [1, 1, 1]}\n");
  const std::string out = folder_.path("other/out.yaml");
  writeDetectors(imported, out, setup);
  const TreatmentSetup read = loadTreatmentSetup(out);
  EXPECT_EQ(folder_.path("ct.nrrd"), read.ct_path);
  EXPECT_EQ(0.1, read.room_from_patient.translation().x());
  for (std::size_t n = 0; n < 2; ++n)
  {
    expectSame(
        read.detectors[n], [&](const Eigen::Vector3d& point) { return imported.detectors[n].project(point); }, 1e-9);
  }
  std::stringstream text;
  text << std::ifstream(out).rdbuf();
  EXPECT_NE(std::string::npos, text.str().find("comment: kept"));
  // What was written can be imported again.
  const auto again = importGeometry({ out }, {}).detectors;
  EXPECT_LT((again[1].origin() - imported.detectors[1].origin()).norm(), 1e-9);
}

/// Where OpenCV's model puts a point of the ideal image.
Eigen::Vector2d distorted(const TestCamera& camera, const std::vector<double>& d, const Eigen::Vector2d& pixel)
{
  const double x = (pixel.x() - camera.camera(0, 2)) / camera.camera(0, 0);
  const double y = (pixel.y() - camera.camera(1, 2)) / camera.camera(1, 1);
  const double r2 = x * x + y * y, radial = 1.0 + d[0] * r2 + d[1] * r2 * r2;
  return { camera.camera(0, 0) * (x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x)) + camera.camera(0, 2),
           camera.camera(1, 1) * (y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y) + camera.camera(1, 2) };
}

/// An image that grows along columns and rows.
cv::Mat ramp(int along_columns, int along_rows)
{
  cv::Mat image(600, 800, CV_16UC1);
  for (int row = 0; row < image.rows; ++row)
  {
    for (int column = 0; column < image.cols; ++column)
    {
      image.at<std::uint16_t>(row, column) = static_cast<std::uint16_t>(along_columns * column + along_rows * row);
    }
  }
  return image;
}

TEST_F(GeometryImport, distortionIsCarriedAndFlippedWithTheImage)
{
  const TestCamera a(20.0), b(110.0);
  const std::vector<double> d{ 0.9, -0.3, 0.04, -0.06 };
  const std::string with = a.mayaCam() + "\ndistortion\n0.9,-0.3,0.04,-0.06\n";
  const std::vector<std::string> files{ write("a.txt", with), write("b.txt", b.mayaCam() + "distortion\n0,0,0,0,0\n") };
  const std::string out = folder_.path("out.yaml");
  writeDetectors(importGeometry(files, withPitch()), out, "");
  // Both flips: turned by half, which is right-handed; of the list that was written.
  GeometryImportOptions both;
  both.flip_columns = both.flip_rows = { "detector_a" };
  const std::string turned_out = folder_.path("turned.yaml");
  writeDetectors(importGeometry({ out }, both), turned_out, "");
  EXPECT_TRUE(loadDistortions(out, loadDetectors(out))[1].none());
  for (const auto& [file, is_turned] : { std::make_pair(out, false), std::make_pair(turned_out, true) })
  {
    // A ramp in u, and one in v, of the distorted image: undone, a pixel has where it was.
    const cv::Mat u = ramp(80, 0), v = ramp(0, 80);
    const LensDistortion distortion = loadDistortions(file, loadDetectors(file)).front();
    const cv::Mat from_u = distortion.undo(u, IntensityModel::Kind::COUNTS);
    const cv::Mat from_v = distortion.undo(v, IntensityModel::Kind::COUNTS);
    for (const cv::Point& pixel : { cv::Point(100, 80), cv::Point(700, 500), cv::Point(150, 520), cv::Point(365, 331) })
    {
      const Eigen::Vector2d as_written =
          is_turned ? Eigen::Vector2d(799.0 - pixel.x, 599.0 - pixel.y) : Eigen::Vector2d(pixel.x, pixel.y);
      Eigen::Vector2d expected = distorted(a, d, as_written);
      if (is_turned)
      {
        expected = Eigen::Vector2d(799.0, 599.0) - expected;
      }
      // Remapping is to a 32nd of a pixel.
      EXPECT_NEAR(expected.x(), from_u.at<std::uint16_t>(pixel) / 80.0, 0.05) << pixel;
      EXPECT_NEAR(expected.y(), from_v.at<std::uint16_t>(pixel) / 80.0, 0.05) << pixel;
    }
  }
}
/// Both focal lengths negative, and the axes with them, is the same camera; its tangential coefficients are of its
/// axes.
TEST_F(GeometryImport, distortionOfNegativeFocalLengths)
{
  TestCamera a(20.0);
  a.camera.diagonal().head<2>() *= -1.0;
  a.rotation.topRows<2>() *= -1.0;
  a.translation.head<2>() *= -1.0;
  const std::vector<double> d{ 0.9, -0.3, 0.04, -0.06 };
  const std::string out = folder_.path("out.yaml");
  writeDetectors(importGeometry({ write("a.txt", a.mayaCam() + "\ndistortion\n0.9,-0.3,0.04,-0.06\n"),
                                  write("b.txt", TestCamera(110.0).mayaCam()) },
                                withPitch()),
                 out, "");
  const cv::Mat u = ramp(80, 0), v = ramp(0, 80);
  const LensDistortion distortion = loadDistortions(out, loadDetectors(out)).front();
  for (const cv::Point& pixel : { cv::Point(100, 80), cv::Point(700, 500), cv::Point(150, 520) })
  {
    const Eigen::Vector2d expected = distorted(a, d, { pixel.x, pixel.y });
    EXPECT_NEAR(expected.x(), distortion.undo(u, IntensityModel::Kind::COUNTS).at<std::uint16_t>(pixel) / 80.0, 0.05);
    EXPECT_NEAR(expected.y(), distortion.undo(v, IntensityModel::Kind::COUNTS).at<std::uint16_t>(pixel) / 80.0, 0.05);
  }
}

}  // namespace
}  // namespace xray_tracking
