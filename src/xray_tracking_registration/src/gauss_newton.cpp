#include "gauss_newton.h"

#include <algorithm>
#include <cmath>

#include <tbb/parallel_for.h>
#include <Eigen/Cholesky>

namespace xray_tracking
{
namespace
{
constexpr Eigen::Index kMedianOf = 1000;  // pixels, at least, that a median is taken of
constexpr float kHuber = 2.5f;            // in standard deviations
constexpr float kDeformation = 1.5f;  // how far parts of the rest are from where its pose, a rigid one, has them [mm]
constexpr double kSmallTranslation = 0.02;  // a step that ends the iterations [mm]
constexpr double kSmallRotation = 0.02 * M_PI / 180.0;
constexpr int kMaxRejections = 2;
constexpr double kMinGain = 0.05;  // of a model that is not yet like the image
constexpr double kMaxSaturation = 3.0;
/// What is known of a saturation before the images are seen: 0.2 within 0.5, from patients' trunks to metal.
constexpr double kSaturationInformation = 4.0;

/// Standard deviation of what counts, from the median size, which a thousand pixels tell within some per cent.
float robustDeviation(const Eigen::VectorXf& residual, const Eigen::VectorXf& valid)
{
  const Eigen::Index step = std::max<Eigen::Index>(1, (valid.array() > 0.0f).count() / kMedianOf);
  std::vector<float> sizes;
  sizes.reserve(2 * kMedianOf);
  Eigen::Index counted = 0;
  for (Eigen::Index n = 0; n < residual.size(); ++n)
  {
    if (valid[n] > 0.0f && counted++ % step == 0)
    {
      sizes.push_back(std::abs(residual[n]));
    }
  }
  if (sizes.empty())
  {
    return 0.0f;
  }
  std::nth_element(sizes.begin(), sizes.begin() + sizes.size() / 2, sizes.end());
  return 1.4826f * sizes[sizes.size() / 2];
}

/// Inverse variances of the pixels' differences, with Huber's weights; the variance follows from the median. 0 for what
/// does not count.
/// @param deformation variance that comes on top in each pixel
Eigen::VectorXf pixelWeights(const Eigen::VectorXf& residual, const Eigen::VectorXf& valid,
                             const Eigen::VectorXf& deformation)
{
  const float deviation = robustDeviation(residual, valid);
  const Eigen::VectorXf shape = (deformation.array() + deviation * deviation).max(1e-12f);
  const Eigen::VectorXf whitened = residual.cwiseQuotient(shape.cwiseSqrt());
  const float limit = kHuber * robustDeviation(whitened, valid);
  const Eigen::VectorXf weights = valid.binaryExpr(
      whitened, [limit](float counts, float r) { return std::abs(r) > limit ? counts * limit / std::abs(r) : counts; });
  const float variance = weights.dot(whitened.cwiseAbs2()) / weights.sum();
  return (variance > 0.0f ? (weights / variance).eval() : weights).cwiseQuotient(shape);
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
  for (const double s : similarity)
  {
    sum += s;
  }
  return sum / static_cast<double>(similarity.size());
}

double Linearisation::cost(const std::vector<ViewLevel>& views, const std::vector<Eigen::VectorXf>& by) const
{
  double sum = 0.0;
  for (std::size_t v = 0; v < views.size(); ++v)
  {
    sum += (views[v].measured() - models[v].image).cwiseAbs2().dot(by[v]);
  }
  return sum;
}

Linearisation linearise(const std::vector<ViewLevel>& views, const Bodies& bodies, const PosePair& poses, Moving moving)
{
  Linearisation at{ std::vector<ViewModel>(views.size()), std::vector<Eigen::VectorXf>(views.size()),
                    std::vector<double>(views.size()) };
  tbb::parallel_for(std::size_t{ 0 }, views.size(),
                    [&](std::size_t v)
                    {
                      ViewModel& model = at.models[v];
                      views[v].model(bodies, poses, poses.saturationOf(v), moving, model);
                      at.similarity[v] = views[v].measured().dot(model.image);
                      // The model's share in the measured image: what is left is noise.
                      const auto gain = static_cast<float>(std::max(at.similarity[v], kMinGain));
                      model.image *= gain;
                      model.derivatives *= gain;
                      model.by_saturation *= gain;
                      Eigen::VectorXf deformation = Eigen::VectorXf::Zero(model.image.size());
                      if (moving == Moving::BOTH)
                      {
                        deformation =
                            kDeformation * kDeformation * model.derivatives.rightCols<3>().rowwise().squaredNorm();
                      }
                      at.weights[v] = pixelWeights(views[v].measured() - model.image, views[v].valid(), deformation);
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

namespace
{
/// Those of one view's image alone. @param v number of the view, of `views` in all
NormalEquations viewEquations(const ViewLevel& view, const Linearisation& at, std::size_t v, std::size_t views)
{
  const Eigen::MatrixXf& derivatives = at.models[v].derivatives;
  const Eigen::VectorXf& by_saturation = at.models[v].by_saturation;
  const Eigen::VectorXf& weights = at.weights[v];
  const Eigen::Index twists = derivatives.cols();
  const Eigen::Index k = twists + static_cast<Eigen::Index>(v);
  const auto unknowns = twists + static_cast<Eigen::Index>(views);
  NormalEquations equations{ Eigen::MatrixXd::Zero(unknowns, unknowns), Eigen::VectorXd::Zero(unknowns) };
  const Eigen::MatrixXf weighted = weights.asDiagonal() * derivatives;
  const Eigen::VectorXf weighted_k = weights.cwiseProduct(by_saturation);
  const Eigen::VectorXf difference = view.measured() - at.models[v].image;
  equations.information.topLeftCorner(twists, twists) = (derivatives.transpose() * weighted).cast<double>();
  equations.information.col(k).head(twists) = (derivatives.transpose() * weighted_k).cast<double>();
  equations.information.row(k).head(twists) = equations.information.col(k).head(twists).transpose();
  equations.information(k, k) = by_saturation.dot(weighted_k);
  equations.gradient.head(twists) = (weighted.transpose() * difference).cast<double>();
  equations.gradient[k] = weighted_k.dot(difference);
  return equations;
}
}  // namespace

Twist RestPrior::deviation(const PosePair& poses, const Eigen::Vector3d& centre) const
{
  return twistAbout(poses.target * centre, poses.rest * (poses.target * target_from_rest).inverse());
}

NormalEquations normalEquations(const std::vector<ViewLevel>& views, const Linearisation& at, const RestPrior& prior,
                                const PosePair& poses, const Eigen::Vector3d& centre)
{
  const Eigen::Index twists = at.models.front().derivatives.cols();
  const auto unknowns = twists + static_cast<Eigen::Index>(views.size());
  NormalEquations equations{ Eigen::MatrixXd::Zero(unknowns, unknowns), Eigen::VectorXd::Zero(unknowns) };
  for (std::size_t v = 0; v < views.size(); ++v)
  {
    const NormalEquations part = viewEquations(views[v], at, v, views.size());
    equations.information += part.information;
    equations.gradient += part.gradient;
    const auto k = twists + static_cast<Eigen::Index>(v);
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
  double damping = 1e-3;
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
      if (isSmall(step) || step.dot(equations.gradient) < descent.min_gain * cost)
      {
        break;
      }
      const Eigen::VectorXd twists = step.head(step.size() - static_cast<Eigen::Index>(views.size()));
      PosePair trial = moved(poses, twists, bodies.centre, moving);
      for (std::size_t v = 0; v < views.size(); ++v)
      {
        trial.saturation[v] =
            std::clamp(poses.saturation[v] + step[twists.size() + static_cast<Eigen::Index>(v)], 0.0, kMaxSaturation);
      }
      if (control.inBounds(trial.target))
      {
        if (!control.mayRender(poses.target, best.meanSimilarity()))
        {
          return best;
        }
        Linearisation there = linearise(views, bodies, trial, moving);
        const double new_cost = there.cost(views, best.weights) + priorCost(trial);
        improved = new_cost < cost;
        if (improved)
        {
          best = std::move(there);
          poses = trial;
          settled = cost - new_cost < descent.min_gain * cost;
        }
      }
      damping = improved ? std::max(damping / 5.0, 1e-6) : damping * 10.0;
    }
    ++control.iterations;
    settled = settled || !improved;
  }
  return best;
}
}  // namespace xray_tracking
