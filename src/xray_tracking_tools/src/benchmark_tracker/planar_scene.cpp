#include "planar_scene.h"

#include <cmath>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <opencv2/imgproc.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
namespace
{
constexpr double kContrast = 334.0;
constexpr double kNoise = 66.0;
constexpr double kLevel = 10000.0;
/// Around the region [px]: room for jumps of 50 px.
constexpr int kMargin = 80;

/// Rays a pixel along columns and rows. Pixels are means over their area, as a detector's; samples of edges as sharp as
/// the phantom's would not tell where between two pixels they are.
constexpr int kRays = 3;

/// Of the bones alone.
cv::Mat lineIntegrals(const NeckPhantom& phantom, DetectorDescription detector, const RigidTransform& pose)
{
  detector.pixel_pitch /= kRays;
  const double first = -0.5 * (kRays - 1);
  detector.origin +=
      first * (detector.pixel_pitch.x() * detector.x_direction + detector.pixel_pitch.y() * detector.y_direction);
  const cv::Size size(detector.image_size.x(), detector.image_size.y());
  detector.image_size *= kRays;
  cv::Mat soft, bone, pixels;
  phantom.lineIntegrals(ProjectionGeometry::fromDescription(detector), pose, pose, soft, bone);
  cv::resize(bone, pixels, size, 0.0, 0.0, cv::INTER_AREA);
  return pixels;
}

/// A plate over a quarter of the region that crosses it somewhere; what it shows does not depend on what is behind it.
void occlude(cv::Mat& values, const cv::Rect& region, const Eigen::Vector2d& displacement, cv::RNG& random)
{
  const cv::Size plate(region.width / 2, region.height / 2);
  const int x = region.x + cvRound(displacement.x()) + random.uniform(0, region.width - plate.width + 1);
  const int y = region.y + cvRound(displacement.y()) + random.uniform(0, region.height - plate.height + 1);
  values(cv::Rect(cv::Point(x, y), plate) & cv::Rect(cv::Point(), values.size())).setTo(kLevel + 4.0 * kContrast);
}
}  // namespace

PlanarScene::PlanarScene(const std::string& setup_file)
{
  const TreatmentSetup setup = loadTreatmentSetup(setup_file);
  const ProjectionGeometry& whole = setup.detectors.front();
  room_from_patient_ = setup.room_from_patient;
  region_ = { kMargin, kMargin, 150, 100 };
  detector_ = whole.description();
  const Eigen::Vector2d corner =
      whole.project(room_from_patient_ * setup.targetCentre()).array().round().matrix() - regionCentre();
  detector_.image_size = { region_.width + 2 * kMargin, region_.height + 2 * kMargin };
  detector_.origin = whole.pixelPosition(corner);

  cv::Scalar mean, deviation;
  cv::meanStdDev(lineIntegrals(phantom_, detector_, room_from_patient_)(region_), mean, deviation);
  mean_ = mean[0];
  scale_ = kContrast / deviation[0];
}

Eigen::Vector2d PlanarScene::regionCentre() const
{
  return { region_.x + (region_.width - 1) / 2.0, region_.y + (region_.height - 1) / 2.0 };
}

cv::Mat PlanarScene::render(const PlanarMotion& motion) const
{
  // Pixel x of this exposure shows what the plain one shows at centre + R^-1 S^-1 (x - centre - displacement). In this
  // order the images of the pixel axes stay at right angles, as a detector's are.
  const Eigen::Matrix2d reference_from_moved =
      Eigen::Rotation2Dd(-motion.rotation).toRotationMatrix() * motion.scale.cwiseInverse().asDiagonal();
  const Eigen::Vector2d first = regionCentre() - reference_from_moved * (regionCentre() + motion.displacement);
  const auto plane = [this](const Eigen::Vector2d& pixels) -> Eigen::Vector3d
  {
    return pixels.x() * detector_.pixel_pitch.x() * detector_.x_direction +
           pixels.y() * detector_.pixel_pitch.y() * detector_.y_direction;
  };
  DetectorDescription moved = detector_;
  moved.origin += plane(first);
  const Eigen::Vector3d columns = plane(reference_from_moved.col(0));
  const Eigen::Vector3d rows = plane(reference_from_moved.col(1));
  moved.pixel_pitch = { columns.norm(), rows.norm() };
  moved.x_direction = columns.normalized();
  moved.y_direction = rows.normalized();
  return kLevel + scale_ * (lineIntegrals(phantom_, moved, room_from_patient_) - mean_);
}

cv::Mat PlanarScene::expose(const cv::Mat& rendered, const PlanarMotion& motion, const ExposureCondition& condition,
                            cv::RNG& random) const
{
  cv::Mat values = rendered.clone();
  if (condition.occlusion)
  {
    occlude(values, region_, motion.displacement, random);
  }
  cv::Mat noise(values.size(), CV_32FC1);
  random.fill(noise, cv::RNG::NORMAL, 0.0, kNoise);
  values = condition.gain * (values + noise) + condition.offset * kContrast;
  if (condition.shading != 0.0)
  {
    for (int y = 0; y < values.rows; ++y)
    {
      for (int x = 0; x < values.cols; ++x)
      {
        const double u = (x - regionCentre().x()) * 2.0 / region_.width;
        const double v = (y - regionCentre().y()) * 2.0 / region_.height;
        values.at<float>(y, x) += static_cast<float>(condition.shading * kContrast * (0.5 * u + 0.3 * v + 0.2 * u * v));
      }
    }
  }
  cv::Mat image;
  values.convertTo(image, CV_16UC1);
  return image;
}

double PlanarScene::displacementBound(MotionModel model) const
{
  const cv::Mat values = render({});
  const int parameters = static_cast<int>(model);
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(parameters, parameters);
  for (int y = region_.y; y < region_.br().y; ++y)
  {
    for (int x = region_.x; x < region_.br().x; ++x)
    {
      const double gx = 0.5 * (values.at<float>(y, x + 1) - values.at<float>(y, x - 1));
      const double gy = 0.5 * (values.at<float>(y + 1, x) - values.at<float>(y - 1, x));
      const Eigen::Vector2d p = Eigen::Vector2d(x, y) - regionCentre();
      Eigen::VectorXd slope(6);
      switch (model)
      {
        case MotionModel::TRANSLATION:
        case MotionModel::EUCLIDEAN:
          slope << gx, gy, gy * p.x() - gx * p.y(), 0.0, 0.0, 0.0;
          break;
        case MotionModel::SIMILARITY:
          slope << gx, gy, gy * p.x() - gx * p.y(), gx * p.x() + gy * p.y(), 0.0, 0.0;
          break;
        case MotionModel::AFFINE:
          slope << gx, gy, gx * p.x(), gx * p.y(), gy * p.x(), gy * p.y();
          break;
      }
      information += slope.head(parameters) * slope.head(parameters).transpose() / (2.0 * kNoise * kNoise);
    }
  }
  return std::sqrt(information.inverse().topLeftCorner<2, 2>().trace());
}
}  // namespace xray_tracking
