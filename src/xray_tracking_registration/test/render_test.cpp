#include <gtest/gtest.h>

#include "phantom_exposures.h"
#include "xray_tracking_core/projection/exact_projection.h"

namespace xray_tracking
{
namespace
{
/// Root mean square of the rendering's difference from exact integrals, over that of these.
double errorOf(const cv::Mat& rendering, const ScalarVolume& attenuation, const ProjectionGeometry& geometry,
               const PixelGrid& grid, const RigidTransform& room_from_patient)
{
  const RigidTransform patient_from_room = room_from_patient.inverse();
  double difference = 0.0, sum = 0.0;
  for (int v = 0; v < grid.size.y(); v += 3)
  {
    for (int u = 0; u < grid.size.x(); u += 3)
    {
      const Ray ray = geometry.backProject(grid.first + Eigen::Vector2d(u, v).cwiseProduct(grid.step));
      const double exact = integrateTrilinear(
          attenuation, { patient_from_room * ray.source, patient_from_room.linear() * ray.direction });
      difference += std::pow(rendering.at<float>(v, u) - exact, 2);
      sum += exact * exact;
    }
  }
  return std::sqrt(difference / sum);
}

class RenderTest : public testing::TestWithParam<bool>
{
};

/// All of the CT at one pose, whether it is held as one body or two.
TEST_P(RenderTest, ShowsTheCtAsExactIntegrationDoes)
{
  const PhantomExposures& phantom = PhantomExposures::instance();
  const Registration registration(GetParam() ? phantom.bodies() : oneBody(phantom.ct()), phantom.targetBox());
  const ScalarVolume attenuation = oneBody(phantom.ct()).target;
  std::mt19937 random(5);
  for (const ProjectionGeometry& view : phantom.views())
  {
    const RigidTransform pose =
        motionAbout(Eigen::Vector3d::Zero(), randomTwist(random, 4.0, 15.0)) * phantom.roomFromPatient();
    const PixelGrid grid = PixelGrid::binnedRegion(Eigen::Vector2i::Zero(), view.imageSize(), 4);
    cv::Mat rendering;
    registration.render(view, grid, pose, rendering);
    ASSERT_EQ(rendering.type(), CV_32FC1);
    ASSERT_EQ(rendering.size(), cv::Size(128, 128));
    // Volumes with voxels of 2 mm and less blur edges by about a grid step of 1.1 mm, and one body has a seam around
    // the target's box; a pose that is off by two steps is told from that.
    const double error = errorOf(rendering, attenuation, view, grid, pose);
    EXPECT_LT(error, 0.03);
    const Eigen::Vector3d aside = 2.2 * view.xDirection();
    EXPECT_GT(errorOf(rendering, attenuation, view, grid, Eigen::Translation3d(aside) * pose), 1.5 * error);
  }
}

INSTANTIATE_TEST_SUITE_P(Bodies, RenderTest, testing::Values(false, true));

TEST(RenderTest, RefusesAPoseThatIsNotRigid)
{
  const PhantomExposures& phantom = PhantomExposures::instance();
  const Registration registration(oneBody(phantom.ct()), phantom.targetBox());
  const ProjectionGeometry& view = phantom.views().front();
  RigidTransform pose = phantom.roomFromPatient();
  pose.translation().x() = std::nan("");
  cv::Mat rendering;
  EXPECT_THROW(registration.render(view, PixelGrid::wholePanel(view), pose, rendering), std::invalid_argument);
}
}  // namespace
}  // namespace xray_tracking
