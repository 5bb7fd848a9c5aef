// Every exposure is answered, the one that a new template is learnt on by the old one.

#include "xray_tracking_hyperplane_tracker/view_tracker.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "synthetic_exposure.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

namespace xray_tracking
{
namespace
{
using State = ViewAnswer::State;
using Kind = Training::Kind;

const IntensityModel kCounts{ IntensityModel::Kind::COUNTS, kOffset, {} };
const cv::Rect kRegion(70, 55, 100, 90);
const cv::Rect kOther(90, 60, 80, 80);
/// Five times the Cramer-Rao bound of 600 points at 1 % noise.
constexpr double kTolerance = 0.25;

cv::Mat exposeAt(const Eigen::Vector2d& place, std::uint32_t seed)
{
  Exposure exposure;
  exposure.displacement = place;
  exposure.noise = 0.01;
  exposure.seed = seed;
  return expose(exposure);
}

/// A tracker and its detector: exposures one after the other.
class ViewTrackerTest : public testing::Test
{
protected:
  explicit ViewTrackerTest(const std::optional<cv::Rect>& region = kRegion) : tracker_(newTracker(region)) {}

  static ViewTracker newTracker(const std::optional<cv::Rect>& region = kRegion)
  {
    return { std::make_unique<HyperplaneTracker>(HyperplaneTrackerOptions(), kCounts),
             kCounts,
             1,
             MotionModel::TRANSLATION,
             false,
             region };
  }

  /// The exposure at a place; what is to be learnt from it is, after its answer. @return the answer
  ViewAnswer show(const Eigen::Vector2d& place, const std::optional<Training>& training = std::nullopt)
  {
    return showImage(exposeAt(place, ++seed_), training);
  }
  ViewAnswer showImage(const cv::Mat& image, const std::optional<Training>& training = std::nullopt)
  {
    const ViewAnswer answer = tracker_.answer(image, ++stamp_, training);
    outcome_ = training ? tracker_.learn(image) : std::string();
    return answer;
  }

  static void expectTracked(const ViewAnswer& answer, std::int64_t reference, const cv::Rect& region,
                            const Eigen::Vector2d& displacement)
  {
    EXPECT_EQ(State::TRACKING, answer.state) << answer.fault;
    EXPECT_EQ("", answer.fault);
    EXPECT_EQ(reference, answer.reference_stamp_ns);
    EXPECT_EQ(region, answer.region);
    EXPECT_LT((answer.motion.displacement - displacement).norm(), kTolerance)
        << answer.motion.displacement.transpose() << " for " << displacement.transpose();
  }

  static cv::Mat blind()
  {
    cv::Mat image(exposeAt({ 0.0, 0.0 }, 1).size(), CV_16UC1);
    cv::theRNG().state = 1;
    cv::randn(image, kOffset + 20.0, 3.0);
    return image;
  }

  /// Upside down: without the region.
  static cv::Mat turned(std::uint32_t seed)
  {
    cv::Mat image;
    cv::flip(exposeAt({ 0.0, 0.0 }, seed), image, 0);
    return image;
  }

  ViewTracker tracker_;
  std::int64_t stamp_ = 0;
  std::uint32_t seed_ = 0;
  std::string outcome_;  ///< of the last training
};

class UnconfiguredViewTrackerTest : public ViewTrackerTest
{
protected:
  UnconfiguredViewTrackerTest() : ViewTrackerTest(std::nullopt) {}
};

/// A driver that bins or cuts out, of which camera_info and setup know nothing: pixels are not what they are taken for.
TEST_F(ViewTrackerTest, imagesOfAnotherSizeTellNothing)
{
  const cv::Mat good = exposeAt({ 0.0, 0.0 }, 1);
  const auto newTrackerOf = [](const cv::Size& size)
  {
    return ViewTracker(std::make_unique<HyperplaneTracker>(HyperplaneTrackerOptions(), kCounts), kCounts, 1,
                       MotionModel::TRANSLATION, false, kRegion, size);
  };
  cv::Mat binned, larger;
  cv::resize(good, binned, good.size() / 2, 0.0, 0.0, cv::INTER_AREA);
  cv::copyMakeBorder(good, larger, 8, 0, 8, 0, cv::BORDER_REPLICATE);
  const cv::Mat cut = good(cv::Rect(8, 0, good.cols - 8, good.rows));
  for (const cv::Mat& wrong : { binned, larger, cut })
  {
    ViewTracker tracker = newTrackerOf(good.size());
    const std::string fault = "the image is " + std::to_string(wrong.cols) + " x " + std::to_string(wrong.rows) +
                              " px, expected the detector's image_size, 240 x 200";
    EXPECT_EQ(State::UNTRAINED, tracker.answer(wrong, 1).state);
    EXPECT_THROW(tracker.takeUp(wrong, 1, kRegion, std::nullopt), std::invalid_argument);
    EXPECT_EQ(State::TRACKING, tracker.answer(good, 2).state);
    const ViewAnswer answer = tracker.answer(wrong, 3);
    EXPECT_FALSE(answer.found());
    EXPECT_TRUE(answer.error);
    EXPECT_EQ(fault, answer.fault);
    EXPECT_EQ(State::TRACKING, tracker.answer(exposeAt({ 0.0, 0.0 }, 2), 4).state);
  }
}

TEST_F(ViewTrackerTest, switchesTemplatesWithoutAGap)
{
  expectTracked(show({ 0.0, 0.0 }), 1, kRegion, { 0.0, 0.0 });
  expectTracked(show({ 3.0, -2.0 }), 1, kRegion, { 3.0, -2.0 });

  expectTracked(show({ 5.0, 1.0 }, Training{ Kind::REGION, kOther }), 1, kRegion, { 5.0, 1.0 });
  EXPECT_EQ("", outcome_);
  expectTracked(show({ 6.5, 3.0 }), 3, kOther, { 1.5, 2.0 });

  expectTracked(show({ 8.0, 2.0 }, Training{ Kind::ANEW, {} }), 3, kOther, { 3.0, 1.0 });
  EXPECT_EQ("", outcome_);
  expectTracked(show({ 7.0, 0.0 }), 5, kRegion, { -1.0, -2.0 });

  // The predictors alone: the reference stays.
  expectTracked(show({ 6.0, 0.5 }, Training{ Kind::AGAIN, {} }), 5, kRegion, { -2.0, -1.5 });
  EXPECT_EQ("", outcome_);
  expectTracked(show({ 4.0, 1.0 }), 5, kRegion, { -4.0, -1.0 });
}

TEST_F(ViewTrackerTest, keepsTheTemplateWhereTrainingFails)
{
  expectTracked(show({ 0.0, 0.0 }), 1, kRegion, { 0.0, 0.0 });
  expectTracked(show({ 1.0, 2.0 }, Training{ Kind::REGION, { 200, 55, 1000, 90 } }), 1, kRegion, { 1.0, 2.0 });
  EXPECT_NE(std::string::npos, outcome_.find("1000 x 90 at (200, 55)")) << outcome_;
  expectTracked(show({ 2.0, 3.0 }), 1, kRegion, { 2.0, 3.0 });

  // A region without contrast beside the one in use.
  cv::Mat image = exposeAt({ 2.5, 3.5 }, 77);
  image(cv::Rect(0, 0, 40, 40)) = 20000;
  expectTracked(showImage(image, Training{ Kind::REGION, { 5, 5, 30, 30 } }), 1, kRegion, { 2.5, 3.5 });
  EXPECT_NE(std::string::npos, outcome_.find("contrast")) << outcome_;
  expectTracked(show({ 3.0, 4.0 }), 1, kRegion, { 3.0, 4.0 });

  // An exposure that shows nothing to learn from.
  for (const Kind kind : { Kind::REGION, Kind::AGAIN, Kind::ANEW })
  {
    const ViewAnswer answer = showImage(blind(), Training{ kind, kOther });
    EXPECT_EQ(State::BLIND, answer.state);
    EXPECT_EQ(1, answer.reference_stamp_ns);
    EXPECT_EQ(answer.fault, outcome_);
    EXPECT_NE("", outcome_);
    expectTracked(show({ 3.5, 4.0 }), 1, kRegion, { 3.5, 4.0 });
  }
}

TEST_F(ViewTrackerTest, learnsWhereTheOldTemplateIsLost)
{
  expectTracked(show({ 0.0, 0.0 }), 1, kRegion, { 0.0, 0.0 });
  for (const Kind kind : { Kind::REGION, Kind::ANEW })
  {
    const cv::Rect learnt = kind == Kind::REGION ? kOther : kRegion;
    const std::int64_t old = tracker_.referenceStamp();
    const ViewAnswer answer =
        showImage(kind == Kind::REGION ? turned(++seed_) : exposeAt({ 1.0, 1.0 }, ++seed_), Training{ kind, kOther });
    EXPECT_EQ(State::LOST, answer.state);
    EXPECT_EQ(old, answer.reference_stamp_ns);
    EXPECT_NE("", answer.fault);
    EXPECT_EQ("", outcome_);
    const std::int64_t reference = stamp_;
    if (kind == Kind::REGION)
    {
      expectTracked(showImage(turned(++seed_)), reference, learnt, { 0.0, 0.0 });
    }
    else
    {
      expectTracked(show({ 2.5, 2.0 }), reference, learnt, { 1.5, 1.0 });
    }
  }
  // What is lost has no predictors to learn anew.
  EXPECT_EQ(State::LOST, showImage(turned(++seed_), Training{ Kind::AGAIN, {} }).state);
  EXPECT_NE(std::string::npos, outcome_.find("lost")) << outcome_;
}

TEST_F(ViewTrackerTest, learnsWhereBladesCoverTheOldTemplate)
{
  const auto with_blades = [this](const Eigen::Vector2d& place)
  {
    cv::Mat image = exposeAt(place, ++seed_);
    cv::Mat covered = image.colRange(0, 130);
    covered = covered / 200 + 5;
    return image;
  };
  const cv::Rect beside(140, 60, 60, 80);
  expectTracked(show({ 0.0, 0.0 }), 1, kRegion, { 0.0, 0.0 });
  const ViewAnswer answer = showImage(with_blades({ 0.5, 0.5 }), Training{ Kind::REGION, beside });
  EXPECT_EQ(State::BLIND, answer.state) << answer.fault;
  EXPECT_EQ(1, answer.reference_stamp_ns);
  EXPECT_EQ("", outcome_);
  expectTracked(showImage(with_blades({ 2.0, 1.5 })), 2, beside, { 1.5, 1.0 });
}

/// What passes in front of the region, sharp-edged as a rod, leaves nothing behind in what is seen of it later.
TEST_F(ViewTrackerTest, whatHasPassedIsForgotten)
{
  constexpr int kAfter = 5;  // exposures
  int lost = 0;
  for (const auto& [width, speed] : { std::pair(5, 7), std::pair(45, 11) })
  {
    tracker_ = newTracker();
    ViewTracker undisturbed = newTracker();
    for (int left = kRegion.x - 2 * width, after = 0; after < kAfter; left += speed)
    {
      cv::Mat image = exposeAt({ 0.02 * left, 1.0 }, ++seed_);
      const ViewAnswer expected = undisturbed.answer(image, ++stamp_, std::nullopt);
      if (left < image.cols)
      {
        cv::Mat rod = image.colRange(std::max(left, 0), std::clamp(left + width, 1, image.cols));
        rod = 0.15 * (rod - kOffset) + kOffset;
      }
      const ViewAnswer answer = tracker_.answer(image, stamp_, std::nullopt);
      lost += answer.found() ? 0 : 1;
      if (left > kRegion.br().x + 10)
      {
        ++after;
        EXPECT_LT((answer.motion.displacement - expected.motion.displacement).norm(), 0.01) << width << " px";
        EXPECT_NEAR(expected.motion.quality, answer.motion.quality, 0.01) << width << " px";
      }
    }
  }
  EXPECT_GT(lost, 0) << "no rod does any harm, so this test tells nothing";
}

TEST_F(ViewTrackerTest, anImageThatCannotBeReadIsALossAndNoMore)
{
  EXPECT_EQ(State::UNTRAINED, tracker_.answerUnreadable("rgb8").state);
  expectTracked(show({ 0.0, 0.0 }), 1, kRegion, { 0.0, 0.0 });
  const ViewAnswer answer = tracker_.answerUnreadable("rgb8");
  EXPECT_EQ(State::LOST, answer.state);
  EXPECT_EQ("rgb8", answer.fault);
  EXPECT_TRUE(answer.error);
  expectTracked(show({ 1.0, 0.0 }), 1, kRegion, { 1.0, 0.0 });
}

TEST_F(UnconfiguredViewTrackerTest, theFirstTemplateAnswersTheExposureThatItIsLearntOn)
{
  EXPECT_EQ(State::UNTRAINED, show({ 0.0, 0.0 }).state);
  EXPECT_EQ(State::UNTRAINED, show({ 0.0, 0.0 }, Training{ Kind::REGION, { 200, 55, 1000, 90 } }).state);
  EXPECT_NE("", outcome_);
  EXPECT_EQ(State::UNTRAINED, show({ 0.0, 0.0 }, Training{ Kind::AGAIN, {} }).state);
  EXPECT_NE(std::string::npos, outcome_.find("untrained")) << outcome_;

  const ViewAnswer first = show({ 2.0, 1.0 }, Training{ Kind::REGION, kRegion });
  EXPECT_EQ("", outcome_);
  EXPECT_EQ(Eigen::Vector2d::Zero(), first.motion.displacement);
  expectTracked(first, 4, kRegion, { 0.0, 0.0 });
  expectTracked(show({ 3.0, 3.0 }), 4, kRegion, { 1.0, 2.0 });

  // All is forgotten, after its last answer.
  expectTracked(show({ 4.0, 3.0 }, Training{ Kind::ANEW, {} }), 4, kRegion, { 2.0, 2.0 });
  EXPECT_EQ("", outcome_);
  const ViewAnswer forgotten = show({ 4.0, 4.0 });
  EXPECT_EQ(State::UNTRAINED, forgotten.state);
  EXPECT_EQ(0, forgotten.reference_stamp_ns);
  EXPECT_EQ(cv::Rect(), forgotten.region);
}

TEST_F(ViewTrackerTest, anotherRunLearnsTheSameRegionAnew)
{
  show({ 0.0, 0.0 }, Training{ Kind::REGION, kOther });
  expectTracked(show({ 1.0, 1.0 }), 1, kOther, { 1.0, 1.0 });
  tracker_.startAnew();
  expectTracked(show({ 5.0, 5.0 }), 3, kOther, { 0.0, 0.0 });
  expectTracked(show({ 6.0, 4.0 }), 3, kOther, { 1.0, -1.0 });
}

/// In the place of one that has died.
class TakenUpViewTrackerTest : public ViewTrackerTest
{
protected:
  static ViewTracker successor(const cv::Mat& image, const cv::Rect& wanted,
                               const std::optional<double>& usual = std::nullopt)
  {
    ViewTracker tracker(std::make_unique<HyperplaneTracker>(HyperplaneTrackerOptions(), kCounts), kCounts, 1,
                        MotionModel::TRANSLATION, false, kRegion);
    tracker.takeUp(image, 1, wanted, usual);
    return tracker;
  }
};

TEST_F(TakenUpViewTrackerTest, motionGoesOnFromTheSameExposure)
{
  const cv::Mat first = exposeAt({ 0.0, 0.0 }, 100);
  ViewTracker tracker = successor(first, kOther);
  EXPECT_EQ(1, tracker.referenceStamp());
  EXPECT_EQ(kOther, tracker.wantedRegion());
  // Wherever the region has gone meanwhile.
  for (const Eigen::Vector2d& place : { Eigen::Vector2d(12.0, -7.0), Eigen::Vector2d(13.0, -7.5) })
  {
    expectTracked(tracker.answer(exposeAt(place, ++seed_), ++stamp_ + 10), 1, kOther, place);
  }
}

/// Before an exposure has shown it, the template is no evidence of anything.
TEST_F(TakenUpViewTrackerTest, aTemplateThatIsNotThereIsNotTracked)
{
  ViewTracker tracker = successor(exposeAt({ 0.0, 0.0 }, 100), kRegion);
  for (int i = 0; i < 3; ++i)
  {
    const ViewAnswer answer = tracker.answer(turned(++seed_), ++stamp_ + 10);
    EXPECT_EQ(State::LOST, answer.state);
    EXPECT_EQ(1, answer.reference_stamp_ns);
  }
  EXPECT_EQ(State::BLIND, tracker.answer(blind(), ++stamp_ + 10).state);
  expectTracked(tracker.answer(exposeAt({ 2.0, 2.0 }, ++seed_), ++stamp_ + 10), 1, kRegion, { 2.0, 2.0 });
}

/// What the one before has seen of the region proves what this one finds.
TEST_F(TakenUpViewTrackerTest, whatIsFoundIsAsItWas)
{
  const auto covered = [this]
  {
    cv::Mat image = exposeAt({ 2.0, 2.0 }, ++seed_);
    cv::GaussianBlur(image, image, {}, 5.0);  // alike, and not the same
    return image;
  };
  const cv::Mat first = exposeAt({ 0.0, 0.0 }, 100);
  ViewTracker lenient = successor(first, kRegion);
  const ViewAnswer& found = lenient.answer(covered(), 20);
  ASSERT_TRUE(found.found()) << found.fault;
  const double left = 1.0 - found.motion.correlation * found.motion.correlation;
  ASSERT_GT(left, 0.06);  // what is always let pass, and some
  ViewTracker strict = successor(first, kRegion, 0.3 * left);
  EXPECT_EQ(State::LOST, strict.answer(covered(), 20).state);
  expectTracked(strict.answer(exposeAt({ 2.0, 2.0 }, ++seed_), 21), 1, kRegion, { 2.0, 2.0 });
}

TEST_F(TakenUpViewTrackerTest, whatIsNoTemplateIsRefused)
{
  EXPECT_THROW(successor(blind(), kRegion), std::invalid_argument);
  EXPECT_THROW(successor(exposeAt({ 0.0, 0.0 }, 100), cv::Rect(200, 55, 1000, 90)), std::invalid_argument);
  EXPECT_THROW(successor(cv::Mat(), kRegion), std::invalid_argument);
}
}  // namespace
}  // namespace xray_tracking
