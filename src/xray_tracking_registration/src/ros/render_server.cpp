#include "xray_tracking_registration/render_server.h"

#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <stdexcept>
#include <utility>

#include <cv_bridge/cv_bridge.h>
#include <sensor_msgs/image_encodings.h>
#include <tbb/task_arena.h>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
constexpr int kLeastSize = 16;  // points along a panel's longer side
constexpr int kMostSize = 512;
constexpr std::size_t kMostViews = 16;
/// Projections do not depend on it [mm].
constexpr double kAnyPanelDistance = 1000.0;

xray_tracking_msgs::RenderedView rendered(const Registration& registration, const ProjectionGeometry& geometry,
                                          const RigidTransform& room_from_patient, int max_size)
{
  const Eigen::Vector2i& size = geometry.imageSize();
  const int binning = (size.maxCoeff() + max_size - 1) / max_size;
  const PixelGrid grid = PixelGrid::binnedRegion(Eigen::Vector2i::Zero(), size, binning);
  cv_bridge::CvImage picture;
  picture.encoding = sensor_msgs::image_encodings::TYPE_32FC1;
  registration.render(geometry, grid, room_from_patient, picture.image);
  if (!cv::checkRange(picture.image))
  {
    throw std::runtime_error("the pose is too far away to be rendered");
  }
  xray_tracking_msgs::RenderedView view;
  picture.toImageMsg(view.line_integrals);
  view.first_x = grid.first.x();
  view.first_y = grid.first.y();
  view.step = grid.step.x();
  return view;
}
}  // namespace

RenderServer::RenderServer(const ros::NodeHandle& pnh, const tf2_ros::Buffer& tf_buffer, Current current)
  : pnh_(pnh), tf_buffer_(tf_buffer), current_(std::move(current))
{
  pnh_.setCallbackQueue(&queue_);
  service_ = pnh_.advertiseService("render", &RenderServer::renderCb, this);
  thread_ = std::thread([this] { work(); });
}

RenderServer::~RenderServer()
{
  stop_ = true;
  thread_.join();
}

void RenderServer::work()
{
  // Linux has priorities of threads by their ids.
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), 19);
  tbb::task_arena alone(1);
  while (!stop_)
  {
    alone.execute([this] { queue_.callAvailable(ros::WallDuration(0.1)); });
  }
}

bool RenderServer::renderCb(xray_tracking_msgs::RenderViews::Request& request,
                            xray_tracking_msgs::RenderViews::Response& response)
{
  try
  {
    const std::shared_ptr<const Registration> registration = current_(response.message);
    if (!registration)
    {
      return true;
    }
    requireOption(request.max_size >= kLeastSize && request.max_size <= kMostSize, "max_size", request.max_size,
                  "16 to 512");
    requireOption(!request.camera_infos.empty() && request.camera_infos.size() <= kMostViews,
                  "the number of camera_infos", request.camera_infos.size(), "1 to 16");
    const RigidTransform room_from_patient = rigidFromPoseMsg(request.pose);
    for (const sensor_msgs::CameraInfo& info : request.camera_infos)
    {
      const RigidTransform room_from_optical =
          rigidFromTransformMsg(tf_buffer_.lookupTransform(kRoomFrame, info.header.frame_id, ros::Time(0)).transform);
      const ProjectionGeometry geometry =
          geometryFromCameraInfo("detector", info, room_from_optical, kAnyPanelDistance);
      response.views.push_back(
          rendered(*registration, geometry, room_from_patient, static_cast<int>(request.max_size)));
    }
    response.success = true;
  }
  catch (const std::exception& error)  // tf2's too
  {
    response.views.clear();
    response.message = error.what();
  }
  return true;
}
}  // namespace xray_tracking
