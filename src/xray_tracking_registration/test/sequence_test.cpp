#include <gtest/gtest.h>

#include "phantom_exposures.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
namespace
{
/// Limits of the target registration error [mm].
struct Limits
{
  const char* sequence;
  double median;
  double p95;
};
}  // namespace

/// Real anatomy, X-rays by foreign physics, bodies that deform; $XRAY_TRACKING_SHARED_DATA is the folder that holds
/// them.
class SequenceTest : public testing::TestWithParam<Limits>
{
};

TEST_P(SequenceTest, RefinesFromTracking)
{
  const char* folder = std::getenv("XRAY_TRACKING_SHARED_DATA");
  if (folder == nullptr)
  {
    GTEST_SKIP() << "XRAY_TRACKING_SHARED_DATA is not set";
  }
  const Sequence sequence = loadSequence(std::string(folder) + "/sequences/" + GetParam().sequence);
  const TreatmentSetup& setup = sequence.setup;
  const CtVolume ct = readCtVolume(setup.ct_path);
  const Registration registration(bodiesOf(ct, targetMaskFromBone(ct, setup.target_box), setup.ct_content),
                                  setup.target_box);
  std::mt19937 random(1);
  std::vector<double> errors;
  RigidTransform target_from_rest = RigidTransform::Identity();
  for (std::size_t n = 0; n < sequence.exposures.size(); ++n)
  {
    const RigidTransform& gold = sequence.gold_standard[n].room_from_patient;
    RegistrationRequest request;
    for (std::size_t v = 0; v < setup.detectors.size(); ++v)
    {
      request.views.push_back(
          { setup.detectors[v], readXrayImage(sequence.exposures[n].files[v], setup.detectors[v].imageSize()) });
    }
    request.intensity = setup.intensity;
    request.room_from_patient = motionAbout(gold * setup.targetCentre(), randomTwist(random, 1.0, 2.0)) * gold;
    request.target_from_rest = target_from_rest;
    request.time_budget = std::chrono::duration<double>(60.0);
    const RegistrationResult result = registration.run(request);
    ASSERT_EQ(result.status, RegistrationStatus::SUCCESS) << "exposure " << n << ": " << result.reason;
    target_from_rest = result.target_from_rest;
    errors.push_back(targetRegistrationError(result.room_from_patient, gold, setup.target_box));
  }
  EXPECT_LE(quantile(errors, 0.5), GetParam().median);
  EXPECT_LE(quantile(errors, 0.95), GetParam().p95);
}

INSTANTIATE_TEST_SUITE_P(Thorax, SequenceTest,
                         testing::Values(Limits{ "thorax_01", 0.2, 0.4 }, Limits{ "thorax_02", 0.25, 0.6 }));
}  // namespace xray_tracking
