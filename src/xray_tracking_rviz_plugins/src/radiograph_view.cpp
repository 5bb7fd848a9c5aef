#include "radiograph_view.h"

#include <cmath>

#include <QKeyEvent>
#include <QMouseEvent>
#include <QPainter>
#include <QPainterPath>
#include <QWheelEvent>

namespace xray_tracking
{
namespace
{
constexpr double kHandle = 7.0;        // reach of edges and corners, screen pixels
constexpr double kZoomStep = 1.2;      // a notch of the wheel
constexpr double kWindowDrag = 300.0;  // screen pixels that double the width
constexpr double kDot = 2.0;           // radius, screen pixels

QPointF toQt(const Eigen::Vector2d& point)
{
  return { point.x(), point.y() };
}

/// From green, faint, to red.
QColor colourOf(const ResidualDot& dot)
{
  const auto between = [&](int from, int to) { return static_cast<int>(std::lround(from + dot.share * (to - from))); };
  return { between(look::kGood.red(), look::kBad.red()), between(look::kGood.green(), look::kBad.green()),
           between(look::kGood.blue(), look::kBad.blue()), between(90, 255) };
}

Eigen::Vector2d positionOf(const QMouseEvent* event)
{
  return { event->localPos().x(), event->localPos().y() };
}
}  // namespace

RadiographView::RadiographView(QWidget* parent) : QWidget(parent), worker_([this] { make(); })
{
  setMouseTracking(true);
  setFocusPolicy(Qt::ClickFocus);
  setMinimumSize(160, 140);
  setSizePolicy(QSizePolicy::Expanding, QSizePolicy::Expanding);
  setAttribute(Qt::WA_OpaquePaintEvent);
}

RadiographView::~RadiographView() = default;

void RadiographView::setImage(const sensor_msgs::ImageConstPtr& image,
                              const std::shared_ptr<const Rendering>& rendering)
{
  if (image == next_.image && rendering == next_.rendering)
  {
    return;
  }
  next_.image = image;
  next_.rendering = rendering;
  request();
}

void RadiographView::setDrawing(const Drawing& drawing)
{
  drawing_ = drawing;
  update();
}

void RadiographView::setOverlay(Overlay overlay, double share)
{
  next_.overlay = overlay;
  next_.share = share;
  request();
}

void RadiographView::setInverted(bool inverted)
{
  next_.inverted = inverted;
  request();
}

void RadiographView::setCounts(bool counts)
{
  if (counts != next_.counts)
  {
    next_.counts = counts;
    request();
  }
}

void RadiographView::setWindow(const std::optional<GreyWindow>& window)
{
  next_.automatic = !window;
  if (window)
  {
    next_.window = *window;
  }
  request();
}

void RadiographView::setReadOut(const QString& text)
{
  if (text != read_out_)
  {
    read_out_ = text;
    update();
  }
}

void RadiographView::setEditing(bool editing)
{
  editing_ = editing;
  unsetCursor();
  update();
}

void RadiographView::setRegion(const cv::Rect& region)
{
  editor_.set(region);
  update();
}

std::optional<Eigen::Vector2d> RadiographView::pointer() const
{
  if (!pointer_ || picture_.pixels.empty())
  {
    return std::nullopt;
  }
  const Eigen::Vector2d pixel = picture_.request.mapping.toPixel(*pointer_);
  const bool inside = pixel.x() >= -0.5 && pixel.y() >= -0.5 && pixel.x() < picture_.pixels.cols - 0.5 &&
                      pixel.y() < picture_.pixels.rows - 0.5;
  return inside ? std::optional<Eigen::Vector2d>(pixel) : std::nullopt;
}

void RadiographView::showAll()
{
  fitted_ = true;
  request();
}

void RadiographView::request()
{
  const cv::Size image =
      next_.image ? cv::Size(static_cast<int>(next_.image->width), static_cast<int>(next_.image->height)) : cv::Size();
  if (image != image_size_)
  {
    image_size_ = image;
    editor_.setImageSize(image);
    fitted_ = true;
  }
  next_.size = cv::Size(width(), height());
  if (fitted_)
  {
    next_.mapping = ViewMapping::fit(image_size_, next_.size);
  }
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    wanted_ = next_;
  }
  worker_.wake();
}

void RadiographView::make()
{
  PictureRequest wanted;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    wanted = wanted_;
  }
  Picture picture = maker_.make(wanted);
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    made_ = std::move(picture);
  }
  QMetaObject::invokeMethod(this, "takePicture", Qt::QueuedConnection);
}

void RadiographView::takePicture()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!made_)
    {
      return;
    }
    picture_ = std::move(*made_);
    made_.reset();
  }
  update();
  Q_EMIT pictureChanged();
}

void RadiographView::paintEvent(QPaintEvent*)
{
  QPainter painter(this);
  const cv::Mat& colours = picture_.colours;
  if (colours.cols != width() || colours.rows != height())
  {
    painter.fillRect(rect(), look::kBackground);
  }
  if (!colours.empty())
  {
    painter.drawImage(
        0, 0, QImage(colours.data, colours.cols, colours.rows, static_cast<int>(colours.step), QImage::Format_RGB32));
  }
  painter.setRenderHint(QPainter::Antialiasing);
  const ViewMapping& mapping = picture_.request.mapping;
  if (!colours.empty())
  {
    painter.setPen(QPen(look::kTarget, 1.3));
    for (const Segment& segment : drawing_.box)
    {
      painter.drawLine(toQt(mapping.toWidget(segment[0])), toQt(mapping.toWidget(segment[1])));
    }
    if (drawing_.began)
    {
      painter.setPen(QPen(QColor(255, 255, 255, 150), 1.0, Qt::DashLine));
      drawOutline(painter, *drawing_.began);
    }
    if (drawing_.trail.size() > 1)
    {
      QPainterPath path(toQt(mapping.toWidget(drawing_.trail.front())));
      for (const Eigen::Vector2d& point : drawing_.trail)
      {
        path.lineTo(toQt(mapping.toWidget(point)));
      }
      painter.setPen(QPen(look::kAccent, 1.0));  // wider ones take long, see StripChart
      painter.drawPath(path);
    }
    painter.setPen(Qt::NoPen);
    for (const ResidualDot& dot : drawing_.residuals)
    {
      painter.setBrush(colourOf(dot));
      painter.drawEllipse(toQt(mapping.toWidget(dot.pixel)), kDot, kDot);
    }
    if (drawing_.now)
    {
      painter.setPen(QPen(drawing_.colour, 2.0));
      drawOutline(painter, *drawing_.now);
    }
    if (editing_)
    {
      drawRegion(painter);
    }
  }
  drawText(painter);
}

void RadiographView::drawOutline(QPainter& painter, const Outline& outline) const
{
  QPolygonF polygon;
  for (const Eigen::Vector2d& corner : outline)
  {
    polygon << toQt(picture_.request.mapping.toWidget(corner));
  }
  painter.setBrush(Qt::NoBrush);
  painter.drawPolygon(polygon);
}

void RadiographView::drawRegion(QPainter& painter) const
{
  if (!editor_.region())
  {
    return;
  }
  const cv::Rect& region = *editor_.region();
  const ViewMapping& mapping = picture_.request.mapping;
  const Eigen::Vector2d low = mapping.toWidget({ region.x - 0.5, region.y - 0.5 });
  const Eigen::Vector2d high = low + mapping.scale * Eigen::Vector2d(region.width, region.height);
  const QRectF box(toQt(low), toQt(high));
  QPainterPath around;
  around.addRect(rect());
  around.addRect(box);
  painter.fillPath(around, QColor(0, 0, 0, 70));
  painter.setPen(QPen(look::kAccent, 2.0));
  painter.setBrush(Qt::NoBrush);
  painter.drawRect(box);
  painter.setPen(Qt::NoPen);
  painter.setBrush(look::kAccent);
  for (const double x : { box.left(), box.center().x(), box.right() })
  {
    for (const double y : { box.top(), box.center().y(), box.bottom() })
    {
      if (x != box.center().x() || y != box.center().y())
      {
        painter.drawRect(QRectF(x - 4.0, y - 4.0, 8.0, 8.0));
      }
    }
  }
}

void RadiographView::drawText(QPainter& painter) const
{
  const int margin = 10;
  const auto shadowed = [&](const QRect& where, int flags, const QString& text, const QColor& colour)
  {
    painter.setPen(QColor(0, 0, 0, 190));
    painter.drawText(where.translated(1, 1), flags, text);
    painter.setPen(colour);
    painter.drawText(where, flags, text);
  };
  QFont large = font();
  large.setPointSizeF(12.5);
  large.setBold(true);
  const QRect area = rect().adjusted(margin, margin, -margin, -margin);
  painter.setFont(large);
  shadowed(area, Qt::AlignTop | Qt::AlignLeft, drawing_.title, look::kText);
  shadowed(area, Qt::AlignTop | Qt::AlignRight, drawing_.state, drawing_.colour);
  const int line = painter.fontMetrics().height();
  painter.setFont(font());
  shadowed(area.adjusted(area.width() / 3, line + 2, 0, 0), Qt::AlignTop | Qt::AlignRight | Qt::TextWordWrap,
           drawing_.note, look::kText);
  shadowed(area, Qt::AlignBottom | Qt::AlignLeft, read_out_, look::kText);
  const QString fault = drawing_.missing.isEmpty() ? QString::fromStdString(picture_.fault) : drawing_.missing;
  if (!fault.isEmpty())
  {
    QFont middle = font();
    middle.setPointSizeF(11.5);
    painter.setFont(middle);
    shadowed(area.adjusted(20, 0, -20, 0), Qt::AlignCenter | Qt::TextWordWrap, fault, look::kWarning);
  }
}

void RadiographView::resizeEvent(QResizeEvent*)
{
  request();
}

void RadiographView::wheelEvent(QWheelEvent* event)
{
  const double notches = event->angleDelta().y() / 120.0;
#if QT_VERSION >= QT_VERSION_CHECK(5, 14, 0)
  const QPointF position = event->position();
#else
  const QPointF position = event->posF();
#endif
  next_.mapping = next_.mapping.zoomed(std::pow(kZoomStep, notches), { position.x(), position.y() });
  fitted_ = false;
  request();
  event->accept();
}

double RadiographView::reach() const
{
  return kHandle / next_.mapping.scale;
}

void RadiographView::mousePressEvent(QMouseEvent* event)
{
  if (button_ != Qt::NoButton)
  {
    return;
  }
  button_ = event->button();
  pressed_ = positionOf(event);
  mapping_before_ = next_.mapping;
  window_before_ = picture_.window;
  if (editing_ && button_ == Qt::LeftButton)
  {
    editor_.press(next_.mapping.toPixel(pressed_), reach());
  }
}

void RadiographView::mouseMoveEvent(QMouseEvent* event)
{
  const Eigen::Vector2d position = positionOf(event);
  const Eigen::Vector2d moved = position - pressed_;
  pointer_ = position;
  const Eigen::Vector2d pixel = next_.mapping.toPixel(position);
  if (button_ == Qt::RightButton)
  {
    next_.automatic = false;
    next_.window = window_before_.adjusted(-moved.y() / kWindowDrag, moved.x() / kWindowDrag);
    request();
    Q_EMIT windowSet();
  }
  else if (button_ == Qt::LeftButton && editing_)
  {
    if (editor_.drag(pixel))
    {
      update();
      Q_EMIT regionEdited();
    }
  }
  else if (button_ == Qt::LeftButton || button_ == Qt::MiddleButton)
  {
    next_.mapping = mapping_before_.moved(moved);
    fitted_ = false;
    request();
  }
  else if (editing_)
  {
    updateCursor(pixel);
  }
  Q_EMIT pointerMoved();
}

void RadiographView::mouseReleaseEvent(QMouseEvent* event)
{
  if (event->button() != button_)
  {
    return;
  }
  button_ = Qt::NoButton;
  editor_.release();
}

void RadiographView::mouseDoubleClickEvent(QMouseEvent* event)
{
  if (!editing_ && event->button() == Qt::LeftButton)
  {
    showAll();
  }
}

void RadiographView::leaveEvent(QEvent*)
{
  pointer_.reset();
  Q_EMIT pointerMoved();
}

void RadiographView::keyPressEvent(QKeyEvent* event)
{
  cv::Point by;
  switch (event->key())
  {
    case Qt::Key_Left:
      by.x = -1;
      break;
    case Qt::Key_Right:
      by.x = 1;
      break;
    case Qt::Key_Up:
      by.y = -1;
      break;
    case Qt::Key_Down:
      by.y = 1;
      break;
    default:
      QWidget::keyPressEvent(event);
      return;
  }
  if (!editing_ || !editor_.region())
  {
    QWidget::keyPressEvent(event);
    return;
  }
  const cv::Rect moved = *editor_.region() + by;
  if ((moved & cv::Rect(cv::Point(), image_size_)) == moved)
  {
    editor_.set(moved);
    update();
    Q_EMIT regionEdited();
  }
}

void RadiographView::updateCursor(const Eigen::Vector2d& pixel)
{
  using Grip = RegionEditor::Grip;
  switch (editor_.gripAt(pixel, reach()))
  {
    case Grip::INSIDE:
      setCursor(Qt::SizeAllCursor);
      break;
    case Grip::LEFT:
    case Grip::RIGHT:
      setCursor(Qt::SizeHorCursor);
      break;
    case Grip::TOP:
    case Grip::BOTTOM:
      setCursor(Qt::SizeVerCursor);
      break;
    case Grip::TOP_LEFT:
    case Grip::BOTTOM_RIGHT:
      setCursor(Qt::SizeFDiagCursor);
      break;
    case Grip::TOP_RIGHT:
    case Grip::BOTTOM_LEFT:
      setCursor(Qt::SizeBDiagCursor);
      break;
    default:
      setCursor(Qt::CrossCursor);
      break;
  }
}
}  // namespace xray_tracking
