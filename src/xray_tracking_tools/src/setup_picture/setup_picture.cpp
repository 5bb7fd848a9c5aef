#include "setup_picture.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <sstream>

#include <opencv2/imgproc.hpp>

#include "drawing.h"
#include "room_drawing.h"
#include "xray_tracking_core/image/attenuation.h"
#include "xray_tracking_core/image/xray_field.h"

namespace xray_tracking
{
namespace
{
constexpr int kWidth = 1500;  // px
constexpr int kRoomHeight = 430;
constexpr int kHeading = 26;
constexpr int kLine = 20;
constexpr int kGap = 8;
const cv::Scalar kOrigin(255, 255, 0);
constexpr double kClipped = 0.01;  // of the darkest and of the brightest pixels

/// Grey values of what X-rays lose, bright bone, with the contrast of each neighbourhood: air beside the patient would
/// take all of it.
/// @param outside CV_8UC1, other than 0 where there are no X-rays, or empty
cv::Mat greyOf(const cv::Mat& attenuation, const cv::Mat& outside = {})
{
  std::vector<float> sorted;
  sorted.reserve(attenuation.total());
  for (int row = 0; row < attenuation.rows; ++row)
  {
    for (int column = 0; column < attenuation.cols; ++column)
    {
      const float value = attenuation.at<float>(row, column);
      if (std::isfinite(value) && (outside.empty() || outside.at<std::uint8_t>(row, column) == 0))
      {
        sorted.push_back(value);
      }
    }
  }
  cv::Mat grey(attenuation.size(), CV_8UC1, cv::Scalar(0));
  if (sorted.empty())
  {
    return grey;
  }
  std::sort(sorted.begin(), sorted.end());
  const float low = sorted[static_cast<std::size_t>(kClipped * (sorted.size() - 1.0))];
  const float high = sorted[static_cast<std::size_t>((1.0 - kClipped) * (sorted.size() - 1.0))];
  const double scale = 255.0 / std::max(1e-6F, high - low);
  attenuation.convertTo(grey, CV_8U, scale, -scale * low);
  cv::createCLAHE(2.0, { 4, 4 })->apply(grey, grey);
  if (!outside.empty())
  {
    grey.setTo(0, outside);
  }
  return grey;
}

cv::Mat greyOfXray(const cv::Mat& image, const IntensityModel& intensity)
{
  constexpr int kLeast = 16;  // px, of an image whose field can be found
  cv::Mat outside = cv::Mat::zeros(image.size(), CV_8UC1);
  if (image.cols >= kLeast && image.rows >= kLeast)
  {
    XrayField field;
    field.update(image, intensity);
    if (field.nothing().empty())
    {
      field.mark(cv::Rect({}, image.size()), 1, outside);
    }
  }
  return greyOf(attenuationImage(image, intensity), outside);
}

/// A detector's images.
class ViewDrawing
{
public:
  ViewDrawing(const TreatmentSetup& setup, std::size_t detector, int width)
    : setup_(setup), detector_(setup.detectors[detector]), colour_(colourOf(detector)), width_(width)
  {
    const Eigen::Vector2i& size = detector_.imageSize();
    // A panel that is taller than wide must not take the page.
    height_ = static_cast<int>(std::lround(std::min(1.0 * width_ / size.x(), 1.1 * width_ / size.y()) * size.y()));
  }

  int height() const { return height_ + 2 * kHeading; }

  /// @param likeness in words; may be empty
  cv::Mat draw(const cv::Mat& xray, const cv::Mat& drr, const std::string& likeness)
  {
    cv::Mat block(height(), 3 * width_ + 2 * kGap, CV_8UC3, cv::Scalar::all(255));
    drawText(block, heading(), { 4, kHeading - 8 }, colour_, 0.5, 1);
    const cv::Mat of_xray = xray.empty() ? cv::Mat() : greyOfXray(xray, setup_.intensity);
    const cv::Mat of_drr = drr.empty() ? cv::Mat() : greyOf(drr);
    const cv::Rect whole(0, 0, detector_.imageSize().x(), detector_.imageSize().y());
    put(block, 0, "X-ray", of_xray, "no image is given", whole);
    put(block, 1, isSmall() ? "DRR" : "DRR at the initial pose", of_drr, "no CT", whole);
    cv::Mat both;
    if (!of_xray.empty() && !of_drr.empty())
    {
      cv::merge(std::vector<cv::Mat>{ of_drr, of_drr, of_xray }, both);
    }
    put(block, 2, (isSmall() ? "both" : "both: X-ray red, DRR cyan") + likeness, both, "", aroundTarget());
    return block;
  }

private:
  bool isSmall() const { return width_ < 300; }

  std::string heading() const
  {
    if (isSmall())
    {
      return detector_.name();
    }
    const Eigen::Vector3d target = setup_.room_from_patient * setup_.targetCentre();
    std::ostringstream text;
    text.precision(4);
    text << detector_.name() << ", as seen from its source: " << detector_.imageSize().x() << " x "
         << detector_.imageSize().y() << " px of " << detector_.pixelPitch().x() << " x " << detector_.pixelPitch().y()
         << " mm, source to panel " << detector_.sourceToDetector() << " mm";
    if (detector_.depth(target) > 0.0)
    {
      text << ", to target " << detector_.depth(target) << " mm";
    }
    return text.str();
  }

  /// What is seen of the target and as much beside it; all where that is most of the image, or nothing is seen.
  cv::Rect aroundTarget() const
  {
    const cv::Rect whole(0, 0, detector_.imageSize().x(), detector_.imageSize().y());
    const cv::Rect target = projectedTargetRegion(setup_, detector_);
    if (target.empty())
    {
      return whole;
    }
    // As much of the panel along columns as along rows.
    const double share =
        std::min(1.0, 2.0 * std::max(1.0 * target.width / whole.width, 1.0 * target.height / whole.height));
    const cv::Size size(std::max(1, static_cast<int>(share * whole.width)),
                        std::max(1, static_cast<int>(share * whole.height)));
    const cv::Point middle = (target.tl() + target.br()) / 2;
    return { { std::clamp(middle.x - size.width / 2, 0, whole.width - size.width),
               std::clamp(middle.y - size.height / 2, 0, whole.height - size.height) },
             size };
  }

  /// A part of the image as it lies in the picture.
  struct Window
  {
    cv::Rect part;
    double scale;
    cv::Point2d place(const Eigen::Vector2d& pixel) const
    {
      return { (pixel.x() - part.x + 0.5) * scale - 0.5, (pixel.y() - part.y + 0.5) * scale - 0.5 };
    }
  };

  void put(cv::Mat& block, int column, const std::string& words, const cv::Mat& image, const std::string& otherwise,
           const cv::Rect& part)
  {
    const int left = column * (width_ + kGap);
    drawText(block, words, { left + 4, 2 * kHeading - 8 }, kInk);
    cv::Mat cell = block(cv::Rect(left, 2 * kHeading, width_, height_));
    cell.setTo(cv::Scalar::all(235));
    const Window window{ part, std::min(1.0 * width_ / part.width, 1.0 * height_ / part.height) };
    const cv::Size size(std::clamp(static_cast<int>(std::lround(window.scale * part.width)), 1, width_),
                        std::clamp(static_cast<int>(std::lround(window.scale * part.height)), 1, height_));
    cv::Mat picture = cell(cv::Rect({ (width_ - size.width) / 2, (height_ - size.height) / 2 }, size));
    if (image.empty())
    {
      drawText(picture, otherwise, { 20, size.height * 3 / 4 }, kInk, 0.5);
    }
    else
    {
      cv::Mat sized;
      cv::resize(image(part), sized, size, 0, 0, window.scale < 1.0 ? cv::INTER_AREA : cv::INTER_LINEAR);
      if (sized.channels() == 1)
      {
        cv::cvtColor(sized, sized, cv::COLOR_GRAY2BGR);
      }
      sized.copyTo(picture);
    }
    annotate(picture, window, column == 1);
  }

  void annotate(cv::Mat& picture, const Window& window, bool with_cube) const
  {
    std::vector<cv::Point2d> box;
    for (int corner = 0; corner < 8; ++corner)
    {
      const auto type = static_cast<Eigen::AlignedBox3d::CornerType>(corner);
      box.push_back(window.place(detector_.project(setup_.room_from_patient * setup_.target_box.corner(type))));
    }
    drawBox(picture, box, kTarget, 1);
    const cv::Point2d origin = window.place(detector_.project(Eigen::Vector3d::Zero()));
    drawLine(picture, origin - cv::Point2d(7, 0), origin + cv::Point2d(7, 0), kOrigin);
    drawLine(picture, origin - cv::Point2d(0, 7), origin + cv::Point2d(0, 7), kOrigin);

    const Eigen::Matrix3d view = viewFromPatient(detector_, setup_.room_from_patient);
    const auto letters = [&](const Eigen::Vector3d& direction) { return patientLetters(view.transpose() * direction); };
    const auto write = [&](const std::string& text, const cv::Point& middle) {
      drawText(picture, text, middle + cv::Point(-textWidth(text, 0.65, 2) / 2, 7), { 0, 0, 0 }, 0.65, 2);
    };
    write(letters(-Eigen::Vector3d::UnitX()), { 20, picture.rows / 2 });
    write(letters(Eigen::Vector3d::UnitX()), { picture.cols - 20, picture.rows / 2 });
    write(letters(-Eigen::Vector3d::UnitY()), { picture.cols / 2, 14 });
    write(letters(Eigen::Vector3d::UnitY()), { picture.cols / 2, picture.rows - 16 });
    if (with_cube)
    {
      const double half = 0.055 * width_;
      drawCube(picture, { picture.cols - 1.9 * half, 1.9 * half }, half, view);
    }
    const Eigen::Vector3d target = setup_.room_from_patient * setup_.targetCentre();
    if (detector_.depth(target) > 0.0)
    {
      const double px_per_mm = window.scale * detector_.focalLength().x() / detector_.depth(target);
      drawScale(picture, { 10, picture.rows - 12 }, px_per_mm, roundLength(0.3 * picture.cols / px_per_mm),
                isSmall() ? "" : "at target", { 0, 0, 0 });
    }
    if (projectedTargetRegion(setup_, detector_).empty())
    {
      drawText(picture, "the target is not in this image", { 10, picture.rows / 2 + 40 }, kFault, 0.55, 2);
    }
  }

  const TreatmentSetup& setup_;
  const ProjectionGeometry& detector_;
  cv::Scalar colour_;
  int width_;
  int height_ = 0;
};

/// Words of at most a picture's width a line.
std::vector<std::string> wrapped(const std::string& text, int width)
{
  std::vector<std::string> lines(1);
  std::istringstream words(text);
  for (std::string word; words >> word;)
  {
    const std::string longer = lines.back().empty() ? word : lines.back() + " " + word;
    if (textWidth(longer) <= width || lines.back().empty())
    {
      lines.back() = longer;
    }
    else
    {
      lines.push_back("    " + word);
    }
  }
  return lines;
}
}  // namespace

cv::Mat drawSetup(const TreatmentSetup& setup, const SetupPictureContent& content)
{
  // More detectors share a row.
  const int across = setup.detectors.size() <= 3 ? 1 : setup.detectors.size() <= 8 ? 2 : 3;
  const int width = ((kWidth - 2 * kGap - (across - 1) * 3 * kGap) / across - 2 * kGap) / 3;

  std::vector<std::string> faults;
  for (const std::string& fault : content.faults)
  {
    const std::vector<std::string> lines = wrapped(fault, kWidth - 4 * kGap);
    faults.insert(faults.end(), lines.begin(), lines.end());
  }
  std::vector<ViewDrawing> views;
  int height = kHeading + (1 + static_cast<int>(faults.size())) * kLine + kGap + kRoomHeight + kGap;
  for (std::size_t d = 0; d < setup.detectors.size(); ++d)
  {
    views.emplace_back(setup, d, width);
  }
  std::vector<int> row_heights;
  for (std::size_t d = 0; d < views.size(); ++d)
  {
    if (d % across == 0)
    {
      row_heights.push_back(0);
    }
    row_heights.back() = std::max(row_heights.back(), views[d].height());
  }
  for (const int row : row_heights)
  {
    height += row + kGap;
  }

  cv::Mat picture(height, kWidth, CV_8UC3, cv::Scalar::all(255));
  drawText(picture, content.title, { kGap, kHeading - 8 }, kInk, 0.55);
  const std::string legend =
      "orange: target box; +: the room's origin; dot on a panel: pixel (0, 0); both: grey where they agree";
  drawText(picture, legend,
           { kWidth - textWidth(legend) - kGap, kHeading + kLine * static_cast<int>(faults.size()) - 8 + kLine }, kInk);
  int y = kHeading;
  for (const std::string& fault : faults)
  {
    y += kLine;
    drawText(picture, fault, { kGap, y - 5 }, kFault);
  }
  y += kLine + kGap;
  const RoomSide sides[] = { { "room from above: x right, y up", 0, 1 },
                             { "room from the side: x right, z up", 0, 2 },
                             { "room from the front: y right, z up", 1, 2 } };
  const int room_width = (kWidth - 4 * kGap) / 3;
  for (int n = 0; n < 3; ++n)
  {
    const cv::Rect place(kGap + n * (room_width + kGap), y, room_width, kRoomHeight);
    drawRoom(setup, content.ct_corners, sides[n], place.size()).copyTo(picture(place));
  }
  y += kRoomHeight + kGap;
  for (std::size_t d = 0; d < views.size(); ++d)
  {
    char likeness[40] = "";
    if (d < content.likeness.size())
    {
      std::snprintf(likeness, sizeof(likeness), "; correlation %.2f", content.likeness[d]);
    }
    const cv::Mat block = views[d].draw(d < content.xrays.size() ? content.xrays[d] : cv::Mat(),
                                        d < content.drrs.size() ? content.drrs[d] : cv::Mat(), likeness);
    const int column = static_cast<int>(d) % across;
    block.copyTo(picture(cv::Rect({ kGap + column * (3 * width + 5 * kGap), y }, block.size())));
    if (column == across - 1)
    {
      y += row_heights[d / across] + kGap;
    }
  }
  return picture;
}
}  // namespace xray_tracking
