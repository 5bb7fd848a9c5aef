#pragma once

#include "xray_tracking_core/geometry/rigid_transform.h"

namespace xray_tracking
{
/// Where the two rigid parts of a patient are: the target's bone and the rest of the body. Both map the patient frame
/// to the room [mm]; they are equal while the patient lies as in the CT.
struct BodyPoses
{
  RigidTransform room_from_target;
  RigidTransform room_from_rest;
};
}  // namespace xray_tracking
