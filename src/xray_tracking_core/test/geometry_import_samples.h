#pragma once

#include <cmath>
#include <iomanip>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "dicom_samples.h"
#include "test_helpers.h"
#include "xray_tracking_core/geometry/geometry_import.h"

namespace xray_tracking
{
using Matrix34 = Eigen::Matrix<double, 3, 4>;

constexpr double kPi = 3.14159265358979323846;

/// Elementary rotations by their entries: Eigen's AngleAxis is what the import uses.
inline Eigen::Matrix3d rotationX(double degrees)
{
  const double c = std::cos(degrees * kPi / 180.0), s = std::sin(degrees * kPi / 180.0);
  return (Eigen::Matrix3d() << 1, 0, 0, 0, c, -s, 0, s, c).finished();
}

inline Eigen::Matrix3d rotationY(double degrees)
{
  const double c = std::cos(degrees * kPi / 180.0), s = std::sin(degrees * kPi / 180.0);
  return (Eigen::Matrix3d() << c, 0, s, 0, 1, 0, -s, 0, c).finished();
}

inline Eigen::Matrix3d rotationZ(double degrees)
{
  const double c = std::cos(degrees * kPi / 180.0), s = std::sin(degrees * kPi / 180.0);
  return (Eigen::Matrix3d() << c, -s, 0, s, c, 0, 0, 0, 1).finished();
}

/// Cameras that look at the middle of the room from `degrees` about y, tilted; fx != fy, rectangular, off centre.
struct TestCamera
{
  Eigen::Vector2i size{ 800, 600 };
  Eigen::Matrix3d camera;
  Eigen::Matrix3d rotation;
  Eigen::Vector3d translation{ 12.5, -7.25, 1100.0 };

  explicit TestCamera(double degrees, double skew = 0.0)
  {
    camera << 4210.5, skew, 365.25, 0.0, 4198.25, 331.75, 0.0, 0.0, 1.0;
    rotation = rotationX(8.0) * rotationY(degrees) * rotationZ(-5.0);
  }

  Matrix34 matrix() const
  {
    Matrix34 extrinsics;
    extrinsics << rotation, translation;
    return camera * extrinsics;
  }

  std::string mayaCam() const
  {
    std::ostringstream text;
    const Eigen::IOFormat rows(17, Eigen::DontAlignCols, ",", "\n");
    text << std::setprecision(17) << "image size\n"
         << size.x() << "," << size.y() << "\n\ncamera matrix\n"
         << camera.format(rows) << "\n\nrotation\n"
         << rotation.format(rows) << "\n\ntranslation\n"
         << translation.x() << "\n"
         << translation.y() << "\n"
         << translation.z() << "\n";
    return text.str();
  }
};

inline std::string textOf(const Matrix34& matrix)
{
  std::ostringstream text;
  text << matrix.format(Eigen::IOFormat(17, Eigen::DontAlignCols, " ", "\n")) << "\n";
  return text.str();
}

inline GeometryImportOptions withPitch(double pitch = 0.3)
{
  GeometryImportOptions options;
  options.pixel_pitch = Eigen::Vector2d(pitch, pitch);
  return options;
}

inline GeometryImportOptions ofMatrices()
{
  GeometryImportOptions options = withPitch();
  options.image_size = Eigen::Vector2i(800, 600);
  return options;
}

class GeometryImport : public testing::Test
{
protected:
  std::string write(const std::string& name, const std::string& text) const
  {
    folder_.write(name, text);
    return folder_.path(name);
  }

  TemporaryFolder folder_;
};

/// The nine parameters of RTK.
struct RtkParameters
{
  double sid, sdd, gantry, out_of_plane, in_plane, source_x, source_y, projection_x, projection_y;

  /// RTK's documentation, "Final Matrix", entry by entry.
  Matrix34 matrix() const
  {
    Eigen::Matrix4d rotation = Eigen::Matrix4d::Identity();
    rotation.topLeftCorner<3, 3>() = rotationZ(-in_plane) * rotationX(-out_of_plane) * rotationY(-gantry);
    Eigen::Matrix4d to_source = Eigen::Matrix4d::Identity();
    to_source(0, 3) = -source_x;
    to_source(1, 3) = -source_y;
    Matrix34 magnification = Matrix34::Zero();
    magnification(0, 0) = magnification(1, 1) = -sdd;
    magnification(2, 2) = 1.0;
    magnification(2, 3) = -sid;
    Eigen::Matrix3d to_panel = Eigen::Matrix3d::Identity();
    to_panel(0, 2) = source_x - projection_x;
    to_panel(1, 2) = source_y - projection_y;
    return to_panel * magnification * to_source * rotation;
  }

  std::string xml(bool with_matrix) const
  {
    std::ostringstream text;
    text << std::setprecision(15) << "  <Projection>\n    <GantryAngle>" << gantry << "</GantryAngle>\n";
    text << "    <OutOfPlaneAngle>" << out_of_plane << "</OutOfPlaneAngle>\n    <InPlaneAngle>" << in_plane
         << "</InPlaneAngle>\n    <SourceOffsetX>" << source_x << "</SourceOffsetX>\n    <SourceOffsetY>" << source_y
         << "</SourceOffsetY>\n    <ProjectionOffsetX>" << projection_x << "</ProjectionOffsetX>\n"
         << "    <ProjectionOffsetY>" << projection_y << "</ProjectionOffsetY>\n";
    if (with_matrix)
    {
      text << "    <Matrix>\n" << matrix().format(Eigen::IOFormat(15)) << "\n    </Matrix>\n";
    }
    text << "  </Projection>\n";
    return text.str();
  }
};

inline std::string rtkFile(const std::string& content)
{
  return "<?xml version=\"1.0\"?>\n<!DOCTYPE RTKGEOMETRY>\n<RTKThreeDCircularGeometry version=\"3\">\n" + content +
         "</RTKThreeDCircularGeometry>\n";
}

inline GeometryImportOptions ofRtk(const std::vector<int>& projections)
{
  GeometryImportOptions options;
  options.image_size = Eigen::Vector2i(512, 384);
  options.pixel_pitch = Eigen::Vector2d(0.8, 0.776);
  options.projections = projections;
  options.flip_rows = { "detector_a", "detector_b" };
  return options;
}

inline std::string dicom(const DicomElements& more)
{
  DicomElements elements{ { { 0x0008, 0x0016 }, { "UI", "1.2.840.10008.5.1.4.1.1.12.1" } },
                          { { 0x0008, 0x0018 }, { "UI", "1.2.3.4" } },
                          { { 0x0028, 0x0010 }, { "US", us(300) } },
                          { { 0x0028, 0x0011 }, { "US", us(400) } } };
  for (const auto& [tag, element] : more)
  {
    elements[tag] = element;
  }
  return dicomFile(elements);
}

inline DicomElements angiography(const std::string& primary, const std::string& secondary)
{
  return { { { 0x0008, 0x0060 }, { "CS", "XA" } },    { { 0x0018, 0x1110 }, { "DS", "1200" } },
           { { 0x0018, 0x1111 }, { "DS", "780.5" } }, { { 0x0018, 0x1164 }, { "DS", "0.4\\0.5" } },
           { { 0x0018, 0x1510 }, { "DS", primary } }, { { 0x0018, 0x1511 }, { "DS", secondary } } };
}

inline DicomElements portal(const std::string& gantry)
{
  return { { { 0x0008, 0x0060 }, { "CS", "RTIMAGE" } },
           { { 0x3002, 0x000c }, { "CS", "NORMAL" } },
           { { 0x3002, 0x000d }, { "DS", "12\\-20\\-500" } },
           { { 0x3002, 0x000e }, { "DS", "7.5" } },
           { { 0x3002, 0x0010 }, { "DS", "1\\0\\0\\0\\-1\\0" } },
           { { 0x3002, 0x0011 }, { "DS", "0.4\\0.5" } },
           { { 0x3002, 0x0012 }, { "DS", "-90.5\\61.25" } },
           { { 0x3002, 0x0022 }, { "DS", "1000" } },
           { { 0x3002, 0x0026 }, { "DS", "1500" } },
           { { 0x300a, 0x011e }, { "DS", gantry } } };
}

inline std::string detectorText(const DetectorDescription& d)
{
  std::ostringstream text;
  const Eigen::IOFormat list(17, Eigen::DontAlignCols, ", ", ", ", "", "", "[", "]");
  text << "- {name: " << d.name << ", image_size: " << d.image_size.format(list)
       << ", pixel_pitch_mm: " << d.pixel_pitch.format(list) << ", source_mm: " << d.source.format(list)
       << ", origin_mm: " << d.origin.format(list) << ", x_direction: " << d.x_direction.format(list)
       << ", y_direction: " << d.y_direction.format(list) << "}\n";
  return text.str();
}

/// Right: from z = 1000 mm down, and from y = 1000 mm.
inline std::vector<DetectorDescription> twoDetectors()
{
  return { { "top", { 400, 300 }, { 0.5, 0.4 }, { 0, 0, 1000 }, { -100, 60, -500 }, { 1, 0, 0 }, { 0, -1, 0 } },
           { "side", { 400, 300 }, { 0.5, 0.4 }, { 0, 1000, 0 }, { -100, -500, -60 }, { 1, 0, 0 }, { 0, 0, 1 } } };
}
}  // namespace xray_tracking
