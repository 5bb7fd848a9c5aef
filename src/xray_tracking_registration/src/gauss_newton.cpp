#include "gauss_newton.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <tbb/parallel_for.h>
#include <Eigen/Cholesky>

namespace xray_tracking
{
namespace
{
constexpr float kHuber = 2.5f;        // in standard deviations
constexpr float kDeformation = 1.5f;  // how far parts of the rest are from where its pose, a rigid one, has them [mm]
constexpr double kSmallTranslation = 0.02;  // a step that ends the iterations [mm]
constexpr double kSmallRotation = 0.02 * M_PI / 180.0;
constexpr double kNearlySmall = 5.0;  // times that: not to be tried shorter
constexpr int kMaxRejections = 2;
/// Of the information's diagonal: with less, what is seen badly of the rest goes to and fro (knee_real; random starts
/// of 0.3 mm and degrees there: 193 to 200 of 200 believed).
constexpr double kLeastDamping = 1e-2;
/// What is known of a saturation before the images are seen: 0.2 within 0.5, from patients' trunks to metal.
constexpr double kSaturationInformation = 4.0;

/// Standard deviation from the median size, which the sample's pixels tell within some per cent.
float robustDeviation(const Eigen::VectorXf& residual, const std::vector<int>& sample)
{
  std::vector<float> sizes(sample.size());
  std::transform(sample.begin(), sample.end(), sizes.begin(), [&](int n) { return std::abs(residual[n]); });
  const auto middle = sizes.begin() + sizes.size() / 2;
  std::nth_element(sizes.begin(), middle, sizes.end());
  return 1.4826f * *middle;
}

/// Inverse variances of the pixels' differences, with Huber's weights; the variance follows from the median. 0 for what
/// does not count.
/// @param deformation variance that comes on top in each pixel
Eigen::VectorXf pixelWeights(const ViewLevel& view, const Eigen::VectorXf& residual, const Eigen::VectorXf& deformation)
{
  const float deviation = robustDeviation(residual, view.sample());
  const Eigen::VectorXf shape = (deformation.array() + deviation * deviation).max(1e-12f);
  const Eigen::VectorXf whitened = residual.cwiseQuotient(shape.cwiseSqrt());
  const float limit = kHuber * robustDeviation(whitened, view.sample());
  const Eigen::VectorXf weights = view.valid().cwiseProduct(
      (limit / whitened.array().abs().max(std::max(limit, std::numeric_limits<float>::min()))).matrix());
  const float variance = weights.dot(whitened.cwiseAbs2()) / weights.sum();
  return (variance > 0.0f ? (weights / variance).eval() : weights).cwiseQuotient(shape);
}

/// By how much a model has to be multiplied to be nearest to an image by these weights.
float scaleOf(const Eigen::VectorXf& model, const Eigen::VectorXf& image, const Eigen::VectorXf& weights)
{
  const Eigen::VectorXf weighted = weights.cwiseProduct(model);
  return weighted.dot(image) / std::max(weighted.dot(model), 1e-12f);
}

/// Whether a step is so short that its image need not be rendered: what the first order lacks is of second order in a
/// twentieth of the finest bins. The iterations then end with it.
bool isSlight(const Eigen::VectorXd& twists, const PosePair& after, const PosePair& before)
{
  constexpr double kTranslation = 0.05;  // [mm]
  constexpr double kRotation = 0.05 * M_PI / 180.0;
  constexpr double kTimesForRest = 4.0;  // its edges are softer, and it is a nuisance
  constexpr double kSaturation = 0.05;
  for (Eigen::Index body = 0; body < twists.size() / 6; ++body)
  {
    const double times = body == 0 ? 1.0 : kTimesForRest;
    if (twists.segment<3>(6 * body).norm() > times * kRotation ||
        twists.segment<3>(6 * body + 3).norm() > times * kTranslation)
    {
      return false;
    }
  }
  return std::equal(after.saturation.begin(), after.saturation.end(), before.saturation.begin(),
                    [](double a, double b) { return std::abs(a - b) < kSaturation; });
}

/// Moves the models by a step, to first order.
void moveModels(const std::vector<ViewLevel>& views, const Eigen::VectorXd& twists, const PosePair& after,
                const PosePair& before, Linearisation& at)
{
  tbb::parallel_for(std::size_t{ 0 }, views.size(),
                    [&](std::size_t v)
                    {
                      Eigen::VectorXf step(twists.size() + 1);
                      step << twists.cast<float>(), static_cast<float>(after.saturation[v] - before.saturation[v]);
                      views[v].move(step, at.models[v]);
                    });
}

/// Whether a step moves the target by next to nothing.
bool isSmall(const Eigen::VectorXd& step)
{
  return step.segment<3>(0).norm() < kSmallRotation && step.segment<3>(3).norm() < kSmallTranslation;
}
}  // namespace

double Linearisation::meanSimilarity() const
{
  double sum = 0.0;
  for (const ViewModel& model : models)
  {
    sum += model.similarity;
  }
  return sum / static_cast<double>(models.size());
}

double Linearisation::cost(const std::vector<ViewLevel>& views, const std::vector<Eigen::VectorXf>& by) const
{
  double sum = 0.0;
  for (std::size_t v = 0; v < views.size(); ++v)
  {
    // At the model's best scale by these weights: along it the cost is flat, so that the gradient need not know of it.
    sum += (views[v].measured() - scaleOf(models[v].image, views[v].measured(), by[v]) * models[v].image)
               .cwiseAbs2()
               .dot(by[v]);
  }
  return sum;
}

Linearisation linearise(const std::vector<ViewLevel>& views, const Bodies& bodies, const PosePair& poses, Moving moving,
                        const Linearisation* near)
{
  Linearisation at{ std::vector<ViewModel>(views.size()), std::vector<Eigen::VectorXf>(views.size()) };
  tbb::parallel_for(std::size_t{ 0 }, views.size(),
                    [&](std::size_t v)
                    {
                      ViewModel& model = at.models[v];
                      if (near != nullptr)
                      {
                        model.rendered = near->models[v].rendered;
                      }
                      views[v].model(bodies, poses, poses.saturationOf(v), moving, model);
                      Eigen::VectorXf deformation = Eigen::VectorXf::Zero(model.image.size());
                      if (moving == Moving::BOTH)
                      {
                        deformation =
                            kDeformation * kDeformation * model.derivatives.middleCols<3>(9).rowwise().squaredNorm();
                      }
                      at.weights[v] = pixelWeights(views[v], views[v].measured() - model.image, deformation);
                      const float scale = scaleOf(model.image, views[v].measured(), at.weights[v]);
                      model.image *= scale;
                      model.derivatives *= scale;
                    });
  return at;
}

std::vector<double> similarities(const std::vector<ViewLevel>& views, const Bodies& bodies, const PosePair& poses)
{
  std::vector<double> values(views.size());
  tbb::parallel_for(std::size_t{ 0 }, views.size(),
                    [&](std::size_t v) { values[v] = views[v].similarity(bodies, poses, poses.saturationOf(v)); });
  return values;
}

Twist RestPrior::deviation(const PosePair& poses, const Eigen::Vector3d& centre) const
{
  return twistAbout(poses.target * centre, poses.rest * (poses.target * target_from_rest).inverse());
}

std::vector<WeighedSums> weighedSumsOf(const std::vector<ViewLevel>& views, const Linearisation& at)
{
  std::vector<WeighedSums> sums(views.size());
  tbb::parallel_for(std::size_t{ 0 }, views.size(),
                    [&](std::size_t v)
                    {
                      const ViewModel& model = at.models[v];
                      sums[v] = weighedSums(model.derivatives, at.weights[v], views[v].measured() - model.image);
                    });
  return sums;
}

NormalEquations normalEquations(const std::vector<ViewLevel>& views, const Linearisation& at, const RestPrior& prior,
                                const PosePair& poses, const Eigen::Vector3d& centre)
{
  const Eigen::Index twists = at.models.front().twists;
  const auto unknowns = twists + static_cast<Eigen::Index>(views.size());
  NormalEquations equations{ Eigen::MatrixXd::Zero(unknowns, unknowns), Eigen::VectorXd::Zero(unknowns) };
  const std::vector<WeighedSums> of_views = weighedSumsOf(views, at);
  for (std::size_t v = 0; v < views.size(); ++v)
  {
    const WeighedSums& sums = of_views[v];
    const auto k = twists + static_cast<Eigen::Index>(v);
    equations.information.topLeftCorner(twists, twists) += sums.squares.topLeftCorner(twists, twists);
    equations.information.col(k).head(twists) = sums.squares.col(twists).head(twists);
    equations.information.row(k).head(twists) = sums.squares.row(twists).head(twists);
    equations.information(k, k) = sums.squares(twists, twists);
    equations.gradient.head(twists) += sums.products.head(twists);
    equations.gradient[k] = sums.products[twists];
    equations.information(k, k) += kSaturationInformation;
    const double saturation = poses.saturationOf(v);
    equations.gradient[k] += kSaturationInformation * (kUsualSaturation - saturation);
    if ((saturation <= 0.0 && equations.gradient[k] < 0.0) ||
        (saturation >= kMaxSaturation && equations.gradient[k] > 0.0))
    {
      // Held at its bound: the twists are not to make up for a step that is not taken.
      equations.information.row(k).setZero();
      equations.information.col(k).setZero();
      equations.information(k, k) = 1.0;
      equations.gradient[k] = 0.0;
    }
  }
  if (twists == 12)
  {
    const Twist pull = -prior.information.cwiseProduct(prior.deviation(poses, centre));
    equations.gradient.segment<6>(6) += pull;
    equations.gradient.head<6>() -= pull;
    const Eigen::Matrix<double, 6, 6> information = prior.information.asDiagonal();
    equations.information.block<6, 6>(0, 0) += information;
    equations.information.block<6, 6>(6, 6) += information;
    equations.information.block<6, 6>(0, 6) -= information;
    equations.information.block<6, 6>(6, 0) -= information;
  }
  return equations;
}

PosePair moved(const PosePair& poses, const Eigen::VectorXd& twists, const Eigen::Vector3d& centre, Moving moving)
{
  const Eigen::Vector3d room_centre = poses.target * centre;
  PosePair result = poses;
  result.target = motionAbout(room_centre, twists.head<6>()) * poses.target;
  if (moving != Moving::TARGET)
  {
    result.rest = motionAbout(room_centre, twists.tail<6>()) * poses.rest;
  }
  return result;
}

Linearisation gaussNewton(const std::vector<ViewLevel>& views, const Bodies& bodies, Moving moving,
                          const RestPrior& prior, const Descent& descent, Linearisation start, RunControl& control,
                          PosePair& poses)
{
  const auto priorCost = [&](const PosePair& at)
  {
    const Twist deviation = prior.deviation(at, bodies.centre);
    double cost = moving == Moving::BOTH ? deviation.dot(prior.information.cwiseProduct(deviation)) : 0.0;
    for (const double k : at.saturation)
    {
      cost += kSaturationInformation * (k - kUsualSaturation) * (k - kUsualSaturation);
    }
    return cost;
  };
  poses.saturation.resize(views.size(), kUsualSaturation);
  Linearisation best = std::move(start);
  double damping = kLeastDamping;
  bool settled = false;
  for (int iteration = 0; !settled && iteration < descent.max_iterations; ++iteration)
  {
    const NormalEquations equations = normalEquations(views, best, prior, poses, bodies.centre);
    const double cost = best.cost(views, best.weights) + priorCost(poses);
    bool improved = false;
    for (int rejections = 0; !improved && rejections <= kMaxRejections; ++rejections)
    {
      Eigen::MatrixXd damped = equations.information;
      damped.diagonal() *= 1.0 + damping;
      const Eigen::VectorXd step = damped.ldlt().solve(equations.gradient);
      if (!step.allFinite())
      {
        return best;
      }
      const Eigen::VectorXd twists = step.head(step.size() - static_cast<Eigen::Index>(views.size()));
      PosePair trial = moved(poses, twists, bodies.centre, moving);
      for (std::size_t v = 0; v < views.size(); ++v)
      {
        trial.saturation[v] =
            std::clamp(poses.saturation[v] + step[twists.size() + static_cast<Eigen::Index>(v)], 0.0, kMaxSaturation);
      }
      const bool in_bounds = control.inBounds(trial.target);
      if (in_bounds && isSlight(twists, trial, poses))
      {
        moveModels(views, twists, trial, poses, best);
        poses = trial;
        return best;
      }
      if (isSmall(step) || step.dot(equations.gradient) < descent.min_gain * cost)
      {
        break;
      }
      if (in_bounds)
      {
        if (!control.mayRender(poses.target, best.meanSimilarity()))
        {
          return best;
        }
        Linearisation there = linearise(views, bodies, trial, moving, &best);
        const double new_cost = there.cost(views, best.weights) + priorCost(trial);
        improved = new_cost < cost;
        if (improved)
        {
          best = std::move(there);
          poses = trial;
          settled = cost - new_cost < descent.min_gain * cost;
        }
      }
      if (!improved && isSmall(step / kNearlySmall))
      {
        break;  // shorter steps would gain next to nothing
      }
      damping = improved ? std::max(damping / 5.0, kLeastDamping) : damping * 10.0;
    }
    ++control.iterations;
    settled = settled || !improved;
  }
  return best;
}
}  // namespace xray_tracking
