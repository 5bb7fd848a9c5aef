#include "random_subject.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <stdexcept>

#include <opencv2/imgproc.hpp>

#include "deforming_ct.h"
#include "limb.h"
#include "random_room.h"
#include "starts.h"

namespace fs = std::filesystem;

namespace xray_tracking
{
namespace
{
constexpr double kEverything = 1e4;  // [mm]
constexpr double kFromEnds = 18.0;   // of a scan, for a target [mm]

Eigen::AlignedBox3d grown(const Eigen::AlignedBox3d& box, double margin)
{
  return { box.min().array() - margin, box.max().array() + margin };
}

Scans::Scan makeScan(const std::string& name, const std::string& path)
{
  constexpr std::int16_t kBone = 300;
  Scans::Scan scan{ name, std::make_shared<const CtVolume>(readCtVolume(path)), {}, {}, {} };
  const double voxel = std::max(1.6, scan.ct->grid.spacing().x());
  scan.coarse =
      resampled(*scan.ct, voxel, std::max(voxel, scan.ct->grid.spacing().z()), grown(scan.ct->grid.extent(), 1.0));
  const VolumeGrid& grid = scan.coarse.grid;
  for (std::size_t n = 0; n < scan.coarse.hu.size(); ++n)
  {
    if (scan.coarse.hu[n] > kBone)
    {
      const auto row = static_cast<std::size_t>(grid.size.x());
      const auto slice = row * static_cast<std::size_t>(grid.size.y());
      scan.bone.push_back(grid.patient_from_index * Eigen::Vector3d(n % row, n / row % grid.size.y(), n / slice));
    }
  }
  return scan;
}

double boneShare(const Scans::Scan& scan, const Eigen::AlignedBox3d& box)
{
  const auto inside = std::count_if(scan.bone.begin(), scan.bone.end(),
                                    [&](const Eigen::Vector3d& point) { return box.contains(point); });
  return static_cast<double>(inside) * std::pow(scan.coarse.grid.spacing().prod(), 1.0) / box.volume();
}

/// A box around bone of any kind; every other one is where there is most of it, as at a vertebra.
Eigen::AlignedBox3d randomBox(std::mt19937& random, const Scans::Scan& scan)
{
  const Eigen::AlignedBox3d extent = scan.ct->grid.extent();
  // Its slices go on beyond the ends only as they are there.
  Eigen::AlignedBox3d inner = extent;
  inner.min().z() += kFromEnds;
  inner.max().z() -= kFromEnds;
  const bool most = withProbability(random, 0.6);
  for (int attempt = 0; attempt < 1000; ++attempt)
  {
    const double edge = most ? betweenLog(random, 30.0, 80.0) : betweenLog(random, 15.0, 150.0);
    const Eigen::Vector3d half =
        0.5 * edge * Eigen::Vector3d(between(random, 0.8, 1.3), between(random, 0.8, 1.3), between(random, 0.6, 1.3));
    Eigen::AlignedBox3d best;
    double share = 0.03;
    for (int n = 0; n < (most ? 40 : 1); ++n)
    {
      const Eigen::Vector3d centre = scan.bone[random() % scan.bone.size()];
      const Eigen::AlignedBox3d box(centre - half, centre + half);
      const bool judged = std::any_of(scan.kept.begin(), scan.kept.end(),
                                      [&](const Eigen::AlignedBox3d& kept) { return kept.contains(centre); });
      if (inner.contains(box) && !judged && boneShare(scan, box) > share)
      {
        share = boneShare(scan, box);
        best = box;
      }
    }
    if (!best.isEmpty())
    {
      return best;
    }
  }
  throw std::runtime_error(scan.name + ": no box with bone found");
}

/// Share that moves with the target: all bone in the box, and what is next to it.
TargetMask rigidWith(const CtVolume& ct, const Eigen::AlignedBox3d& box)
{
  const TargetMaskOptions options{ 180.0, 2.0, 3.0, 25.0 };
  CtVolume labels = ct;
  for (int k = 0; k < ct.grid.size.z(); ++k)
  {
    for (int j = 0; j < ct.grid.size.y(); ++j)
    {
      for (int i = 0; i < ct.grid.size.x(); ++i)
      {
        const std::size_t n = ct.grid.offset(i, j, k);
        labels.hu[n] =
            ct.hu[n] > options.threshold_hu && box.contains(ct.grid.patient_from_index * Eigen::Vector3d(i, j, k));
      }
    }
  }
  return targetMaskFromLabels(ct.grid, labels, 1, options);
}

/// The target's bone alone, air around it.
void cutOut(CtVolume& ct, const TargetMask& mask)
{
  const Eigen::Affine3d mask_from_ct = mask.grid.patient_from_index.inverse() * ct.grid.patient_from_index;
  const Eigen::Vector3i first = mask_from_ct.translation().array().round().cast<int>();
  for (int k = 0; k < ct.grid.size.z(); ++k)
  {
    for (int j = 0; j < ct.grid.size.y(); ++j)
    {
      for (int i = 0; i < ct.grid.size.x(); ++i)
      {
        const Eigen::Vector3i at = first + Eigen::Vector3i(i, j, k);
        const bool inside = (at.array() >= 0).all() && (at.array() < mask.grid.size.array()).all();
        if (!inside || mask.values[mask.grid.offset(at.x(), at.y(), at.z())] < 0.5F)
        {
          ct.hu[ct.grid.offset(i, j, k)] = -1000;
        }
      }
    }
  }
}

void addNoise(CtVolume& ct, double deviation, std::mt19937& random)
{
  cv::Mat noise(1, static_cast<int>(ct.hu.size()), CV_16SC1);
  cv::RNG(random()).fill(noise, cv::RNG::NORMAL, 0.0, deviation);
  for (std::size_t n = 0; n < ct.hu.size(); ++n)
  {
    ct.hu[n] = static_cast<std::int16_t>(std::max(-1000, ct.hu[n] + noise.at<std::int16_t>(static_cast<int>(n))));
  }
}

RandomAnatomy limbAnatomy(std::mt19937& random, Limb::Kind kind)
{
  const auto limb = std::make_shared<Limb>(kind, random);
  RandomAnatomy made;
  made.name = kind == Limb::Kind::IMPLANT ? "implant" : "forearm";
  made.anatomy = limb;
  made.exact = true;
  made.symmetric = true;
  made.box = limb->box();
  const double voxel = between(random, 0.4, 1.2);
  made.ct = limb->segmentedCt(voxel, between(random, 0.4, 1.5), withProbability(random, 0.5));
  return made;
}

/// Lengths of the materials in all pixels; of what is not sharp, from a grid of 0.8 mm at the target.
void materialsOf(const RandomAnatomy& anatomy, const ProjectionGeometry& geometry, const BodyPoses& poses,
                 cv::Mat& soft, cv::Mat& bone)
{
  const double grid = anatomy.exact ? 0.3 : 0.8;
  const double pixel = geometry.pixelPitch().x() / geometry.magnification(Eigen::Vector3d::Zero());
  const cv::Size size(geometry.imageSize().x(), geometry.imageSize().y());
  if (pixel >= grid)
  {
    anatomy.anatomy->materials(geometry, poses, soft, bone);
    return;
  }
  DetectorDescription coarse = geometry.description();
  coarse.image_size = (coarse.image_size.cast<double>() * pixel / grid).array().ceil().cast<int>();
  coarse.pixel_pitch = geometry.imageSize()
                           .cast<double>()
                           .cwiseQuotient(coarse.image_size.cast<double>())
                           .cwiseProduct(geometry.pixelPitch());
  // Edges coincide, as cv::resize has it.
  const Eigen::Vector2d shift = 0.5 * (coarse.pixel_pitch - geometry.pixelPitch());
  coarse.origin += shift.x() * coarse.x_direction + shift.y() * coarse.y_direction;
  cv::Mat coarse_soft, coarse_bone;
  anatomy.anatomy->materials(ProjectionGeometry::fromDescription(coarse), poses, coarse_soft, coarse_bone);
  cv::resize(coarse_soft, soft, size, 0.0, 0.0, cv::INTER_CUBIC);
  cv::resize(coarse_bone, bone, size, 0.0, 0.0, cv::INTER_CUBIC);
  soft = cv::max(soft, 0.0);
  bone = cv::max(bone, 0.0);
}
}  // namespace

Scans::Scans(const std::string& folder)
{
  for (const auto& [name, file] : { std::pair("thorax", "thorax_ct"), std::pair("pelvis", "lumbar_pelvis_ct/ct.nii.gz"),
                                    std::pair("half thorax", "rtstruct/ct") })
  {
    const fs::path path = fs::path(folder) / file;
    if (fs::exists(path))
    {
      scans_.push_back(makeScan(name, path.string()));
    }
  }
  if (scans_.empty())
  {
    throw std::invalid_argument(folder + ": expected a folder with thorax_ct, lumbar_pelvis_ct or rtstruct");
  }
  if (scans_.front().name == "thorax")
  {
    // The spine of thorax_01 and thorax_02 and of the vertebra above, by which the belief is judged.
    scans_.front().kept.push_back({ Eigen::Vector3d(-60.0, 150.0, -575.0), Eigen::Vector3d(60.0, 300.0, -480.0) });
  }
}

RandomAnatomy scannedAnatomy(std::mt19937& random, const Scans::Scan& scan, bool xrayed)
{
  RandomAnatomy made;
  made.box = randomBox(random, scan);
  made.name = scan.name;
  if (xrayed)
  {
    const double wave = between(random, 0.0, 4.0);
    made.anatomy = std::make_shared<DeformingCt>(scan.ct, rigidWith(scan.coarse, made.box), wave,
                                                 0.9 * std::min(1.0, scan.ct->grid.spacing().minCoeff()));
  }
  // What is registered is coarser than what is X-rayed.
  const Eigen::Vector3d spacing = scan.ct->grid.spacing();
  const double voxel = std::max(spacing.x(), between(random, 0.8, 2.0));
  const double slice = std::max(spacing.z(), betweenLog(random, 1.0, 3.0));
  const double margin = withProbability(random, 0.2) ? kEverything : between(random, 20.0, 100.0);
  made.ct = resampled(*scan.ct, voxel, slice, grown(made.box, margin));
  addNoise(made.ct, between(random, 0.0, 30.0), random);
  if (withProbability(random, 0.2))
  {
    made.name += "; bone cut out";
    cutOut(made.ct, targetMaskFromBone(made.ct, made.box, { 180.0, 2.0, 0.5, 1.5 }));
  }
  made.two_bodies = !withProbability(random, 0.1);
  return made;
}

RandomAnatomy phantomAnatomy(std::mt19937& random)
{
  RandomAnatomy made;
  const std::string target = "c" + std::to_string(3 + random() % 4);
  made.name = "phantom " + target;
  made.anatomy = std::make_shared<PhantomAnatomy>();
  made.exact = true;
  made.target_is_rest = target == "c6";
  made.box = phantomBox(target);
  const double voxel = between(random, 0.8, 2.0);
  made.ct = phantomCt(voxel, std::max(voxel, betweenLog(random, 1.0, 3.0)));
  made.two_bodies = !withProbability(random, 0.1);
  return made;
}

RandomAnatomy randomAnatomy(std::mt19937& random, const Scans& scans, bool xrayed)
{
  const double kind = between(random, 0.0, 1.0);
  if (kind < 0.25)
  {
    return phantomAnatomy(random);
  }
  if (kind < 0.5)
  {
    return limbAnatomy(random, kind < 0.37 ? Limb::Kind::FOREARM : Limb::Kind::IMPLANT);
  }
  // Half of the scanned ones are of the first, which is the finest.
  const std::size_t scan = kind < 0.75 ? 0 : random() % scans.all().size();
  return scannedAnatomy(random, scans.all()[scan], xrayed);
}

BodyModel bodiesOf(const RandomAnatomy& anatomy)
{
  std::optional<TargetMask> mask;
  if (anatomy.two_bodies)
  {
    mask = targetMaskFromBone(anatomy.ct, anatomy.box);
  }
  return bodiesOf(recognisedCt(anatomy.ct), mask);
}

RandomScene::RandomScene(std::mt19937& random, RandomAnatomy anatomy, const RoomLimits& limits)
  : anatomy_(std::move(anatomy))
{
  const Eigen::AlignedBox3d& box = anatomy_.box;
  setup_.target_box = box;
  RigidTransform& nominal = setup_.room_from_patient;
  nominal.linear() = rotationFromVector(between(random, 0.0, EIGEN_PI) * randomDirection(random));
  nominal.translation() = -(nominal.linear() * box.center());
  const double field = box.sizes().norm() + 2.0 * between(random, 8.0, 35.0);
  setup_.detectors = randomRoom(random, nominal.linear() * Eigen::Vector3d::UnitZ(), field, limits);
  std::vector<cv::Rect> regions;
  for (const ProjectionGeometry& detector : setup_.detectors)
  {
    regions.push_back(projectedTargetRegion(setup_, detector));
  }
  detectors_.emplace(random, setup_.detectors, regions);
  setup_.intensity = detectors_->intensity();
  posture_ = randomTwist(random, between(random, 0.0, 4.0) * kDegree, between(random, 0.0, 6.0));
}

std::vector<cv::Mat> RandomScene::images(const RigidTransform& room_from_target, const RigidTransform& room_from_rest,
                                         int exposure)
{
  BodyPoses poses{ room_from_target, room_from_rest };
  if (anatomy_.target_is_rest)
  {
    std::swap(poses.room_from_target, poses.room_from_rest);
  }
  std::vector<cv::Mat> images;
  for (std::size_t d = 0; d < setup_.detectors.size(); ++d)
  {
    cv::Mat soft, bone;
    materialsOf(anatomy_, setup_.detectors[d], poses, soft, bone);
    images.push_back(detectors_->expose(soft, bone, static_cast<int>(d), exposure));
  }
  return images;
}

RandomSubject randomSubject(std::mt19937& random, const Scans& scans)
{
  constexpr int kExposures = 2;
  RandomScene scene(random, randomAnatomy(random, scans, true));
  RandomSubject subject{ scene.anatomy(), {} };
  subject.exposures.setup = scene.setup();
  const Eigen::Vector3d centre = scene.anatomy().box.center();
  for (int exposure = 0; exposure < kExposures; ++exposure)
  {
    const RigidTransform gold =
        motionAbout(Eigen::Vector3d::Zero(),
                    randomTwist(random, between(random, 0.0, 4.0) * kDegree, between(random, 2.0, 6.0))) *
        scene.setup().room_from_patient;
    const RigidTransform rest = motionAbout(gold * centre, scene.posture()) * gold;
    subject.exposures.images.push_back(scene.images(gold, rest, exposure));
    subject.exposures.room_from_patient.push_back(gold);
  }
  return subject;
}
}  // namespace xray_tracking
