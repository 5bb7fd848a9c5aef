#pragma once

#include <rviz/panel.h>

namespace xray_tracking
{
/// All detectors' images side by side, with what is tracked in them.
class RadiographPanel : public rviz::Panel
{
  Q_OBJECT
};
}  // namespace xray_tracking
