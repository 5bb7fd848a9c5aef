#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include <QWidget>

#include "look.h"
#include "picture.h"
#include "region_editor.h"
#include "track_shape.h"
#include "worker.h"

namespace xray_tracking
{
/// What is drawn upon a radiograph; pixel coordinates of its image.
struct Drawing
{
  std::optional<Outline> began;
  std::optional<Outline> now;
  std::vector<Eigen::Vector2d> trail;  ///< oldest first
  std::vector<Segment> box;
  std::vector<ResidualDot> residuals;
  QColor colour = look::kQuiet;  ///< of the region's state
  QString title;                 ///< detector
  QString state;                 ///< in words, in `colour`
  QString note;                  ///< beside it, quiet
  QString missing;               ///< across the middle: what there is nothing to see for
};

/// One radiograph with what is tracked in it. Wheel: zoom; left or middle button: pan; right button: brightness and
/// contrast; double click: all of the image. While a region is being edited, the left button draws, moves and resizes
/// it, and arrow keys move it by a pixel.
///
/// Pictures are made in a thread of their own, of the newest image and settings; painting takes what is ready.
class RadiographView : public QWidget
{
  Q_OBJECT
public:
  explicit RadiographView(QWidget* parent = nullptr);
  ~RadiographView() override;

  void setImage(const sensor_msgs::ImageConstPtr& image, const std::shared_ptr<const Rendering>& rendering);
  void setDrawing(const Drawing& drawing);
  void setOverlay(Overlay overlay, double share);
  void setInverted(bool inverted);
  /// Pixel values are counts, with dark bone; else attenuation.
  void setCounts(bool counts);
  /// @param window none: automatic
  void setWindow(const std::optional<GreyWindow>& window);
  /// Text of the line at the bottom.
  void setReadOut(const QString& text);

  void setEditing(bool editing);
  void setRegion(const cv::Rect& region);
  const std::optional<cv::Rect>& region() const { return editor_.region(); }

  /// The picture on the screen.
  const Picture& picture() const { return picture_; }
  /// Where the pointer is; none if it is not on the image. [px]
  std::optional<Eigen::Vector2d> pointer() const;

  QSize sizeHint() const override { return { 480, 420 }; }

public Q_SLOTS:
  void showAll();

Q_SIGNALS:
  void pointerMoved();
  void pictureChanged();
  void regionEdited();
  /// The user has set a window of his own.
  void windowSet();

protected:
  void paintEvent(QPaintEvent* event) override;
  void resizeEvent(QResizeEvent* event) override;
  void wheelEvent(QWheelEvent* event) override;
  void mousePressEvent(QMouseEvent* event) override;
  void mouseMoveEvent(QMouseEvent* event) override;
  void mouseReleaseEvent(QMouseEvent* event) override;
  void mouseDoubleClickEvent(QMouseEvent* event) override;
  void leaveEvent(QEvent* event) override;
  void keyPressEvent(QKeyEvent* event) override;

private Q_SLOTS:
  void takePicture();

private:
  void request();
  void make();
  void updateCursor(const Eigen::Vector2d& pixel);
  double reach() const;  ///< of the region's handles [px]
  void drawOutline(QPainter& painter, const Outline& outline) const;
  void drawRegion(QPainter& painter) const;
  void drawText(QPainter& painter) const;

  PictureRequest next_;
  bool fitted_ = true;  ///< the mapping follows the widget's size
  cv::Size image_size_;
  Picture picture_;
  Drawing drawing_;
  QString read_out_;
  bool editing_ = false;
  RegionEditor editor_;
  std::optional<Eigen::Vector2d> pointer_;  ///< widget
  Qt::MouseButton button_ = Qt::NoButton;   ///< that is down
  Eigen::Vector2d pressed_ = Eigen::Vector2d::Zero();
  ViewMapping mapping_before_;
  GreyWindow window_before_;

  std::mutex mutex_;  ///< of the two below
  PictureRequest wanted_;
  std::optional<Picture> made_;
  PictureMaker maker_;  ///< the worker's alone
  Worker worker_;       ///< last: it uses all the others
};
}  // namespace xray_tracking
