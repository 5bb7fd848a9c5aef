#pragma once

#include <array>
#include <atomic>
#include <optional>
#include <string>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "surface_mesh.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_core/volume/ct_content.h"

namespace xray_tracking
{
/// A plane of the CT through the target's centre. Pixel (0, 0)'s centre is `origin`.
struct CtSlice
{
  Eigen::Vector3d origin, column_step, row_step;  ///< patient frame [mm], steps of a pixel
  cv::Mat hu;                                     ///< CV_16SC1
};

/// What a patient's CT looks like, in the patient frame [mm].
struct Anatomy
{
  SurfaceMesh target;             ///< the bone that is followed
  SurfaceMesh rest;               ///< the other ones
  std::array<CtSlice, 3> slices;  ///< sagittal, coronal, axial
};

/// What anatomy is made from.
struct AnatomySource
{
  bool phantom = false;  ///< the neck phantom instead of the setup's CT
  std::string ct_path;
  CtContent content = CtContent::RECOGNISED;
  Eigen::AlignedBox3d target_box;  ///< patient frame [mm]
  CtChoice ct_choice{};
  std::optional<std::string> data_folder{};  ///< where the CT has to be below; nothing: anywhere

  /// Of all that the result hangs on: a file's name, time and size among it, and this code's version. Of a folder, of
  /// all files in it. @throws std::runtime_error naming the path if it is not there
  std::string key() const;
};

/// HU by linear interpolation; -1024 outside of the CT.
/// @param size columns, rows
CtSlice sliceOf(const CtVolume& ct, const Eigen::Vector3d& centre, const Eigen::Vector3d& column_step,
                const Eigen::Vector3d& row_step, const cv::Size& size);

/// Where the patient is in a CT of him: 1 up to some millimetres around the largest body of soft tissue and bone that
/// is no thin shell, 0 elsewhere as at the couch. Coarse.
ScalarVolume bodyOf(const CtVolume& ct);

/// 0 to 255 from level - window / 2 to level + window / 2.
cv::Mat windowed(const cv::Mat& hu, double level, double window);

/// @param stop set by another thread: comes back early with what is no result
/// @throws std::runtime_error as readPatientCt()
Anatomy makeAnatomy(const AnatomySource& source, const std::atomic<bool>& stop);

/// The same from a folder of earlier results, or made and left there. What is damaged there is made anew; a folder that
/// cannot be written to is done without.
Anatomy cachedAnatomy(const AnatomySource& source, const std::string& folder, const std::atomic<bool>& stop);

/// Covariance of a point of the patient from that of (translation [mm], rotation about the fixed axes [rad]).
/// @param arm from the patient frame's origin to the point, room axes [mm]
Eigen::Matrix3d pointCovariance(const Eigen::Matrix<double, 6, 6>& covariance, const Eigen::Vector3d& arm);

/// Of 1, 2, 5, 10, ... 1000: the smallest that makes the length at least the wanted one.
double readableScale(double length, double wanted);
}  // namespace xray_tracking
