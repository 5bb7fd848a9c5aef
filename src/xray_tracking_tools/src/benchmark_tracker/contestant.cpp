#include "contestant.h"

#include <algorithm>

#include <opencv2/imgproc.hpp>

#include "xray_tracking_core/image/attenuation.h"

namespace xray_tracking
{
BenchmarkFrame makeFrame(const cv::Mat& raw, const BenchmarkView& view)
{
  BenchmarkFrame frame;
  frame.raw = raw;
  cv::Mat values = attenuationImage(raw(view.window), view.intensity);
  // What is slow is not the region's, and moves the window's mean and deviation as it comes and goes.
  cv::Mat slow;
  cv::blur(values, slow, { 65, 65 });
  values -= slow;
  cv::Scalar mean, deviation;
  cv::meanStdDev(values, mean, deviation);
  const double gain = 40.0 / std::max(deviation[0], 1e-9);
  values.convertTo(frame.normalised, CV_8UC1, gain, 128.0 - gain * mean[0]);
  return frame;
}

std::string shortName(MotionModel model)
{
  switch (model)
  {
    case MotionModel::TRANSLATION:
      return "translation";
    case MotionModel::EUCLIDEAN:
      return "Euclidean";
    case MotionModel::SIMILARITY:
      return "similarity";
    case MotionModel::AFFINE:
      return "affine";
  }
  return "";
}

Contestants makeContestants(MotionModel model, const IntensityModel& intensity)
{
  Contestants contestants;
  addOurs(model, intensity, contestants);
  addOpenCv(model, contestants);
  addVisp(model, contestants);
  return contestants;
}
}  // namespace xray_tracking
