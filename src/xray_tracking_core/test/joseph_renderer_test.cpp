#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "xray_tracking_core/projection/drr_renderer.h"

namespace xray_tracking
{
namespace
{
/// An ellipsoid of value amplitude * (1 - r^2)^2, r = 1 on its surface, whose line integrals have a closed form.
struct SoftEllipsoid
{
  Eigen::Vector3d centre;             ///< [mm]
  Eigen::Matrix3d unit_from_patient;  ///< inverse of the half axes [mm]
  double amplitude;

  double at(const Eigen::Vector3d& point) const
  {
    const double rest = 1.0 - (unit_from_patient * (point - centre)).squaredNorm();
    return rest > 0.0 ? amplitude * rest * rest : 0.0;
  }

  double lineIntegral(const Ray& ray) const
  {
    const Eigen::Vector3d start = unit_from_patient * (ray.source - centre);
    const Eigen::Vector3d along = unit_from_patient * ray.direction;
    const double rest = 1.0 - start.squaredNorm() + std::pow(start.dot(along), 2) / along.squaredNorm();
    // The integral of (1 - x^2)^2 over [-1, 1] is 16 / 15.
    return rest > 0.0 ? amplitude * 16.0 / 15.0 * std::pow(rest, 2.5) / along.norm() : 0.0;
  }
};

Eigen::Matrix3d rotation(double x, double y, double z)
{
  return rotationFromVector(Eigen::Vector3d(x, y, z));
}

SoftEllipsoid softEllipsoid(const Eigen::Vector3d& centre, const Eigen::Matrix3d& rotation,
                            const Eigen::Vector3d& half_axes, double amplitude)
{
  return { centre, half_axes.cwiseInverse().asDiagonal() * rotation.transpose(), amplitude };
}

/// Three ellipsoids without a symmetry, within 38 mm of the origin.
const std::vector<SoftEllipsoid> kSoftObject{ softEllipsoid({ 0, 0, 0 }, rotation(0.3, 0.2, 0.1), { 34, 26, 22 }, 0.02),
                                              softEllipsoid({ 14, -6, 5 }, rotation(0, 0.5, 0.3), { 18, 16, 20 }, 0.02),
                                              softEllipsoid({ -12, 8, -10 }, rotation(0.2, 0, 0), { 17, 19, 16 },
                                                            0.03) };

double softObjectAt(const Eigen::Vector3d& point)
{
  double sum = 0.0;
  for (const SoftEllipsoid& ellipsoid : kSoftObject)
  {
    sum += ellipsoid.at(point);
  }
  return sum;
}

/// Partial volume: every voxel is the mean of `samples`^3 points spread evenly over it.
template <typename Function>
std::shared_ptr<ScalarVolume> sample(Function valueAt, const Eigen::Matrix3d& axes, const Eigen::Vector3i& size,
                                     int samples)
{
  const auto volume = std::make_shared<ScalarVolume>();
  volume->grid.size = size;
  volume->grid.patient_from_index.linear() = axes;
  volume->grid.patient_from_index.translation() = -volume->grid.centre();
  volume->values.resize(volume->grid.voxelCount());
  for (int k = 0; k < size.z(); ++k)
  {
    for (int j = 0; j < size.y(); ++j)
    {
      for (int i = 0; i < size.x(); ++i)
      {
        double sum = 0.0;
        for (int n = 0; n < samples * samples * samples; ++n)
        {
          const Eigen::Array3d step(n % samples, n / samples % samples, n / samples / samples);
          const Eigen::Vector3d within = (step + 0.5) / samples - 0.5;
          sum += valueAt(volume->grid.patient_from_index * (Eigen::Vector3d(i, j, k) + within));
        }
        volume->values[volume->grid.offset(i, j, k)] = static_cast<float>(sum / (samples * samples * samples));
      }
    }
  }
  return volume;
}

std::shared_ptr<ScalarVolume> sampledSoftObject(const Eigen::Matrix3d& axes = Eigen::Matrix3d::Identity())
{
  const Eigen::Array3d extent = 80.0 / axes.colwise().norm().transpose().array();
  return sample(softObjectAt, axes, extent.ceil().cast<int>(), 2);
}

/// A panel of 96 x 80 pixels behind the room's origin.
/// @param room_from_optical_rotation the viewing direction is its z axis; @param tilt of the panel about its own x axis
/// [rad]; @param shift of the panel in its plane [mm]
DetectorDescription panel(const Eigen::Matrix3d& room_from_optical_rotation, double source_to_origin,
                          double source_to_detector, double field_of_view, double tilt, const Eigen::Vector2d& shift)
{
  DetectorDescription panel;
  panel.name = "panel";
  panel.image_size = { 96, 80 };
  panel.pixel_pitch = Eigen::Vector2d::Constant(field_of_view * source_to_detector / source_to_origin / 96);
  panel.source = room_from_optical_rotation * Eigen::Vector3d(0, 0, -source_to_origin);
  const Eigen::Matrix3d room_from_panel = room_from_optical_rotation * rotation(tilt, 0, 0);
  panel.x_direction = room_from_panel.col(0);
  panel.y_direction = room_from_panel.col(1);
  panel.origin = room_from_optical_rotation * Eigen::Vector3d(0, 0, source_to_detector - source_to_origin) +
                 (shift.x() - 47.5 * panel.pixel_pitch.x()) * panel.x_direction +
                 (shift.y() - 39.5 * panel.pixel_pitch.y()) * panel.y_direction;
  return panel;
}

std::vector<DetectorDescription> panels()
{
  const double right_angle = std::acos(0.0);
  const double half = right_angle / 2;
  return { panel(Eigen::Matrix3d::Identity(), 2600, 3800, 100, 0, { 0, 0 }),
           panel(rotation(right_angle, 0, 0), 2600, 3800, 100, 0, { 0, 0 }),    // AP
           panel(rotation(0, right_angle, 0), 2600, 3800, 100, 0, { 0, 0 }),    // lateral
           panel(rotation(half, 0, 0), 2600, 3800, 100, 0, { 0, 0 }),           // oblique
           panel(rotation(-half, 0, 0), 2600, 3800, 100, 0, { 0, 0 }),          //
           panel(rotation(0.4, 0.7, -0.3), 600, 1000, 90, 0.4, { 60, -35 }),    // tilted, off-centre, near
           panel(rotation(-2.1, 0.4, 1.3), 300, 450, 90, -0.5, { -20, 30 }) };  // very near
}

/// The pixel's ray as formats.md defines it, in the patient frame.
Ray rayOf(const DetectorDescription& panel, int u, int v, const RigidTransform& room_from_patient)
{
  const Eigen::Vector3d pixel =
      panel.origin + u * panel.pixel_pitch.x() * panel.x_direction + v * panel.pixel_pitch.y() * panel.y_direction;
  const RigidTransform patient_from_room = room_from_patient.inverse();
  return { patient_from_room * panel.source, patient_from_room.linear() * (pixel - panel.source).normalized() };
}

cv::Mat closedForm(const DetectorDescription& panel, const RigidTransform& room_from_patient)
{
  cv::Mat result(panel.image_size.y(), panel.image_size.x(), CV_32FC1);
  for (int v = 0; v < result.rows; ++v)
  {
    for (int u = 0; u < result.cols; ++u)
    {
      double sum = 0.0;
      for (const SoftEllipsoid& ellipsoid : kSoftObject)
      {
        sum += ellipsoid.lineIntegral(rayOf(panel, u, v, room_from_patient));
      }
      result.at<float>(v, u) = static_cast<float>(sum);
    }
  }
  return result;
}

cv::Mat render(const std::shared_ptr<const ScalarVolume>& volume, const DetectorDescription& panel,
               const RigidTransform& room_from_patient)
{
  cv::Mat result;
  makeJosephRenderer(volume)->render(ProjectionGeometry::fromDescription(panel), room_from_patient, result);
  return result;
}

/// Largest difference in shares of the expected image's peak.
double error(const cv::Mat& image, const cv::Mat& expected)
{
  return cv::norm(image, expected, cv::NORM_INF) / cv::norm(expected, cv::NORM_INF);
}

RigidTransform pose(const Eigen::Vector3d& rotation_vector, const Eigen::Vector3d& translation)
{
  RigidTransform transform = RigidTransform::Identity();
  transform.linear() = rotationFromVector(rotation_vector);
  transform.translation() = translation;
  return transform;
}

const std::vector<RigidTransform> kPoses{ RigidTransform::Identity(), pose({ 0.2, -0.3, 0.5 }, { 4, -3, 6 }) };

/// Projections add up single floats over about 100 voxels.
constexpr double kRounding = 2e-5;
/// What the renderer promises at a voxel of 1 mm.
constexpr double kPromise = 0.005;

TEST(JosephRendererTest, ClosedFormFromAllSides)
{
  const auto volume = sampledSoftObject();
  for (std::size_t n = 0; n < panels().size(); ++n)
  {
    for (const RigidTransform& room_from_patient : kPoses)
    {
      const cv::Mat expected = closedForm(panels()[n], room_from_patient);
      EXPECT_GT(cv::norm(expected, cv::NORM_INF), 0.5) << "the object is in the picture";
      EXPECT_LT(error(render(volume, panels()[n], room_from_patient), expected), kPromise) << "panel " << n;
    }
  }
}

TEST(JosephRendererTest, ClosedFormOnEveryGrid)
{
  Eigen::Matrix3d permutation;
  permutation << 0, 0, 1, 1, 0, 0, 0, -1, 0;
  Eigen::Matrix3d shear = Eigen::Matrix3d::Identity();
  shear(1, 2) = 0.3;  // a tilted gantry
  const Eigen::Matrix3d oblique = rotation(0.5, -0.8, 1.1);
  const Eigen::Matrix3d left_handed = oblique * Eigen::Vector3d(1, 1, -1).asDiagonal();
  const Eigen::Matrix3d uneven = oblique * Eigen::Vector3d(0.7, 1.0, 0.85).asDiagonal();
  for (const Eigen::Matrix3d& axes : { permutation, shear, oblique, left_handed, uneven })
  {
    const auto volume = sampledSoftObject(axes);
    for (std::size_t n = 0; n < panels().size(); ++n)
    {
      EXPECT_LT(error(render(volume, panels()[n], kPoses[1]), closedForm(panels()[n], kPoses[1])), kPromise)
          << "panel " << n << ", axes\n"
          << axes;
    }
  }
}

/// With edges as hard as the voxels allow, single rays depend on where between two planes they meet the edge; so the
/// root mean square is judged, up to 0.9 radii: beyond, a chord's length has a slope without bound.
TEST(JosephRendererTest, ChordsOfASolidBall)
{
  constexpr double kRadius = 30.0;
  const auto volume = sample([](const Eigen::Vector3d& point) { return point.norm() < kRadius ? 1.0 : 0.0; },
                             Eigen::Matrix3d::Identity(), { 70, 66, 64 }, 8);
  for (const DetectorDescription& panel : panels())
  {
    const cv::Mat image = render(volume, panel, kPoses[0]);
    double squares = 0.0;
    int inside = 0;
    for (int v = 0; v < image.rows; ++v)
    {
      for (int u = 0; u < image.cols; ++u)
      {
        const Ray ray = rayOf(panel, u, v, kPoses[0]);
        const double distance = ray.source.cross(ray.direction).norm();
        if (distance < 0.9 * kRadius)
        {
          const double chord = 2.0 * std::sqrt(kRadius * kRadius - distance * distance);
          squares += std::pow(image.at<float>(v, u) - chord, 2);
          ++inside;
        }
        else if (distance > kRadius + 2.0)
        {
          ASSERT_EQ(image.at<float>(v, u), 0.0f) << "pixel " << u << ", " << v;
        }
      }
    }
    EXPECT_GT(inside, 1000);
    EXPECT_LT(std::sqrt(squares / inside), kPromise * 2.0 * kRadius);
  }
}

TEST(JosephRendererTest, OrderOfTheAxesIsOfNoConsequence)
{
  const auto volume = sampledSoftObject();
  // The same voxels at the same places, held in the order -k, i, j.
  const auto turned = std::make_shared<ScalarVolume>();
  const VolumeGrid& grid = volume->grid;
  turned->grid.size = { grid.size.z(), grid.size.x(), grid.size.y() };
  const Eigen::Matrix3d& axes = grid.patient_from_index.linear();
  turned->grid.patient_from_index.linear() << -axes.col(2), axes.col(0), axes.col(1);
  turned->grid.patient_from_index.translation() = grid.patient_from_index * Eigen::Vector3d(0, 0, grid.size.z() - 1);
  for (int j = 0; j < grid.size.y(); ++j)
  {
    for (int i = 0; i < grid.size.x(); ++i)
    {
      for (int k = grid.size.z() - 1; k >= 0; --k)
      {
        turned->values.push_back(volume->values[grid.offset(i, j, k)]);
      }
    }
  }
  for (const DetectorDescription& panel : panels())
  {
    EXPECT_LT(error(render(turned, panel, kPoses[1]), render(volume, panel, kPoses[1])), kRounding);
  }
}

TEST(JosephRendererTest, MovingTheVolumeIsMovingTheDetectorBack)
{
  const auto volume = sampledSoftObject();
  const RigidTransform motion = pose({ -0.4, 0.6, 0.2 }, { 5, 8, -7 });
  for (const DetectorDescription& panel : panels())
  {
    DetectorDescription moved = panel;
    moved.source = motion.inverse() * panel.source;
    moved.origin = motion.inverse() * panel.origin;
    moved.x_direction = motion.linear().transpose() * panel.x_direction;
    moved.y_direction = motion.linear().transpose() * panel.y_direction;
    EXPECT_LT(error(render(volume, panel, motion), render(volume, moved, RigidTransform::Identity())), kRounding);
  }
}

/// 41 x 31 x 20 voxels of 1 x 1 x 2 mm and value 0.5, seen along k; pixel (48, 40)'s ray is the room's z axis.
class BlockTest : public testing::Test
{
protected:
  BlockTest()
    : block_(
          sample([](const Eigen::Vector3d&) { return 0.5; }, Eigen::Vector3d(1, 1, 2).asDiagonal(), { 41, 31, 20 }, 1)),
      panel_(panel(Eigen::Matrix3d::Identity(), 1000, 1500, 20, 0, { 0, 0 }))
  {
    panel_.origin = { -48 * panel_.pixel_pitch.x(), -40 * panel_.pixel_pitch.y(), 500 };
  }

  float onAxis(const Eigen::Vector3d& translation) const
  {
    return render(block_, panel_, pose({ 0, 0, 0 }, translation)).at<float>(40, 48);
  }

  std::shared_ptr<ScalarVolume> block_;
  DetectorDescription panel_;
};

TEST_F(BlockTest, LengthIsOblique)
{
  const cv::Mat image = render(block_, panel_, RigidTransform::Identity());
  for (int v = 0; v < image.rows; ++v)
  {
    for (int u = 0; u < image.cols; ++u)
    {
      // 40 mm thick, half voxels at both faces included.
      const double length = 40.0 / rayOf(panel_, u, v, RigidTransform::Identity()).direction.z();
      ASSERT_NEAR(image.at<float>(v, u), 0.5 * length, 1e-4) << u << ", " << v;
    }
  }
}

TEST_F(BlockTest, FallsToZeroOverOneVoxelOutside)
{
  EXPECT_NEAR(onAxis({ 0, 0, 0 }), 20.0, 1e-4);
  EXPECT_NEAR(onAxis({ 20, 0, 0 }), 20.0, 1e-4);    // outermost centres
  EXPECT_NEAR(onAxis({ 20.5, 0, 0 }), 10.0, 1e-4);  // the volume's face
  EXPECT_NEAR(onAxis({ -20.75, 0, 0 }), 5.0, 1e-4);
  EXPECT_NEAR(onAxis({ 0, -15.5, 0 }), 10.0, 1e-4);
  EXPECT_NEAR(onAxis({ 20.5, 15.5, 0 }), 5.0, 1e-4);  // an edge
  EXPECT_EQ(onAxis({ 21.01, 0, 0 }), 0.0f);
  EXPECT_EQ(onAxis({ 0, 16.01, 0 }), 0.0f);
}

TEST_F(BlockTest, CountsOnlyWhatIsInFrontOfTheSource)
{
  // Of the planes at z = -19, -17, ..., 19 mm those from 5 mm on are in front: 8 of 20.
  EXPECT_NEAR(onAxis({ 0, 0, -1004 }), 8.0, 1e-4);
  EXPECT_EQ(onAxis({ 0, 0, -1100 }), 0.0f);
  // Beyond the panel: its distance has no part in the projection.
  EXPECT_NEAR(onAxis({ 0, 0, 600 }), 20.0, 1e-4);
}

/// Rays in the plane of a single layer, where there is no neighbour to interpolate with.
TEST_F(BlockTest, ASingleLayerSeenFromItsEdge)
{
  block_ = sample([](const Eigen::Vector3d&) { return 0.5; }, Eigen::Vector3d(1, 1, 2).asDiagonal(), { 1, 31, 20 }, 1);
  EXPECT_NEAR(onAxis({ 0, 0, 0 }), 20.0, 1e-4);
  EXPECT_NEAR(onAxis({ 0.5, 0, 0 }), 10.0, 1e-4);
  const auto aslant = [this](const Eigen::Vector3d& turn) {
    return render(block_, panel_, pose(turn, { 0, 0, 0 })).at<float>(40, 48);
  };
  // The ray leaves the layer at an angle: planes 2 mm apart along k in which it is (n + 1/2) 2 tan mm off the middle.
  const double slope = std::tan(0.1);
  double sum = 0.0;
  for (int n = -10; n < 10; ++n)
  {
    sum += 0.5 * std::max(0.0, 1.0 - std::abs((n + 0.5) * 2.0 * slope)) * 2.0 / std::cos(0.1);
  }
  EXPECT_NEAR(aslant({ 0, 0.1, 0 }), sum, 1e-4);
  // A single voxel, met in its middle by a ray along no axis.
  block_ = sample([](const Eigen::Vector3d&) { return 0.5; }, Eigen::Vector3d(1, 1, 2).asDiagonal(), { 1, 1, 1 }, 1);
  EXPECT_NEAR(aslant({ 0.1, 0.2, 0 }), 1.0 / std::cos(std::hypot(0.1, 0.2)), 1e-4);
}

TEST_F(BlockTest, MissesAreZeroAndTheImageIsReused)
{
  const auto renderer = makeJosephRenderer(block_);
  const ProjectionGeometry geometry = ProjectionGeometry::fromDescription(panel_);
  cv::Mat image(80, 96, CV_32FC1, cv::Scalar(7.0f));
  const uchar* data = image.data;
  renderer->render(geometry, pose({ 0, 0, 0 }, { 0, 300, 0 }), image);
  EXPECT_EQ(image.data, data);
  EXPECT_EQ(cv::countNonZero(image), 0);
}

TEST_F(BlockTest, BadInputIsRefused)
{
  EXPECT_THROW(makeJosephRenderer(nullptr), std::invalid_argument);
  ScalarVolume lacking = *block_;
  lacking.values.pop_back();
  EXPECT_THROW(makeJosephRenderer(std::make_shared<ScalarVolume>(lacking)), std::invalid_argument);
  ScalarVolume flat = *block_;
  flat.grid.patient_from_index.linear().col(2) = flat.grid.patient_from_index.linear().col(1);
  EXPECT_THROW(makeJosephRenderer(std::make_shared<ScalarVolume>(flat)), std::invalid_argument);
  EXPECT_THROW(onAxis({ std::numeric_limits<double>::quiet_NaN(), 0, 0 }), std::invalid_argument);
}
}  // namespace
}  // namespace xray_tracking
