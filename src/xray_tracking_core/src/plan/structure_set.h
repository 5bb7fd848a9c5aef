#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "xray_tracking_core/plan/structure_choice.h"

namespace xray_tracking
{
struct DrawnContour
{
  int number;                           ///< in the file, from 1
  std::vector<Eigen::Vector3d> points;  ///< three or more, LPS [mm]
};

/// A structure as it is drawn: closed contours in any order.
struct DrawnStructure
{
  std::string uid;                 ///< SOPInstanceUID of the structure set
  std::string patient_id;          ///< PatientID; may be empty
  std::string frame_of_reference;  ///< FrameOfReferenceUID that the contours are in
  std::vector<DrawnContour> contours;
  double slab_thickness = 0.0;  ///< ContourSlabThickness [mm]; 0: not told
};

/// @throws std::runtime_error as Structure::read(), of what the file itself says
DrawnStructure readDrawnStructure(const StructureChoice& choice);

/// With backslashes between them, as DICOM has it.
std::string numbersText(const std::vector<double>& values);
}  // namespace xray_tracking
