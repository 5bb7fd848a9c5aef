#pragma once

#include <QRegion>
#include <QWidget>

namespace xray_tracking
{
/// Whether a panel is on show in its window. Qt calls a dock visible that is behind another one's tab: it only moves it
/// out of the window.
inline bool isSeen(const QWidget& panel)
{
  return !panel.visibleRegion().isEmpty();
}
}  // namespace xray_tracking
