#include "xray_tracking_hyperplane_tracker/tracker_parameters.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <string>

#include "xray_tracking_core/option_check.h"

namespace xray_tracking
{
namespace
{
cv::Rect readRegion(ParameterReader& reader)
{
  const auto read = [&](const std::string& key)
  {
    const std::string name = "region/" + key;
    requireOption(reader.has(name), "parameter " + reader.nameOf(name), "not set",
                  "x_offset, y_offset, width and height in pixels");
    return reader.read(name, 0);
  };
  return { read("x_offset"), read("y_offset"), read("width"), read("height") };
}

MotionModel modelNamed(const std::string& name)
{
  static const std::map<std::string, MotionModel> kModels = { { "auto", MotionModel::EUCLIDEAN },
                                                              { "translation", MotionModel::TRANSLATION },
                                                              { "euclidean", MotionModel::EUCLIDEAN },
                                                              { "similarity", MotionModel::SIMILARITY },
                                                              { "affine", MotionModel::AFFINE } };
  const auto found = kModels.find(name);
  requireOption(found != kModels.end(), "model", name, "auto, translation, euclidean, similarity or affine");
  return found->second;
}
}  // namespace

void TrackerParameters::scaleTo(double pixel)
{
  const double pixels = resolution / pixel;
  // Of no number one: validate() refuses it.
  tracker.reduction = pixels > 1.0 ? static_cast<int>(std::min(std::round(pixels), 64.0)) : 1;
  const double unit = tracker.reduction * pixel;
  tracker.ranges = ranges;
  for (double& range : tracker.ranges)
  {
    range /= unit;
  }
  tracker.convergence = convergence / unit;
  tracker.max_predicted_sd = max_predicted_sd / unit;
}

void TrackerParameters::adopt(const TreatmentSetup& setup)
{
  const ProjectionGeometry& geometry = setup.detector(detector);
  const double magnification = geometry.magnification(setup.room_from_patient * setup.targetCentre());
  if (!(magnification > 0.0))
  {
    throw std::invalid_argument("the target is not in front of the source of " + geometry.name());
  }
  scaleTo(geometry.pixelPitch().mean() / magnification);
  image_size = cv::Size(geometry.imageSize().x(), geometry.imageSize().y());
  const auto given = setup.regions.find(detector);
  if (!region)
  {
    region = given != setup.regions.end() ? given->second : projectedTargetRegion(setup, geometry);
  }
}

void TrackerParameters::validate() const
{
  const auto require_length = [](const char* key, double value, double largest)
  {
    requireOption(value > 0.0 && value <= largest, key, value,
                  "a length > 0, up to " + std::to_string(largest) + " [mm at the target]");
  };
  require_length("resolution", resolution, 10.0);
  requireOption(!ranges.empty(), "ranges", "empty", "one number or more");
  for (std::size_t i = 0; i < ranges.size(); ++i)
  {
    requireOption(ranges[i] > 0.0 && ranges[i] <= 250.0 && (i == 0 || ranges[i] < ranges[i - 1]), "ranges", ranges[i],
                  "numbers > 0 that fall, up to 250 [mm at the target]");
  }
  require_length("convergence", convergence, 10.0);
  require_length("max_predicted_sd", max_predicted_sd, 100.0);
  tracker.validate();
  requireInRange("queue_size", queue_size, 1, 1000);
  requireInRange("max_wait", max_wait, 0.0, 3600.0);
  requireInRange("train_timeout", train_timeout, 0.01, 3600.0);
  requireInRange("image_timeout", image_timeout, 0.01, 3600.0);
}

TrackerParameters readTrackerParameters(ParameterReader reader, const std::string& default_detector)
{
  TrackerParameters parameters;
  HyperplaneTrackerOptions& tracker = parameters.tracker;
  const std::string model = reader.read("model", std::string("auto"));
  tracker.points = reader.read("points", tracker.points);
  tracker.bin = reader.read("bin", tracker.bin);
  parameters.resolution = reader.read("resolution", parameters.resolution);
  parameters.ranges = reader.read("ranges", parameters.ranges);
  tracker.rotation_range = reader.read("rotation_range", tracker.rotation_range);
  tracker.scale_range = reader.read("scale_range", tracker.scale_range);
  tracker.training_motions = reader.read("training_motions", tracker.training_motions);
  tracker.background = reader.read("background", tracker.background);
  tracker.whole_region = reader.read("whole_region", tracker.whole_region);
  tracker.max_iterations = reader.read("max_iterations", tracker.max_iterations);
  parameters.convergence = reader.read("convergence", parameters.convergence);
  tracker.min_correlation = reader.read("min_correlation", tracker.min_correlation);
  tracker.found_correlation = reader.read("found_correlation", tracker.found_correlation);
  tracker.min_quality = reader.read("min_quality", tracker.min_quality);
  tracker.good_quality = reader.read("good_quality", tracker.good_quality);
  parameters.max_predicted_sd = reader.read("max_predicted_sd", parameters.max_predicted_sd);
  const int seed = reader.read("seed", static_cast<int>(tracker.seed));
  parameters.detector = reader.read("detector", default_detector);
  parameters.setup_file = reader.read("setup_file", parameters.setup_file);
  if (reader.has("region"))
  {
    parameters.region = readRegion(reader);
  }
  parameters.queue_size = reader.read("queue_size", parameters.queue_size);
  parameters.max_wait = reader.read("max_wait", parameters.max_wait);
  parameters.train_timeout = reader.read("train_timeout", parameters.train_timeout);
  parameters.image_timeout = reader.read("image_timeout", parameters.image_timeout);
  parameters.overlay_points = reader.read("overlay_points", parameters.overlay_points);
  parameters.keep_for_restart = reader.read("keep_for_restart", parameters.keep_for_restart);
  reader.warnOfUnread();

  tracker.model = modelNamed(model);
  parameters.model_by_data = model == "auto";
  requireOption(seed >= 0, "seed", seed, "0 or more");
  tracker.seed = static_cast<std::uint32_t>(seed);
  parameters.scaleTo(parameters.resolution);
  parameters.validate();
  return parameters;
}
}  // namespace xray_tracking
