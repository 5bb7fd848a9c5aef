#include "subject.h"

#include <map>
#include <stdexcept>

#include "starts.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_detector_simulator/anatomy.h"
#include "xray_tracking_detector_simulator/image_formation.h"
#include "xray_tracking_tools/command_line.h"

namespace xray_tracking
{
Subject sequenceSubject(const std::string& path)
{
  Subject subject;
  subject.name = path;
  subject.exposures = loadExposureSet(path);
  const TreatmentSetup& setup = subject.exposures.setup;
  if (setup.ct_path.empty() || subject.exposures.room_from_patient.empty())
  {
    throw std::invalid_argument(path + ": expected a sequence with a CT and a gold standard");
  }
  subject.ct = readPatientCt(setup.ct_path, setup.ct_content, setup.ct_choice);
  return subject;
}

Eigen::AlignedBox3d phantomBox(const std::string& vertebra)
{
  const Eigen::AlignedBox3d c4 = NeckPhantom().targetBox();
  const std::map<std::string, std::pair<double, double>> places{
    { "c3", { 0.0, 16.0 } }, { "c4", { 0.0, 0.0 } }, { "c5", { 2.5, -18.0 } }, { "c6", { 5.5, -35.0 } }
  };
  const auto place = places.find(vertebra);
  if (place == places.end())
  {
    throw std::invalid_argument("target is " + vertebra + ", expected c3, c4, c5 or c6");
  }
  const Eigen::Vector3d shift(0.0, place->second.first, place->second.second);
  return { c4.min() + shift, c4.max() + shift };
}

CtVolume phantomCt(double voxel, double slice)
{
  PhantomCtOptions scan;
  const Eigen::Vector3d extent = scan.size.cast<double>().cwiseProduct(scan.spacing);
  scan.slice_thickness = slice;
  scan.spacing = { voxel, voxel, slice };
  scan.size = extent.cwiseQuotient(scan.spacing).cast<int>();
  return NeckPhantom().sampleCt(scan);
}

Subject phantomSubject(int count, const PhantomCase& what)
{
  Subject subject;
  subject.name = "phantom, " + what.target + ", " + what.room;
  subject.ct = { phantomCt(what.voxel, 1.25 * what.voxel), CtContent::FULL };
  ExposureSet& exposures = subject.exposures;
  exposures.setup = loadTreatmentSetup(coreConfigPath("phantom_neck.yaml"));
  exposures.setup.detectors = loadDetectors(coreConfigPath("geometry/" + what.room + ".yaml"));
  exposures.setup.target_box = phantomBox(what.target);
  RigidTransform& start = exposures.setup.room_from_patient;
  start.translation() = -(start.linear() * subject.box().center());
  const PhantomAnatomy anatomy;
  ImageFormation formation(ImageFormationOptions(), exposures.setup.intensity, 1);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> share;
  Progress progress("exposure");
  for (int n = 0; n < count; ++n)
  {
    const double angle = 4.0 * kDegree * share(random);
    const RigidTransform gold = subject.moved(randomTwist(random, angle, 12.0 * share(random)), start);
    const RigidTransform rest = subject.moved(randomTwist(random, what.rest_degrees * kDegree, what.rest_mm), gold);
    std::vector<cv::Mat> images;
    for (std::size_t d = 0; d < exposures.setup.detectors.size(); ++d)
    {
      cv::Mat soft, bone, counts;
      anatomy.materials(exposures.setup.detectors[d],
                        what.target == "c6" ? BodyPoses{ rest, gold } : BodyPoses{ gold, rest }, soft, bone);
      formation.form(soft, bone, static_cast<int>(d), n, counts);
      images.push_back(counts);
    }
    exposures.images.push_back(images);
    exposures.room_from_patient.push_back(gold);
    progress(n + 1, count);
  }
  return subject;
}
}  // namespace xray_tracking
