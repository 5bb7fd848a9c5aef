#include "treatment_widgets.h"

#include <algorithm>
#include <cmath>

#include <QPainter>
#include <QPainterPath>

#include "look.h"

namespace xray_tracking
{
namespace
{
constexpr double kDegrees = 180.0 / 3.14159265358979323846;
constexpr std::int64_t kPause = 10000000000;  ///< of exposures, over which no line is drawn [ns]
constexpr int kNameWidth = 96;
constexpr int kValueWidth = 88;

QFont sized(int pixels, bool bold = false)
{
  QFont font;
  font.setPixelSize(pixels);
  font.setBold(bold);
  return font;
}

/// 1, 2 or 5 times a power of ten, at least the value.
double roundUp(double value)
{
  if (!(value > 1e-6))
  {
    return 1e-6;
  }
  const double decade = std::pow(10.0, std::floor(std::log10(value)));
  for (const double step : { 1.0, 2.0, 5.0 })
  {
    if (value <= step * decade * (1.0 + 1e-9))
    {
      return step * decade;
    }
  }
  return 10.0 * decade;
}
}  // namespace

QColor colourOf(GateLight light)
{
  switch (light)
  {
    case GateLight::OPEN:
      return { 0x1c, 0x8f, 0x5a };
    case GateLight::CLOSED:
      return { 0xc0, 0x36, 0x30 };
    case GateLight::HELD:
      return { 0xb8, 0x72, 0x12 };
    default:
      return { 0x5c, 0x63, 0x6e };
  }
}

GateBanner::GateBanner(QWidget* parent) : QWidget(parent)
{
  setMinimumHeight(132);
  setObjectName("gate_banner");
}

void GateBanner::display(const GateView& view)
{
  const bool same = view.light == view_.light && view.headline == view_.headline && view.reason == view_.reason;
  view_ = view;
  if (!same)
  {
    update();
  }
}

void GateBanner::paintEvent(QPaintEvent*)
{
  QPainter painter(this);
  painter.setRenderHint(QPainter::Antialiasing);
  painter.setPen(Qt::NoPen);
  painter.setBrush(colourOf(view_.light));
  painter.drawRoundedRect(rect(), 8, 8);
  if (view_.light == GateLight::SILENT)
  {
    painter.setBrush(QBrush(look::kBackground, Qt::BDiagPattern));
    painter.drawRoundedRect(rect(), 8, 8);
  }
  painter.setPen(Qt::white);
  painter.setFont(sized(38, true));
  painter.drawText(rect().adjusted(16, 8, -16, -height() + 60), Qt::AlignLeft | Qt::AlignVCenter,
                   QString::fromStdString(view_.headline));
  painter.setFont(sized(14));
  painter.drawText(rect().adjusted(16, 60, -16, -6), Qt::AlignLeft | Qt::AlignTop | Qt::TextWordWrap,
                   QString::fromStdString(view_.reason));
}

ToleranceBars::ToleranceBars(QWidget* parent) : QWidget(parent)
{
  setObjectName("tolerance_bars");
  bars_ = { { { "Room x", "mm", true, std::nullopt, 3.0 },
              { "Room y", "mm", true, std::nullopt, 3.0 },
              { "Room z", "mm", true, std::nullopt, 3.0 },
              { "Distance", "mm", false, std::nullopt, 3.0 },
              { "Rotation", "°", false, std::nullopt, 3.0 },
              { "Uncertainty", "mm", false, std::nullopt, 1.5 } } };
  setFixedHeight(8 + 24 * static_cast<int>(bars_.size()));
}

void ToleranceBars::display(const TreatmentView& view)
{
  for (Bar& bar : bars_)
  {
    bar.value.reset();
  }
  for (std::size_t i = 0; i < 4; ++i)
  {
    bars_[i].tolerance = view.max_displacement;
  }
  bars_[4].tolerance = view.max_rotation;
  bars_[5].tolerance = view.max_sigma;
  stale_ = view.stale;
  if (view.measured)
  {
    const auto& gate = view.gate->message;
    const double axes[] = { gate.displacement.x, gate.displacement.y, gate.displacement.z };
    double squares = 0.0;
    for (std::size_t i = 0; i < 3; ++i)
    {
      bars_[i].value = 1e3 * axes[i];
      squares += 1e6 * axes[i] * axes[i];
    }
    bars_[3].value = std::sqrt(squares);
    bars_[4].value = kDegrees * gate.rotation;
    bars_[5].value = worstSigma(view.motion->covariance);
  }
  for (Bar& bar : bars_)
  {
    if (bar.value && !std::isfinite(*bar.value))
    {
      bar.value.reset();
    }
  }
  update();
}

void ToleranceBars::paintEvent(QPaintEvent*)
{
  QPainter painter(this);
  painter.setRenderHint(QPainter::Antialiasing);
  painter.setBrush(look::kSurface);
  painter.setPen(Qt::NoPen);
  painter.drawRoundedRect(rect(), 6, 6);
  int y = 4;
  for (const Bar& bar : bars_)
  {
    const QRectF row(10, y, width() - 20, 24);
    y += 24;
    painter.setFont(sized(13));
    painter.setPen(look::kQuiet);
    painter.drawText(row, Qt::AlignLeft | Qt::AlignVCenter, bar.name);
    const QRectF field(row.left() + kNameWidth, row.top() + 6, row.width() - kNameWidth - kValueWidth, 12);
    painter.setPen(Qt::NoPen);
    painter.setBrush(look::kBackground);
    painter.drawRoundedRect(field, 3, 3);
    // The tolerance is at two thirds of what is shown.
    const double shown = 1.5 * bar.tolerance;
    const auto at = [&](double value)
    {
      const double share = std::clamp(value / shown, -1.0, 1.0);
      return bar.is_signed ? field.center().x() + 0.5 * share * field.width()
                           : field.left() + std::max(0.0, share) * field.width();
    };
    if (bar.value)
    {
      const bool within = std::abs(*bar.value) <= bar.tolerance;
      const double from = at(0.0);
      const double to = at(*bar.value);
      painter.setBrush(stale_ ? look::kQuiet : within ? look::kAccent : look::kBad);
      painter.drawRect(
          QRectF(QPointF(std::min(from, to), field.top() + 2), QPointF(std::max(from, to), field.bottom() - 2)));
    }
    painter.setPen(QPen(look::kQuiet, 1));
    if (bar.is_signed)
    {
      painter.drawLine(QPointF(at(0.0), field.top()), QPointF(at(0.0), field.bottom()));
    }
    painter.setPen(QPen(look::kWarning, 2));
    painter.drawLine(QPointF(at(bar.tolerance), field.top() - 2), QPointF(at(bar.tolerance), field.bottom() + 2));
    if (bar.is_signed)
    {
      painter.drawLine(QPointF(at(-bar.tolerance), field.top() - 2), QPointF(at(-bar.tolerance), field.bottom() + 2));
    }
    painter.setFont(sized(15, true));
    painter.setPen(bar.value && !stale_ ? look::kText : look::kQuiet);
    const QString number = bar.value ? QString::number(*bar.value, 'f', bar.unit[0] == 'm' ? 2 : 1) : QString("-");
    painter.drawText(row, Qt::AlignRight | Qt::AlignVCenter,
                     number + (bar.unit[0] == 'm' ? " " : "") + QString::fromUtf8(bar.unit));
  }
}

StripChart::StripChart(const QString& name, const QString& unit, int decimals, QWidget* parent)
  : QWidget(parent), name_(name), unit_(unit), decimals_(decimals), values_(0, 1), lights_(0, 1)
{
  setMinimumHeight(44);
  setSizePolicy(QSizePolicy::Preferred, QSizePolicy::Expanding);
}

void StripChart::display(const RecentValues<double>& values, const TreatmentFeed::Lights& lights,
                         std::optional<double> tolerance, std::int64_t now)
{
  values_ = values;
  lights_ = lights;
  tolerance_ = tolerance;
  now_ = now;
  update();
}

double StripChart::top() const
{
  double most = tolerance_ ? 1.2 * *tolerance_ : 0.0;
  for (const auto& entry : values_.entries())
  {
    most = std::isfinite(entry.value) ? std::max(most, entry.value) : most;
  }
  return unit_.isEmpty() ? 1.0 : roundUp(most);
}

double StripChart::x(std::int64_t time) const
{
  const double share = 1.0 - static_cast<double>(now_ - time) / static_cast<double>(values_.span());
  return 1.0 + (width() - 2.0) * std::clamp(share, 0.0, 1.0);
}

void StripChart::paintEvent(QPaintEvent*)
{
  QPainter painter(this);
  painter.fillRect(rect(), look::kSurface);
  const double bottom = height() - 2.0;
  const double scale = (height() - 6.0) / top();
  if (values_.span() > 0)
  {
    const auto& lights = lights_.entries();
    for (std::size_t i = 0; i < lights.size(); ++i)
    {
      QColor colour = colourOf(lights[i].value);
      colour.setAlpha(90);
      const double from = x(lights[i].time);
      const double to = i + 1 < lights.size() ? x(lights[i + 1].time) : x(now_);
      painter.fillRect(QRectF(from, 0.0, to - from, height()), colour);
    }
  }
  if (tolerance_)
  {
    painter.setPen(QPen(look::kWarning, 1, Qt::DashLine));
    painter.drawLine(QPointF(0.0, bottom - scale * *tolerance_), QPointF(width(), bottom - scale * *tolerance_));
  }
  painter.setRenderHint(QPainter::Antialiasing);
  QPainterPath path;
  bool drawing = false;
  std::int64_t last = 0;
  std::optional<double> latest;
  for (const auto& entry : values_.entries())
  {
    latest = std::isfinite(entry.value) ? std::optional(entry.value) : std::nullopt;
    if (!latest || now_ - entry.time > values_.span())
    {
      drawing = false;
      continue;
    }
    const QPointF point(x(entry.time), bottom - scale * std::max(0.0, entry.value));
    // A pause is no line.
    if (drawing && entry.time - last < kPause)
    {
      path.lineTo(point);
    }
    else
    {
      path.moveTo(point);
      path.lineTo(point + QPointF(0.7, 0.0));
    }
    drawing = true;
    last = entry.time;
  }
  // No wider: Qt strokes wider ones as areas, and those of a minute at 30 Hz for 37 ms instead of 0.5.
  painter.setPen(QPen(look::kText, 1.0));
  painter.setBrush(Qt::NoBrush);
  painter.drawPath(path);
  painter.setFont(sized(12));
  painter.setPen(look::kQuiet);
  painter.drawText(rect().adjusted(6, 2, -6, -2), Qt::AlignLeft | Qt::AlignTop, name_);
  painter.setFont(sized(14, true));
  painter.setPen(look::kText);
  if (latest && now_ - values_.entries().back().time < kPause)
  {
    painter.drawText(rect().adjusted(6, 1, -6, -2), Qt::AlignRight | Qt::AlignTop,
                     QString::number(*latest, 'f', decimals_) + (unit_.isEmpty() ? "" : " " + unit_));
  }
}
}  // namespace xray_tracking
