#include "ct_ends.h"

#include <cmath>

#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
constexpr double kBody = 0.006;       // attenuation that is no air, a third of water's [1/mm]
constexpr double kHeadOn = 0.5;       // cosine of a ray and a face's normal
constexpr int kStep = 2;              // in bins, of the rays that are asked for
constexpr double kLeastShare = 0.02;  // of a face: where a body ends by itself, its last slice holds next to nothing
}  // namespace

CtEnds::CtEnds(const ScalarVolume& volume) : index_from_patient_(volume.grid.patient_from_index.inverse())
{
  const Eigen::Vector3i& size = volume.grid.size;
  for (int axis = 0; axis < 3; ++axis)
  {
    const int columns = (axis + 1) % 3;
    const int rows = (axis + 2) % 3;
    for (const int slice : { 0, size[axis] - 1 })
    {
      Face face{ axis, static_cast<double>(slice), cv::Mat(size[rows], size[columns], CV_8UC1) };
      Eigen::Vector3i voxel;
      voxel[axis] = slice;
      for (voxel[rows] = 0; voxel[rows] < size[rows]; ++voxel[rows])
      {
        for (voxel[columns] = 0; voxel[columns] < size[columns]; ++voxel[columns])
        {
          const float value = volume.values[volume.grid.offset(voxel.x(), voxel.y(), voxel.z())];
          face.body.at<std::uint8_t>(voxel[rows], voxel[columns]) = value > kBody ? 255 : 0;
        }
      }
      if (cv::countNonZero(face.body) > kLeastShare * static_cast<double>(face.body.total()))
      {
        faces_.push_back(face);
      }
    }
  }
}

bool CtEnds::cut(const Ray& ray) const
{
  const Eigen::Vector3d source = index_from_patient_ * ray.source;
  const Eigen::Vector3d direction = index_from_patient_.linear() * ray.direction;
  for (const Face& face : faces_)
  {
    const Eigen::Vector3d normal = index_from_patient_.linear().row(face.axis).transpose();
    const double cosine = std::abs(normal.dot(ray.direction)) / (normal.norm() * ray.direction.norm());
    if (cosine > kHeadOn || cosine < 1e-9)
    {
      continue;
    }
    const Eigen::Vector3d at = source + (face.plane - source[face.axis]) / direction[face.axis] * direction;
    const double column = std::round(at[(face.axis + 1) % 3]);
    const double row = std::round(at[(face.axis + 2) % 3]);
    if (column >= 0 && column < face.body.cols && row >= 0 && row < face.body.rows &&
        face.body.at<std::uint8_t>(static_cast<int>(row), static_cast<int>(column)) != 0)
    {
      return true;
    }
  }
  return false;
}

cv::Mat insideEnds(const ProjectionGeometry& geometry, const PixelGrid& pixels, const std::vector<PlacedEnds>& ends)
{
  const cv::Size size(pixels.size.x(), pixels.size.y());
  cv::Mat inside((size.height + kStep - 1) / kStep, (size.width + kStep - 1) / kStep, CV_32FC1, 1.0f);
  for (const PlacedEnds& placed : ends)
  {
    const RigidTransform ct_from_room = placed.room_from_ct.inverse();
    for (int row = 0; row < inside.rows; ++row)
    {
      for (int column = 0; column < inside.cols; ++column)
      {
        const Eigen::Vector2d bin(column * kStep, row * kStep);
        const Ray ray = geometry.backProject(pixels.first + bin.cwiseProduct(pixels.step));
        if (placed.ends.cut({ ct_from_room * ray.source, ct_from_room.linear() * ray.direction }))
        {
          inside.at<float>(row, column) = 0.0f;
        }
      }
    }
  }
  cv::Mat all;
  cv::resize(inside, all, cv::Size(inside.cols * kStep, inside.rows * kStep), 0.0, 0.0, cv::INTER_NEAREST);
  return all(cv::Rect(cv::Point(), size)).clone();
}
}  // namespace xray_tracking
