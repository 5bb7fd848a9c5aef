#include "xray_tracking_hyperplane_tracker/tracker_parameters.h"

#include <map>
#include <string>

#include "xray_tracking_conversions/parameters.h"
#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
cv::Rect readRegion(const ros::NodeHandle& pnh, ParameterReader& reader)
{
  const auto read = [&](const std::string& key)
  {
    const std::string name = "region/" + key;
    requireOption(pnh.hasParam(name), "parameter " + pnh.resolveName(name), "not set",
                  "x_offset, y_offset, width and height in pixels");
    return reader.read(name, 0);
  };
  return { read("x_offset"), read("y_offset"), read("width"), read("height") };
}

MotionModel modelNamed(const std::string& name)
{
  const std::map<std::string, MotionModel> models = { { "translation", MotionModel::TRANSLATION },
                                                      { "euclidean", MotionModel::EUCLIDEAN },
                                                      { "similarity", MotionModel::SIMILARITY },
                                                      { "affine", MotionModel::AFFINE } };
  const auto found = models.find(name);
  requireOption(found != models.end(), "model", name, "translation, euclidean, similarity or affine");
  return found->second;
}
}  // namespace

TrackerParameters readTrackerParameters(const ros::NodeHandle& pnh, const std::string& default_detector)
{
  ParameterReader reader(pnh);
  TrackerParameters parameters;
  HyperplaneTrackerOptions& tracker = parameters.tracker;
  const std::string model = reader.read("model", std::string("translation"));
  tracker.points = reader.read("points", tracker.points);
  tracker.bin = reader.read("bin", tracker.bin);
  tracker.ranges = reader.read("ranges", tracker.ranges);
  tracker.rotation_range = reader.read("rotation_range", tracker.rotation_range);
  tracker.scale_range = reader.read("scale_range", tracker.scale_range);
  tracker.training_motions = reader.read("training_motions", tracker.training_motions);
  tracker.background = reader.read("background", tracker.background);
  tracker.whole_region = reader.read("whole_region", tracker.whole_region);
  tracker.max_iterations = reader.read("max_iterations", tracker.max_iterations);
  tracker.convergence = reader.read("convergence", tracker.convergence);
  tracker.min_correlation = reader.read("min_correlation", tracker.min_correlation);
  tracker.found_correlation = reader.read("found_correlation", tracker.found_correlation);
  tracker.min_quality = reader.read("min_quality", tracker.min_quality);
  tracker.good_quality = reader.read("good_quality", tracker.good_quality);
  tracker.max_predicted_sd = reader.read("max_predicted_sd", tracker.max_predicted_sd);
  const int seed = reader.read("seed", static_cast<int>(tracker.seed));
  parameters.detector = reader.read("detector", default_detector);
  parameters.setup_file = reader.read("setup_file", parameters.setup_file);
  if (pnh.hasParam("region"))
  {
    parameters.region = readRegion(pnh, reader);
  }
  parameters.queue_size = reader.read("queue_size", parameters.queue_size);
  parameters.train_timeout = reader.read("train_timeout", parameters.train_timeout);
  parameters.image_timeout = reader.read("image_timeout", parameters.image_timeout);
  reader.warnOfUnread();

  tracker.model = modelNamed(model);
  requireOption(seed >= 0, "seed", seed, "0 or more");
  tracker.seed = static_cast<std::uint32_t>(seed);
  tracker.validate();
  requireInRange("queue_size", parameters.queue_size, 1, 100000);
  requireInRange("train_timeout", parameters.train_timeout, 0.01, 3600.0);
  requireInRange("image_timeout", parameters.image_timeout, 0.01, 3600.0);
  return parameters;
}
}  // namespace xray_tracking
