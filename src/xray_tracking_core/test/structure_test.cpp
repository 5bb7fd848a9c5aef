#include "xray_tracking_core/plan/structure.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "rt_samples.h"
#include "shared_data.h"
#include "test_helpers.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_core/volume/target_mask.h"

namespace xray_tracking
{
namespace
{
const Eigen::Vector3d kCentre(-31.0, 120.5, -540.0);
constexpr double kThickness = 2.0;

/// CT axes: axial, coronal with a flip, oblique.
std::vector<Eigen::Matrix3d> directions()
{
  const Eigen::Matrix3d coronal = (Eigen::Matrix3d() << 1, 0, 0, 0, 0, 1, 0, -1, 0).finished();
  return { Eigen::Matrix3d::Identity(), Eigen::Vector3d(1, -1, -1).asDiagonal(), coronal,
           Eigen::AngleAxisd(0.6, Eigen::Vector3d(1, 2, -3).normalized()).toRotationMatrix() };
}

VolumeGrid gridOf(const Eigen::Matrix3d& direction)
{
  VolumeGrid grid;
  grid.size = { 71, 67, 41 };
  grid.patient_from_index.linear() = direction * Eigen::Vector3d(0.9, 1.0, kThickness).asDiagonal();
  grid.patient_from_index.translation() = kCentre - grid.patient_from_index.linear() * Eigen::Vector3d(35, 33, 20);
  return grid;
}

/// Radius of a ball's cross-section; below 0: none.
double sectionOf(double radius, double distance)
{
  return radius > std::abs(distance) ? std::sqrt(radius * radius - distance * distance) : -1.0;
}

/// A body of revolution about the slices' normal, drawn on every slice of the grid.
/// @param radii of a slice by its distance from the centre [mm], outer to inner: XOR of their circles
using Radii = std::function<std::vector<double>(double)>;

std::vector<SampleContour> drawn(const VolumeGrid& grid, const Radii& radii, bool keyhole = false)
{
  const Eigen::Matrix3d axes = grid.patient_from_index.linear().colwise().normalized();
  const Eigen::Vector3d normal = axes.col(0).cross(axes.col(1));
  std::vector<SampleContour> contours;
  for (int k = 0; k < grid.size.z(); ++k)
  {
    const double distance = normal.dot(grid.patient_from_index * Eigen::Vector3d(0, 0, k) - kCentre);
    SampleContour joined_contour;
    for (const double radius : radii(distance))
    {
      if (radius <= 0.0)
      {
        continue;
      }
      std::vector<Eigen::Vector3d> points = circle(kCentre + distance * normal, radius, axes.col(0), axes.col(1));
      if (!keyhole)
      {
        contours.push_back({ points });
        continue;
      }
      // There, round, and back by the same way.
      points.push_back(points.front());
      if (!joined_contour.points.empty())
      {
        std::reverse(points.begin(), points.end());
      }
      joined_contour.points.insert(joined_contour.points.end(), points.begin(), points.end());
    }
    if (keyhole && !joined_contour.points.empty())
    {
      contours.push_back(joined_contour);
    }
  }
  return contours;
}

class StructureTest : public testing::Test
{
protected:
  Structure read(const std::vector<SampleRoi>& rois, const std::string& name = "bone",
                 const DicomElements& others = {}) const
  {
    folder_.write("rs.dcm", structureSetFile(rois, others));
    return Structure::read({ folder_.path("rs.dcm"), name });
  }

  void expectRefused(const std::vector<SampleRoi>& rois, std::vector<std::string> parts,
                     const DicomElements& others = {}) const
  {
    parts.insert(parts.begin(), folder_.path("rs.dcm"));
    expectError<std::runtime_error>([&] { read(rois, "bone", others); }, parts);
  }

  /// Every voxel whose centre is not on an edge (0.01 mm: 360 points, four decimals) against the circles.
  static void expectInside(const CtVolume& labels, const Radii& radii)
  {
    const Eigen::Matrix3d axes = labels.grid.patient_from_index.linear().colwise().normalized();
    const Eigen::Vector3d normal = axes.col(0).cross(axes.col(1));
    int wrong = 0;
    std::size_t n = 0;
    for (int k = 0; k < labels.grid.size.z(); ++k)
    {
      for (int j = 0; j < labels.grid.size.y(); ++j)
      {
        for (int i = 0; i < labels.grid.size.x(); ++i)
        {
          const int label = labels.hu[n++];
          const Eigen::Vector3d from_centre = labels.grid.patient_from_index * Eigen::Vector3d(i, j, k) - kCentre;
          const double distance = normal.dot(from_centre);
          const double across = (from_centre - distance * normal).norm();
          bool inside = false, edge = false;
          for (const double radius : radii(distance))
          {
            inside = inside != (across < radius);
            edge = edge || (radius > 0.0 && std::abs(across - radius) < 0.01);
          }
          wrong += !edge && label != (inside ? 1 : 0) ? 1 : 0;
        }
      }
    }
    EXPECT_EQ(wrong, 0);
  }

  TemporaryFolder folder_;
};

const Radii kBall = [](double distance) { return std::vector<double>{ sectionOf(20.5, distance) }; };
const Radii kShell = [](double distance) {
  return std::vector<double>{ sectionOf(20.5, distance), sectionOf(12.5, distance) };
};
/// A ball within the hole of a shell.
const Radii kNested = [](double distance) {
  return std::vector<double>{ sectionOf(24.5, distance), sectionOf(15.5, distance), sectionOf(6.5, distance) };
};

double volumeOf(const CtVolume& labels)
{
  return static_cast<double>(std::count(labels.hu.begin(), labels.hu.end(), 1)) *
         std::abs(labels.grid.patient_from_index.linear().determinant());
}

TEST_F(StructureTest, BallShellAndNestedInEveryDirection)
{
  for (const Eigen::Matrix3d& direction : directions())
  {
    SCOPED_TRACE(testing::Message() << "direction\n" << direction);
    const VolumeGrid grid = gridOf(direction);
    for (const Radii& radii : { kBall, kShell, kNested })
    {
      expectInside(read({ { 3, "other", {} }, { 7, "bone", drawn(grid, radii) } }).labels(grid), radii);
      expectInside(read({ { 7, "bone", drawn(grid, radii, true) } }).labels(grid), radii);
    }
    // A slab of a slice is as thick as the slices are apart: it adds or lacks what the cross-section changes by within
    // half of it, which adds up to at most the largest cross-section times the thickness.
    const auto ball = [](double radius) { return 4.0 / 3.0 * M_PI * radius * radius * radius; };
    const double off = M_PI * 20.5 * 20.5 * kThickness;
    EXPECT_NEAR(volumeOf(read({ { 7, "bone", drawn(grid, kBall) } }).labels(grid)), ball(20.5), off);
    EXPECT_NEAR(volumeOf(read({ { 7, "bone", drawn(grid, kShell) } }).labels(grid)), ball(20.5) - ball(12.5), off);
  }
}

TEST_F(StructureTest, BoxInEveryDirection)
{
  for (const Eigen::Matrix3d& direction : directions())
  {
    SCOPED_TRACE(testing::Message() << "direction\n" << direction);
    const VolumeGrid grid = gridOf(direction);
    const Eigen::AlignedBox3d box = read({ { 1, "bone", drawn(grid, kBall) } }).box();
    for (int axis = 0; axis < 3; ++axis)
    {
      // Discs of half a slice's thickness to either side of their planes.
      const double along = std::abs(direction.col(2)[axis]), across = std::sqrt(std::max(0.0, 1.0 - along * along));
      double reach = 0.0;
      for (int k = -20; k <= 20; ++k)
      {
        const double radius = sectionOf(20.5, k * kThickness);
        reach = radius > 0.0 ? std::max(reach, along * (k + 0.5) * kThickness + across * radius) : reach;
      }
      EXPECT_NEAR(box.max()[axis], kCentre[axis] + reach, 0.002);
      EXPECT_NEAR(box.min()[axis], kCentre[axis] - reach, 0.002);
    }
  }
}

TEST_F(StructureTest, TwoBlobsOnASlice)
{
  const VolumeGrid grid = gridOf(Eigen::Matrix3d::Identity());
  std::vector<SampleContour> contours;
  const Eigen::Vector3d x(1, 0, 0), y(0, 1, 0);
  for (int k = 15; k < 25; ++k)
  {
    const Eigen::Vector3d middle(kCentre.x(), kCentre.y(), (grid.patient_from_index * Eigen::Vector3d(0, 0, k)).z());
    contours.push_back({ circle(middle - 15.0 * x, 9.0, x, y), "CLOSEDPLANAR_XOR" });
    contours.push_back({ circle(middle + 12.0 * x, 6.0, x, y), "CLOSEDPLANAR_XOR" });
    contours.push_back({ { middle, middle + x } });  // encloses nothing
  }
  const CtVolume labels = read({ { 1, "bone", contours } }).labels(grid);
  const auto at = [&](const Eigen::Vector3d& from_centre)
  {
    const Eigen::Vector3i index =
        (grid.patient_from_index.inverse() * (kCentre + from_centre)).array().round().cast<int>();
    return labels.hu[grid.offset(index.x(), index.y(), index.z())];
  };
  EXPECT_EQ(at({ -15, 0, 0 }), 1);
  EXPECT_EQ(at({ 12, 0, 0 }), 1);
  EXPECT_EQ(at({ 0, 0, 0 }), 0);
  EXPECT_EQ(at({ 12, 0, 12 }), 0);
  // Ten slices; an area of n voxels' centres is off by less than its rim of one voxel.
  EXPECT_NEAR(volumeOf(labels), M_PI * (81.0 + 36.0) * 10 * kThickness, 0.02 * M_PI * 117.0 * 10 * kThickness);
}

TEST_F(StructureTest, TiltedGantryAndSlicesLeftOut)
{
  VolumeGrid tilted = gridOf(Eigen::Matrix3d::Identity());
  tilted.patient_from_index.linear().col(2).y() = 0.7;
  tilted.patient_from_index.translation() = kCentre - tilted.patient_from_index.linear() * Eigen::Vector3d(35, 33, 20);
  expectInside(read({ { 1, "bone", drawn(tilted, kShell) } }).labels(tilted), kShell);

  // On every second slice: those in between are filled; half the last distance beside the ends.
  const VolumeGrid grid = gridOf(Eigen::Matrix3d::Identity());
  const Eigen::Vector3d x(1, 0, 0), y(0, 1, 0), z(0, 0, 1);
  const auto disc = [&](double distance) { return SampleContour{ circle(kCentre + distance * z, 10.0, x, y) }; };
  const Structure every_second = read({ { 1, "bone", { disc(-4), disc(0), disc(4), disc(8) } } });
  EXPECT_NEAR(every_second.box().min().z(), kCentre.z() - 6.0, 1e-9);
  EXPECT_NEAR(every_second.box().max().z(), kCentre.z() + 10.0, 1e-9);
  const double of_disc = volumeOf(read({ { 1, "bone", { disc(0), disc(2) } } }).labels(grid)) / 2.0;
  EXPECT_NEAR(volumeOf(every_second.labels(grid)), 8.0 * of_disc, 1e-6);
  // Two parts, far apart: nothing in between.
  EXPECT_NEAR(volumeOf(read({ { 1, "bone", { disc(-20), disc(-18), disc(-16), disc(10), disc(12) } } }).labels(grid)),
              5.0 * of_disc, 1e-6);
}

TEST_F(StructureTest, OnePlane)
{
  const Eigen::Vector3d x(1, 0, 0), y(0, 1, 0);
  expectRefused({ { 1, "bone", { { circle(kCentre, 10.0, x, y) } } } }, { "'bone'", "one plane", "(3006,0044)" });
  const Structure structure =
      read({ { 1,
               "bone",
               { { circle(kCentre, 10.0, x, y), "CLOSED_PLANAR", { { { 0x3006, 0x0044 }, { "DS", "3" } } } } } } });
  EXPECT_NEAR(structure.box().sizes().z(), 3.0, 1e-9);
}

TEST_F(StructureTest, TargetMaskOfIt)
{
  const VolumeGrid grid = gridOf(Eigen::Matrix3d::Identity());
  const CtVolume labels = read({ { 1, "bone", drawn(grid, kBall) } }).labels(grid);
  const TargetMask mask = targetMaskFromLabels(grid, labels, 1);
  EXPECT_EQ(mask.values[mask.grid.offset(mask.grid.size.x() / 2, mask.grid.size.y() / 2, mask.grid.size.z() / 2)],
            1.0f);
}

TEST_F(StructureTest, Refused)
{
  const VolumeGrid grid = gridOf(Eigen::Matrix3d::Identity());
  const std::vector<SampleContour> ball = drawn(grid, kBall);
  const Eigen::Vector3d x(1, 0, 0), y(0, 1, 0), z(0, 0, 1);
  const auto with = [&](const SampleContour& contour)
  {
    std::vector<SampleContour> contours = ball;
    contours.push_back(contour);
    return std::vector<SampleRoi>{ { 1, "bone", contours } };
  };
  const auto data = [&](const std::string& values, const std::string& count = "3")
  {
    return with({ circle(kCentre, 5.0, x, y, 3),
                  "CLOSED_PLANAR",
                  { { { 0x3006, 0x0050 }, { "DS", values } }, { { 0x3006, 0x0046 }, { "IS", count } } } });
  };
  read({ { 1, "bone", ball } });

  expectRefused({ { 1, "PTV", ball }, { 2, "GTV", {} } }, { "(3006,0026)", "'bone'", "'PTV', 'GTV'" });
  expectRefused({ { 1, "bone", ball }, { 2, "bone", ball } }, { "2 structures", "'bone'", "ROINumber 1 and 2" });
  expectRefused({ { 1, "bone", {} } }, { "'bone'", "no contours", "(3006,0040)" });
  expectRefused({}, { "(3006,0020)", "absent or empty" });
  expectRefused({ { 1, "bone", ball } }, { "'bone'", "no contours" }, { { { 0x3006, 0x0039 }, { "", "" } } });
  expectRefused({ { 1, "bone", ball }, { 1, "twin", ball } }, { "ROINumber 1", "2 items", "(3006,0039)" });
  const std::string next = "contour " + std::to_string(ball.size() + 1);
  expectRefused(with({ { kCentre }, "POINT" }), { next, "(3006,0042) is POINT", "CLOSED_PLANAR" });
  expectRefused(with({ circle(kCentre, 5.0, x, y), "OPEN_PLANAR" }), { next, "OPEN_PLANAR" });
  expectRefused(with({ circle(kCentre, 5.0, x, y), "OPEN_NONPLANAR" }), { next, "OPEN_NONPLANAR" });

  expectRefused(data("0\\0\\0\\1\\0\\0\\1\\1"), { next, "(3006,0050) has 8 numbers", "(3006,0046) 3" });
  expectRefused(data("0\\0\\0\\1\\0\\0\\1\\1\\0", "4"), { next, "9 numbers", "(3006,0046) 4" });
  expectRefused(data("0\\0\\0\\1\\nan\\0\\1\\1\\0"), { next, "(3006,0050)", "nan", "expected numbers" });
  expectRefused(data("0\\0\\0\\1\\\\0\\1\\1\\0"), { next, "(3006,0050)", "expected numbers" });
  expectRefused(data("0\\0\\0\\1,5\\0\\0\\1\\1\\0"), { next, "1,5", "expected numbers" });
  expectRefused(data("0\\0\\0\\1e300\\0\\0\\1\\1\\0"), { next, "1e+300", "expected mm" });
  expectRefused(data(""), { next, "(3006,0050) is absent or empty" });
  expectRefused(with({ circle(kCentre, 5.0, x, y), "CLOSED_PLANAR", { { { 0x3006, 0x0045 }, { "DS", "0\\0\\5" } } } }),
                { next, "(3006,0045)", "0\\0\\5" });

  expectRefused(with({ circle(kCentre, 5.0, x, z) }), { next, "thick along the normal", "parallel planes" });
  expectRefused(with({ circle(kCentre + 10.0 * z + 8.0 * x, 17.0, x, y) }), { "overlap in part", "hole" });
  expectRefused(with({ circle(kCentre, 20.55, x, y) }), { "twice", "hole" });
  expectRefused({ { 1, "bone", { { circle(kCentre, 5.0, x, y) }, { circle(kCentre + 12.0 * z, 5.0, x, y) } } } },
                { "12 mm apart", "expected at most 10" });
  expectRefused({ { 1,
                    "bone",
                    { { circle(kCentre, 5.0, x, y) },
                      { circle(kCentre + 0.15 * z, 4.0, x, y) },
                      { circle(kCentre + 0.3 * z, 5.0, x, y) } } } },
                { "on one plane or on two" });
  expectRefused({ { 1, "bone", { { { kCentre, kCentre + x } } } } }, { "enclose nothing" });
  expectRefused({ { 1, "bone", ball, { { { 0x3006, 0x0024 }, { "UI", "" } } } } }, { "(3006,0024) is absent" });

  expectRefused({ { 1, "bone", ball } }, { "(0008,0060) is RTPLAN, a treatment plan", "expected RTSTRUCT" },
                { { { 8, 0x0060 }, { "CS", "RTPLAN" } } });
  expectRefused({ { 1, "bone", ball } }, { "(0008,0016)", "1.2.3" }, { { { 8, 0x0016 }, { "UI", "1.2.3" } } });
  folder_.write("rs.dcm", ctSliceFile(grid, 0));
  expectError<std::runtime_error>(
      [&] {
        Structure::read({ folder_.path("rs.dcm"), "bone" });
      },
      { "rs.dcm", "(0008,0060) is CT", "RTSTRUCT" });
  folder_.write("rs.dcm", "text");
  expectError<std::runtime_error>(
      [&] {
        Structure::read({ folder_.path("rs.dcm"), "bone" });
      },
      { "rs.dcm", "not a DICOM file", "expected DICOM RTSTRUCT" });
  expectError<std::runtime_error>(
      [&] {
        Structure::read({ folder_.path("no.dcm"), "bone" });
      },
      { "no.dcm", "no such file" });
  expectError<std::runtime_error>([&] { Structure::read({ folder_.path(), "bone" }); }, { "not a file" });
}

TEST_F(StructureTest, CutAnywhereItIsRefused)
{
  const Eigen::Vector3d x(1, 0, 0), y(0, 1, 0), z(0, 0, 1);
  const std::string whole = structureSetFile(
      { { 1, "bone", { { circle(kCentre, 5.0, x, y, 4) }, { circle(kCentre + 2.0 * z, 5.0, x, y, 4) } } } });
  folder_.write("rs.dcm", whole);
  Structure::read({ folder_.path("rs.dcm"), "bone" });
  for (std::size_t size = 0; size < whole.size(); ++size)
  {
    folder_.write("rs.dcm", whole.substr(0, size));
    expectError<std::runtime_error>([&] { Structure::read({ folder_.path("rs.dcm"), "bone" }); }, { "rs.dcm" });
  }
}

TEST_F(StructureTest, NamesOfOtherCharacterSets)
{
  const VolumeGrid grid = gridOf(Eigen::Matrix3d::Identity());
  const DicomElements latin{ { { 8, 0x0005 }, { "CS", "ISO_IR 100" } } };
  EXPECT_EQ(read({ { 1, "Wirbelk\xF6rper", drawn(grid, kBall) } }, "Wirbelk\xC3\xB6rper", latin).choice().roi,
            "Wirbelk\xC3\xB6rper");
  const DicomElements unicode{ { { 8, 0x0005 }, { "CS", "ISO_IR 192" } } };
  read({ { 1, "Wirbelk\xC3\xB6rper", drawn(grid, kBall) } }, "Wirbelk\xC3\xB6rper", unicode);
}

/// Implicit VR, sequences and items without lengths, contours longer than an explicit DS can be: as planning systems
/// write them.
TEST_F(StructureTest, ImplicitVr)
{
  const auto number = [](std::size_t value) { return bytesOf({ static_cast<std::uint32_t>(value) }); };
  const auto element = [&](int group, int tag, std::string value)
  {
    value += value.size() % 2 == 0 ? "" : " ";
    return us(group) + us(tag) + number(value.size()) + value;
  };
  const auto item = [&](const std::string& data)
  { return us(0xFFFE) + us(0xE000) + number(0xFFFFFFFF) + data + us(0xFFFE) + us(0xE00D) + number(0); };
  const auto sequence = [&](int tag, const std::string& items)
  { return us(0x3006) + us(tag) + number(0xFFFFFFFF) + items + us(0xFFFE) + us(0xE0DD) + number(0); };
  constexpr int kPoints = 5000;
  std::string contours;
  for (const double z : { 0.0, 2.0 })
  {
    std::vector<double> values;
    for (const Eigen::Vector3d& point : circle(kCentre + z * Eigen::Vector3d::UnitZ(), 20.0, Eigen::Vector3d::UnitX(),
                                               Eigen::Vector3d::UnitY(), kPoints))
    {
      values.insert(values.end(), point.data(), point.data() + 3);
    }
    contours += item(element(0x3006, 0x0042, "CLOSED_PLANAR") + element(0x3006, 0x0046, std::to_string(kPoints)) +
                     element(0x3006, 0x0050, joined(values)));
  }
  folder_.write("rs.dcm", std::string(128, '\0') + "DICM" +
                              dicomData({ { { 2, 0x0010 }, { "UI", "1.2.840.10008.1.2" } } }) +
                              element(8, 0x0016, "1.2.840.10008.5.1.4.1.1.481.3") + element(8, 0x0060, "RTSTRUCT") +
                              sequence(0x0020, item(element(0x3006, 0x0022, "1") + element(0x3006, 0x0024, kFrameUid) +
                                                    element(0x3006, 0x0026, "bone"))) +
                              sequence(0x0039, item(sequence(0x0040, contours) + element(0x3006, 0x0084, "1"))));
  const Eigen::AlignedBox3d box = Structure::read({ folder_.path("rs.dcm"), "bone" }).box();
  EXPECT_LT((box.center() - kCentre - Eigen::Vector3d::UnitZ()).norm(), 1e-3);
  EXPECT_LT((box.sizes() - Eigen::Vector3d(40, 40, 4)).norm(), 1e-3);
}

/// Whatever bytes are in it, it is read or refused, and no more memory taken than the file has.
TEST_F(StructureTest, ChangedBytes)
{
  const Eigen::Vector3d x(1, 0, 0), y(0, 1, 0), z(0, 0, 1);
  const std::string whole = structureSetFile(
      { { 1, "bone", { { circle(kCentre, 5.0, x, y, 4) }, { circle(kCentre + 2.0 * z, 5.0, x, y, 4) } } } });
  std::mt19937 random(7);
  int refused = 0;
  for (int n = 0; n < 600; ++n)
  {
    std::string bytes = whole;
    for (int changes = n % 3; changes >= 0; --changes)
    {
      bytes[132 + random() % (bytes.size() - 132)] = static_cast<char>(random() % 256);
    }
    folder_.write("rs.dcm", bytes);
    try
    {
      EXPECT_TRUE(Structure::read({ folder_.path("rs.dcm"), "bone" }).box().sizes().allFinite());
    }
    catch (const std::runtime_error& error)
    {
      ++refused;
      EXPECT_NE(std::string(error.what()).find("rs.dcm"), std::string::npos) << error.what();
    }
  }
  EXPECT_GT(refused, 300);
}

/// A CT in the folder, a structure set beside its slices and a setup.
class TargetOfSetup : public StructureTest
{
protected:
  void SetUp() override
  {
    grid_ = gridOf(directions().back());
    writeCt(kFrameUid);
    folder_.write("ct/rs.dcm", structureSetFile({ { 1, "bone", drawn(grid_, kBall) },
                                                  { 2, "point", { { { kCentre }, "POINT" } } } }));
  }

  void writeCt(const std::string& frame) const
  {
    std::filesystem::create_directories(folder_.path("ct"));
    for (int k = 0; k < grid_.size.z(); ++k)
    {
      folder_.write("ct/" + std::to_string(k) + ".dcm", ctSliceFile(grid_, k, frame));
    }
  }

  std::string write(const std::string& target, const std::string& ct = "ct: ct\n") const
  {
    folder_.write("setup.yaml", ct + target + R"(
initial_pose: { translation_mm: [0, 0, 0], rotation_xyzw: [0, 0, 0, 1] }
detectors:
  - { name: a, image_size: [9, 9], pixel_pitch_mm: [1, 1], source_mm: [0, 0, 500], origin_mm: [-4, 4, -500],
      x_direction: [1, 0, 0], y_direction: [0, -1, 0] }
  - { name: b, image_size: [9, 9], pixel_pitch_mm: [1, 1], source_mm: [500, 0, 0], origin_mm: [-500, -4, 4],
      x_direction: [0, 1, 0], y_direction: [0, 0, -1] }
)");
    return folder_.path("setup.yaml");
  }

  void expectRefusedSetup(const std::string& target, std::vector<std::string> parts,
                          const std::string& ct = "ct: ct\n") const
  {
    parts.insert(parts.begin(), "setup.yaml");
    expectError<std::runtime_error>([&] { loadTreatmentSetup(write(target, ct)); }, parts);
  }

  VolumeGrid grid_;
};

const std::string kTarget = "target: { rtstruct: ct/rs.dcm, roi: bone }\n";

TEST_F(TargetOfSetup, IsTheStructuresBox)
{
  const Eigen::AlignedBox3d box = Structure::read({ folder_.path("ct/rs.dcm"), "bone" }).box();
  const TreatmentSetup setup = loadTreatmentSetup(write(kTarget));
  EXPECT_TRUE(setup.target_box.isApprox(box));
  EXPECT_NEAR((setup.targetCentre() - kCentre).norm(), 0.0, 0.001);
  ASSERT_TRUE(setup.target_structure);
  EXPECT_EQ(setup.target_structure->file, folder_.path("ct/rs.dcm"));

  saveTreatmentSetup(setup, folder_.path("saved.yaml"));
  const TreatmentSetup saved = loadTreatmentSetup(folder_.path("saved.yaml"));
  EXPECT_TRUE(saved.target_box.isApprox(box));
  ASSERT_TRUE(saved.target_structure);
  EXPECT_EQ(saved.target_structure->roi, "bone");

  // The text of a setup says the same where there is no structure set.
  const std::string text = selfContainedSetup(folder_.path("setup.yaml"));
  std::filesystem::remove(folder_.path("ct/rs.dcm"));
  EXPECT_TRUE(treatmentSetupFromText(text, "text").target_box.isApprox(box)) << text;
}

TEST_F(TargetOfSetup, Refused)
{
  expectRefusedSetup("", { "target_box_mm is missing" });
  expectRefusedSetup("target: { rtstruct: ct/rs.dcm }\n", { "target.roi is missing" });
  expectRefusedSetup("target: { roi: bone }\n", { "target.rtstruct is missing" });
  expectRefusedSetup("target: { rtstruct: ct/rs.dcm, roi: bones }\n",
                     { "line 2", "target", folder_.path("ct/rs.dcm"), "'bones'", "'bone', 'point'" });
  expectRefusedSetup("target: { rtstruct: ct/0.dcm, roi: bone }\n", { "0.dcm", "is CT", "RTSTRUCT" });
  expectRefusedSetup(kTarget + "target_box_mm: { min: [-51, 100.5, -560], max: [-11, 140.5, -519] }\n",
                     { "target_box_mm", "bone", "alone" });
  expectRefusedSetup(kTarget, { "target", "ct as well" }, "");
  expectRefusedSetup(kTarget, { "neither", "no such file or folder" }, "ct: neither\n");
  folder_.write("ct.nrrd", "NRRD0004\n");
  expectRefusedSetup(kTarget, { "ct.nrrd", "no DICOM", "target_box_mm" }, "ct: ct.nrrd\n");

  writeCt("1.2.3.10");
  expectRefusedSetup(kTarget, { "rs.dcm", "'bone'", "1.2.3.9,", "1.2.3.10", folder_.path("ct"), "another scan" });
  folder_.write("ct/7.dcm", ctSliceFile(grid_, 7, kFrameUid));
  expectRefusedSetup(kTarget, { "7.dcm", "(0020,0052)", "1.2.3.9", "1.2.3.10", "the same of all slices" });
  writeCt("");
  expectRefusedSetup(kTarget, { "(0020,0052) is absent" });
  grid_.patient_from_index.translation().x() += 500.0;
  writeCt(kFrameUid);
  expectRefusedSetup(kTarget, { "it reaches from", "expected a structure within it" });
}

using RealStructure = SharedDataTest;

/// The volume of GTV-1 that 25 groups agreed on is 358,000 +- 5,000 mm^3 (IBSI reference manual, configuration A).
TEST_F(RealStructure, OfIbsi)
{
  const Structure structure = Structure::read({ folder_ + "/rtstruct/structure_set/DCM_RS_00060.dcm", "GTV-1" });
  const CtFrame ct = readCtFrame(folder_ + "/rtstruct/ct");
  structure.requireOn(ct);
  EXPECT_NEAR(volumeOf(structure.labels(ct.grid)), 358e3, 5e3);
  expectError<std::runtime_error>([&] { structure.requireOn(CtFrame{ "other", ct.grid, "1.2.3" }); }, { "1.2.3" });
}
}  // namespace
}  // namespace xray_tracking
