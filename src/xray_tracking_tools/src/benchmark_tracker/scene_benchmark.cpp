#include "scene_benchmark.h"

#include <algorithm>
#include <functional>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <boost/math/constants/constants.hpp>

#include "follow.h"

namespace xray_tracking
{
namespace
{
constexpr double kDegree = boost::math::constants::degree<double>();
constexpr int kWalkFrames = 100;
/// Every one has noise of its own, which shifts all that is found with it.
constexpr int kTemplates = 8;
constexpr int kJumps = 40;
/// Of kJumps, that are recovered within the capture range: 95 %.
constexpr int kRecovered = 38;
constexpr double kJumpStep = 4.0;
constexpr double kLongestJump = 60.0;
/// A jump is recovered if the answer errs by less [px].
constexpr double kRecoveredError = 1.5;
/// Everything moves alike, who errs by more follows nothing [px].
constexpr double kLostInScene = 3.0;

std::string nameOf(MotionModel model)
{
  switch (model)
  {
    case MotionModel::TRANSLATION:
      return "translation";
    case MotionModel::EUCLIDEAN:
      return "translation and rotation";
    case MotionModel::SIMILARITY:
      return "translation, rotation and scale";
    case MotionModel::AFFINE:
      return "translation, rotation and two scales";
  }
  return "";
}

/// The rotation and the scales that a model allows, at random.
void deform(MotionModel model, cv::RNG& random, double share, PlanarMotion& motion)
{
  if (model == MotionModel::TRANSLATION)
  {
    return;
  }
  const double largest_angle = 3.0 * kDegree;
  motion.rotation = std::clamp(motion.rotation + share * random.uniform(-largest_angle, largest_angle), -largest_angle,
                               largest_angle);
  if (model == MotionModel::EUCLIDEAN)
  {
    return;
  }
  for (double& scale : motion.scale)
  {
    scale = std::clamp(scale + share * random.uniform(-0.03, 0.03), 0.97, 1.03);
  }
  if (model == MotionModel::SIMILARITY)
  {
    motion.scale[1] = motion.scale[0];
  }
}

/// Within +-12 px with steps of up to 4 px a direction, +-3 degrees and +-3 % of scale; the first one stays.
std::vector<PlanarMotion> walk(MotionModel model, cv::RNG& random)
{
  std::vector<PlanarMotion> motions(1);
  while (static_cast<int>(motions.size()) <= kWalkFrames)
  {
    PlanarMotion motion = motions.back();
    for (double& d : motion.displacement)
    {
      d = std::clamp(d + random.uniform(-4.0, 4.0), -12.0, 12.0);
    }
    deform(model, random, 1.0 / 3.0, motion);
    motions.push_back(motion);
  }
  return motions;
}

BenchmarkView sceneView(const PlanarScene& scene, const cv::Size& image)
{
  BenchmarkView view;
  view.intensity.kind = IntensityModel::Kind::ATTENUATION;
  view.region = scene.region();
  view.window = cv::Rect(cv::Point(), image);
  return view;
}

/// Exposures of rendered motions; the condition is drawn for each of them but the first, which is plain.
template <typename DrawCondition>
KnownSequence exposeWalk(const PlanarScene& scene, const std::vector<PlanarMotion>& motions,
                         const std::vector<cv::Mat>& rendered, cv::RNG& random, DrawCondition draw)
{
  KnownSequence sequence;
  sequence.view = sceneView(scene, rendered.front().size());
  for (std::size_t k = 0; k < motions.size(); ++k)
  {
    const ExposureCondition condition = k == 0 ? ExposureCondition() : draw();
    sequence.frames.push_back(makeFrame(scene.expose(rendered[k], motions[k], condition, random), sequence.view));
    sequence.displacements.push_back(motions[k].displacement);
  }
  return sequence;
}

/// The longest jump from the template's place that is recovered in 95 % of the trials, and all shorter ones [px].
std::vector<double> captureRanges(const PlanarScene& scene, MotionModel model, const KnownSequence& sequence,
                                  const Contestants& contestants)
{
  cv::RNG random(3);
  std::vector<double> ranges(contestants.size(), 0.0);
  std::vector<bool> captures(contestants.size(), true);
  for (const auto& contestant : contestants)
  {
    contestant->train(sequence.frames[0], sequence.view);
  }
  for (double length = kJumpStep; length <= kLongestJump; length += kJumpStep)
  {
    std::vector<int> missed(contestants.size(), 0);
    for (int trial = 0; trial < kJumps; ++trial)
    {
      PlanarMotion motion;
      motion.displacement = Eigen::Rotation2Dd(random.uniform(0.0, 360.0) * kDegree) * Eigen::Vector2d(length, 0.0);
      deform(model, random, 1.0, motion);
      ExposureCondition condition;
      condition.gain = random.uniform(0.9, 1.1);
      const BenchmarkFrame frame =
          makeFrame(scene.expose(scene.render(motion), motion, condition, random), sequence.view);
      for (std::size_t i = 0; i < contestants.size(); ++i)
      {
        if (captures[i] && missed[i] <= kJumps - kRecovered)
        {
          contestants[i]->restart();
          const std::optional<Eigen::Vector2d> found = contestants[i]->track(frame);
          missed[i] += !(found && (*found - motion.displacement).norm() < kRecoveredError);
        }
      }
    }
    bool any = false;
    for (std::size_t i = 0; i < contestants.size(); ++i)
    {
      captures[i] = captures[i] && missed[i] <= kJumps - kRecovered;
      ranges[i] = captures[i] ? length : ranges[i];
      any = any || captures[i];
    }
    if (!any)
    {
      break;
    }
  }
  return ranges;
}

}  // namespace

BenchmarkTable benchmarkModel(const PlanarScene& scene, MotionModel model)
{
  cv::RNG random(1);
  const std::vector<PlanarMotion> motions = walk(model, random);
  std::vector<cv::Mat> rendered;
  for (const PlanarMotion& motion : motions)
  {
    rendered.push_back(scene.render(motion));
  }
  std::vector<KnownSequence> sequences;
  while (static_cast<int>(sequences.size()) < kTemplates)
  {
    sequences.push_back(exposeWalk(scene, motions, rendered, random,
                                   [&random]
                                   {
                                     ExposureCondition condition;
                                     condition.gain = random.uniform(0.9, 1.1);
                                     return condition;
                                   }));
  }
  const double bound = scene.displacementBound(model);
  const Contestants contestants = makeContestants(model, sequences.front().view.intensity);
  BenchmarkTable table;
  table.title = "Region of 150 x 100 px, noise a fifth of its contrast, gain +-10 %; " + nameOf(model) + "; " +
                std::to_string(kTemplates) + " templates, each followed through " + std::to_string(kWalkFrames) +
                " exposures; Cramer-Rao bound " + std::to_string(bound) + " px";
  table.columns = { "training ms", "us", "RMSE px", "/ bound", "lost", "capture px" };
  const std::vector<double> ranges = captureRanges(scene, model, sequences.front(), contestants);
  for (std::size_t i = 0; i < contestants.size(); ++i)
  {
    const FollowScore score = follow(*contestants[i], sequences, kLostInScene);
    table.rows.emplace_back(contestants[i]->name(),
                            std::vector<double>{ score.training_ms, score.median_us, score.rmse, score.rmse / bound,
                                                 static_cast<double>(score.lost), ranges[i] });
  }
  return table;
}

BenchmarkTable benchmarkConditions(const PlanarScene& scene)
{
  cv::RNG random(2);
  const std::vector<PlanarMotion> motions = walk(MotionModel::TRANSLATION, random);
  std::vector<cv::Mat> rendered;
  for (const PlanarMotion& motion : motions)
  {
    rendered.push_back(scene.render(motion));
  }
  struct Condition
  {
    std::string name;
    std::function<void(ExposureCondition&)> draw;
  };
  const std::vector<Condition> conditions = {
    { "gain", [&random](ExposureCondition& c) { c.gain = random.uniform(0.7, 1.3); } },
    { "offset", [&random](ExposureCondition& c) { c.offset = random.uniform(-3.0, 3.0); } },
    { "shading", [&random](ExposureCondition& c) { c.shading = random.uniform(-2.0, 2.0); } },
    { "occlusion", [](ExposureCondition& c) { c.occlusion = true; } },
  };

  BenchmarkTable table;
  table.title = "The same region, translation, " + std::to_string(kWalkFrames) +
                " exposures: gain +-30 %, offset +-3 and shading +-2 times the contrast, a quarter of it occluded";
  const Contestants contestants = makeContestants(MotionModel::TRANSLATION, sceneView(scene, cv::Size()).intensity);
  for (const auto& contestant : contestants)
  {
    table.rows.emplace_back(contestant->name(), std::vector<double>());
  }
  for (const Condition& condition : conditions)
  {
    table.columns.push_back(condition.name + " px");
    table.columns.push_back(condition.name + " lost");
    const KnownSequence sequence = exposeWalk(scene, motions, rendered, random,
                                              [&condition]
                                              {
                                                ExposureCondition drawn;
                                                condition.draw(drawn);
                                                return drawn;
                                              });
    for (std::size_t i = 0; i < contestants.size(); ++i)
    {
      const FollowScore score = follow(*contestants[i], { sequence }, kLostInScene);
      table.rows[i].second.push_back(score.rmse);
      table.rows[i].second.push_back(score.lost);
    }
  }
  return table;
}

}  // namespace xray_tracking
