#include "xray_tracking_core/geometry/projected_box.h"

namespace xray_tracking
{
cv::Rect projectedBoxRegion(const Eigen::AlignedBox3d& box, const RigidTransform& room_from_patient,
                            const ProjectionGeometry& geometry)
{
  Eigen::AlignedBox2d seen;
  for (int corner = 0; corner < 8; ++corner)
  {
    const Eigen::Vector3d point = box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner));
    const Eigen::Vector2d pixel = geometry.project(room_from_patient * point);
    if (!pixel.allFinite())
    {
      return {};
    }
    seen.extend(pixel);
  }
  // A pixel reaches half its width around its centre. Clipped before conversion, which large values would not survive.
  const Eigen::Array2d size = geometry.imageSize().cast<double>().array();
  const Eigen::Array2d first = (seen.min().array() + 0.5).floor().max(0.0).min(size);
  const Eigen::Array2d end = ((seen.max().array() + 0.5).floor() + 1.0).max(0.0).min(size);
  if ((first >= end).any())
  {
    return {};
  }
  return { cv::Point(int(first.x()), int(first.y())), cv::Point(int(end.x()), int(end.y())) };
}
}  // namespace xray_tracking
