#pragma once

#include "setup_picture.h"

namespace xray_tracking
{
/// From where the room is looked at: room axes that go right and up in the picture.
struct RoomSide
{
  const char* words;
  int right, up;
};

/// The room as from infinitely far. @return CV_8UC3 of that size
cv::Mat drawRoom(const TreatmentSetup& setup, const std::vector<Eigen::Vector3d>& ct_corners, const RoomSide& side,
                 const cv::Size& size);
}  // namespace xray_tracking
