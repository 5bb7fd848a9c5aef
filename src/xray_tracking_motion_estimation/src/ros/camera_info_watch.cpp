#include "xray_tracking_motion_estimation/camera_info_watch.h"

#include <sstream>
#include <stdexcept>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
constexpr double kNominalSourceToDetector = 1000.0;  // mm

/// Names the first field in which two camera_infos differ; empty if they are the same.
std::string difference(const sensor_msgs::CameraInfo& accepted, const sensor_msgs::CameraInfo& info)
{
  std::ostringstream message;
  const auto differ = [&](const std::string& field, const auto& before, const auto& now)
  {
    const bool differs = !(before == now);  // NaN differs from itself
    if (differs)
    {
      message << "camera_info." << field << " changed from " << before << " to " << now;
    }
    return differs;
  };
  const auto anyDiffers = [&](const std::string& field, const auto& before, const auto& now)
  {
    bool differs = differ(field + "'s size", before.size(), now.size());
    for (std::size_t i = 0; !differs && i < before.size(); ++i)
    {
      differs = differ(field + "[" + std::to_string(i) + "]", before[i], now[i]);
    }
    return differs;
  };
  (void)(differ("header.frame_id", accepted.header.frame_id, info.header.frame_id) ||
         differ("width", accepted.width, info.width) || differ("height", accepted.height, info.height) ||
         anyDiffers("K", accepted.K, info.K) || anyDiffers("D", accepted.D, info.D) ||
         anyDiffers("R", accepted.R, info.R) || anyDiffers("P", accepted.P, info.P) ||
         differ("binning_x", accepted.binning_x, info.binning_x) ||
         differ("binning_y", accepted.binning_y, info.binning_y) ||
         differ("roi.x_offset", accepted.roi.x_offset, info.roi.x_offset) ||
         differ("roi.y_offset", accepted.roi.y_offset, info.roi.y_offset) ||
         differ("roi.width", accepted.roi.width, info.roi.width) ||
         differ("roi.height", accepted.roi.height, info.roi.height));
  return message.str();
}

ProjectionGeometry nominalGeometry(const std::string& detector, const sensor_msgs::CameraInfo& info,
                                   const RigidTransform& room_from_optical)
{
  return geometryFromCameraInfo(detector, info, room_from_optical, kNominalSourceToDetector);
}
}  // namespace

void CameraInfoWatch::update(const std::string& detector, const sensor_msgs::CameraInfo& info)
{
  std::string fault;
  if (accepted_)
  {
    fault = difference(*accepted_, info);
  }
  else if (info.header.frame_id.empty())
  {
    fault = "camera_info.header.frame_id is empty, expected the detector's optical frame";
  }
  else
  {
    try
    {
      nominalGeometry(detector, info, RigidTransform::Identity());
      accepted_ = info;
    }
    catch (const std::invalid_argument& error)
    {
      fault = error.what();
    }
  }
  fault_ = fault;
}

ProjectionGeometry CameraInfoWatch::geometry(const std::string& detector, const RigidTransform& room_from_optical) const
{
  return nominalGeometry(detector, *accepted_, room_from_optical);
}
}  // namespace xray_tracking
