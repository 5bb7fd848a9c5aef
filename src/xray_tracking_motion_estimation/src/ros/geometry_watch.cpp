#include "xray_tracking_motion_estimation/geometry_watch.h"

#include <stdexcept>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
GeometryWatch::GeometryWatch(const std::vector<std::string>& detectors, const tf2_ros::Buffer& tf_buffer)
  : tf_buffer_(tf_buffer)
{
  for (const std::string& name : detectors)
  {
    views_.push_back({ name, {}, RigidTransform::Identity() });
  }
}

void GeometryWatch::update(std::size_t detector, const sensor_msgs::CameraInfo& info)
{
  views_[detector].camera_info.update(views_[detector].name, info);
}

std::string GeometryWatch::check()
{
  try
  {
    for (View& view : views_)
    {
      if (const std::string fault = check(view); !fault.empty())
      {
        return fault;
      }
    }
  }
  catch (const std::exception& error)  // tf2's
  {
    return error.what();
  }
  return std::string();
}

std::string GeometryWatch::check(View& view) const
{
  const CameraInfoWatch& camera_info = view.camera_info;
  if (!camera_info.fault().empty())
  {
    return view.name + ": " + camera_info.fault();
  }
  if (!camera_info.valid())
  {
    return "no " + view.name + "/camera_info so far";
  }
  const RigidTransform room_from_optical =
      rigidFromTransformMsg(tf_buffer_.lookupTransform(kRoomFrame, camera_info.frame(), ros::Time(0)).transform);
  if (!accepted_)
  {
    view.room_from_optical = room_from_optical;
  }
  // Rounding of what combines transforms is let through; in mm and of the rotation times the distances, it is less than
  // a micrometre.
  else if (!room_from_optical.isApprox(view.room_from_optical, 1e-10))
  {
    return view.name + ": frame " + camera_info.frame() + " has moved in " + kRoomFrame +
           ", expected it to stay where it was at first";
  }
  return std::string();
}

std::vector<ProjectionGeometry> GeometryWatch::geometries() const
{
  std::vector<ProjectionGeometry> geometries;
  for (const View& view : views_)
  {
    geometries.push_back(view.camera_info.geometry(view.name, view.room_from_optical));
  }
  return geometries;
}
}  // namespace xray_tracking
