#pragma once

#include <array>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/image/image_inspector.h"

namespace xray_tracking
{
/// Puts the median of their neighbours in the place of a detector's stuck pixels, exposure by exposure: where one is
/// stuck it stays so.
class PixelRepair
{
public:
  /// Takes in the STUCK pixels of another report. @param size of the images; that of another one starts anew
  void add(const ImageReport& report, const cv::Size& size);
  bool empty() const { return repairs_.empty(); }
  std::size_t count() const { return repairs_.size(); }
  void clear();

  /// No allocation after the first image. @param image CV_8UC1, CV_16UC1 or CV_32FC1 of the size that was added; of
  /// another size or type nothing is known, and it is copied as it is
  void apply(const cv::Mat& image, cv::Mat& repaired) const;

private:
  static constexpr int kNeighbours = 8;
  struct Repair
  {
    cv::Point place;
    std::array<cv::Point, kNeighbours> neighbours;
    int count = 0;
  };

  cv::Mat stuck_;  ///< CV_8UC1 of the images' size
  std::vector<Repair> repairs_;
};
}  // namespace xray_tracking
