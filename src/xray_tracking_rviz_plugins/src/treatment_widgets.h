#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include <QColor>
#include <QWidget>

#include "treatment_feed.h"

namespace xray_tracking
{
/// Of fields with white text on them.
QColor colourOf(GateLight light);

/// The gate's state: a coloured field with its headline and its reason.
class GateBanner : public QWidget
{
public:
  explicit GateBanner(QWidget* parent);
  void display(const GateView& view);
  const GateView& shown() const { return view_; }

protected:
  void paintEvent(QPaintEvent* event) override;

private:
  GateView view_;
};

/// Displacement by axis, distance, rotation and uncertainty, each against its tolerance; of an exposure without a pose
/// nothing, of a stale one without colour.
class ToleranceBars : public QWidget
{
public:
  explicit ToleranceBars(QWidget* parent);
  void display(const TreatmentView& view);
  /// What is shown, if there is anything. @param bar 0 to 5, in the order above
  std::optional<double> value(std::size_t bar) const { return bars_.at(bar).value; }
  bool stale() const { return stale_; }

protected:
  void paintEvent(QPaintEvent* event) override;

private:
  struct Bar
  {
    const char* name;
    const char* unit;
    bool is_signed;
    std::optional<double> value;
    double tolerance;
  };
  std::array<Bar, 6> bars_;
  bool stale_ = false;
};

/// One quantity over the last minute, with the gate's colour behind.
class StripChart : public QWidget
{
public:
  /// @param decimals of the value that is written
  StripChart(const QString& name, const QString& unit, int decimals, QWidget* parent);
  /// @param tolerance drawn as a line; none: nothing
  void display(const RecentValues<double>& values, const TreatmentFeed::Lights& lights, std::optional<double> tolerance,
               std::int64_t now);

protected:
  void paintEvent(QPaintEvent* event) override;

private:
  double top() const;  ///< of the scale, a round number
  double x(std::int64_t time) const;

  QString name_, unit_;
  int decimals_;
  RecentValues<double> values_;
  TreatmentFeed::Lights lights_;
  std::optional<double> tolerance_;
  std::int64_t now_ = 0;
};
}  // namespace xray_tracking
