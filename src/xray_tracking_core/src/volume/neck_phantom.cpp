#include "xray_tracking_core/volume/neck_phantom.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <sstream>
#include <stdexcept>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include "neck_anatomy.h"

namespace xray_tracking
{
namespace
{
/// A solid on the panel: which pixels may see it, and how their rays meet it.
struct ProjectedSolid
{
  SolidFromSource solid;
  cv::Rect pixels;
  // Ray directions in the solid's body, from the source to the panel: first + column * step_x + row * step_y.
  Eigen::Vector3d first, step_x, step_y;
};

/// The smallest rectangle of pixels with all of a convex solid, whose corners these are; all pixels if one of them is
/// not in front of the source.
cv::Rect pixelsAround(const std::array<Eigen::Vector3d, 8>& room_corners, const ProjectionGeometry& geometry)
{
  const cv::Rect panel(0, 0, geometry.imageSize().x(), geometry.imageSize().y());
  Eigen::AlignedBox2d box;
  for (const Eigen::Vector3d& corner : room_corners)
  {
    const Eigen::Vector2d pixel = geometry.project(corner);
    if (!pixel.allFinite())
    {
      return panel;
    }
    box.extend(pixel);
  }
  // Clamped before the conversion: what lies near the source's plane projects beyond the range of int.
  const Eigen::Vector2d size = geometry.imageSize().cast<double>();
  const Eigen::Vector2i low = box.min().array().ceil().max(0.0).min(size.array()).cast<int>();
  const Eigen::Vector2i high = (box.max().array().floor() + 1.0).max(0.0).min(size.array()).cast<int>();
  return { low.x(), low.y(), std::max(0, high.x() - low.x()), std::max(0, high.y() - low.y()) };
}

void projectBody(const std::vector<Solid>& solids, const ProjectionGeometry& geometry,
                 const RigidTransform& room_from_body, std::vector<ProjectedSolid>& projected)
{
  const RigidTransform body_from_room = room_from_body.inverse();
  const Eigen::Vector3d source = body_from_room * geometry.source();
  const Eigen::Vector3d first = body_from_room.linear() * (geometry.origin() - geometry.source());
  const Eigen::Vector3d step_x = body_from_room.linear() * geometry.xDirection() * geometry.pixelPitch().x();
  const Eigen::Vector3d step_y = body_from_room.linear() * geometry.yDirection() * geometry.pixelPitch().y();
  for (const Solid& solid : solids)
  {
    std::array<Eigen::Vector3d, 8> corners = solid.corners();
    for (Eigen::Vector3d& corner : corners)
    {
      corner = room_from_body * corner;
    }
    const cv::Rect pixels = pixelsAround(corners, geometry);
    if (!pixels.empty())
    {
      projected.push_back({ SolidFromSource(solid, source), pixels, first, step_x, step_y });
    }
  }
}

template <typename Function>
void forEachSolid(const std::vector<Solid>& target, const std::vector<Solid>& rest, Function function)
{
  std::for_each(target.begin(), target.end(), function);
  std::for_each(rest.begin(), rest.end(), function);
}

void require(bool good, const char* option, double value, const char* expected)
{
  if (!good)
  {
    std::ostringstream message;
    message << "phantom CT option " << option << " is " << value << ", expected " << expected;
    throw std::invalid_argument(message.str());
  }
}

/// Lines along y and along z in each voxel over which its value is averaged; along x the average is exact.
constexpr int kLinesAlongY = 4;
constexpr int kLinesAlongZ = 4;

/// One slice of the noiseless CT [HU].
class SliceSampler
{
public:
  SliceSampler(const VolumeGrid& grid, double slice_thickness)
    : size_(grid.size),
      spacing_(grid.spacing()),
      origin_(grid.patient_from_index.translation()),
      thickness_(slice_thickness)
  {
  }

  void addSolid(const Solid& solid, int k, std::vector<double>& hu) const
  {
    const Eigen::AlignedBox3d box = solid.boundingBox();
    const double z = origin_.z() + k * spacing_.z();
    if (box.min().z() > z + 0.5 * thickness_ || box.max().z() < z - 0.5 * thickness_)
    {
      return;
    }
    const auto row_of = [this](double y) { return std::floor((y - origin_.y()) / spacing_.y() + 0.5); };
    const int first_row = static_cast<int>(std::clamp(row_of(box.min().y()), 0.0, size_.y() - 1.0));
    const int last_row = static_cast<int>(std::clamp(row_of(box.max().y()), 0.0, size_.y() - 1.0));
    // HU are linear in the amounts: what a solid adds to air is what it adds to anything.
    const double added_hu = (huFromMaterials(solid.added()) + 1000.0) / (kLinesAlongY * kLinesAlongZ);
    const double left_edge = origin_.x() - 0.5 * spacing_.x();
    for (int j = first_row; j <= last_row; ++j)
    {
      for (int line = 0; line < kLinesAlongY * kLinesAlongZ; ++line)
      {
        const double share_y = (line % kLinesAlongY + 0.5) / kLinesAlongY - 0.5;
        const double share_z = (line / kLinesAlongY + 0.5) / kLinesAlongZ - 0.5;
        const Eigen::Vector3d start(std::min(left_edge, box.min().x() - 1.0),
                                    origin_.y() + (j + share_y) * spacing_.y(), z + share_z * thickness_);
        const RaySegment segment = solid.intersect({ start, Eigen::Vector3d::UnitX() });
        addSegment((start.x() + segment.enter - left_edge) / spacing_.x(),
                   (start.x() + segment.exit - left_edge) / spacing_.x(), added_hu,
                   hu.data() + static_cast<std::size_t>(j) * size_.x());
      }
    }
  }

private:
  /// Adds to each voxel of a row its covered share; the segment is in voxels from the row's left edge.
  void addSegment(double enter, double exit, double hu, double* row) const
  {
    enter = std::max(enter, 0.0);
    exit = std::min(exit, static_cast<double>(size_.x()));
    if (exit <= enter)
    {
      return;
    }
    const int first = std::min(static_cast<int>(enter), size_.x() - 1);
    const int last = std::min(static_cast<int>(exit), size_.x() - 1);
    if (first == last)
    {
      row[first] += hu * (exit - enter);
      return;
    }
    row[first] += hu * (first + 1 - enter);
    for (int i = first + 1; i < last; ++i)
    {
      row[i] += hu;
    }
    row[last] += hu * (exit - last);
  }

  Eigen::Vector3i size_;
  Eigen::Vector3d spacing_;
  Eigen::Vector3d origin_;
  double thickness_;
};
}  // namespace

void PhantomCtOptions::validate() const
{
  // 2000 voxels an edge are more than any scanner's; beyond, the volume would not fit the memory of a workstation.
  require(size.minCoeff() >= 1 && size.maxCoeff() <= 2000, "size",
          size.minCoeff() < 1 ? size.minCoeff() : size.maxCoeff(), "1 to 2000 voxels along each axis");
  for (const double edge : { spacing.x(), spacing.y(), spacing.z() })
  {
    require(std::isfinite(edge) && edge > 0.0, "spacing", edge, "positive distances [mm]");
  }
  require(std::isfinite(slice_thickness) && slice_thickness > 0.0, "slice_thickness", slice_thickness,
          "a positive length [mm]");
  require(std::isfinite(noise_hu) && noise_hu >= 0.0, "noise_hu", noise_hu, "zero or a positive number [HU]");
}

NeckPhantom::NeckPhantom() : target_box_(boxAroundC4())
{
  NeckSolids neck;
  addNeckSurroundings(neck.rest);
  addCervicalSpine(neck);
  target_ = std::move(neck.target);
  rest_ = std::move(neck.rest);
}

Materials NeckPhantom::lineIntegral(const Ray& ray) const
{
  Materials sum;
  forEachSolid(target_, rest_,
               [&ray, &sum](const Solid& solid)
               {
                 const double length = solid.intersect(ray).length();
                 sum.soft += length * solid.added().soft;
                 sum.bone += length * solid.added().bone;
               });
  return sum;
}

void NeckPhantom::lineIntegrals(const ProjectionGeometry& geometry, const RigidTransform& room_from_target,
                                const RigidTransform& room_from_rest, cv::Mat& soft, cv::Mat& bone) const
{
  std::vector<ProjectedSolid> solids;
  solids.reserve(target_.size() + rest_.size());
  projectBody(target_, geometry, room_from_target, solids);
  projectBody(rest_, geometry, room_from_rest, solids);

  const int columns = geometry.imageSize().x();
  const int rows = geometry.imageSize().y();
  soft.create(rows, columns, CV_32FC1);
  bone.create(rows, columns, CV_32FC1);
  const Eigen::Vector3d corner = geometry.origin() - geometry.source();
  const Eigen::Vector3d pixel_x = geometry.xDirection() * geometry.pixelPitch().x();
  const Eigen::Vector3d pixel_y = geometry.yDirection() * geometry.pixelPitch().y();
  tbb::parallel_for(tbb::blocked_range<int>(0, rows),
                    [&](const tbb::blocked_range<int>& range)
                    {
                      std::vector<Materials> sums(columns);
                      for (int row = range.begin(); row < range.end(); ++row)
                      {
                        std::fill(sums.begin(), sums.end(), Materials());
                        for (const ProjectedSolid& projected : solids)
                        {
                          const cv::Rect& pixels = projected.pixels;
                          if (row < pixels.y || row >= pixels.y + pixels.height)
                          {
                            continue;
                          }
                          projected.solid.addRow(projected.first + row * projected.step_y + pixels.x * projected.step_x,
                                                 projected.step_x, pixels.width, sums.data() + pixels.x);
                        }
                        float* soft_row = soft.ptr<float>(row);
                        float* bone_row = bone.ptr<float>(row);
                        for (int column = 0; column < columns; ++column)
                        {
                          const double distance = (corner + row * pixel_y + column * pixel_x).norm();
                          soft_row[column] = static_cast<float>(sums[column].soft * distance);
                          bone_row[column] = static_cast<float>(sums[column].bone * distance);
                        }
                      }
                    });
}

Materials NeckPhantom::at(const Eigen::Vector3d& point) const
{
  Materials sum;
  forEachSolid(target_, rest_,
               [&point, &sum](const Solid& solid)
               {
                 if (solid.contains(point))
                 {
                   sum.soft += solid.added().soft;
                   sum.bone += solid.added().bone;
                 }
               });
  return sum;
}

CtVolume NeckPhantom::sampleCt(const PhantomCtOptions& options) const
{
  options.validate();
  CtVolume ct;
  ct.grid.size = options.size;
  ct.grid.patient_from_index.linear() = options.spacing.asDiagonal();
  ct.grid.patient_from_index.translation() =
      -0.5 * options.spacing.cwiseProduct(options.size.cast<double>() - Eigen::Vector3d::Ones());
  ct.hu.resize(ct.grid.voxelCount());

  const SliceSampler sampler(ct.grid, options.slice_thickness);
  const std::size_t slice_size = ct.grid.offset(0, 0, 1);
  tbb::parallel_for(0, options.size.z(),
                    [&](int k)
                    {
                      std::vector<double> hu(slice_size, -1000.0);
                      forEachSolid(target_, rest_, [&](const Solid& solid) { sampler.addSolid(solid, k, hu); });
                      // A generator a slice: the noise does not depend on how slices are shared out among threads.
                      std::seed_seq seed{ options.seed, static_cast<std::uint32_t>(k) };
                      std::mt19937 generator(seed);
                      std::normal_distribution<double> normal;
                      std::int16_t* out = ct.hu.data() + ct.grid.offset(0, 0, k);
                      for (const double value : hu)
                      {
                        // As scanners store it, 12 bits from -1024.
                        *out++ = static_cast<std::int16_t>(
                            std::lround(std::clamp(value + options.noise_hu * normal(generator), -1024.0, 3071.0)));
                      }
                    });
  return ct;
}
}  // namespace xray_tracking
