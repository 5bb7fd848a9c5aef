#include "real_sequences.h"

#include <algorithm>
#include <filesystem>
#include <limits>
#include <map>
#include <stdexcept>

#include "starts.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/volume/ct_content.h"
#include "xray_tracking_core/volume/target_mask.h"

namespace fs = std::filesystem;

namespace xray_tracking
{
namespace
{
constexpr double kRight = 1.0;  // [mm]
constexpr double kRightAngle = 2.0 * kDegree;
constexpr double kLong = 1.8;       // times the next edge: a box of which either end is registered, too
constexpr std::size_t kFewest = 3;  // results of an exposure for a spread

/// How far a sequence's reference can be trusted, as its makers say.
std::string referenceUncertainty(const fs::path& folder)
{
  static const std::map<std::string, std::string> known{
    { "wrist_real", "0.15 mm; 0.5 deg; 2 about the shaft" },
    { "knee_real", "0.18 mm; at most 0.46" },
    { "portal_real", "1 mm; 1 deg" },
  };
  for (const fs::path& part : folder)
  {
    if (const auto found = known.find(part.string()); found != known.end())
    {
      return found->second;
    }
  }
  return "not stated";
}

std::string nameOf(const fs::path& folder)
{
  const std::string parent = folder.parent_path().filename().string();
  return (parent.find("_real") != std::string::npos ? parent + "/" : "") + folder.filename().string();
}

std::vector<fs::path> findSequences(const fs::path& folder)
{
  std::vector<fs::path> found;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder))
  {
    const fs::path parent = entry.path().parent_path();
    if (entry.path().filename() == "sequence.yaml" && parent.string().find("_real") != std::string::npos)
    {
      found.push_back(parent);
    }
  }
  if (found.empty())
  {
    throw std::invalid_argument(folder.string() + ": expected sequence folders called *_real or within one so called");
  }
  std::sort(found.begin(), found.end());
  return found;
}

/// What is nearest to all others, to which outliers do nothing.
RigidTransform medianPose(const std::vector<RigidTransform>& poses, const Eigen::AlignedBox3d& box)
{
  double least = std::numeric_limits<double>::infinity();
  RigidTransform best = poses.front();
  for (const RigidTransform& pose : poses)
  {
    std::vector<double> distances;
    for (const RigidTransform& other : poses)
    {
      distances.push_back(targetRegistrationError(other, pose, box));
    }
    const double median = quantile(distances, 0.5);
    if (median < least)
    {
      least = median;
      best = pose;
    }
  }
  return best;
}

/// Distance of every result from the median pose of its exposure's right ones, median over all [mm].
double spread(const std::map<std::size_t, std::vector<RigidTransform>>& right, const Eigen::AlignedBox3d& box)
{
  std::vector<double> distances;
  for (const auto& [exposure, poses] : right)
  {
    if (poses.size() < kFewest)
    {
      continue;
    }
    const RigidTransform median = medianPose(poses, box);
    for (const RigidTransform& pose : poses)
    {
      distances.push_back(targetRegistrationError(pose, median, box));
    }
  }
  return distances.empty() ? std::numeric_limits<double>::quiet_NaN() : quantile(distances, 0.95);
}

/// One row; exposures of the trials in `index`.
void addRow(FigureTable& table, const std::string& name, const std::string& start, const std::string& reference,
            const std::vector<Trial>& trials, const std::vector<std::size_t>& index, const Eigen::AlignedBox3d& box)
{
  std::vector<double> errors, angles, cpu;
  std::map<std::size_t, std::vector<RigidTransform>> right_poses;
  int right = 0, right_believed = 0, wrong = 0, wrong_believed = 0;
  double worst_believed = 0.0;
  for (std::size_t n = 0; n < trials.size(); ++n)
  {
    const Trial& trial = trials[n];
    errors.push_back(trial.error);
    angles.push_back(trial.angle / kDegree);
    cpu.push_back(trial.cpu_ms);
    wrong += trial.error > kFalseSuccess;
    wrong_believed += trial.error > kFalseSuccess && trial.believed();
    worst_believed = std::max(worst_believed, trial.believed() ? trial.error : 0.0);
    if (trial.error < kRight && trial.angle < kRightAngle)
    {
      ++right;
      right_believed += trial.believed();
      right_poses[index[n]].push_back(trial.result.room_from_patient);
    }
  }
  table.beginRow();
  table.add("sequence", name);
  table.add("start", start);
  table.add("starts", static_cast<double>(trials.size()), 0);
  table.add("error median", quantile(errors, 0.5));
  table.add("p95", quantile(errors, 0.95));
  table.add("max", quantile(errors, 1.0));
  table.add("deg median", quantile(angles, 0.5), 2);
  table.add("reference good to", reference);
  table.add("spread p95", spread(right_poses, box));
  table.add("right %", 100.0 * right / static_cast<double>(trials.size()), 1);
  table.add("of them believed %", 100.0 * right_believed / right, 1);
  table.add("> 1.5 mm", wrong, 0);
  table.add("of them believed", wrong_believed, 0);
  table.add("worst believed", worst_believed);
  table.add("CPU ms", quantile(cpu, 0.5), 1);
}
struct Part
{
  std::string name;
  Eigen::AlignedBox3d box;
};

/// The target's box, and of a long one either end.
std::vector<Part> partsOf(const Eigen::AlignedBox3d& box)
{
  std::vector<Part> parts{ { "", box } };
  int axis = 0;
  box.sizes().maxCoeff(&axis);
  Eigen::Vector3d others = box.sizes();
  others[axis] = 0.0;
  if (box.sizes()[axis] > kLong * others.maxCoeff())
  {
    parts.push_back({ "; low end", box });
    parts.back().box.max()[axis] = box.center()[axis];
    parts.push_back({ "; high end", box });
    parts.back().box.min()[axis] = box.center()[axis];
  }
  return parts;
}

/// From starts of every size, and from the pose of the exposure before.
/// @return poses of the first exposure from near starts
std::vector<RigidTransform> measureSequence(const Subject& subject, const Registration& registration,
                                            const std::string& reference, int starts, FigureTable& table,
                                            std::vector<Trial>& trials)
{
  const auto& gold = subject.exposures.room_from_patient;
  std::vector<RigidTransform> first_poses;
  std::mt19937 random(3);
  const auto finish =
      [&](const std::string& start, const std::vector<Trial>& done, const std::vector<std::size_t>& index)
  {
    addRow(table, subject.name, start, reference, done, index, subject.box());
    trials.insert(trials.end(), done.begin(), done.end());
  };
  for (const auto& [millimetres, degrees] :
       { std::pair(2, 1), std::pair(5, 3), std::pair(10, 5), std::pair(16, 10), std::pair(30, 15) })
  {
    std::vector<Twist> twists;
    std::vector<std::size_t> index;
    for (int n = 0; n < starts; ++n)
    {
      twists.push_back(randomTwist(random, degrees * kDegree, millimetres));
      index.push_back(n % gold.size());
    }
    const std::string start = std::to_string(millimetres) + " mm; " + std::to_string(degrees) + " degrees";
    const std::vector<Trial> done = registerAll(subject, registration, twists, 0, start);
    finish(start, done, index);
    for (std::size_t n = 0; n < done.size() && millimetres <= 5; n += gold.size())
    {
      first_poses.push_back(done[n].result.room_from_patient);
    }
  }
  if (gold.size() > 1)
  {
    const std::string start = "the exposure before";
    std::vector<Trial> done;
    std::vector<std::size_t> index;
    for (std::size_t k = 1; k < gold.size(); ++k)
    {
      done.push_back(
          tryRegistration(registration, requestFor(subject.exposures, k, gold[k - 1]), gold[k], subject.box()));
      done.back().subject = subject.name;
      done.back().kind = start;
      index.push_back(k);
    }
    finish(start, done, index);
  }
  return first_poses;
}
}  // namespace

std::vector<FigureTable> measureRealSequences(const std::string& folder, const RegistrationOptions& options, int starts,
                                              std::vector<Trial>& trials)
{
  FigureTable table("real sequences; right: within 1 mm and 2 degrees of the reference");
  FigureTable agreement("agreement of folders that show the same thing, medians of their first exposures [mm]");
  std::map<fs::path, std::vector<std::pair<std::string, RigidTransform>>> alike;  // by CT
  for (const fs::path& path : findSequences(folder))
  {
    Subject subject = sequenceSubject(path.string());
    const Eigen::AlignedBox3d whole = subject.box();
    for (const Part& part : partsOf(whole))
    {
      subject.name = nameOf(path) + part.name;
      subject.exposures.setup.target_box = part.box;
      const Registration registration(bodiesOf(subject.ct, targetMaskOf(subject.ct, part.box)), part.box, options);
      const std::vector<RigidTransform> poses =
          measureSequence(subject, registration, referenceUncertainty(path), starts, table, trials);
      if (!part.name.empty())
      {
        continue;
      }
      const RigidTransform pose = medianPose(poses, whole);
      auto& others = alike[fs::canonical(subject.exposures.setup.ct_path)];
      for (const auto& [other, other_pose] : others)
      {
        agreement.beginRow();
        agreement.add("folder", subject.name);
        agreement.add("and", other);
        agreement.add("apart", targetRegistrationError(pose, other_pose, whole));
      }
      others.emplace_back(subject.name, pose);
    }
  }
  return { table, agreement };
}
}  // namespace xray_tracking
