#include "room_drawing.h"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

#include "drawing.h"

namespace xray_tracking
{
namespace
{
constexpr int kMargin = 46;           // px
constexpr double kScaleShare = 0.22;  // of the width, at most
const cv::Scalar kCt(150, 150, 150);

std::vector<Eigen::Vector3d> panelCorners(const ProjectionGeometry& detector)
{
  const double right = detector.imageSize().x() - 0.5, bottom = detector.imageSize().y() - 0.5;
  return { detector.pixelPosition({ -0.5, -0.5 }), detector.pixelPosition({ right, -0.5 }),
           detector.pixelPosition({ right, bottom }), detector.pixelPosition({ -0.5, bottom }) };
}

class RoomDrawing
{
public:
  RoomDrawing(const TreatmentSetup& setup, const std::vector<Eigen::Vector3d>& ct_corners, const RoomSide& side,
              const cv::Size& size)
    : setup_(setup), ct_(ct_corners), side_(side), canvas_(size, CV_8UC3, cv::Scalar::all(255))
  {
    Eigen::AlignedBox2d all(flat(Eigen::Vector3d::Zero()));
    for (const ProjectionGeometry& detector : setup.detectors)
    {
      all.extend(flat(detector.source()));
      for (const Eigen::Vector3d& corner : panelCorners(detector))
      {
        all.extend(flat(corner));
      }
    }
    all.extend(flat(setup.room_from_patient * setup.targetCentre()));
    const Eigen::Vector2d available(size.width - 2 * kMargin, size.height - 2 * kMargin);
    px_per_mm_ = (available.array() / all.sizes().array().max(1.0)).minCoeff();
    middle_ = all.center();
  }

  cv::Mat draw()
  {
    drawGrid();
    for (std::size_t d = 0; d < setup_.detectors.size(); ++d)
    {
      drawBeam(setup_.detectors[d], colourOf(d));
    }
    drawPatient();
    for (std::size_t d = 0; d < setup_.detectors.size(); ++d)
    {
      drawDetector(setup_.detectors[d], colourOf(d));
    }
    const cv::Point2d origin = place(Eigen::Vector3d::Zero());
    drawLine(canvas_, origin - cv::Point2d(9, 0), origin + cv::Point2d(9, 0), kInk, 2);
    drawLine(canvas_, origin - cv::Point2d(0, 9), origin + cv::Point2d(0, 9), kInk, 2);
    drawFrame();
    return canvas_;
  }

private:
  Eigen::Vector2d flat(const Eigen::Vector3d& room) const { return { room[side_.right], room[side_.up] }; }

  cv::Point2d place(const Eigen::Vector3d& room) const
  {
    const Eigen::Vector2d p = (flat(room) - middle_) * px_per_mm_;
    return { 0.5 * canvas_.cols + p.x(), 0.5 * canvas_.rows - p.y() };
  }

  void drawGrid()
  {
    const double step = roundLength(0.3 * canvas_.cols / px_per_mm_);
    const double reach = std::max(canvas_.cols, canvas_.rows) / px_per_mm_;
    for (double at = -std::ceil(2.0 * reach / step) * step; at <= 2.0 * reach; at += step)
    {
      for (const int axis : { side_.right, side_.up })
      {
        Eigen::Vector3d from = Eigen::Vector3d::Zero();
        from[axis] = at + std::round(middle_[axis == side_.right ? 0 : 1] / step) * step;
        Eigen::Vector3d to = from;
        const int other = axis == side_.right ? side_.up : side_.right;
        from[other] = middle_[other == side_.right ? 0 : 1] - reach;
        to[other] = middle_[other == side_.right ? 0 : 1] + reach;
        drawLine(canvas_, place(from), place(to), { 238, 238, 238 });
      }
    }
  }

  void drawBeam(const ProjectionGeometry& detector, const cv::Scalar& colour)
  {
    std::vector<cv::Point> panel;
    const cv::Scalar pale = 0.75 * cv::Scalar::all(255) + 0.25 * colour;
    for (const Eigen::Vector3d& corner : panelCorners(detector))
    {
      panel.emplace_back(place(corner));
      drawLine(canvas_, place(detector.source()), place(corner), pale);
    }
    cv::fillConvexPoly(canvas_, panel, pale, cv::LINE_AA);
    // Through the target's centre to where it is seen.
    const Eigen::Vector2d pixel = detector.project(setup_.room_from_patient * setup_.targetCentre());
    if (pixel.allFinite())
    {
      drawLine(canvas_, place(detector.source()), place(detector.pixelPosition(pixel)), colour);
    }
  }

  void drawDetector(const ProjectionGeometry& detector, const cv::Scalar& colour)
  {
    const std::vector<Eigen::Vector3d> corners = panelCorners(detector);
    for (std::size_t n = 0; n < 4; ++n)
    {
      drawLine(canvas_, place(corners[n]), place(corners[(n + 1) % 4]), colour, 2);
    }
    cv::circle(canvas_, cv::Point(place(corners[0])), 4, colour, cv::FILLED, cv::LINE_AA);  // pixel (0, 0)
    const cv::Point2d source = place(detector.source());
    cv::circle(canvas_, cv::Point(source), 6, colour, cv::FILLED, cv::LINE_AA);
    if (setup_.detectors.size() <= 3)
    {
      label(detector.name() + " source", source, colour);
      label(detector.name(), 0.5 * (place(corners[0]) + place(corners[2])), colour);
    }
    else if (&detector == &setup_.detectors.front() || &detector == &setup_.detectors.back())
    {
      label(detector.name(), source, colour);
    }
  }

  void drawPatient()
  {
    const RigidTransform& pose = setup_.room_from_patient;
    std::vector<cv::Point2d> box, ct;
    for (int corner = 0; corner < 8; ++corner)
    {
      box.push_back(place(pose * setup_.target_box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner))));
    }
    for (const Eigen::Vector3d& corner : ct_)
    {
      ct.push_back(place(pose * corner));
    }
    drawBox(canvas_, ct, kCt, 1);
    if (!ct.empty())
    {
      drawText(canvas_, "CT", cv::Point(ct.back()) + cv::Point(4, -4), kCt, 0.4);
    }
    drawBox(canvas_, box, kTarget, 2);
    // Axes: where the patient's left, posterior and superior point to.
    const double length = 0.16 * canvas_.cols / px_per_mm_;
    const cv::Scalar colours[] = { { 60, 60, 220 }, { 50, 150, 50 }, { 210, 100, 30 } };
    const Eigen::Vector3d centre = pose * setup_.targetCentre();
    for (int axis = 0; axis < 3; ++axis)
    {
      const cv::Point2d from = place(centre);
      const cv::Point2d to = place(centre + length * pose.linear().col(axis));
      const double seen = cv::norm(to - from);
      if (seen < 12.0)
      {
        continue;  // towards the viewer or away
      }
      cv::arrowedLine(canvas_, cv::Point(from), cv::Point(to), colours[axis], 2, cv::LINE_AA, 0, 8.0 / seen);
      drawText(canvas_, std::string(1, "LPS"[axis]), cv::Point(to + (to - from) * (10.0 / seen)) + cv::Point(-5, 5),
               colours[axis], 0.55, 2);
    }
  }

  /// Beside a point, within the picture.
  void label(const std::string& text, const cv::Point2d& at, const cv::Scalar& colour)
  {
    cv::Point place(static_cast<int>(at.x) + 9, static_cast<int>(at.y) - 8);
    place.x = std::clamp(place.x, 4, std::max(4, canvas_.cols - textWidth(text) - 4));
    place.y = std::clamp(place.y, 36, canvas_.rows - 30);
    drawText(canvas_, text, place, colour);
  }

  void drawFrame()
  {
    cv::rectangle(canvas_, cv::Rect({}, canvas_.size()), kFaint, 1);
    drawText(canvas_, side_.words, { 8, 18 }, kInk, 0.5);
    const cv::Point corner(canvas_.cols - 62, canvas_.rows - 16);
    cv::arrowedLine(canvas_, corner, corner + cv::Point(34, 0), kInk, 1, cv::LINE_AA, 0, 0.2);
    cv::arrowedLine(canvas_, corner, corner - cv::Point(0, 34), kInk, 1, cv::LINE_AA, 0, 0.2);
    drawText(canvas_, std::string(1, "xyz"[side_.right]), corner + cv::Point(38, 4), kInk);
    drawText(canvas_, std::string(1, "xyz"[side_.up]), corner + cv::Point(-4, -39), kInk);
    drawScale(canvas_, { 12, canvas_.rows - 14 }, px_per_mm_, roundLength(kScaleShare * canvas_.cols / px_per_mm_), "",
              kInk);
  }

  const TreatmentSetup& setup_;
  const std::vector<Eigen::Vector3d>& ct_;
  const RoomSide& side_;
  cv::Mat canvas_;
  double px_per_mm_ = 1.0;
  Eigen::Vector2d middle_;
};
}  // namespace

cv::Mat drawRoom(const TreatmentSetup& setup, const std::vector<Eigen::Vector3d>& ct_corners, const RoomSide& side,
                 const cv::Size& size)
{
  return RoomDrawing(setup, ct_corners, side, size).draw();
}
}  // namespace xray_tracking
