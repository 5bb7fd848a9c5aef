#include "treatment_commands.h"

#include <sstream>
#include <utility>
#include <vector>

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::BeamGate;
using xray_tracking_msgs::RefinementResult;

constexpr std::int64_t kSecond = 1000000000;
/// A registration that is at another request is asked again for so long [ns].
constexpr std::int64_t kBusy = 3 * kSecond;
constexpr std::int64_t kHoldAgain = kSecond / 2;  ///< after which a hold that is not confirmed is asked for again [ns]

const char* statusWords(std::uint8_t status)
{
  static const char* const kWords[] = { "believed",    "not believed", "ran out of time",  "cancelled",
                                        "bad request", "no CT loaded", "no such exposure", "busy" };
  return status < 8 ? kWords[status] : "unknown status";
}
}  // namespace

TreatmentCommands::TreatmentCommands(const ros::NodeHandle& nh, LastPose last_pose)
  : nh_(nh), last_pose_(std::move(last_pose))
{
  hold_ = std::make_unique<ServiceCaller<std_srvs::SetBool>>(
      nh_, "motion_estimation/hold_beam",
      [this](const std::optional<std_srvs::SetBool::Response>& response, const std::string& why)
      { holdAnswered(response && response->success, response ? response->message : why); });
  restart_ = std::make_unique<ServiceCaller<Trigger>>(
      nh_, "motion_estimation/restart",
      [this](const std::optional<Trigger::Response>& response, const std::string& why)
      { end(Command::RESET, response && response->success, response ? response->message : why); });
  refine_next_ = std::make_unique<ServiceCaller<Trigger>>(
      nh_, "motion_estimation/refine", [](const std::optional<Trigger::Response>&, const std::string&) {});
  load_volume_ = std::make_unique<ServiceCaller<xray_tracking_msgs::LoadVolume>>(
      nh_, "registration/load_volume",
      [this](const std::optional<xray_tracking_msgs::LoadVolume::Response>& response, const std::string& why)
      { end(Command::LOAD_CT, response && response->success, response ? response->message : why); });
}

TreatmentCommands::~TreatmentCommands()
{
  for (auto& [name, tracker] : trackers_)
  {
    tracker.retrain->shutdown();
    tracker.reset->shutdown();
  }
  hold_->shutdown();
  restart_->shutdown();
  refine_next_->shutdown();
  load_volume_->shutdown();
  refiner_.reset();
}

std::array<CommandState, kCommands> TreatmentCommands::states() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return commands_;
}

bool TreatmentCommands::registrationIsThere() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return registration_;
}

void TreatmentCommands::gateSaid(const BeamGate& gate)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  // Before it is answered, the gate may be held by what a release that is under way ends.
  if (hold_asked_ && hold_answered_ && *hold_asked_ == (gate.reason == BeamGate::HELD))
  {
    hold_asked_.reset();
  }
}

void TreatmentCommands::addTracker(const std::string& detector)
{
  const auto caller = [&](Command which, const char* service)
  {
    return std::make_unique<ServiceCaller<Trigger>>(
        nh_, detector + service,
        [this, which, detector](const std::optional<Trigger::Response>& response, const std::string& why)
        { trackerAnswered(which, detector, response, why); });
  };
  Tracker tracker{ caller(Command::TRAIN, "/retrain"), caller(Command::RESET, "/reset") };
  const std::lock_guard<std::mutex> lock(mutex_);
  trackers_.emplace(detector, std::move(tracker));
}

std::string TreatmentCommands::missing(const std::vector<std::string>& services) const
{
  std::string names;
  for (const std::string& service : services)
  {
    if (!ros::service::exists(nh_.resolveName(service), false))
    {
      names += (names.empty() ? "no service " : ", ") + service;
    }
  }
  return names;
}

std::array<std::string, kCommands> TreatmentCommands::wants() const
{
  std::vector<std::string> retrain, reset{ "motion_estimation/restart" };
  for (const auto& [name, tracker] : trackers_)  // only this thread adds to them
  {
    retrain.push_back(name + "/retrain");
    reset.push_back(name + "/reset");
  }
  std::array<std::string, kCommands> wants;
  wants[static_cast<std::size_t>(Command::HOLD)] = missing({ "motion_estimation/hold_beam" });
  wants[static_cast<std::size_t>(Command::TRAIN)] = retrain.empty() ? "no tracker is running" : missing(retrain);
  wants[static_cast<std::size_t>(Command::RESET)] = missing(reset);
  wants[static_cast<std::size_t>(Command::LOAD_CT)] = missing({ "registration/load_volume" });
  const bool registration = wants[static_cast<std::size_t>(Command::LOAD_CT)].empty();
  wants[static_cast<std::size_t>(Command::REFINE)] =
      refiner_ && refiner_->isServerConnected() && registration ? "" : "the registration is not running";
  return wants;
}

void TreatmentCommands::look()
{
  if (!refiner_ && ros::Time::isValid())
  {
    auto made = std::make_unique<Client>(nh_, "registration/refine_pose", false);
    const std::lock_guard<std::mutex> lock(mutex_);
    refiner_ = std::move(made);
  }
  const std::array<std::string, kCommands> wants = this->wants();
  const std::lock_guard<std::mutex> lock(mutex_);
  registration_ = wants[static_cast<std::size_t>(Command::LOAD_CT)].empty();
  if (command(Command::REFINE).busy && !wants[static_cast<std::size_t>(Command::REFINE)].empty())
  {
    command(Command::REFINE).busy = send_again_ = false;  // nobody will answer
    command(Command::REFINE).failed = true;
  }
  for (std::size_t i = 0; i < kCommands; ++i)
  {
    CommandState& state = commands_[i];
    const bool told = !state.offered && !state.failed && !state.busy;  // what is missing
    state.offered = wants[i].empty();
    if (!state.offered && !state.busy)
    {
      state.text = wants[i];
    }
    else if (told)
    {
      state.text.clear();
    }
  }
}

bool TreatmentCommands::holdIsConfirmed()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!hold_asked_.value_or(false))
  {
    return true;
  }
  // Until it is confirmed: motion estimation may only be starting.
  if (!command(Command::HOLD).busy && steadyNanoseconds() - hold_tried_ > kHoldAgain)
  {
    callHold(true);
  }
  return false;
}

void TreatmentCommands::refineAgain()
{
  bool again = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    again = std::exchange(send_again_, false);
  }
  if (again)
  {
    sendGoal();
  }
}

void TreatmentCommands::begin(Command which, const std::string& text)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  CommandState& state = command(which);
  state.busy = true;
  state.failed = false;
  state.text = text;
}

void TreatmentCommands::end(Command which, bool success, const std::string& text)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  CommandState& state = command(which);
  state.busy = false;
  state.failed = !success;
  state.text = text;
  if (which == Command::HOLD && !success && hold_asked_ == false)
  {
    hold_asked_.reset();
  }
}

void TreatmentCommands::hold(bool on)
{
  begin(Command::HOLD, on ? "holding ..." : "releasing ...");
  bool called = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    hold_asked_ = on;
    hold_answered_ = false;
    called = callHold(on);
  }
  if (!called)
  {
    end(Command::HOLD, false, "motion_estimation does not answer an earlier call");
  }
}

bool TreatmentCommands::callHold(bool on)
{
  hold_tried_ = steadyNanoseconds();
  std_srvs::SetBool::Request request;
  request.data = static_cast<std::uint8_t>(on);
  const bool called = hold_->call(request);
  hold_called_ = called ? on : hold_called_;
  return called;
}

void TreatmentCommands::holdAnswered(bool success, const std::string& text)
{
  end(Command::HOLD, success, text);
  const std::lock_guard<std::mutex> lock(mutex_);
  if (hold_asked_ && *hold_asked_ != hold_called_)
  {
    hold_tried_ = 0;  // what was asked for meanwhile is due
  }
  else
  {
    hold_answered_ = success;
  }
}

void TreatmentCommands::askTrackers(Command which)
{
  std::vector<ServiceCaller<Trigger>*> callers;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (command(which).busy)
    {
      return;
    }
    for (const auto& [name, tracker] : trackers_)
    {
      callers.push_back(which == Command::TRAIN ? tracker.retrain.get() : tracker.reset.get());
    }
    rounds_[static_cast<std::size_t>(which)] = { static_cast<int>(callers.size()), "" };
  }
  begin(which, which == Command::TRAIN ? "learning the templates at the next exposure ..." : "resetting ...");
  if (callers.empty())
  {
    end(which, false, "no tracker is running");
  }
  for (ServiceCaller<Trigger>* caller : callers)
  {
    if (!caller->call(Trigger::Request()))
    {
      trackerAnswered(which, "a tracker", std::nullopt, "does not answer an earlier call");
    }
  }
}

void TreatmentCommands::trackerAnswered(Command which, const std::string& detector,
                                        const std::optional<Trigger::Response>& response, const std::string& why)
{
  std::string faults;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    Round& round = rounds_[static_cast<std::size_t>(which)];
    if (!response || !response->success)
    {
      round.faults += (round.faults.empty() ? "" : "; ") + detector + ": " + (response ? response->message : why);
    }
    if (--round.waiting_for > 0)
    {
      return;
    }
    faults = round.faults;
  }
  if (which == Command::RESET && faults.empty())
  {
    // After the templates: those that motion estimation does not know of would be doubted.
    if (restart_->call(Trigger::Request()))
    {
      return;
    }
    faults = "motion_estimation does not answer an earlier call";
  }
  end(which, faults.empty(), faults.empty() ? "all templates are learnt" : faults);
}

void TreatmentCommands::train()
{
  askTrackers(Command::TRAIN);
}

void TreatmentCommands::reset()
{
  askTrackers(Command::RESET);
}

void TreatmentCommands::loadCt(const std::string& path)
{
  begin(Command::LOAD_CT, "loading " + path + " ...");
  xray_tracking_msgs::LoadVolume::Request request;
  request.path = path;
  if (!load_volume_->call(request))
  {
    end(Command::LOAD_CT, false, "the registration is still loading another CT");
  }
}

void TreatmentCommands::refine()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (command(Command::REFINE).busy)
    {
      return;
    }
    refine_began_ = steadyNanoseconds();
  }
  Client* const client = refiner();
  if (client == nullptr || !client->isServerConnected())
  {
    end(Command::REFINE, false, "the registration is not running");
    return;
  }
  begin(Command::REFINE, "asked ...");
  sendGoal();
}

void TreatmentCommands::sendGoal()
{
  const std::optional<geometry_msgs::Pose> pose = last_pose_();
  xray_tracking_msgs::RefinePoseGoal goal;
  goal.request.seed.orientation.w = 1.0;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!command(Command::REFINE).busy)
    {
      return;  // cancelled meanwhile
    }
    if (!pose)
    {
      CommandState& state = command(Command::REFINE);
      state.busy = false;
      state.failed = true;
      state.text = "nothing on patient_pose to start from so far: reset, or align by hand";
      return;
    }
    goal.request.seed = *pose;
  }
  refiner()->sendGoal(
      goal,
      [this](const actionlib::SimpleClientGoalState& state, const xray_tracking_msgs::RefinePoseResultConstPtr& result)
      { refineDone(state, result); },
      Client::SimpleActiveCallback(),
      [this](const xray_tracking_msgs::RefinePoseFeedbackConstPtr& feedback)
      {
        std::ostringstream text;
        text.precision(2);
        text << "level " << feedback->level + 1 << ", step " << feedback->iteration << ", similarity " << std::fixed
             << feedback->similarity;
        const std::lock_guard<std::mutex> lock(mutex_);
        if (command(Command::REFINE).busy)
        {
          command(Command::REFINE).text = text.str();
        }
      });
}

void TreatmentCommands::refineDone(const actionlib::SimpleClientGoalState& state,
                                   const xray_tracking_msgs::RefinePoseResultConstPtr& result)
{
  if (!result)
  {
    end(Command::REFINE, false, "the registration gave no result: " + state.getText());
    return;
  }
  const RefinementResult& found = result->result;
  if (found.status == RefinementResult::BUSY)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (steadyNanoseconds() - refine_began_ < kBusy)
    {
      command(Command::REFINE).text = "waiting for the registration, which is at an earlier exposure ...";
      send_again_ = true;
      return;
    }
  }
  std::ostringstream text;
  text.precision(2);
  text << std::fixed << statusWords(found.status);
  if (found.status <= RefinementResult::CANCELLED)
  {
    text << ", probability " << found.probability << ", similarity " << found.similarity_after << ", "
         << found.time.toSec() << " s";
  }
  if (found.status != RefinementResult::SUCCESS)
  {
    text << ": " << found.reason;
  }
  else
  {
    refine_next_->call(Trigger::Request());
  }
  end(Command::REFINE, found.status == RefinementResult::SUCCESS, text.str());
}

void TreatmentCommands::cancelRefinement()
{
  bool waiting = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    waiting = std::exchange(send_again_, false);
    if (!command(Command::REFINE).busy)
    {
      return;
    }
  }
  if (waiting)
  {
    end(Command::REFINE, false, "cancelled");
    return;
  }
  refiner()->cancelGoal();
}
}  // namespace xray_tracking
