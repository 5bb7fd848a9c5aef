#include "drawing.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
const cv::Scalar kHalo(255, 255, 255);

/// A face of the cube, seen from outside.
struct Face
{
  const char* letter;
  Eigen::Vector3d normal, up;  ///< LPS
  cv::Scalar colour;
};
}  // namespace

cv::Scalar colourOf(std::size_t detector)
{
  static const std::vector<cv::Scalar> kColours{ { 200, 90, 20 }, { 60, 140, 30 }, { 170, 40, 150 },
                                                 { 150, 130, 0 }, { 40, 70, 190 }, { 110, 110, 110 } };
  return kColours[detector % kColours.size()];
}

std::string patientLetters(const Eigen::Vector3d& lps)
{
  std::vector<std::pair<double, char>> parts;
  for (int axis = 0; axis < 3; ++axis)
  {
    parts.emplace_back(std::abs(lps[axis]), (lps[axis] > 0.0 ? "LPS" : "RAI")[axis]);
  }
  std::stable_sort(parts.begin(), parts.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  std::string letters;
  for (const auto& [strength, letter] : parts)
  {
    if (strength > lps.norm() / 3.0)
    {
      letters += letter;
    }
  }
  return letters;
}

Eigen::Matrix3d viewFromPatient(const ProjectionGeometry& detector, const RigidTransform& room_from_patient)
{
  return detector.roomFromOptical().linear().transpose() * room_from_patient.linear();
}

void drawCube(cv::Mat& canvas, const cv::Point2d& centre, double half_edge, const Eigen::Matrix3d& view_from_patient)
{
  const Eigen::Vector3d left(1, 0, 0), posterior(0, 1, 0), superior(0, 0, 1);
  const Face faces[] = {
    { "L", left, superior, { 200, 200, 255 } },       { "R", -left, superior, { 170, 170, 235 } },
    { "P", posterior, superior, { 200, 240, 200 } },  { "A", -posterior, superior, { 170, 225, 170 } },
    { "S", superior, -posterior, { 255, 220, 190 } }, { "I", -superior, -posterior, { 235, 195, 165 } }
  };
  constexpr int kTexture = 64;
  const auto place = [&](const Eigen::Vector3d& patient)
  {
    const Eigen::Vector3d view = view_from_patient * patient;
    return cv::Point2f(static_cast<float>(centre.x + half_edge * view.x()),
                       static_cast<float>(centre.y + half_edge * view.y()));
  };
  for (const Face& face : faces)
  {
    const double away = (view_from_patient * face.normal).z();
    if (away > -0.03)
    {
      continue;  // seen from behind, or from the edge
    }
    cv::Mat texture(kTexture, kTexture, CV_8UC3, face.colour);
    cv::rectangle(texture, cv::Rect(0, 0, kTexture, kTexture), kInk, 3);
    const cv::Size size = cv::getTextSize(face.letter, cv::FONT_HERSHEY_SIMPLEX, 1.6, 4, nullptr);
    cv::putText(texture, face.letter, { (kTexture - size.width) / 2, (kTexture + size.height) / 2 },
                cv::FONT_HERSHEY_SIMPLEX, 1.6, kInk, 4, cv::LINE_AA);
    const Eigen::Vector3d right = face.up.cross(face.normal);
    const cv::Point2f from[] = { { 0, 0 }, { kTexture, 0 }, { 0, kTexture } };
    const cv::Point2f to[] = { place(face.normal + face.up - right), place(face.normal + face.up + right),
                               place(face.normal - face.up - right) };
    const cv::Mat turn = cv::getAffineTransform(from, to);
    cv::warpAffine(texture, canvas, turn, canvas.size(), cv::INTER_LINEAR, cv::BORDER_TRANSPARENT);
  }
}

void drawText(cv::Mat& canvas, const std::string& text, const cv::Point& at, const cv::Scalar& colour, double scale,
              int thickness)
{
  cv::putText(canvas, text, at, cv::FONT_HERSHEY_SIMPLEX, scale, kHalo, thickness + 3, cv::LINE_AA);
  cv::putText(canvas, text, at, cv::FONT_HERSHEY_SIMPLEX, scale, colour, thickness, cv::LINE_AA);
}

int textWidth(const std::string& text, double scale, int thickness)
{
  return cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, scale, thickness, nullptr).width;
}

void drawLine(cv::Mat& canvas, const cv::Point2d& from, const cv::Point2d& to, const cv::Scalar& colour, int thickness)
{
  constexpr double kFar = 1e6;
  for (const double value : { from.x, from.y, to.x, to.y })
  {
    if (!(std::abs(value) < kFar))
    {
      return;
    }
  }
  constexpr int kShift = 4;
  const auto fixed = [](const cv::Point2d& point)
  {
    return cv::Point(static_cast<int>(std::lround(point.x * (1 << kShift))),
                     static_cast<int>(std::lround(point.y * (1 << kShift))));
  };
  cv::line(canvas, fixed(from), fixed(to), colour, thickness, cv::LINE_AA, kShift);
}

void drawBox(cv::Mat& canvas, const std::vector<cv::Point2d>& corners, const cv::Scalar& colour, int thickness)
{
  for (std::size_t corner = 0; corner < corners.size(); ++corner)
  {
    for (std::size_t axis = 1; axis < corners.size(); axis *= 2)
    {
      if ((corner & axis) == 0)
      {
        drawLine(canvas, corners[corner], corners[corner | axis], colour, thickness);
      }
    }
  }
}

double roundLength(double mm)
{
  const double power = std::pow(10.0, std::floor(std::log10(mm)));
  const double first = mm / power;
  return power * (first >= 5.0 ? 5.0 : first >= 2.0 ? 2.0 : 1.0);
}

void drawScale(cv::Mat& canvas, const cv::Point& at, double px_per_mm, double mm, const std::string& words,
               const cv::Scalar& colour)
{
  const cv::Point end = at + cv::Point(static_cast<int>(std::lround(mm * px_per_mm)), 0);
  for (const auto& [ink, thickness] : { std::make_pair(kHalo, 5), std::make_pair(colour, 2) })
  {
    cv::line(canvas, at, end, ink, thickness);
    cv::line(canvas, at - cv::Point(0, 5), at + cv::Point(0, 5), ink, thickness);
    cv::line(canvas, end - cv::Point(0, 5), end + cv::Point(0, 5), ink, thickness);
  }
  char text[80];
  std::snprintf(text, sizeof(text), "%g mm%s%s", mm, words.empty() ? "" : " ", words.c_str());
  drawText(canvas, text, at + cv::Point(0, -9), colour);
}
}  // namespace xray_tracking
