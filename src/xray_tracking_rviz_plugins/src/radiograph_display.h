#pragma once

#include <rviz/display.h>

namespace xray_tracking
{
/// A detector's image as a plane where the detector stands.
class RadiographDisplay : public rviz::Display
{
  Q_OBJECT
};
}  // namespace xray_tracking
