#include "mask_picture.h"

#include <algorithm>
#include <stdexcept>

#include <opencv2/imgcodecs.hpp>

namespace xray_tracking
{
void drawMask(const Subject& subject, const TargetMask& mask, const std::string& path)
{
  constexpr double kPixel = 0.5;  // [mm]
  constexpr int kEdge = 280;
  const Eigen::Affine3d ct_index = subject.ct.volume.grid.patient_from_index.inverse();
  const Eigen::Affine3d mask_index = mask.grid.patient_from_index.inverse();
  const auto voxel = [](const VolumeGrid& grid, const Eigen::Vector3d& index)
  {
    const Eigen::Vector3i nearest = index.array().round().cast<int>();
    const bool inside = nearest.minCoeff() >= 0 && (nearest.array() < grid.size.array()).all();
    return inside ? static_cast<std::ptrdiff_t>(grid.offset(nearest.x(), nearest.y(), nearest.z())) : -1;
  };
  cv::Mat picture(kEdge, 2 * kEdge, CV_8UC3);
  for (int row = 0; row < kEdge; ++row)
  {
    for (int column = 0; column < 2 * kEdge; ++column)
    {
      const double across = kPixel * (column % kEdge - kEdge / 2);
      const double down = kPixel * (row - kEdge / 2);
      const Eigen::Vector3d point = subject.box().center() + (column < kEdge ? Eigen::Vector3d(across, down, 0.0)
                                                                             : Eigen::Vector3d(0.0, across, -down));
      const std::ptrdiff_t in_ct = voxel(subject.ct.volume.grid, ct_index * point);
      const std::ptrdiff_t in_mask = voxel(mask.grid, mask_index * point);
      const double grey = in_ct < 0 ? 0.0 : std::clamp((subject.ct.volume.hu[in_ct] + 300.0) / 1200.0, 0.0, 1.0);
      const double weight = in_mask < 0 ? 0.0 : mask.values[in_mask];
      Eigen::AlignedBox3d inner = subject.box();
      inner.min().array() += kPixel;
      inner.max().array() -= kPixel;
      const bool edge = subject.box().contains(point) && !inner.contains(point);
      picture.at<cv::Vec3b>(row, column) =
          edge ? cv::Vec3b(0, 220, 220)
               : cv::Vec3b(cv::saturate_cast<std::uint8_t>(255.0 * grey * (1.0 - 0.6 * weight)),
                           cv::saturate_cast<std::uint8_t>(255.0 * grey * (1.0 - 0.6 * weight)),
                           cv::saturate_cast<std::uint8_t>(255.0 * (grey + 0.35 * weight * (1.0 - grey))));
    }
  }
  if (!cv::imwrite(path, picture))
  {
    throw std::runtime_error("cannot write " + path);
  }
}
}  // namespace xray_tracking
