#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "subject.h"
#include "xray_tracking_core/volume/body_model.h"
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
  bool target_is_rest = false;  ///< of the phantom: the target moves with its other body
  CtVolume ct;
  Eigen::AlignedBox3d box;
  bool two_bodies = true;
};

/// @param xrayed else the anatomy, which takes time, is left out
RandomAnatomy randomAnatomy(std::mt19937& random, const Scans& scans, bool xrayed);

BodyModel bodiesOf(const RandomAnatomy& anatomy);

/// Two exposures of a random anatomy in a random room, 4 to 12 mm apart, by random detectors, its rest up to 6 mm and 4
/// degrees from where it was in the CT. All of it hangs on the seed alone.
struct RandomSubject
{
  RandomAnatomy anatomy;
  ExposureSet exposures;
};

RandomSubject randomSubject(std::mt19937& random, const Scans& scans);
}  // namespace xray_tracking
