#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_hyperplane_tracker/region_tracker.h"

namespace xray_tracking
{
/// An exposure as the contestants get it.
struct BenchmarkFrame
{
  cv::Mat raw;         ///< as the detector gave it, CV_16UC1
  cv::Mat normalised;  ///< the window's attenuation without slow shading, mean 128, standard deviation 40, CV_8UC1
};

/// What is the same for all exposures of a benchmark.
struct BenchmarkView
{
  IntensityModel intensity;
  cv::Rect region;  ///< [px] in the raw image
  cv::Rect window;  ///< of the raw image, that the normalised one shows

  cv::Rect regionInWindow() const { return region - window.tl(); }
};

/// Prepares what the contestants other than our own need: 8 bit, gain and offset taken out.
BenchmarkFrame makeFrame(const cv::Mat& raw, const BenchmarkView& view);

/// One of the trackers that are compared.
class Contestant
{
public:
  explicit Contestant(std::string name) : name_(std::move(name)) {}
  virtual ~Contestant() = default;

  const std::string& name() const { return name_; }
  virtual void train(const BenchmarkFrame& frame, const BenchmarkView& view) = 0;
  /// The next search starts where the template was learnt.
  virtual void restart() = 0;
  /// @return the displacement of the region's centre since the training [px], none if the contestant says it is lost
  virtual std::optional<Eigen::Vector2d> track(const BenchmarkFrame& frame) = 0;

private:
  std::string name_;
};

using Contestants = std::vector<std::unique_ptr<Contestant>>;

/// "translation", "Euclidean", "similarity" or "affine"
std::string shortName(MotionModel model);

/// Our own trackers with this motion model.
void addOurs(MotionModel model, const IntensityModel& intensity, Contestants& contestants);
/// OpenCV's: findTransformECC with this motion model; phaseCorrelate, matchTemplate and Lucas-Kanade, which give
/// displacements only.
void addOpenCv(MotionModel model, Contestants& contestants);
/// ViSP's template trackers with this motion model; none if the build has no ViSP.
void addVisp(MotionModel model, Contestants& contestants);
/// All of these.
Contestants makeContestants(MotionModel model, const IntensityModel& intensity);
}  // namespace xray_tracking
