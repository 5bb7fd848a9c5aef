#pragma once

#include <QColor>
#include <QString>

namespace xray_tracking
{
/// What all our widgets look like: calm and dark, for a room where little light is on.
namespace look
{
const QColor kBackground(0x12, 0x15, 0x1a);
const QColor kSurface(0x1c, 0x21, 0x28);
const QColor kBorder(0x33, 0x3b, 0x46);
const QColor kText(0xd9, 0xe0, 0xe8);
const QColor kQuiet(0x8b, 0x97, 0xa5);   ///< text of less weight
const QColor kAccent(0x4c, 0xb8, 0xff);  ///< what can be done, what is chosen
const QColor kGood(0x3d, 0xd6, 0x8c);
const QColor kWarning(0xff, 0xb9, 0x46);
const QColor kBad(0xff, 0x5c, 0x5c);
const QColor kTarget(0xf0, 0x7a, 0xe8);   ///< the target's box and bone
const QColor kOverlay(0xff, 0xa0, 0x40);  ///< what was computed from the CT

/// Of a panel and all that is in it.
inline QString styleSheet()
{
  return QString(
      "QWidget { background: #12151a; color: #d9e0e8; font-size: 10pt; }"
      "QLabel { background: transparent; }"
      "QPushButton, QToolButton, QComboBox, QSpinBox, QDoubleSpinBox, QLineEdit {"
      "  background: #1c2128; border: 1px solid #333b46; border-radius: 5px; padding: 4px 9px; min-height: 18px; }"
      "QPushButton:hover, QToolButton:hover, QComboBox:hover, QSpinBox:hover { border-color: #4cb8ff; }"
      "QPushButton:pressed, QToolButton:pressed { background: #26303b; }"
      "QPushButton:checked, QToolButton:checked { background: #1d4a6b; border-color: #4cb8ff; color: white; }"
      "QPushButton:disabled, QToolButton:disabled, QComboBox:disabled, QSpinBox:disabled { color: #5b6673; "
      "  border-color: #262c34; }"
      "QPushButton[primary=\"true\"] { background: #1f6fa5; border-color: #4cb8ff; color: white; }"
      "QPushButton[primary=\"true\"]:disabled { background: #1c2128; border-color: #262c34; color: #5b6673; }"
      "QComboBox QFrame { background: #1c2128; border: 1px solid #333b46; }"
      "QComboBox QAbstractItemView { background: #1c2128; selection-background-color: #1d4a6b; }"
      "QComboBox::drop-down { border: none; width: 20px; }"
      "QComboBox::down-arrow { image: none; width: 0; height: 0; margin-right: 10px;"
      "  border-left: 4px solid #1c2128; border-right: 4px solid #1c2128; border-top: 6px solid #8b97a5; }"
      "QSlider::groove:horizontal { height: 4px; background: #333b46; border-radius: 2px; }"
      "QSlider::handle:horizontal { width: 14px; margin: -6px 0; border-radius: 7px; background: #4cb8ff; }"
      "QSlider::handle:horizontal:disabled { background: #4a5460; }"
      "QToolTip { background: #1c2128; color: #d9e0e8; border: 1px solid #4cb8ff; }");
}
}  // namespace look
}  // namespace xray_tracking
