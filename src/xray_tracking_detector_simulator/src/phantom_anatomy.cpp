#include "xray_tracking_detector_simulator/anatomy.h"

namespace xray_tracking
{
void PhantomAnatomy::materials(const ProjectionGeometry& geometry, const BodyPoses& poses, cv::Mat& soft,
                               cv::Mat& bone) const
{
  phantom_.lineIntegrals(geometry, poses.room_from_target, poses.room_from_rest, soft, bone);
}
}  // namespace xray_tracking
