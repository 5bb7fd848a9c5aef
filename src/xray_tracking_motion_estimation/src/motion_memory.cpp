#include "xray_tracking_motion_estimation/motion_memory.h"

#include <cmath>
#include <stdexcept>

#include <Eigen/Eigenvalues>
#include <nlohmann/json.hpp>

namespace xray_tracking
{
namespace
{
using nlohmann::json;

/// Of what stands in the file in decimals, beside what camera_info and tf say anew.
constexpr double kRounding = 1e-9;

template <typename Derived>
json jsonOf(const Eigen::MatrixBase<Derived>& matrix)
{
  json numbers = json::array();
  for (Eigen::Index i = 0; i < matrix.rows(); ++i)
  {
    for (Eigen::Index j = 0; j < matrix.cols(); ++j)
    {
      numbers.push_back(matrix(i, j));
    }
  }
  return numbers;
}

json jsonOf(const RigidTransform& pose)
{
  return jsonOf(pose.matrix().topRows<3>());
}

template <typename Matrix>
Matrix matrixFrom(const json& numbers, const char* name)
{
  Matrix matrix;
  if (!numbers.is_array() || numbers.size() != static_cast<std::size_t>(matrix.size()))
  {
    throw std::invalid_argument(std::string(name) + " has " + std::to_string(numbers.size()) + " numbers, expected " +
                                std::to_string(matrix.size()));
  }
  for (Eigen::Index i = 0; i < matrix.size(); ++i)
  {
    // Row by row.
    matrix(i / matrix.cols(), i % matrix.cols()) = numbers[static_cast<std::size_t>(i)].get<double>();
  }
  if (!matrix.allFinite())
  {
    throw std::invalid_argument(std::string(name) + " is not finite");
  }
  return matrix;
}

RigidTransform poseFrom(const json& numbers, const char* name)
{
  RigidTransform pose = RigidTransform::Identity();
  pose.matrix().topRows<3>() = matrixFrom<Eigen::Matrix<double, 3, 4>>(numbers, name);
  if (!isRigid(pose))
  {
    throw std::invalid_argument(std::string(name) + " is no rotation and translation");
  }
  return pose;
}

Matrix6d covarianceFrom(const json& numbers, const char* name)
{
  const Matrix6d covariance = matrixFrom<Matrix6d>(numbers, name);
  const double least = Eigen::SelfAdjointEigenSolver<Matrix6d>(covariance, Eigen::EigenvaluesOnly).eigenvalues()[0];
  if (!covariance.isApprox(covariance.transpose(), kRounding) || least < -kRounding * covariance.norm())
  {
    throw std::invalid_argument(std::string(name) + " is no covariance: not symmetric, or negative");
  }
  return covariance;
}

json jsonOf(const Track& track)
{
  return { { "model", static_cast<int>(track.model) },
           { "centre", jsonOf(track.centre) },
           { "displacement", jsonOf(track.displacement) },
           { "linear", jsonOf(track.linear) },
           { "covariance", jsonOf(track.covariance) } };
}

Track trackFrom(const json& from)
{
  Track track;
  const int model = from.at("model").get<int>();
  if (model != 2 && model != 3 && model != 4 && model != 6)
  {
    throw std::invalid_argument("model is " + std::to_string(model) + ", expected 2, 3, 4 or 6 parameters");
  }
  track.model = static_cast<TrackModel>(model);
  track.centre = matrixFrom<Eigen::Vector2d>(from.at("centre"), "centre");
  track.displacement = matrixFrom<Eigen::Vector2d>(from.at("displacement"), "displacement");
  track.linear = matrixFrom<Eigen::Matrix2d>(from.at("linear"), "linear");
  track.covariance = covarianceFrom(from.at("covariance"), "covariance");
  if (!(track.linear.determinant() > 0.0))
  {
    throw std::invalid_argument("linear mirrors the region, or leaves nothing of it");
  }
  return track;
}

json jsonOf(const ViewReference& reference)
{
  const cv::Rect& region = reference.region;
  return { { "template_stamp", reference.template_stamp },
           { "region", { region.x, region.y, region.width, region.height } },
           { "learnt_at", jsonOf(reference.learnt_at) },
           { "room_from_patient", jsonOf(reference.room_from_patient) },
           { "anchor", reference.anchor ? jsonOf(*reference.anchor) : json() },
           { "anchor_stamp", reference.anchor_stamp },
           { "registered", reference.registered } };
}

ViewReference referenceFrom(const json& from)
{
  const json& region = from.at("region");
  ViewReference reference;
  reference.template_stamp = from.at("template_stamp").get<std::int64_t>();
  reference.region = { region.at(0).get<int>(), region.at(1).get<int>(), region.at(2).get<int>(),
                       region.at(3).get<int>() };
  reference.learnt_at = poseFrom(from.at("learnt_at"), "learnt_at");
  reference.room_from_patient = poseFrom(from.at("room_from_patient"), "room_from_patient");
  if (!from.at("anchor").is_null())
  {
    reference.anchor = trackFrom(from.at("anchor"));
  }
  reference.anchor_stamp = from.at("anchor_stamp").get<std::int64_t>();
  reference.registered = from.at("registered").get<bool>();
  return reference;
}

json jsonOf(const std::optional<std::int64_t>& stamp)
{
  return stamp ? json(*stamp) : json();
}

std::optional<std::int64_t> stampFrom(const json& from)
{
  return from.is_null() ? std::nullopt : std::make_optional(from.get<std::int64_t>());
}

json jsonOf(const ViewSight& sight)
{
  return { { "usual", sight.usual ? json(*sight.usual) : json() },
           { "hidden", sight.hidden },
           { "template_stamp", jsonOf(sight.template_stamp) },
           { "template_hidden", sight.template_hidden },
           { "stated", jsonOf(sight.stated) } };
}

ViewSight sightFrom(const json& from)
{
  ViewSight sight;
  if (!from.at("usual").is_null())
  {
    sight.usual = from.at("usual").get<double>();
    if (!(std::abs(*sight.usual) <= 1.0))
    {
      throw std::invalid_argument("usual is " + std::to_string(*sight.usual) + ", expected a similarity of -1 to 1");
    }
  }
  sight.hidden = from.at("hidden").get<bool>();
  sight.template_stamp = stampFrom(from.at("template_stamp"));
  sight.template_hidden = from.at("template_hidden").get<bool>();
  sight.stated = stampFrom(from.at("stated"));
  return sight;
}

json jsonOf(const MotionMemory& motion)
{
  json sights = json::array();
  for (const ViewSight& sight : motion.sights)
  {
    sights.push_back(jsonOf(sight));
  }
  json references = json::array();
  for (const std::optional<ViewReference>& reference : motion.references)
  {
    references.push_back(reference ? jsonOf(*reference) : json());
  }
  return { { "references", references },
           { "sights", sights },
           { "reference", jsonOf(motion.reference) },
           { "reference_covariance", jsonOf(motion.reference_covariance) },
           { "last_stamp", motion.last_stamp },
           { "last_pose", jsonOf(motion.last_pose) },
           { "doubt", motion.doubt } };
}

MotionMemory motionFrom(const json& from)
{
  MotionMemory motion;
  for (const json& reference : from.at("references"))
  {
    motion.references.push_back(reference.is_null() ? std::nullopt : std::make_optional(referenceFrom(reference)));
  }
  for (const json& sight : from.at("sights"))
  {
    motion.sights.push_back(sightFrom(sight));
  }
  motion.reference = poseFrom(from.at("reference"), "reference");
  motion.reference_covariance = covarianceFrom(from.at("reference_covariance"), "reference_covariance");
  motion.last_stamp = from.at("last_stamp").get<std::int64_t>();
  motion.last_pose = poseFrom(from.at("last_pose"), "last_pose");
  motion.doubt = from.at("doubt").get<std::string>();
  return motion;
}

json jsonOf(const DetectorDescription& detector)
{
  return { { "name", detector.name },
           { "image_size", { detector.image_size.x(), detector.image_size.y() } },
           { "pixel_pitch", jsonOf(detector.pixel_pitch) },
           { "source", jsonOf(detector.source) },
           { "origin", jsonOf(detector.origin) },
           { "x_direction", jsonOf(detector.x_direction) },
           { "y_direction", jsonOf(detector.y_direction) } };
}

DetectorDescription detectorFrom(const json& from)
{
  const json& size = from.at("image_size");
  return { from.at("name").get<std::string>(),
           { size.at(0).get<int>(), size.at(1).get<int>() },
           matrixFrom<Eigen::Vector2d>(from.at("pixel_pitch"), "pixel_pitch"),
           matrixFrom<Eigen::Vector3d>(from.at("source"), "source"),
           matrixFrom<Eigen::Vector3d>(from.at("origin"), "origin"),
           matrixFrom<Eigen::Vector3d>(from.at("x_direction"), "x_direction"),
           matrixFrom<Eigen::Vector3d>(from.at("y_direction"), "y_direction") };
}
}  // namespace

std::string textOf(const RunMemory& memory)
{
  json detectors = json::array();
  for (const DetectorDescription& detector : memory.detectors)
  {
    detectors.push_back(jsonOf(detector));
  }
  const json all = { { "detectors", detectors },
                     { "motion", memory.motion ? jsonOf(*memory.motion) : json() },
                     { "hold", memory.hold },
                     { "operator_present", memory.operator_present } };
  return all.dump(1, ' ', false, json::error_handler_t::replace);
}

RunMemory runMemoryFrom(const std::string& text)
{
  try
  {
    const json all = json::parse(text);
    RunMemory memory;
    for (const json& detector : all.at("detectors"))
    {
      memory.detectors.push_back(detectorFrom(detector));
    }
    if (!all.at("motion").is_null())
    {
      memory.motion = motionFrom(all.at("motion"));
      if (memory.motion->references.size() != memory.detectors.size() ||
          memory.motion->sights.size() != memory.detectors.size())
      {
        throw std::invalid_argument("references are of " + std::to_string(memory.motion->references.size()) +
                                    " views, sights of " + std::to_string(memory.motion->sights.size()) +
                                    ", expected one a detector");
      }
    }
    memory.hold = all.at("hold").get<std::string>();
    memory.operator_present = all.at("operator_present").get<bool>();
    return memory;
  }
  catch (const json::exception& error)
  {
    throw std::invalid_argument(error.what());
  }
}

std::string difference(const std::vector<DetectorDescription>& then, const std::vector<ProjectionGeometry>& now)
{
  if (then.size() != now.size())
  {
    return "there are " + std::to_string(now.size()) + " detectors, there were " + std::to_string(then.size());
  }
  for (std::size_t i = 0; i < then.size(); ++i)
  {
    const DetectorDescription& was = then[i];
    const DetectorDescription& is = now[i].description();
    if (is.name != was.name)
    {
      return "a detector is " + is.name + ", it was " + was.name;
    }
    if (is.image_size != was.image_size || !is.pixel_pitch.isApprox(was.pixel_pitch, kRounding) ||
        !is.source.isApprox(was.source, kRounding) || !is.origin.isApprox(was.origin, kRounding) ||
        !is.x_direction.isApprox(was.x_direction, kRounding) || !is.y_direction.isApprox(was.y_direction, kRounding))
    {
      return is.name + " stands or projects differently than it did";
    }
  }
  return std::string();
}
}  // namespace xray_tracking
