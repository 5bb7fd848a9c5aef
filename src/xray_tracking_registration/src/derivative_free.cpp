#include "derivative_free.h"

#include <cmath>

#include <tbb/parallel_for.h>
#include <nlopt.hpp>

#include "gauss_newton.h"

namespace xray_tracking
{
namespace
{
constexpr double kDegree = M_PI / 180.0;

/// What NLopt calls: unknowns in degrees and mm.
struct Objective
{
  const std::vector<ViewLevel>& views;
  const Bodies& bodies;
  Moving moving;
  const Similarity& similarity;
  RunControl& control;
  const PosePair start;
  PosePair best;
  double best_value = -std::numeric_limits<double>::infinity();

  double operator()(const std::vector<double>& unknowns)
  {
    Eigen::VectorXd step = Eigen::VectorXd::Map(unknowns.data(), static_cast<Eigen::Index>(unknowns.size()));
    for (Eigen::Index twist = 0; twist < step.size(); twist += 6)
    {
      step.segment<3>(twist) *= kDegree;
    }
    const PosePair poses = moved(start, step, bodies.centre, moving);
    if (!control.mayRender(best.target, best_value))
    {
      throw nlopt::forced_stop();
    }
    if (!control.inBounds(poses.target))
    {
      return -1.0;  // below what any similarity gives near the optimum
    }
    std::vector<double> values(views.size());
    tbb::parallel_for(std::size_t{ 0 }, views.size(),
                      [&](std::size_t v)
                      {
                        cv::Mat image;
                        views[v].modelImage(bodies, poses, poses.saturationOf(v), image);
                        values[v] = similarity(views[v].measuredImage(), image);
                      });
    double mean = 0.0;
    for (const double value : values)
    {
      mean += value / static_cast<double>(values.size());
    }
    if (mean > best_value)
    {
      best_value = mean;
      best = poses;
    }
    ++control.iterations;
    return mean;
  }
};

double callObjective(const std::vector<double>& unknowns, std::vector<double>&, void* objective)
{
  return (*static_cast<Objective*>(objective))(unknowns);
}
}  // namespace

void optimiseDerivativeFree(const std::vector<ViewLevel>& views, const Bodies& bodies, Moving moving,
                            const Similarity& similarity, double reach, RunControl& control, PosePair& poses)
{
  const unsigned count = moving == Moving::BOTH ? 12 : 6;
  nlopt::opt search(nlopt::LN_BOBYQA, count);
  Objective objective{ views, bodies, moving, similarity, control, poses, poses };
  search.set_max_objective(callObjective, &objective);
  search.set_lower_bounds(-5.0 * reach);
  search.set_upper_bounds(5.0 * reach);
  search.set_initial_step(reach);
  search.set_xtol_abs(0.01);
  search.set_maxeval(60 * static_cast<int>(count));
  std::vector<double> unknowns(count, 0.0);
  double value = 0.0;
  try
  {
    search.optimize(unknowns, value);
  }
  catch (const nlopt::forced_stop&)
  {
    // The best so far counts.
  }
  catch (const nlopt::roundoff_limited&)
  {
    // As far as it goes.
  }
  poses = objective.best;
}
}  // namespace xray_tracking
