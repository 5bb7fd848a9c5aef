#include <gtest/gtest.h>

#include "phantom_exposures.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
namespace
{
/// Another vertebra, another CT, a posture far from the CT's: the rest 6 mm and 4 degrees off.
struct Case
{
  CtVolume ct;
  Eigen::Vector3d from_c4 = Eigen::Vector3d::Zero();  ///< of the target's box [mm]
  bool moves_with_rest = false;                       ///< of the phantom, whose C3 to C5 are one body
};

struct Outcome
{
  double error;
  bool believed;
};

/// @param along_mm of the start besides, along the patient's long axis
std::vector<Outcome> registerAll(const Case& subject, double start_mm, double start_degrees, int count,
                                 double along_mm = 0.0)
{
  const PhantomExposures& phantom = PhantomExposures::instance();
  const Eigen::AlignedBox3d box(phantom.targetBox().min() + subject.from_c4,
                                phantom.targetBox().max() + subject.from_c4);
  const Registration registration(splitBodies(subject.ct, targetMaskFromBone(subject.ct, box)), box);
  std::mt19937 random(1);
  std::vector<Outcome> outcomes;
  RigidTransform initial = phantom.roomFromPatient();
  initial.translation() = -(initial.linear() * box.center());
  for (int n = 0; n < count; ++n)
  {
    const RigidTransform gold = motionAbout(Eigen::Vector3d::Zero(), randomTwist(random, 2.0, 6.0)) * initial;
    const RigidTransform rest = motionAbout(gold * box.center(), randomTwist(random, 4.0, 6.0)) * gold;
    RegistrationRequest request =
        subject.moves_with_rest ? phantom.expose(rest, gold, random) : phantom.expose(gold, rest, random);
    request.room_from_patient = motionAbout(gold * box.center(), randomTwist(random, start_degrees, start_mm)) * gold *
                                Eigen::Translation3d(0.0, 0.0, along_mm);
    const RegistrationResult result = registration.run(request);
    outcomes.push_back(
        { targetRegistrationError(result.room_from_patient, gold, box), result.status == RegistrationStatus::SUCCESS });
  }
  return outcomes;
}

std::vector<double> errorsOf(const std::vector<Outcome>& outcomes)
{
  std::vector<double> errors;
  for (const Outcome& outcome : outcomes)
  {
    errors.push_back(outcome.error);
  }
  return errors;
}
}  // namespace

TEST(Generalisation, CoarseVoxelsCostAQuarterOfThem)
{
  PhantomCtOptions scan;
  scan.size = (scan.size.cast<double>().cwiseProduct(scan.spacing) / 2.0).cast<int>();
  scan.size.z() = static_cast<int>(scan.size.z() / 1.25);
  scan.spacing = { 2.0, 2.0, 2.5 };
  scan.slice_thickness = 2.5;
  const std::vector<double> errors = errorsOf(registerAll({ NeckPhantom().sampleCt(scan) }, 2.0, 1.0, 20));
  EXPECT_LE(quantile(errors, 0.5), 0.5);
  EXPECT_LE(quantile(errors, 0.95), 0.8);
}

TEST(Generalisation, TheRestDoesNotCarryTheTargetAway)
{
  // C3: the vertebra below it moves along, the one above and the tissue do not.
  const std::vector<double> errors =
      errorsOf(registerAll({ PhantomExposures::instance().ct(), { 0.0, 0.0, 16.0 } }, 2.0, 1.0, 20));
  EXPECT_LE(quantile(errors, 0.5), 0.3);
  EXPECT_LE(quantile(errors, 1.0), 1.0);
}

TEST(Generalisation, TheNextVertebraIsNotBelieved)
{
  // C6 from up to beyond where C5 is nearer, and from C5 itself.
  const Case c6{ PhantomExposures::instance().ct(), { 0.0, 5.5, -35.0 }, true };
  int lost = 0;
  for (const auto& [start, along] : { std::pair(13.0, 0.0), std::pair(16.0, 0.0), std::pair(3.0, 18.0) })
  {
    for (const Outcome& outcome : registerAll(c6, start, 7.0, 15, along))
    {
      EXPECT_FALSE(outcome.believed && outcome.error > 1.5)
          << outcome.error << " mm off from " << start << " and " << along << " mm";
      lost += outcome.error > 1.5 ? 1 : 0;
    }
  }
  // Of 45: the right one is found from there, too.
  EXPECT_LE(lost, 2);
}
}  // namespace xray_tracking
