#pragma once

#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include "xray_tracking_core/plan/structure_choice.h"
#include "xray_tracking_core/volume/ct_frame.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
struct DrawnContour;

/// A structure of a DICOM RT structure set: closed contours on parallel planes, in any orientation.
///
/// On a plane a point is inside if it lies in an odd number of contours (XOR: holes; keyholes, too). A plane's contours
/// hold for the slab that reaches half way to the planes beside it, where these are at most 1.5 times the usual
/// distance away, else half the usual distance: slices without contours in between are a gap.
class Structure
{
public:
  /// Reads a structure. Contours of fewer than three points enclose nothing and are left out.
  /// @throws std::runtime_error naming file, ROI, contour, tag, value and what was expected: no such ROI (with a list)
  /// or two of that name, no contours, contours other than closed planar ones (POINT, open), numbers that are none or
  /// too many, contours that are not plane or on planes that are not parallel or more than 10 mm apart, a contour twice
  /// or two that overlap in part (union or hole?), one plane alone without ContourSlabThickness
  static Structure read(const StructureChoice& choice);

  const StructureChoice& choice() const { return choice_; }
  /// FrameOfReferenceUID that the contours are in.
  const std::string& frameOfReference() const { return frame_of_reference_; }
  /// SOPInstanceUID of the structure set.
  const std::string& uid() const { return uid_; }
  /// For comparison alone; may be empty.
  const std::string& patientId() const { return patient_id_; }

  /// About the slabs of all planes, patient frame (LPS) [mm].
  Eigen::AlignedBox3d box() const;

  /// 1 for voxels whose centre is inside, else 0.
  /// @throws std::runtime_error naming file and ROI if there is none
  CtVolume labels(const VolumeGrid& grid) const;

  /// @throws std::runtime_error naming both if the CT's frame of reference is another, or the structure is outside of
  /// it
  void requireOn(const CtFrame& ct) const;

private:
  struct Plane
  {
    double offset;        ///< along the normal [mm]
    double lower, upper;  ///< the slab's ends
    std::vector<std::vector<Eigen::Vector2d>> contours;
  };

  [[noreturn]] void fail(const std::string& what) const;
  void setAxes(const std::vector<DrawnContour>& contours);
  void setPlanes(const std::vector<DrawnContour>& contours, double slab_thickness);
  void requireApart(const Plane& plane) const;
  /// What of a row of voxels, `start + n step`, n = 0 to count - 1, is inside: pairs of first n and n behind the last.
  void inside(const Eigen::Vector3d& start, const Eigen::Vector3d& step, int count,
              std::vector<std::pair<int, int>>& runs) const;

  StructureChoice choice_;
  std::string frame_of_reference_;
  std::string uid_;
  std::string patient_id_;
  Eigen::Matrix3d plane_from_patient_;  ///< rows: two axes in the planes, their normal
  std::vector<Plane> planes_;           ///< by offset
};
}  // namespace xray_tracking
