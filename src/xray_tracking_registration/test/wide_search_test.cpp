#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include <gtest/gtest.h>

#include "phantom_exposures.h"
#include "pose_search.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_registration/attenuation_image.h"
#include "xray_tracking_registration/registration.h"

namespace xray_tracking
{
namespace
{
constexpr double kDegree = M_PI / 180.0;

/// Up to 25 mm and 10 degrees along and about every axis.
Twist roughTwist(std::mt19937& random)
{
  std::uniform_real_distribution<double> share(-1.0, 1.0);
  Twist twist;
  for (int n = 0; n < 6; ++n)
  {
    twist[n] = share(random) * (n < 3 ? 10.0 * kDegree : 25.0);
  }
  return twist;
}

void searchWidely(RegistrationRequest& request)
{
  request.search = Search::WIDE;
  request.max_translation_mm = kUsualSearch;
  request.max_rotation_rad = kUsualSearchRotation;
}

class WideSearch : public testing::Test
{
protected:
  WideSearch() : registration_(phantom_.bodies(), phantom_.targetBox()) {}

  /// The target moved by up to 8 mm and 3 degrees, the rest elsewhere by 4 mm and 2 degrees; the start is the truth.
  RegistrationRequest expose()
  {
    const RigidTransform gold =
        motionAbout(phantom_.roomFromPatient() * phantom_.centre(), randomTwist(random_, 3.0, 8.0)) *
        phantom_.roomFromPatient();
    const RigidTransform rest = motionAbout(gold * phantom_.centre(), randomTwist(random_, 2.0, 4.0)) * gold;
    RegistrationRequest request = phantom_.expose(gold, rest, random_);
    searchWidely(request);
    return request;
  }

  RigidTransform moved(const RigidTransform& pose, const Twist& twist) const
  {
    return motionAbout(pose * phantom_.centre(), twist) * pose;
  }

  const PhantomExposures& phantom_ = PhantomExposures::instance();
  std::mt19937 random_{ 1 };
  Registration registration_;
};
}  // namespace

TEST_F(WideSearch, FindsThePoseFromARoughStart)
{
  for (int n = 0; n < 8; ++n)
  {
    RegistrationRequest request = expose();
    const RigidTransform gold = request.room_from_patient;
    request.room_from_patient = moved(gold, roughTwist(random_));
    const RegistrationResult result = registration_.run(request);
    EXPECT_EQ(result.status, RegistrationStatus::SUCCESS) << n << ": " << result.reason;
    // As from a near start.
    EXPECT_LT(targetRegistrationError(result.room_from_patient, gold, phantom_.targetBox()), 0.4) << n;
    // What else there is lies elsewhere, and is less alike.
    ASSERT_FALSE(result.rivals.empty()) << n;
    for (const Rival& rival : result.rivals)
    {
      EXPECT_GT(rival.distance_mm, 5.0) << n;
      EXPECT_NEAR(rival.distance_mm,
                  targetRegistrationError(rival.room_from_patient, result.room_from_patient, phantom_.targetBox()),
                  1e-9);
      EXPECT_LT(rival.similarity, result.similarity_after) << n;
    }
  }
}

TEST_F(WideSearch, DoesNotSellAGuess)
{
  // Nothing within the bounds is right: the truth is 60 mm away, the next vertebrae are not.
  for (const Eigen::Vector3d& direction : { Eigen::Vector3d(1.0, 0.0, 0.0), Eigen::Vector3d(-1.0, 0.0, 0.0),
                                            Eigen::Vector3d(0.0, 0.7, 0.7), Eigen::Vector3d(0.0, -0.7, 0.7) })
  {
    RegistrationRequest request = expose();
    Twist away = Twist::Zero();
    away.tail<3>() = 60.0 * direction;
    request.room_from_patient = moved(request.room_from_patient, away);
    request.max_translation_mm = 30.0;
    const RegistrationResult result = registration_.run(request);
    EXPECT_NE(result.status, RegistrationStatus::SUCCESS) << direction.transpose();
    EXPECT_FALSE(result.reason.empty());
  }
  // Not this patient, or no patient at all.
  RegistrationRequest request = expose();
  for (RegistrationView& view : request.views)
  {
    cv::flip(view.image, view.image, -1);
  }
  EXPECT_NE(registration_.run(request).status, RegistrationStatus::SUCCESS);
  cv::theRNG().state = 1;
  for (RegistrationView& view : request.views)
  {
    cv::randu(view.image, 10000, 40000);
  }
  EXPECT_NE(registration_.run(request).status, RegistrationStatus::SUCCESS);
}

TEST_F(WideSearch, SaysIfAViewSeesNothingOfTheNeighbourhood)
{
  RegistrationRequest request = expose();
  Twist away = Twist::Zero();
  away.tail<3>() << 0.0, 0.0, 5000.0;  // behind the sources
  request.room_from_patient = moved(request.room_from_patient, away);
  RegistrationResult result = registration_.run(request);
  EXPECT_EQ(result.status, RegistrationStatus::INVALID);
  EXPECT_NE(result.reason.find("view detector_"), std::string::npos) << result.reason;
  away.tail<3>() = request.views[0].geometry.source() - request.room_from_patient * phantom_.centre() -
                   Eigen::Vector3d(0.0, 0.0, 60.0);  // right before it
  RegistrationRequest near = request;
  near.room_from_patient = moved(request.room_from_patient, away);
  result = registration_.run(near);
  EXPECT_EQ(result.status, RegistrationStatus::INVALID) << result.reason;
  away.tail<3>() << 400.0, 0.0, 0.0;  // beside the panels
  request.room_from_patient = moved(request.room_from_patient, away);
  result = registration_.run(request);
  EXPECT_NE(result.status, RegistrationStatus::SUCCESS);
}

TEST_F(WideSearch, HonoursBudgetAndCancel)
{
  RegistrationRequest request = expose();
  request.time_budget = std::chrono::microseconds(100);
  EXPECT_EQ(registration_.run(request).status, RegistrationStatus::TIMED_OUT);
  request.time_budget = std::chrono::minutes(1);
  int all = 0;
  request.progress = [&](const RegistrationProgress&) { return ++all > 0; };
  registration_.run(request);
  ASSERT_GT(all, 10);
  for (const int allowed : { 0, 1, all / 2, all - 1 })
  {
    int asked = 0;
    request.progress = [&](const RegistrationProgress&) { return ++asked <= allowed; };
    EXPECT_EQ(registration_.run(request).status, RegistrationStatus::CANCELLED) << allowed;
    EXPECT_EQ(asked, allowed + 1) << "is asked no more once it said no";
  }
}

TEST_F(WideSearch, RefusesBadRequests)
{
  const auto refused = [&](const RegistrationRequest& request, const std::string& word)
  {
    const RegistrationResult result = registration_.run(request);
    EXPECT_EQ(result.status, RegistrationStatus::INVALID) << word;
    EXPECT_NE(result.reason.find(word), std::string::npos) << result.reason;
  };
  const RegistrationRequest good = expose();
  RegistrationRequest request = good;
  request.max_translation_mm = 101.0;
  refused(request, "101");
  request = good;
  request.max_rotation_rad = 0.9;
  refused(request, "0.9");
  request = good;
  request.views[1].region = cv::Rect(100, 100, 200, 200);
  refused(request, "detector_b");
}

/// What sliding a rendering gives for no shift is what comparing there alone gives; also where the CT's ends leave
/// parts out, and of every orientation.
TEST_F(WideSearch, SlidesRenderingsRightly)
{
  PhantomCtOptions short_ct;
  short_ct.size.z() = 48;  // 60 mm: its ends are in the target's region
  for (const CtVolume& ct : { phantom_.ct(), NeckPhantom().sampleCt(short_ct) })
  {
    const Bodies bodies(splitBodies(ct, targetMaskFromBone(ct, phantom_.targetBox())), phantom_.targetBox(), 1.0,
                        Projector::SHEAR_WARP);
    const RegistrationRequest request = expose();
    RunControl control(request, bodies.centre);
    std::vector<AttenuationImage> attenuation;
    for (const RegistrationView& view : request.views)
    {
      attenuation.emplace_back(view.image, request.intensity);
    }
    const xray_tracking::Run run{ request, attenuation, control };
    const PosePair start{ request.room_from_patient, request.room_from_patient };
    // No translation but none.
    const PoseSearch search(run, bodies, phantom_.targetBox(), start, { 0.5, 0.31 }, Moving::TOGETHER);
    const std::vector<Place> places = search.places(20);
    ASSERT_GE(places.size(), 10u);
    for (std::size_t n = 0; n < places.size(); ++n)
    {
      EXPECT_NEAR(places[n].similarity, search.similarity(places[n].poses), 1e-4) << n;
      EXPECT_LT(places[n].similarity, n == 0 ? 1.0 : places[n - 1].similarity + 1e-9);
      for (std::size_t m = 0; m < n; ++m)
      {
        EXPECT_GT(targetRegistrationError(places[n].poses.target, places[m].poses.target, phantom_.targetBox()),
                  search.separation());
      }
    }
    EXPECT_GT(search.similarity(start), 0.8);
  }
}

/// Real X-rays, in $XRAY_TRACKING_SHARED_DATA: a start that is off as it was delivered, and one exposure's pose as
/// another's start.
TEST(WideSearchOfRealImages, FindsThePose)
{
  const char* folder = std::getenv("XRAY_TRACKING_SHARED_DATA");
  if (folder == nullptr)
  {
    GTEST_SKIP() << "XRAY_TRACKING_SHARED_DATA is not set";
  }
  struct Case
  {
    const char* sequence;
    std::size_t exposure;
    double off;        ///< the start, at least [mm]
    double reference;  ///< error that is the reference's own [mm]
  };
  for (const Case& one : { Case{ "portal_real/pair_20", 0, 35.0, 1.2 }, Case{ "portal_real/pair_16", 0, 35.0, 1.2 },
                           Case{ "portal_real/three", 0, 35.0, 1.2 }, Case{ "wrist_real", 2, 15.0, 1.0 },
                           Case{ "knee_real", 35, 30.0, 1.0 } })
  {
    const std::string path = std::string(folder) + "/sequences/" + one.sequence;
    if (!std::filesystem::exists(path))
    {
      continue;
    }
    const Sequence sequence = loadSequence(path);
    const TreatmentSetup& setup = sequence.setup;
    const PatientCt ct = readPatientCt(setup.ct_path, setup.ct_content);
    const Registration registration(bodiesOf(ct, targetMaskOf(ct, setup.target_box)), setup.target_box);
    RegistrationRequest request;
    for (std::size_t v = 0; v < setup.detectors.size(); ++v)
    {
      request.views.push_back({ setup.detectors[v], sequence.image(one.exposure, v) });
    }
    request.intensity = setup.intensity;
    request.room_from_patient = setup.room_from_patient;
    request.time_budget = std::chrono::minutes(1);
    searchWidely(request);
    const RigidTransform& gold = sequence.gold_standard[one.exposure].room_from_patient;
    ASSERT_GT(targetRegistrationError(request.room_from_patient, gold, setup.target_box), one.off) << one.sequence;
    const RegistrationResult result = registration.run(request);
    EXPECT_LT(targetRegistrationError(result.room_from_patient, gold, setup.target_box), one.reference)
        << one.sequence << ": " << result.reason;
  }
}
}  // namespace xray_tracking
