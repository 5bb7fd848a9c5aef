#pragma once

#include <map>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "random_room.h"
#include "subject.h"
#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_detector_simulator/anatomy.h"

namespace xray_tracking
{
/// The scans that random subjects are made of, read once.
class Scans
{
public:
  /// @param folder with thorax_ct, lumbar_pelvis_ct/ct.nii.gz and rtstruct/ct; those that are there
  explicit Scans(const std::string& folder);

  struct Scan
  {
    std::string name;
    std::shared_ptr<const CtVolume> ct;
    CtVolume coarse;                        ///< for masks
    std::vector<Eigen::Vector3d> bone;      ///< places of bone in it
    std::vector<Eigen::AlignedBox3d> kept;  ///< what is judged elsewhere, not to be learnt on
  };

  const std::vector<Scan>& all() const { return scans_; }

private:
  std::vector<Scan> scans_;
};

/// What is X-rayed and what is registered to that.
struct RandomAnatomy
{
  std::string name;
  std::shared_ptr<const Anatomy> anatomy;
  bool exact = false;           ///< sharp: X-rays are sampled at every pixel
  bool symmetric = false;       ///< nearly: mirrored or turned by half it looks the same
  bool target_is_rest = false;  ///< of the phantom: the target moves with its other body
  CtVolume ct;
  Eigen::AlignedBox3d box;
  bool two_bodies = true;
};

/// @param xrayed else the anatomy, which takes time, is left out
RandomAnatomy randomAnatomy(std::mt19937& random, const Scans& scans, bool xrayed);
/// The neck phantom: one of C3 to C6, voxels and slices of its CT.
RandomAnatomy phantomAnatomy(std::mt19937& random);
/// A box around bone of a scan, and what of it is registered.
RandomAnatomy scannedAnatomy(std::mt19937& random, const Scans::Scan& scan, bool xrayed);

BodyModel bodiesOf(const RandomAnatomy& anatomy);

/// A random anatomy in a random room with random detectors, its rest up to 6 mm and 4 degrees from where it was in the
/// CT. The target's centre is at the room's origin in the setup's pose, the patient turned in any way.
class RandomScene
{
public:
  RandomScene(std::mt19937& random, RandomAnatomy anatomy, const RoomLimits& limits = {});

  const RandomAnatomy& anatomy() const { return anatomy_; }
  const TreatmentSetup& setup() const { return setup_; }
  /// Of the rest about the target's centre, room axes: how else than in the CT it lies.
  const Twist& posture() const { return posture_; }

  /// X-rays of an exposure, CV_16UC1. @param exposure index; noise hangs on it
  std::vector<cv::Mat> images(const RigidTransform& room_from_target, const RigidTransform& room_from_rest,
                              int exposure);

private:
  RandomAnatomy anatomy_;
  TreatmentSetup setup_;
  std::optional<RandomDetectors> detectors_;
  Twist posture_;
};

/// Two exposures of a random scene, 4 to 12 mm apart. All of it hangs on the seed alone.
struct RandomSubject
{
  RandomAnatomy anatomy;
  ExposureSet exposures;
};

RandomSubject randomSubject(std::mt19937& random, const Scans& scans);
}  // namespace xray_tracking
