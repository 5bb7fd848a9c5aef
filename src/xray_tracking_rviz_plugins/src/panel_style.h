#pragma once

#include <QColor>
#include <QString>

#include "gate_light.h"

namespace xray_tracking
{
/// Colours of what we draw ourselves: to be read in a dark room.
namespace style
{
inline const QColor kGround(0x1b, 0x1f, 0x24);
inline const QColor kCard(0x25, 0x2b, 0x32);
inline const QColor kLine(0x3d, 0x46, 0x50);
inline const QColor kText(0xe8, 0xeb, 0xee);
inline const QColor kDim(0x93, 0x9d, 0xa8);
inline const QColor kAccent(0x5a, 0xb0, 0xf0);
inline const QColor kGood(0x2c, 0xb0, 0x70);
inline const QColor kWarn(0xe0, 0x9a, 0x2b);
inline const QColor kBad(0xd2, 0x43, 0x3c);
inline const QColor kUnknown(0x6a, 0x70, 0x7a);

/// Of the gate's banner, and behind charts.
inline QColor ofLight(GateLight light)
{
  switch (light)
  {
    case GateLight::OPEN:
      return kGood;
    case GateLight::CLOSED:
      return kBad;
    case GateLight::HELD:
      return kWarn;
    default:
      return kUnknown;
  }
}

/// The style sheet of a panel: its own widgets alone.
inline QString sheet()
{
  return QString(
      "QWidget#ground { background: #1b1f24; }"
      "QLabel { color: #e8ebee; font-size: 13px; }"
      "QLabel#dim { color: #939da8; font-size: 12px; }"
      "QPushButton { background: #323a43; color: #e8ebee; border: 1px solid #48525d; border-radius: 6px;"
      "  padding: 7px 4px; font-size: 14px; }"
      "QPushButton:hover { background: #3d4752; }"
      "QPushButton:pressed { background: #262c33; }"
      "QPushButton:disabled { color: #656e78; background: #252b32; border-color: #333b44; }"
      "QPushButton#hold { background: #8d2b26; border: 2px solid #d2433c; font-size: 20px; font-weight: bold;"
      "  padding: 12px; }"
      "QPushButton#hold:hover { background: #a9332d; }"
      "QPushButton#release { font-size: 16px; padding: 12px; }"
      "QPushButton#release:enabled { border: 2px solid #e09a2b; color: #f4c77c; }"
      "QPushButton#record:checked { background: #8d2b26; border-color: #d2433c; }"
      "QToolTip { color: #e8ebee; background: #323a43; border: 1px solid #48525d; }");
}
}  // namespace style
}  // namespace xray_tracking
