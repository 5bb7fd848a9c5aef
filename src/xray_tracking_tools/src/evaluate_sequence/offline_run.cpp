#include "offline_run.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "processor_time.h"
#include "xray_tracking_hyperplane_tracker/tracker_parameters.h"

namespace xray_tracking
{
namespace
{
constexpr double kTimeBudget = 600.0;  // [s]: nothing waits, and a result is not to hang on the machine

MotionMonitorOptions monitorOptions(const TreatmentSetup& setup, PoseMethod method, int refine_every, bool paper)
{
  MotionMonitorOptions options;
  options.method = method;
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    options.tracks.views.push_back(detector.name());
  }
  if (method != PoseMethod::TRACKING)
  {
    options.refinement.mode = refine_every > 1 ? RefinementMode::EVERY_N : RefinementMode::EVERY_FRAME;
    options.refinement.every_n = refine_every;
  }
  if (paper)
  {
    options.tracks.estimation.method = EstimationMethod::BACKPROJECTION;
  }
  options.derive();
  return options;
}

std::unique_ptr<ViewTracker> makeTracker(const TreatmentSetup& setup, const ProjectionGeometry& detector, bool paper)
{
  TrackerParameters parameters;
  parameters.detector = detector.name();
  parameters.adopt(setup);
  if (paper)
  {
    // Single pixels at random places, predictors alone, white noise; ranges in pixels.
    parameters.model_by_data = false;
    parameters.tracker.model = MotionModel::TRANSLATION;
    parameters.tracker.points = 600;
    parameters.tracker.bin = 1;
    parameters.tracker.whole_region = false;
    parameters.tracker.background = 0.0;
    parameters.tracker.ranges = { 30.0, 12.0, 4.0, 1.5 };
  }
  parameters.validate();
  return std::make_unique<ViewTracker>(std::make_unique<HyperplaneTracker>(parameters.tracker, setup.intensity),
                                       setup.intensity, parameters.tracker.reduction, parameters.tracker.model,
                                       parameters.model_by_data, parameters.region, parameters.image_size);
}

TrackedView trackedView(const ViewAnswer& answer)
{
  TrackedView view;
  view.state = static_cast<RegionState>(answer.state);
  view.fault = answer.fault;
  view.region = answer.region;
  view.reference_stamp = answer.reference_stamp_ns;
  if (answer.found())
  {
    view.track.model = static_cast<TrackModel>(answer.model);
    view.track.centre = { answer.region.x + (answer.region.width - 1.0) / 2.0,
                          answer.region.y + (answer.region.height - 1.0) / 2.0 };
    view.track.displacement = answer.motion.displacement;
    view.track.linear = answer.motion.linear;
    view.track.covariance = answer.motion.covariance;
  }
  return view;
}
}  // namespace

OfflineRun::OfflineRun(const TreatmentSetup& setup, PoseMethod method, std::shared_ptr<const Registration> registration,
                       int refine_every, bool paper)
  : setup_(setup),
    options_(monitorOptions(setup, method, refine_every, paper)),
    monitor_(options_, setup.room_from_patient, setup.target_box),
    views_(setup.detectors.size()),
    registration_(std::move(registration))
{
  monitor_.tracks().setGeometry(setup.detectors, TargetShape::isotropic(setup.targetCentre()));
  for (std::size_t d = 0; d < views_.size(); ++d)
  {
    views_[d].tracker = makeTracker(setup, setup.detectors[d], paper);
  }
  if (method != PoseMethod::TRACKING)
  {
    sequence_.emplace(setup.targetCentre());
    sequence_->setRegistration(registration_);
  }
}

MotionDecision OfflineRun::add(std::int64_t stamp_ns, const std::vector<cv::Mat>& images)
{
  registration_seconds_ = 0.0;
  TrackedExposure exposure = track(stamp_ns, images);
  const std::int64_t now = exposure.arrival;
  monitor_.onExposure(std::move(exposure), now);
  std::optional<MotionDecision> decision = monitor_.takeDecision();
  while (const std::optional<RefinementRequest> request = monitor_.takeRequest())
  {
    const double start = processorSeconds();
    const RefinementReply reply = registered(*request);
    registration_seconds_ += processorSeconds() - start;
    monitor_.onReply(reply, now);
  }
  if (!decision)
  {
    decision = monitor_.takeDecision();
  }
  while (const std::optional<RegionProposal> proposal = monitor_.takeProposal())
  {
    views_[proposal->view].training = Training{ Training::Kind::REGION, proposal->region };
  }
  return *decision;
}

TrackedExposure OfflineRun::track(std::int64_t stamp_ns, const std::vector<cv::Mat>& images)
{
  TrackedExposure exposure;
  exposure.stamp = stamp_ns;
  exposure.arrival = stamp_ns;
  last_views_.clear();
  for (std::size_t d = 0; d < views_.size(); ++d)
  {
    View& view = views_[d];
    const std::optional<Training> training = std::exchange(view.training, std::nullopt);
    last_views_.push_back(trackedView(view.tracker->answer(images[d], stamp_ns, training)));
    exposure.views.push_back(last_views_.back());
    if (training)
    {
      view.tracker->learn(images[d]);
    }
    if (sequence_)
    {
      view.image = view.pixels.look(images[d], setup_.intensity, stamp_ns);
    }
  }
  return exposure;
}

RefinementReply OfflineRun::registered(const RefinementRequest& request)
{
  RefinementReply reply;
  reply.id = request.id;
  RegistrationRequest registration;
  registration.intensity = setup_.intensity;
  registration.room_from_patient = request.room_from_patient;
  registration.time_budget = std::chrono::duration<double>(kTimeBudget);
  std::vector<std::string> compared;
  for (std::size_t d = 0; d < views_.size(); ++d)
  {
    if (request.without[d])
    {
      continue;
    }
    compared.push_back(setup_.detectors[d].name());
    if (!views_[d].image.fault.empty())
    {
      reply.text = setup_.detectors[d].name() + ": " + views_[d].image.fault;
      return reply;
    }
    registration.views.push_back({ setup_.detectors[d], views_[d].image.image, {}, views_[d].image.usable });
  }
  const RegistrationResult result = sequence_->run(std::move(registration), request.stamp, request.unverified);
  reply.success = result.status == RegistrationStatus::SUCCESS;
  reply.text = result.reason;
  reply.room_from_patient = result.room_from_patient;
  reply.covariance = result.poseCovariance(setup_.targetCentre());
  reply.seed_similarity = result.similarity_before;
  reply.similarity = result.similarity_after;
  reply.pull = result.figures.pull_mm;
  std::vector<double> similarities;
  std::transform(result.views.begin(), result.views.end(), std::back_inserter(similarities),
                 [](const ViewResidual& view) { return view.similarity; });
  reply.view_similarities = ofViews(similarities, compared, options_.tracks.views);
  return reply;
}
}  // namespace xray_tracking
