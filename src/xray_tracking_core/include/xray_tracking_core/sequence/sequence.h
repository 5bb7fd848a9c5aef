#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/image/lens_distortion.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// How far the stamps of one exposure may be apart where nothing else is said [s]: what a patient moves by in the
/// meantime is below what tracking sees.
constexpr double kPairingTolerance = 0.005;

/// A pose with its time.
struct StampedPose
{
  std::int64_t stamp_ns = 0;
  RigidTransform room_from_patient = RigidTransform::Identity();
};

/// One exposure: the image file of every detector, in the order of the setup's detectors.
struct Exposure
{
  std::int64_t stamp_ns = 0;
  std::vector<std::string> files;  ///< absolute
};

/// A sequence folder (docs/playback.md): setup, exposures in order of time, and the gold standard where there is one.
struct Sequence
{
  TreatmentSetup setup;
  std::vector<Exposure> exposures;
  std::vector<StampedPose> gold_standard;   ///< empty, or one for each exposure
  std::vector<std::string> tables;          ///< absolute paths of sequence.yaml and what it names but images and CT
  std::vector<LensDistortion> distortions;  ///< of the setup's detectors, in their order

  /// The image that a detector's projection describes: readXrayImage(), undistorted.
  /// @param exposure, detector indices. @return CV_16UC1. @throws std::runtime_error as readXrayImage()
  cv::Mat image(std::size_t exposure, std::size_t detector) const;
};

/// What `distortion` of a setup file's detectors says, {model: plumb_bob or rational_polynomial, coefficients: [...]}.
/// It tells of the images that a sequence's files hold; whoever reads these takes it out, once.
/// @param detectors the file's, as loadTreatmentSetup() reads them. @return one for each, in their order
/// @throws std::runtime_error naming file, key and value, and what LensDistortion says
std::vector<LensDistortion> loadDistortions(const std::string& path, const std::vector<ProjectionGeometry>& detectors);

/// A row of a sequence's table of frames, or what a pattern of files makes one of.
struct FrameRow
{
  std::int64_t stamp_ns = 0;
  std::string detector;
  std::string file;   ///< absolute
  std::string where;  ///< table and line, or the pattern, for messages
};

/// A sequence folder's frames, row by row as they are, also where loadSequence() refuses them: of the table that
/// `frames` names, or of `frames: {rate: Hz, files: {DETECTOR: PATTERN}}`, the k-th file of each pattern at k / rate,
/// by the numbers in their names.
/// @throws std::runtime_error naming the file, the line and what is wrong with the row itself
std::vector<FrameRow> loadFrameTable(const std::string& directory);

/// Path of the table of the gold standard that a sequence folder names; empty if it names none.
/// @throws std::runtime_error if there is no sequence.yaml
std::string goldStandardPath(const std::string& directory);

/// Reads `DIR/sequence.yaml` and the tables it names; images are only looked for, not read. Stamps must be plain
/// decimal numbers ("1699999999.25"; no sign, no exponent) from 0 to less than 2^32 s; digits after the ninth are
/// rounded. Rows of one exposure may differ by `pairing_tolerance` [s] of sequence.yaml (0 to 1, default
/// kPairingTolerance, as motion_estimation's parameter); the exposure's stamp is that of the first detector. The gold
/// standard may have rows between the exposures, which are left out, and tables may have further columns.
/// @throws std::runtime_error naming the file, the line and what is wrong: stamps that do not grow, a detector without
/// an image in an exposure or with two, an unknown detector, a missing image, a pose that is not finite or whose
/// quaternion is not of unit norm, a gold standard without an exposure's stamp.
Sequence loadSequence(const std::string& directory);

/// Reads a table of poses, `stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw` of room_T_patient, as gold_standard.csv is one;
/// stamps as in loadSequence().
/// @throws std::runtime_error naming the file, the line and what is wrong: stamps that do not grow, a pose that is not
/// finite or whose quaternion is not of unit norm
std::vector<StampedPose> loadPoses(const std::string& path);

/// Reads one X-ray image: PNG, TIFF (whole numbers or floating point) or DICOM, one page or frame of grey values.
/// Values are those that the file stores (DICOM: rescaled), whatever it says of their display (MONOCHROME1,
/// MinIsWhite): what they mean is said by `intensity`, with which PixelIntensityRelationship must agree. Line integrals
/// in floating point come out in steps of 1/4096. docs/formats_supported.md has all of it.
/// @return CV_16UC1
/// @throws std::runtime_error naming the file, and the tag and its value, if it is missing, unreadable, of another
/// kind, not of the detector's size or ImagerPixelSpacing, or its values are not 0 to 65535
cv::Mat readXrayImage(const std::string& path, const ProjectionGeometry& detector, const IntensityModel& intensity);
}  // namespace xray_tracking
