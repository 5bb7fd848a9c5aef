#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"

namespace xray_tracking
{
// BGR.
const cv::Scalar kInk(40, 40, 40);
const cv::Scalar kFaint(205, 205, 205);
const cv::Scalar kTarget(0, 140, 255);
const cv::Scalar kFault(30, 30, 210);

/// Of a detector, the same in all parts of the picture.
cv::Scalar colourOf(std::size_t detector);

/// Letters of a direction in the patient (L R P A S I), the strongest first; those below a third are left out.
std::string patientLetters(const Eigen::Vector3d& lps);

/// Rotation from patient to the view's axes: along columns, along rows, away from the source.
Eigen::Matrix3d viewFromPatient(const ProjectionGeometry& detector, const RigidTransform& room_from_patient);

/// A cube whose faces have the patient's letters, as it is seen along the third of the view's axes.
void drawCube(cv::Mat& canvas, const cv::Point2d& centre, double half_edge, const Eigen::Matrix3d& view_from_patient);

/// Text with its lower left corner at a point, legible on any ground.
void drawText(cv::Mat& canvas, const std::string& text, const cv::Point& at, const cv::Scalar& colour,
              double scale = 0.45, int thickness = 1);
/// Its width [px].
int textWidth(const std::string& text, double scale = 0.45, int thickness = 1);

/// The twelve edges of a box given by its corners (bit n of the index: upper end of axis n), already in the picture;
/// edges with an end that is not finite are left out.
void drawBox(cv::Mat& canvas, const std::vector<cv::Point2d>& corners, const cv::Scalar& colour, int thickness);

/// A line between points that may be far outside; nothing if one is not finite.
void drawLine(cv::Mat& canvas, const cv::Point2d& from, const cv::Point2d& to, const cv::Scalar& colour,
              int thickness = 1);

/// The longest of 1, 2 or 5 times a power of ten that is at most `mm`.
double roundLength(double mm);

/// A bar of `mm` and its words.
void drawScale(cv::Mat& canvas, const cv::Point& at, double px_per_mm, double mm, const std::string& words,
               const cv::Scalar& colour);
}  // namespace xray_tracking
