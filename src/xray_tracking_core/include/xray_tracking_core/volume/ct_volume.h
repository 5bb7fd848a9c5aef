#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Geometry>

namespace xray_tracking
{
/// A regular voxel grid in the patient frame (DICOM LPS, mm).
struct VolumeGrid
{
  Eigen::Vector3i size = Eigen::Vector3i::Zero();  ///< voxels along i (fastest), j, k
  /// Continuous voxel index (i, j, k; whole numbers are voxel centres) to patient point [mm]. Holds spacing and
  /// direction, which may be left-handed.
  Eigen::Affine3d patient_from_index = Eigen::Affine3d::Identity();

  std::size_t voxelCount() const
  {
    return static_cast<std::size_t>(size.x()) * static_cast<std::size_t>(size.y()) * static_cast<std::size_t>(size.z());
  }
  std::size_t offset(int i, int j, int k) const
  {
    return (static_cast<std::size_t>(k) * size.y() + j) * static_cast<std::size_t>(size.x()) + i;
  }
  /// Distances of voxel centres along i, j, k [mm].
  Eigen::Vector3d spacing() const { return patient_from_index.linear().colwise().norm(); }
  /// Patient point of the grid's middle [mm].
  Eigen::Vector3d centre() const { return patient_from_index * (0.5 * (size.cast<double>().array() - 1.0)).matrix(); }
  /// Box about the voxels' centres, patient frame [mm].
  Eigen::AlignedBox3d extent() const
  {
    Eigen::AlignedBox3d box;
    for (int corner = 0; corner < 8; ++corner)
    {
      const Eigen::Vector3i upper(corner & 1, corner >> 1 & 1, corner >> 2);
      box.extend(patient_from_index * upper.cwiseProduct((size.array() - 1).matrix()).cast<double>().eval());
    }
    return box;
  }
};

/// A CT in Hounsfield units.
struct CtVolume
{
  VolumeGrid grid;
  std::vector<std::int16_t> hu;  ///< voxelCount() values, i fastest
};

/// Values per voxel on a grid, e.g. linear attenuation [1/mm].
struct ScalarVolume
{
  VolumeGrid grid;
  std::vector<float> values;  ///< voxelCount() values, i fastest
};

/// Which of a NIfTI file's two statements of its axes holds.
enum class NiftiForm
{
  AGREED,  ///< either: they have to be the same where there are both, and without shear
  QFORM,
  SFORM
};

/// What to take where a file or folder holds more than one answer. Nothing is guessed: reading fails and names them.
struct CtChoice
{
  std::string series;  ///< SeriesInstanceUID, or what the list of a refusal has; empty: the only one there is
  NiftiForm nifti_form = NiftiForm::AGREED;
};

/// Reads a CT: a NRRD, MetaImage or NIfTI file, a folder with a DICOM CT series (in sub-folders, too), or a DICOM file
/// of enhanced multi-frame CT. Axes come out as LPS mm whatever the file declares (NRRD: LPS, RAS or LAS, or no space,
/// which is taken for LPS). DICOM files of other modalities, scouts and screenshots are passed over; a tilted gantry
/// gives a sheared grid; PixelPaddingValue becomes air. Values below -1200, by which scanners fill up what they did not
/// scan, are kept. docs/formats_supported.md has all of it.
/// @throws std::runtime_error naming the path and what is wrong: not there, not readable, truncated, not three-
/// dimensional, not in mm, several series or axes and no choice, a slice missing, or values that are not Hounsfield
/// units of a body in air (no voxel between -200 and 200, none between -1200 and -200, or any outside [-32768, 32767]).
CtVolume readCtVolume(const std::string& path, const CtChoice& choice = {});

/// Reads labels on a CT's grid, instead of HU: 0 for the background, others above it.
/// @throws as readCtVolume, but for what values may be: whole numbers, 0 the lowest, at most 200 others
CtVolume readLabelMap(const std::string& path, const CtChoice& choice = {});

/// Writes a CT as NRRD, NIfTI or MetaImage by the file's extension. @throws std::runtime_error naming the path: not
/// writable, another extension, or a sheared grid as NIfTI
void writeCtVolume(const CtVolume& volume, const std::string& path);

/// The centre of the cube of the given edge [mm], along the patient's axes, that holds most bone (HU over 200), its
/// centre in the middle third of the superior-inferior axis: a first guess of a vertebra for a CT of which nothing else
/// is known.
/// @throws std::runtime_error if there is no bone, std::invalid_argument if the edge is less than a voxel
Eigen::Vector3d findBonyTarget(const CtVolume& volume, double edge);
}  // namespace xray_tracking
