#include "contestant.h"
#include "template_registration.h"
#include "xray_tracking_hyperplane_tracker/hyperplane_tracker.h"

namespace xray_tracking
{
namespace
{
class RegionTrackerContestant : public Contestant
{
public:
  RegionTrackerContestant(std::string name, std::unique_ptr<RegionTracker> tracker)
    : Contestant(std::move(name)), tracker_(std::move(tracker))
  {
  }

  void train(const BenchmarkFrame& frame, const BenchmarkView& view) override
  {
    first_ = frame.raw;
    tracker_->train(first_, view.region);
  }
  void restart() override { tracker_->trackFrom(first_, Eigen::Vector2d::Zero()); }
  std::optional<Eigen::Vector2d> track(const BenchmarkFrame& frame) override
  {
    const TrackResult& result = tracker_->track(frame.raw);
    return result.found() ? std::optional<Eigen::Vector2d>(result.displacement) : std::nullopt;
  }

private:
  std::unique_ptr<RegionTracker> tracker_;
  cv::Mat first_;
};
}  // namespace

void addOurs(MotionModel model, const IntensityModel& intensity, Contestants& contestants)
{
  const auto add = [&contestants](const std::string& name, std::unique_ptr<RegionTracker> tracker)
  { contestants.push_back(std::make_unique<RegionTrackerContestant>(name, std::move(tracker))); };
  HyperplaneTrackerOptions hyperplane;
  hyperplane.model = model;
  add("hyperplane, " + shortName(model), std::make_unique<HyperplaneTracker>(hyperplane, intensity));
  // Single pixels at random places, predictors alone, white noise.
  hyperplane.points = 600;
  hyperplane.bin = 1;
  hyperplane.whole_region = false;
  hyperplane.background = 0.0;
  hyperplane.ranges = { 30.0, 12.0, 4.0, 1.5 };
  add("paper's hyperplane, " + shortName(model), std::make_unique<HyperplaneTracker>(hyperplane, intensity));
  if (model == MotionModel::TRANSLATION || model == MotionModel::EUCLIDEAN)
  {
    TemplateRegistrationOptions options;
    options.model = model;
    add("registration, NMI, " + shortName(model), std::make_unique<TemplateRegistration>(options, intensity));
    options.similarity = TemplateRegistrationOptions::Similarity::GRADIENT_CORRELATION;
    add("registration, gradients, " + shortName(model), std::make_unique<TemplateRegistration>(options, intensity));
  }
}
}  // namespace xray_tracking
