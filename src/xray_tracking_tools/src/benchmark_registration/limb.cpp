#include "limb.h"

#include <algorithm>
#include <cmath>

#include <tbb/parallel_for.h>

#include "random_room.h"
#include "starts.h"
#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
using Shape = Solid::Shape;

constexpr Materials kSoft{ 1.05, 0.0 };
/// In place of soft tissue.
constexpr Materials kCortical{ -1.05, 0.95 };
constexpr Materials kMarrow{ 1.0, -0.85 };  // in place of cortical bone: 0.95 soft, 0.1 bone
/// Cobalt chromium, of which 8000 HU is as much as a CT says.
constexpr Materials kMetal{ -1.05, 3.5 };

RigidTransform placed(const Eigen::Vector3d& centre, const Eigen::Vector3d& turn = Eigen::Vector3d::Zero())
{
  RigidTransform pose = RigidTransform::Identity();
  pose.linear() = rotationFromVector(turn);
  pose.translation() = centre;
  return pose;
}

/// A shell of cortical bone around marrow.
void addBone(Shape shape, const RigidTransform& pose, const Eigen::Vector3d& half_axes, double cortex,
             std::vector<Solid>& solids)
{
  solids.emplace_back(shape, pose, half_axes, kCortical);
  solids.emplace_back(shape, pose, half_axes.array() - cortex, kMarrow);
}

/// A bone along z from its wide end at 0 downwards, one part ending where the next begins.
void addLongBone(const Eigen::Vector3d& place, double width, double length, std::mt19937& random,
                 std::vector<Solid>& solids)
{
  const double cortex = between(random, 1.2, 3.0);
  const double head = between(random, 0.8, 1.3) * width;
  std::vector<Solid> parts;
  addBone(Shape::ELLIPSOID, placed(place - Eigen::Vector3d(0.0, 0.0, head)),
          Eigen::Vector3d(width, between(random, 0.6, 0.9) * width, head), cortex, parts);
  for (Solid& part : parts)
  {
    part.cutBy(-Eigen::Vector3d::UnitZ(), head * 1.3 - place.z());
    part.cutBy(Eigen::Vector3d(between(random, -0.3, 0.3), 0.1, 1.0), place.z() - 0.2 * head);
  }
  const double shaft = between(random, 0.42, 0.6) * width;
  std::vector<Solid> shafts;
  addBone(Shape::CYLINDER, placed(place - Eigen::Vector3d(0.0, 0.0, 1.3 * head + 0.5 * length)),
          Eigen::Vector3d(shaft, between(random, 0.8, 1.0) * shaft, 0.5 * length), cortex, shafts);
  parts.insert(parts.end(), shafts.begin(), shafts.end());
  // What tells one side from the other: a process and a tubercle.
  parts.emplace_back(Shape::ELLIPSOID, placed(place + Eigen::Vector3d(0.9 * width, 0.0, -0.3 * head)),
                     Eigen::Vector3d(0.25 * width, 0.25 * width, 0.6 * head), kCortical);
  parts.emplace_back(Shape::ELLIPSOID, placed(place + Eigen::Vector3d(-0.2 * width, 0.7 * width, -0.8 * head)),
                     Eigen::Vector3d(0.2 * width, 0.15 * width, 0.4 * head), kCortical);
  solids.insert(solids.end(), parts.begin(), parts.end());
}

Eigen::AlignedBox3d boxAround(const std::vector<Solid>& solids)
{
  Eigen::AlignedBox3d box;
  for (const Solid& solid : solids)
  {
    box.extend(solid.boundingBox());
  }
  return box;
}
}  // namespace

Limb::Limb(Kind kind, std::mt19937& random)
{
  kind == Kind::FOREARM ? addForearm(random) : addImplant(random);
  box_ = boxAround(target_);
}

void Limb::addForearm(std::mt19937& random)
{
  const double width = between(random, 8.0, 22.0);
  const double length = between(random, 25.0, 90.0);
  addLongBone(Eigen::Vector3d::Zero(), width, length, random, target_);
  addLongBone(Eigen::Vector3d(2.2 * width, between(random, -4.0, 4.0), between(random, -8.0, 2.0)), 0.7 * width, 140.0,
              random, rest_);
  for (int n = 0; n < 8; ++n)
  {
    const Eigen::Vector3d centre(between(random, -1.2, 2.6) * width, between(random, -6.0, 6.0),
                                 (n < 4 ? 0.9 : 2.1) * width + between(random, -2.0, 2.0));
    addBone(Shape::ELLIPSOID, placed(centre, between(random, 0.0, 1.5) * randomDirection(random)),
            Eigen::Vector3d(between(random, 0.3, 0.5), between(random, 0.3, 0.5), between(random, 0.4, 0.6)) * width,
            1.0, rest_);
  }
  rest_.emplace_back(Shape::CYLINDER, placed(Eigen::Vector3d(width, 0.0, 0.0)),
                     Eigen::Vector3d(between(random, 2.6, 3.5) * width, between(random, 1.5, 2.2) * width, 250.0),
                     kSoft);
}

void Limb::addImplant(std::mt19937& random)
{
  const double width = between(random, 22.0, 42.0);
  const double depth = between(random, 0.55, 0.75) * width;
  const double plate = between(random, 1.5, 4.0);
  const double stem = between(random, 12.0, 28.0);
  target_.emplace_back(Shape::CYLINDER, placed(Eigen::Vector3d::Zero()), Eigen::Vector3d(width, depth, plate), kMetal);
  target_.back().cutBy(Eigen::Vector3d::UnitY(), 0.6 * depth);
  target_.emplace_back(Shape::CYLINDER, placed(Eigen::Vector3d(0.0, between(random, -4.0, 4.0), -plate - 0.5 * stem)),
                       Eigen::Vector3d(between(random, 4.0, 8.0), between(random, 4.0, 8.0), 0.5 * stem), kMetal);
  for (const double side : { -1.0, 1.0 })
  {
    target_.emplace_back(Shape::BOX,
                         placed(Eigen::Vector3d(side * (9.0 + 0.25 * width), 2.0, -plate - 0.25 * stem),
                                Eigen::Vector3d(0.0, side * 0.4, 0.0)),
                         Eigen::Vector3d(0.15 * width, 1.5, 0.2 * stem), kMetal);
    const Eigen::Vector3d condyle(side * 0.5 * width, between(random, -3.0, 3.0), plate + 12.0 + 0.5 * width);
    counterpart_.emplace_back(Shape::ELLIPSOID, placed(condyle),
                              Eigen::Vector3d(0.35 * width, 0.85 * depth, 0.5 * width), kMetal);
    counterpart_.back().cutBy(Eigen::Vector3d::UnitZ(), condyle.z());
    counterpart_.emplace_back(Shape::ELLIPSOID, placed(condyle),
                              Eigen::Vector3d(0.35 * width - 2.0, 0.85 * depth - 3.0, 0.5 * width - 4.0),
                              Materials{ 1.05, -3.5 });
    counterpart_.back().cutBy(Eigen::Vector3d::UnitZ(), condyle.z());
  }
  const double away = plate + 20.0 + 0.9 * width;
  addBone(Shape::CYLINDER, placed(Eigen::Vector3d(2.0, 0.0, -plate - stem - 60.0)), Eigen::Vector3d(15.0, 14.0, 60.0),
          4.0, rest_);
  addBone(Shape::CYLINDER, placed(Eigen::Vector3d(-2.0, 0.0, away + 60.0)), Eigen::Vector3d(16.0, 15.0, 60.0), 5.0,
          rest_);
  rest_.emplace_back(Shape::CYLINDER, placed(Eigen::Vector3d(0.0, 8.0, 0.0)),
                     Eigen::Vector3d(between(random, 1.3, 1.8) * width, between(random, 1.2, 1.6) * width, 300.0),
                     kSoft);
  if (between(random, 0.0, 1.0) < 0.5)  // the other leg
  {
    const double apart = between(random, 3.2, 4.5) * width;
    rest_.emplace_back(Shape::CYLINDER, placed(Eigen::Vector3d(apart, 20.0, 0.0)),
                       Eigen::Vector3d(1.4 * width, 1.3 * width, 300.0), kSoft);
    addBone(Shape::CYLINDER, placed(Eigen::Vector3d(apart, 20.0, 0.0)), Eigen::Vector3d(16.0, 15.0, 200.0), 5.0, rest_);
  }
}

void Limb::materials(const ProjectionGeometry& geometry, const BodyPoses& poses, cv::Mat& soft, cv::Mat& bone) const
{
  struct Projected
  {
    SolidFromSource solid;
    Eigen::Vector3d first, step_x, step_y;  // directions of the rays
  };
  std::vector<Projected> all;
  const auto add = [&](const std::vector<Solid>& solids, const RigidTransform& pose)
  {
    const RigidTransform inverse = pose.inverse();
    for (const Solid& solid : solids)
    {
      all.push_back({ SolidFromSource(solid, inverse * geometry.source()),
                      inverse.linear() * (geometry.origin() - geometry.source()),
                      inverse.linear() * (geometry.pixelPitch().x() * geometry.xDirection()),
                      inverse.linear() * (geometry.pixelPitch().y() * geometry.yDirection()) });
    }
  };
  add(target_, poses.room_from_target);
  add(counterpart_, poses.room_from_rest);
  add(rest_, poses.room_from_rest);
  const cv::Size size(geometry.imageSize().x(), geometry.imageSize().y());
  soft.create(size, CV_32FC1);
  bone.create(size, CV_32FC1);
  tbb::parallel_for(
      0, size.height,
      [&](int row)
      {
        std::vector<Materials> sums(static_cast<std::size_t>(size.width));
        for (const Projected& projected : all)
        {
          projected.solid.addRow(projected.first + row * projected.step_y, projected.step_x, size.width, sums.data());
        }
        for (int column = 0; column < size.width; ++column)
        {
          const double length = (geometry.pixelPosition(Eigen::Vector2d(column, row)) - geometry.source()).norm();
          // Of overlapping solids none may take away more than is there.
          soft.at<float>(row, column) = static_cast<float>(std::max(0.0, sums[column].soft * length));
          bone.at<float>(row, column) = static_cast<float>(std::max(0.0, sums[column].bone * length));
        }
      });
}

CtVolume Limb::segmentedCt(double voxel, double slice, bool counterpart) const
{
  constexpr double kMargin = 4.0;  // [mm]
  constexpr double kMost = 8000.0;
  constexpr int kParts = 3;
  Eigen::AlignedBox3d extent = box_;
  std::vector<Solid> solids = target_;
  if (counterpart)
  {
    solids.insert(solids.end(), counterpart_.begin(), counterpart_.end());
    extent.extend(boxAround(counterpart_));
  }
  const Eigen::Vector3d spacing(voxel, voxel, slice);
  CtVolume ct;
  ct.grid.patient_from_index =
      Eigen::Translation3d(extent.min() - Eigen::Vector3d::Constant(kMargin)) * Eigen::Scaling(spacing);
  ct.grid.size = ((extent.sizes().array() + 2.0 * kMargin) / spacing.array()).ceil().cast<int>();
  ct.hu.resize(ct.grid.voxelCount());
  tbb::parallel_for(
      0, ct.grid.size.z(),
      [&](int k)
      {
        for (int j = 0; j < ct.grid.size.y(); ++j)
        {
          for (int i = 0; i < ct.grid.size.x(); ++i)
          {
            double sum = 0.0;
            for (int part = 0; part < kParts * kParts * kParts; ++part)
            {
              const Eigen::Vector3d at(part % kParts, part / kParts % kParts, part / (kParts * kParts));
              const Eigen::Vector3d point = ct.grid.patient_from_index *
                                            (Eigen::Vector3d(i, j, k).array() + (at.array() - 1.0) / kParts).matrix();
              Materials here;
              bool inside = false;
              for (const Solid& solid : solids)
              {
                if (solid.contains(point))
                {
                  inside = true;
                  here.soft += solid.added().soft;
                  here.bone += solid.added().bone;
                }
              }
              here.soft = std::max(0.0, here.soft + kSoft.soft);
              here.bone = std::max(0.0, here.bone);
              const double hu = here.bone > 0.0 ? huFromMaterials(here) : -1000.0;
              sum += inside ? std::min(kMost, hu) : -1000.0;
            }
            ct.hu[ct.grid.offset(i, j, k)] = static_cast<std::int16_t>(std::lround(sum / (kParts * kParts * kParts)));
          }
        }
      });
  return ct;
}
}  // namespace xray_tracking
