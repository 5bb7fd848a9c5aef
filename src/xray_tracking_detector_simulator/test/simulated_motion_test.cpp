#include "xray_tracking_detector_simulator/simulated_motion.h"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "test_room.h"

namespace xray_tracking
{
namespace
{
const std::vector<const char*> kTypesWithoutFile = {
  "none", "drift", "step", "breathing", "swallow", "random_walk", "drift_and_breathing"
};
// Of composing and inverting double precision transforms of a few hundred mm.
constexpr double kExact = 1e-9;

class MotionModelTest : public testing::Test
{
protected:
  MotionModelTest()
  {
    quiet_.rest_jitter_mm = 0.0;
    turning_.amplitude_deg = { 1.0, -0.5, 0.8 };
  }

  SimulatedMotion model(const MotionOptions& options, std::uint64_t seed = 1) const
  {
    return { options, setup_.room_from_patient, setup_.targetCentre(), seed };
  }

  /// Motion since exposure 0 about the target's centre, room axes.
  Twist motion(const RigidTransform& pose) const
  {
    return twistAbout(setup_.room_from_patient * setup_.targetCentre(), pose * setup_.room_from_patient.inverse());
  }

  Twist targetMotion(const MotionOptions& options, int exposure) const
  {
    return motion(model(options).poses(exposure).room_from_target);
  }

  std::string writeFile(const std::string& text) const
  {
    const std::string path = (std::filesystem::path(testing::TempDir()) / "simulated_motion_test.csv").string();
    std::ofstream(path) << text;
    return path;
  }

  static std::string row(double stamp, const RigidTransform& pose)
  {
    std::ostringstream text;
    text.precision(17);
    const Eigen::Quaterniond q(pose.linear());
    text << stamp;
    for (const double value :
         { pose.translation().x(), pose.translation().y(), pose.translation().z(), q.x(), q.y(), q.z(), q.w() })
    {
      text << "," << value;
    }
    return text.str() + "\n";
  }

  MotionOptions fromFile(const std::string& text) const
  {
    MotionOptions options;
    options.type = MotionType::CSV;
    options.csv_file = writeFile(text);
    return options;
  }

  const std::string header_ = "stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
  TreatmentSetup setup_ = makeSetup();
  MotionOptions quiet_;
  MotionOptions turning_;
};

TEST_F(MotionModelTest, ExposureZeroIsExactlyTheSetupsPoseOfBothBodies)
{
  for (const char* name : kTypesWithoutFile)
  {
    MotionOptions options = turning_;
    options.type = motionTypeFromName(name);
    const BodyPoses poses = model(options).poses(0);
    EXPECT_EQ(poses.room_from_target.matrix(), setup_.room_from_patient.matrix()) << name;
    EXPECT_EQ(poses.room_from_rest.matrix(), setup_.room_from_patient.matrix()) << name;
  }
}

TEST_F(MotionModelTest, TheDefaultReachesTenMillimetresInThirtyExposuresWithoutRotation)
{
  double largest = 0.0;
  for (int exposure = 0; exposure < 30; ++exposure)
  {
    const Twist twist = targetMotion({}, exposure);
    EXPECT_LT(twist.head<3>().norm(), kExact);
    largest = std::max(largest, twist.tail<3>().norm());
  }
  EXPECT_GT(largest, 9.0);
  EXPECT_LE(largest, 10.0);
}

TEST_F(MotionModelTest, ShapesAreThoseThatAreDocumented)
{
  MotionOptions options;
  options.amplitude_mm = { 3.0, -2.0, 1.0 };
  options.amplitude_deg = { 1.0, 0.5, -1.0 };
  options.period = 8.0;
  options.start = 5;
  Twist whole;
  whole << options.amplitude_deg * EIGEN_PI / 180.0, options.amplitude_mm;
  const auto expectShares = [&](const char* name, const std::vector<std::pair<int, double>>& shares)
  {
    options.type = motionTypeFromName(name);
    for (const auto& [exposure, share] : shares)
    {
      // The bounds shorten the twist by (|v| / bound)^8 / 8 at the most: 4e-6 of 3.7 mm within 12 mm, and 3e-4 of
      // 1.5 degrees within 3.
      EXPECT_NEAR((targetMotion(options, exposure) - share * whole).norm(), 0.0, 1e-4)
          << name << " at exposure " << exposure;
    }
  };
  expectShares("none", { { 1, 0.0 }, { 100, 0.0 } });
  expectShares("drift", { { 4, 0.5 }, { 2, 0.15625 }, { 8, 1.0 }, { 100, 1.0 } });
  expectShares("step", { { 1, 0.0 }, { 4, 0.0 }, { 5, 1.0 }, { 100, 1.0 } });
  expectShares("breathing", { { 2, 0.5 }, { 4, 1.0 }, { 8, 0.0 }, { 12, 1.0 }, { 800, 0.0 } });
  expectShares("swallow", { { 4, 0.0 }, { 5, 0.0 }, { 7, 0.5 }, { 9, 1.0 }, { 13, 0.0 }, { 21, 0.0 } });
}

TEST_F(MotionModelTest, NoMotionLeavesTheBounds)
{
  for (const char* name : kTypesWithoutFile)
  {
    MotionOptions options;
    options.type = motionTypeFromName(name);
    options.amplitude_mm = { 40.0, -60.0, 80.0 };
    options.amplitude_deg = { -20.0, 15.0, 10.0 };
    options.max_shift_mm = 4.0;
    options.max_rotation_deg = 1.5;
    options.period = 17.0;
    for (int exposure = 0; exposure < 300; ++exposure)
    {
      const Twist twist = targetMotion(options, exposure);
      EXPECT_LE(twist.tail<3>().norm(), 4.0) << name;
      EXPECT_LE(twist.head<3>().norm(), 1.5 * EIGEN_PI / 180.0 + kExact) << name;
    }
    options.max_shift_mm = 0.0;
    options.max_rotation_deg = 0.0;
    EXPECT_LT(targetMotion(options, 11).norm(), kExact) << name;
  }
}

TEST_F(MotionModelTest, RandomWalksWanderSmoothlyAndDifferBySeed)
{
  MotionOptions options;
  options.type = MotionType::RANDOM_WALK;
  options.period = 100.0;
  options.amplitude_mm = { 8.0, 8.0, 8.0 };
  options.max_shift_mm = 100.0;
  double largest_step = 0.0;
  double largest_shift = 0.0;
  double difference = 0.0;
  for (int exposure = 1; exposure < 200; ++exposure)
  {
    const Twist now = targetMotion(options, exposure);
    largest_step = std::max(largest_step, (now - targetMotion(options, exposure - 1)).norm());
    largest_shift = std::max(largest_shift, now.norm());
    difference = std::max(difference, (motion(model(options, 2).poses(exposure).room_from_target) - now).norm());
  }
  EXPECT_GT(largest_shift, 4.0);
  EXPECT_LT(largest_shift, 2.0 * std::sqrt(3.0) * 8.0);
  EXPECT_LT(largest_step, 0.3 * largest_shift);
  EXPECT_GT(difference, 1.0);
}

TEST_F(MotionModelTest, TheRestMakesItsShareExactlyWithoutJitter)
{
  for (const char* name : kTypesWithoutFile)
  {
    for (const double share : { 0.0, 0.6, 1.0 })
    {
      MotionOptions options = turning_;
      options.type = motionTypeFromName(name);
      options.rest_jitter_mm = 0.0;
      options.rest_share = share;
      for (const int exposure : { 1, 7, 29, 400 })
      {
        const BodyPoses poses = model(options).poses(exposure);
        EXPECT_NEAR((motion(poses.room_from_rest) - share * motion(poses.room_from_target)).norm(), 0.0, kExact)
            << name;
      }
    }
  }
}

TEST_F(MotionModelTest, JitterIsTheRestsOwn)
{
  MotionOptions options;
  options.rest_jitter_mm = 0.4;
  constexpr int kExposures = 2000;
  Eigen::Vector3d squares = Eigen::Vector3d::Zero();
  for (int exposure = 1; exposure <= kExposures; ++exposure)
  {
    const BodyPoses poses = model(options).poses(exposure);
    const BodyPoses without = model(quiet_).poses(exposure);
    EXPECT_EQ(poses.room_from_target.matrix(), without.room_from_target.matrix());
    const Twist jitter = motion(poses.room_from_rest) - motion(without.room_from_rest);
    EXPECT_LT(jitter.head<3>().norm(), kExact);
    squares += jitter.tail<3>().cwiseAbs2();
  }
  for (int axis = 0; axis < 3; ++axis)
  {
    // Chi-square: five standard errors of the variance.
    EXPECT_NEAR(squares[axis] / kExposures / 0.16, 1.0, 5.0 * std::sqrt(2.0 / kExposures));
  }
}

TEST_F(MotionModelTest, PosesOfAFileComeBack)
{
  std::string text = header_;
  std::vector<RigidTransform> poses;
  for (int i = 0; i < 5; ++i)
  {
    Twist twist;
    twist << 0.01 * i, -0.005 * i, 0.002 * i, 1.0 * i, -2.0 * i, 4.0 * i;
    poses.push_back(motionAbout(Eigen::Vector3d(10.0, 20.0, 30.0), twist) * setup_.room_from_patient);
    text += row(100.0 + 0.5 * i, poses.back());
  }
  MotionOptions options = fromFile(text);
  options.rest_jitter_mm = 0.0;
  options.rest_share = 0.5;
  options.max_shift_mm = 1.0;  // of no account for a file
  const SimulatedMotion model = this->model(options);
  EXPECT_EQ(model.poses(0).room_from_target.matrix(), setup_.room_from_patient.matrix());
  for (int i = 1; i < 8; ++i)
  {
    const BodyPoses body = model.poses(i);
    EXPECT_TRUE(body.room_from_target.isApprox(poses[std::min(i, 4)], 1e-12)) << i;
    EXPECT_NEAR((motion(body.room_from_rest) - 0.5 * motion(body.room_from_target)).norm(), 0.0, kExact);
  }
}

TEST_F(MotionModelTest, BadFilesAreRefusedWithTheirName)
{
  const std::string first = row(0.0, setup_.room_from_patient);
  const std::string name = "simulated_motion_test.csv";
  const auto expectRefused = [&](const std::string& text, const std::string& part)
  {
    expectThrowNaming<std::runtime_error>(name, [&] { model(fromFile(text)); });
    expectThrowNaming<std::runtime_error>(part, [&] { model(fromFile(text)); });
  };
  EXPECT_NO_THROW(model(fromFile(header_ + first)));
  expectRefused(header_ + first + "1.0,nan,0,0,0,0,0,1\n", "line 3");
  expectRefused(header_ + first + "1.0,0,0,0,0,0,0,0.5\n", "line 3");
  expectRefused(header_ + first + row(2.0, setup_.room_from_patient) + row(1.0, setup_.room_from_patient), "line 4");
  expectRefused(header_ + first + first, "line 3");
  expectRefused(header_, "no poses");
  RigidTransform elsewhere = setup_.room_from_patient;
  elsewhere.translation().x() += 0.5;
  expectRefused(header_ + row(0.0, elsewhere), "initial_pose");

  MotionOptions missing;
  missing.type = MotionType::CSV;
  missing.csv_file = "/nowhere/poses.csv";
  expectThrowNaming<std::runtime_error>("/nowhere/poses.csv", [&] { model(missing); });
}

TEST_F(MotionModelTest, BadOptionsAreNamed)
{
  const std::vector<std::pair<std::string, std::function<void(MotionOptions&)>>> cases = {
    { "motion/amplitude_mm[1] is 1000", [](auto& o) { o.amplitude_mm.y() = 1000.0; } },
    { "motion/amplitude_deg[2] is nan",
      [](auto& o) { o.amplitude_deg.z() = std::numeric_limits<double>::quiet_NaN(); } },
    { "motion/period is 0", [](auto& o) { o.period = 0.0; } },
    { "motion/start is 0", [](auto& o) { o.start = 0; } },
    { "motion/max_shift_mm is -1", [](auto& o) { o.max_shift_mm = -1.0; } },
    { "motion/max_rotation_deg is 90", [](auto& o) { o.max_rotation_deg = 90.0; } },
    { "motion/rest_share is 1.5", [](auto& o) { o.rest_share = 1.5; } },
    { "motion/rest_jitter_mm is -0.4", [](auto& o) { o.rest_jitter_mm = -0.4; } },
    { "motion/csv_file is empty", [](auto& o) { o.type = MotionType::CSV; } },
  };
  EXPECT_NO_THROW(MotionOptions().validate());
  for (const auto& [text, spoil] : cases)
  {
    MotionOptions options;
    spoil(options);
    expectThrowNaming<std::invalid_argument>(text, [&] { options.validate(); });
    expectThrowNaming<std::invalid_argument>(text, [&] { model(options); });
  }
  expectThrowNaming<std::invalid_argument>("motion/type is 'dance'", [] { motionTypeFromName("dance"); });
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
