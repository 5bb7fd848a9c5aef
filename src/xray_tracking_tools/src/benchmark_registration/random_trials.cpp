#include "random_trials.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include <opencv2/imgproc.hpp>

#include "random_room.h"
#include "random_subject.h"
#include "starts.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_tools/command_line.h"

namespace xray_tracking
{
namespace
{
constexpr double kRight = 1.0;  // [mm]
/// Between two exposures, along what both of two views see. What only one view sees of a motion cannot be found to
/// contradict the other view; nor a smaller one, as a pose between both is wrong for neither [mm].
constexpr double kContradiction = 2.0 * kFalseSuccess;

enum class Wrong
{
  FAR,
  NEXT_VERTEBRA,
  TURNED,
  UPSIDE_DOWN,
  MIRRORED,
  EXCHANGED,
  OTHER_EXPOSURE,
  OTHER_CT
};

constexpr std::array<const char*, 8> kWrongNames{ "far",      "next vertebra", "turned",         "upside down",
                                                  "mirrored", "exchanged",     "other exposure", "other CT" };

class SubjectTrials
{
public:
  SubjectTrials(const Scans& scans, int seed, std::vector<Trial>& trials)
    : scans_(scans), random_(static_cast<unsigned>(seed)), trials_(trials), subject_(randomSubject(random_, scans))
  {
    name_ = std::to_string(seed) + " " + subject_.anatomy.name;
    registration_.emplace(bodiesOf(subject_.anatomy), box());
  }

  void run()
  {
    for (int n = 0; n < 6; ++n)
    {
      const double distance = between(random_, 0.0, n < 3 ? 4.0 : 16.0);
      const double angle = between(random_, 0.0, n < 3 ? 2.0 : 10.0) * kDegree;
      const std::size_t exposure = n % 2;
      add("right", *registration_, request(exposure, randomTwist(random_, angle, distance)), gold(exposure));
    }
    for (int n = 0; n < 4; ++n)
    {
      addWrong(static_cast<Wrong>(random_() % kWrongNames.size()));
    }
  }

private:
  const Eigen::AlignedBox3d& box() const { return subject_.anatomy.box; }
  const RigidTransform& gold(std::size_t exposure) const { return subject_.exposures.room_from_patient[exposure]; }

  RegistrationRequest request(std::size_t exposure, const Twist& offset)
  {
    return requestFor(subject_.exposures, exposure,
                      motionAbout(gold(exposure) * box().center(), offset) * gold(exposure));
  }

  void add(const std::string& kind, const Registration& registration, const RegistrationRequest& request,
           const RigidTransform& gold, bool nothing_right = false)
  {
    try
    {
      Trial trial = tryRegistration(registration, request, gold, box());
      trial.subject = name_;
      trial.kind = kind;
      trial.error = nothing_right ? std::numeric_limits<double>::infinity() : trial.error;
      trials_.push_back(std::move(trial));
    }
    catch (const std::runtime_error&)
    {
      // Refused as INVALID, such as a start out of every image: nothing that could be believed.
    }
  }

  void addWrong(Wrong what)
  {
    if (subject_.anatomy.symmetric && (what == Wrong::UPSIDE_DOWN || what == Wrong::MIRRORED))
    {
      return;
    }
    const std::string kind = kWrongNames[static_cast<std::size_t>(what)];
    const Twist little = randomTwist(random_, between(random_, 0.0, 5.0) * kDegree, between(random_, 0.0, 6.0));
    RegistrationRequest wrong = request(0, little);
    RigidTransform& start = wrong.room_from_patient;
    const auto turned = [&](const Eigen::Vector3d& axis, double angle)
    {
      Twist twist = Twist::Zero();
      twist.head<3>() = angle * axis;
      return motionAbout(box().center(), twist);
    };
    switch (what)
    {
      case Wrong::FAR:
        start = motionAbout(gold(0) * box().center(),
                            randomTwist(random_, between(random_, 0.0, 0.3), between(random_, 20.0, 60.0))) *
                gold(0);
        break;
      case Wrong::NEXT_VERTEBRA:
        start = start * Eigen::Translation3d(0.0, between(random_, -3.0, 3.0),
                                             (random_() % 2 == 0 ? 1.0 : -1.0) * between(random_, 14.0, 32.0));
        break;
      case Wrong::TURNED:
        start = start * turned(randomDirection(random_), between(random_, 10.0, 180.0) * kDegree);
        break;
      case Wrong::UPSIDE_DOWN:
        start = start * turned(random_() % 2 == 0 ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitX(), EIGEN_PI);
        break;
      case Wrong::MIRRORED:
        for (RegistrationView& view : wrong.views)
        {
          cv::Mat mirrored;
          cv::flip(view.image, mirrored, 1);
          view.image = mirrored;
        }
        break;
      case Wrong::EXCHANGED:
        if (wrong.views.size() < 2)
        {
          return;
        }
        std::swap(wrong.views[0].image, wrong.views[1].image);
        break;
      case Wrong::OTHER_EXPOSURE:
        if (wrong.views.size() < 2 || sharedMotion() < kContradiction)
        {
          return;
        }
        wrong.views[1].image = subject_.exposures.images[1][1];
        break;
      case Wrong::OTHER_CT:
        addOtherCt(kind, wrong);
        return;
    }
    add(kind, *registration_, wrong, gold(0), what == Wrong::OTHER_EXPOSURE);
  }

  /// Of the target from one exposure to the other, along what the first two views both see [mm].
  double sharedMotion() const
  {
    const auto& detectors = subject_.exposures.setup.detectors;
    const Eigen::Vector3d centre = gold(0) * box().center();
    const Eigen::Vector3d both = (centre - detectors[0].source()).cross(centre - detectors[1].source()).normalized();
    return std::abs(both.dot(gold(1) * box().center() - centre));
  }

  void addOtherCt(const std::string& kind, RegistrationRequest& request)
  {
    const RandomAnatomy other = randomAnatomy(random_, scans_, false);
    // Another part of the same body may rightly be found.
    const auto body = [](const std::string& name) { return name.substr(0, name.find_first_of(" ;")); };
    if (body(other.name) == body(subject_.anatomy.name))
    {
      return;
    }
    const Registration registration(bodiesOf(other), other.box);
    request.room_from_patient = request.room_from_patient * Eigen::Translation3d(box().center() - other.box.center());
    add(kind, registration, request, gold(0), true);
  }

  const Scans& scans_;
  std::mt19937 random_;
  std::vector<Trial>& trials_;
  RandomSubject subject_;
  std::string name_;
  std::optional<Registration> registration_;
};

void addRow(FigureTable& table, const std::string& name, const std::vector<const Trial*>& trials)
{
  int right = 0, right_believed = 0, wrong = 0, wrong_believed = 0;
  std::vector<double> errors, cpu;
  for (const Trial* trial : trials)
  {
    right += trial->error < kRight;
    right_believed += trial->error < kRight && trial->believed();
    wrong += trial->error > kFalseSuccess;
    wrong_believed += trial->error > kFalseSuccess && trial->believed();
    cpu.push_back(trial->cpu_ms);
    if (trial->error < kFalseSuccess)
    {
      errors.push_back(trial->error);
    }
  }
  table.beginRow();
  table.add("of", name);
  table.add("registrations", static_cast<double>(trials.size()), 0);
  table.add("below 1 mm", right, 0);
  table.add("of them believed %", 100.0 * right_believed / right, 1);
  table.add("above 1.5 mm", wrong, 0);
  table.add("of them believed", wrong_believed, 0);
  table.add("TRE of the others", errors.empty() ? std::numeric_limits<double>::quiet_NaN() : quantile(errors, 0.5));
  table.add("CPU ms", quantile(cpu, 0.5), 1);
  table.add("CPU p95", quantile(cpu, 0.95), 1);
}
}  // namespace

std::vector<FigureTable> measureRandomSubjects(const std::string& folder, int seed, int subjects,
                                               std::vector<Trial>& trials)
{
  requireAtLeast("subjects", subjects, 1);
  const Scans scans(folder);
  Progress progress("subject");
  for (int n = 0; n < subjects; ++n)
  {
    SubjectTrials(scans, seed + n, trials).run();
    progress(n + 1, subjects);
  }
  std::map<std::string, std::vector<const Trial*>> by_kind, by_anatomy;
  for (const Trial& trial : trials)
  {
    by_kind[trial.kind].push_back(&trial);
    by_anatomy[trial.subject.substr(trial.subject.find(' ') + 1)].push_back(&trial);
  }
  FigureTable starts("by start"), anatomies("by anatomy");
  for (const auto& [name, some] : by_kind)
  {
    addRow(starts, name, some);
  }
  for (const auto& [name, some] : by_anatomy)
  {
    addRow(anatomies, name, some);
  }
  return { starts, anatomies };
}
}  // namespace xray_tracking
