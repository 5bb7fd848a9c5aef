#pragma once

#include <cmath>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "dicom_samples.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
inline const std::string kFrameUid = "1.2.3.9";
inline const std::string kStructureSetUid = "1.2.3.77";

inline std::string joined(const std::vector<double>& values, int decimals = 4)
{
  std::string text;
  for (const double value : values)
  {
    char number[40];
    std::snprintf(number, sizeof(number), "%.*f", decimals, value);
    text += (text.empty() ? "" : "\\") + std::string(number);
  }
  return text;
}

inline std::string pointText(const Eigen::Vector3d& point)
{
  return joined(std::vector<double>{ point.x(), point.y(), point.z() });
}

struct SampleContour
{
  std::vector<Eigen::Vector3d> points;
  std::string type = "CLOSED_PLANAR";
  DicomElements others = {};  ///< in the place of what the points give
};

struct SampleRoi
{
  int number;
  std::string name;
  std::vector<SampleContour> contours;
  DicomElements others = {};  ///< of its item in StructureSetROISequence
};

inline DicomElements changed(DicomElements elements, const DicomElements& others)
{
  for (const auto& [tag, element] : others)
  {
    elements[tag] = element;
  }
  return elements;
}

/// @param others of the file; an element without a VR is left out
inline std::string structureSetFile(const std::vector<SampleRoi>& rois, const DicomElements& others = {})
{
  std::string names, contours;
  for (const SampleRoi& roi : rois)
  {
    names += dicomItem(changed({ { { 0x3006, 0x0022 }, { "IS", std::to_string(roi.number) } },
                                 { { 0x3006, 0x0024 }, { "UI", kFrameUid } },
                                 { { 0x3006, 0x0026 }, { "LO", roi.name } } },
                               roi.others));
    std::string drawn;
    for (const SampleContour& contour : roi.contours)
    {
      std::vector<double> values;
      for (const Eigen::Vector3d& point : contour.points)
      {
        values.insert(values.end(), point.data(), point.data() + 3);
      }
      drawn += dicomItem(changed({ { { 0x3006, 0x0042 }, { "CS", contour.type } },
                                   { { 0x3006, 0x0046 }, { "IS", std::to_string(contour.points.size()) } },
                                   { { 0x3006, 0x0050 }, { "DS", joined(values) } } },
                                 contour.others));
    }
    contours += dicomItem(
        { { { 0x3006, 0x0040 }, { "SQ", drawn } }, { { 0x3006, 0x0084 }, { "IS", std::to_string(roi.number) } } });
  }
  DicomElements elements = changed({ { { 8, 0x0016 }, { "UI", "1.2.840.10008.5.1.4.1.1.481.3" } },
                                     { { 8, 0x0018 }, { "UI", kStructureSetUid } },
                                     { { 8, 0x0060 }, { "CS", "RTSTRUCT" } },
                                     { { 0x3006, 0x0020 }, { "SQ", names } },
                                     { { 0x3006, 0x0039 }, { "SQ", contours } } },
                                   others);
  for (auto element = elements.begin(); element != elements.end();)
  {
    element = element->second.first.empty() ? elements.erase(element) : std::next(element);
  }
  return dicomFile(elements);
}

struct SampleBeam
{
  int number = 1;
  Eigen::Vector3d isocentre = Eigen::Vector3d::Zero();
  double couch = 0.0;
  double gantry = 0.0;
  DicomElements others = {};  ///< of the first control point
  DicomElements later = {};   ///< of the second
  std::optional<int> setup = 1;
};

/// @param positions by PatientSetupNumber, from 1
inline std::string planFile(const std::vector<SampleBeam>& beams, const std::vector<std::string>& positions = { "HFS" },
                            const DicomElements& others = {})
{
  std::string beam_items, setups;
  for (const SampleBeam& beam : beams)
  {
    const std::string points = dicomItem(changed({ { { 0x300a, 0x011e }, { "DS", joined({ beam.gantry }) } },
                                                   { { 0x300a, 0x0122 }, { "DS", joined({ beam.couch }) } },
                                                   { { 0x300a, 0x012c }, { "DS", pointText(beam.isocentre) } } },
                                                 beam.others)) +
                               dicomItem(changed({ { { 0x300a, 0x0112 }, { "IS", "1" } } }, beam.later));
    DicomElements item{ { { 0x300a, 0x00c0 }, { "IS", std::to_string(beam.number) } },
                        { { 0x300a, 0x00c2 }, { "LO", "field " + std::to_string(beam.number) } },
                        { { 0x300a, 0x0111 }, { "SQ", points } } };
    if (beam.setup)
    {
      item[{ 0x300c, 0x006a }] = { "IS", std::to_string(*beam.setup) };
    }
    beam_items += dicomItem(item);
  }
  for (std::size_t n = 0; n < positions.size(); ++n)
  {
    setups += dicomItem(
        { { { 0x0018, 0x5100 }, { "CS", positions[n] } }, { { 0x300a, 0x0182 }, { "IS", std::to_string(n + 1) } } });
  }
  return dicomFile(changed({ { { 8, 0x0016 }, { "UI", "1.2.840.10008.5.1.4.1.1.481.5" } },
                             { { 8, 0x0018 }, { "UI", "1.2.3.88" } },
                             { { 8, 0x0060 }, { "CS", "RTPLAN" } },
                             { { 0x20, 0x0052 }, { "UI", kFrameUid } },
                             { { 0x300a, 0x00b0 }, { "SQ", beam_items } },
                             { { 0x300a, 0x0180 }, { "SQ", setups } } },
                           others));
}

/// A slice of a CT, all water; columns, rows and slices along the grid's i, j and k.
inline std::string ctSliceFile(const VolumeGrid& grid, int k, const std::string& frame = kFrameUid)
{
  const Eigen::Vector3d x = grid.patient_from_index.linear().col(0).normalized();
  const Eigen::Vector3d y = grid.patient_from_index.linear().col(1).normalized();
  DicomElements elements{
    { { 8, 0x0016 }, { "UI", "1.2.840.10008.5.1.4.1.1.2" } },
    { { 8, 0x0018 }, { "UI", "1.2.3.4." + std::to_string(k) } },
    { { 8, 0x0060 }, { "CS", "CT" } },
    { { 0x20, 0x000e }, { "UI", "1.2.3.4" } },
    { { 0x20, 0x0032 }, { "DS", pointText(grid.patient_from_index * Eigen::Vector3d(0, 0, k)) } },
    { { 0x20, 0x0037 }, { "DS", joined({ x.x(), x.y(), x.z(), y.x(), y.y(), y.z() }, 9) } },
    { { 0x20, 0x0052 }, { "UI", frame } },
    { { 0x28, 0x0002 }, { "US", us(1) } },
    { { 0x28, 0x0004 }, { "CS", "MONOCHROME2" } },
    { { 0x28, 0x0010 }, { "US", us(grid.size.y()) } },
    { { 0x28, 0x0011 }, { "US", us(grid.size.x()) } },
    { { 0x28, 0x0030 }, { "DS", joined({ grid.spacing().y(), grid.spacing().x() }) } },
    { { 0x28, 0x0100 }, { "US", us(16) } },
    { { 0x28, 0x0101 }, { "US", us(16) } },
    { { 0x28, 0x0102 }, { "US", us(15) } },
    { { 0x28, 0x0103 }, { "US", us(1) } },
    { { 0x7fe0, 0x0010 }, { "OW", std::string(2 * static_cast<std::size_t>(grid.size.x()) * grid.size.y(), '\0') } }
  };
  if (frame.empty())
  {
    elements.erase({ 0x20, 0x0052 });
  }
  return dicomFile(elements);
}

/// Points of a circle about `centre` in the plane of two orthonormal axes.
inline std::vector<Eigen::Vector3d> circle(const Eigen::Vector3d& centre, double radius, const Eigen::Vector3d& x,
                                           const Eigen::Vector3d& y, int count = 360)
{
  std::vector<Eigen::Vector3d> points;
  for (int n = 0; n < count; ++n)
  {
    const double angle = 2.0 * M_PI * (n + 0.37) / count;  // not on a row of voxels
    points.push_back(centre + radius * (std::cos(angle) * x + std::sin(angle) * y));
  }
  return points;
}
}  // namespace xray_tracking
