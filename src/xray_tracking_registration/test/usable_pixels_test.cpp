#include "xray_tracking_registration/usable_pixels.h"

#include <stdexcept>
#include <string>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "phantom_exposures.h"
#include "xray_tracking_core/evaluation/evaluation.h"

namespace xray_tracking
{
namespace
{
const PhantomExposures& phantom()
{
  return PhantomExposures::instance();
}

/// The region that the target is seen in [px].
cv::Rect regionOf(const RegistrationView& view, const RigidTransform& room_from_patient)
{
  std::vector<cv::Point2f> corners;
  for (int i = 0; i < 8; ++i)
  {
    const Eigen::Vector3d corner = phantom().targetBox().corner(static_cast<Eigen::AlignedBox3d::CornerType>(i));
    const Eigen::Vector2d pixel = view.geometry.project(room_from_patient * corner);
    corners.emplace_back(static_cast<float>(pixel.x()), static_cast<float>(pixel.y()));
  }
  return cv::boundingRect(corners);
}

class UsablePixelsTest : public testing::Test
{
protected:
  /// From 3 mm and 2 degrees off. @return the error [mm]
  double error(const RegistrationRequest& exposure, bool leave_out, RegistrationStatus& status)
  {
    RegistrationRequest request = exposure;
    Twist offset;
    offset << 0.02, -0.015, 0.02, 2.0, -1.5, 1.7;
    const RigidTransform truth = request.room_from_patient;
    request.room_from_patient = motionAbout(truth * phantom().centre(), offset) * truth;
    if (leave_out)
    {
      usable_.apply(++stamp_, request);
    }
    const RegistrationResult result = registration_.run(request);
    status = result.status;
    reason_ = result.reason;
    return targetRegistrationError(result.room_from_patient, truth, phantom().targetBox());
  }
  RegistrationRequest expose()
  {
    return phantom().expose(phantom().roomFromPatient(), phantom().roomFromPatient(), random_);
  }

  Registration registration_{ phantom().bodies(), phantom().targetBox() };
  UsablePixels usable_;
  std::string reason_;
  std::int64_t stamp_ = 0;
  std::mt19937 random_{ 5 };
};

TEST_F(UsablePixelsTest, bladesInTheRegionDoNoHarm)
{
  RegistrationRequest exposure = expose();
  for (RegistrationView& view : exposure.views)
  {
    cv::Rect lit = regionOf(view, exposure.room_from_patient);
    lit = cv::Rect(lit.x + 12, lit.y - 40, lit.width - 12, lit.height + 80);
    cv::Mat behind(view.image.size(), CV_16UC1);
    cv::randn(behind, 110.0, 4.0);
    view.image(lit).copyTo(behind(lit));
    view.image = behind;
  }
  RegistrationStatus status;
  EXPECT_LT(error(exposure, true, status), 0.3);
  EXPECT_EQ(RegistrationStatus::SUCCESS, status) << reason_;
  const double without = error(exposure, false, status);
  EXPECT_TRUE(without > 0.3 || status != RegistrationStatus::SUCCESS)
      << "blades do no harm, so this test tells nothing";
}

TEST_F(UsablePixelsTest, stuckPixelsDoNoHarm)
{
  RegistrationRequest exposure = expose();
  for (RegistrationView& view : exposure.views)
  {
    for (int n = 0; n < 0.01 * view.image.total(); ++n)
    {
      view.image.at<std::uint16_t>(static_cast<int>(random_() % 512), static_cast<int>(random_() % 512)) =
          n % 2 == 0 ? 0 : 65535;
    }
  }
  const cv::Mat before = exposure.views.front().image.clone();
  RegistrationStatus status;
  EXPECT_LT(error(exposure, true, status), 0.3);
  EXPECT_EQ(RegistrationStatus::SUCCESS, status) << reason_;
  EXPECT_EQ(0, cv::countNonZero(before != exposure.views.front().image)) << "the message's own pixels were changed";
}

TEST_F(UsablePixelsTest, stuckPixelsAreThoseOfAnImageOfTheSize)
{
  const auto withStuckPixel = [this](const cv::Point& place)
  {
    RegistrationRequest exposure = expose();
    exposure.views.pop_back();
    exposure.views[0].image.at<std::uint16_t>(place) = 65535;
    return exposure;
  };
  RegistrationRequest large = withStuckPixel({ 500, 490 });
  usable_.apply(++stamp_, large);
  EXPECT_LT(large.views[0].image.at<std::uint16_t>(490, 500), 65535);
  // A detector that is binned from now on: the place is outside, and its own stuck pixel is another one.
  RegistrationRequest small = withStuckPixel({ 100, 90 });
  small.views[0].image = small.views[0].image(cv::Rect(0, 0, 256, 256)).clone();
  usable_.apply(++stamp_, small);
  EXPECT_EQ(cv::Size(256, 256), small.views[0].image.size());
  EXPECT_LT(small.views[0].image.at<std::uint16_t>(90, 100), 65535);
}

TEST_F(UsablePixelsTest, namesTheViewThatShowsNothingNew)
{
  const auto refusal = [this](std::int64_t stamp, RegistrationRequest request)
  {
    try
    {
      usable_.apply(stamp, request);
    }
    catch (const std::invalid_argument& error)
    {
      return std::string(error.what());
    }
    return std::string();
  };
  const RegistrationRequest exposure = expose();
  EXPECT_EQ("", refusal(1000000000, exposure));
  EXPECT_EQ("", refusal(1000000000, exposure)) << "asked for once more, it is the same exposure";
  RegistrationRequest frozen = expose();
  frozen.views[1] = exposure.views[1];
  EXPECT_NE(std::string::npos,
            refusal(3000000000, frozen)
                .find("detector_b: the image, or a good part of its rows, is bit for bit that of 2 s"));
  RegistrationRequest black = expose();
  cv::randn(black.views[0].image, 100.0, 5.0);
  EXPECT_NE(std::string::npos, refusal(4000000000, black).find("detector_a: the image shows nothing"));
  EXPECT_EQ("", refusal(500000000, frozen)) << "one from before is no repetition";
  RegistrationRequest woven = expose();
  const cv::Mat before = woven.views[1].image;
  cv::Mat moved = expose().views[1].image.clone();
  cv::warpAffine(moved, moved, cv::Matx23d(1.0, 0.0, 6.0, 0.0, 1.0, 2.0), moved.size());
  for (int y = 0; y < moved.rows; y += 2)
  {
    before.row(y).copyTo(moved.row(y));
  }
  woven.views[1].image = moved;
  EXPECT_NE(std::string::npos, refusal(4500000000, woven).find("detector_b: every other row is of another exposure"));
  usable_.reset();
  EXPECT_EQ("", refusal(5000000000, exposure));
}
}  // namespace
}  // namespace xray_tracking
