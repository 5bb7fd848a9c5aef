#include "sequence_files.h"

#include <iomanip>
#include <limits>
#include <sstream>
#include <stdexcept>

#include <opencv2/imgcodecs.hpp>

namespace xray_tracking
{
SequenceFiles::SequenceFiles(const std::filesystem::path& folder, const TreatmentSetup& setup) : folder_(folder)
{
  std::filesystem::create_directories(folder_);
  saveTreatmentSetup(setup, (folder_ / "sequence.yaml").string());
  std::ofstream yaml(folder_ / "sequence.yaml", std::ios::app);
  yaml << "frames: frames.csv\ngold_standard: gold_standard.csv\n";
  yaml.close();
  if (!yaml)
  {
    throw std::runtime_error(folder_.string() + ": cannot be written");
  }
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    detectors_.push_back(detector.name());
  }
  frames_.open(folder_ / "frames.csv");
  gold_.open(folder_ / "gold_standard.csv");
  frames_ << "stamp_s,detector,file\n";
  gold_ << "stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
}

void SequenceFiles::add(double stamp_s, const RigidTransform& truth, const std::vector<cv::Mat>& images)
{
  std::ostringstream stamp;
  stamp << std::fixed << std::setprecision(1) << stamp_s;
  const Eigen::Quaterniond rotation(truth.linear());
  gold_ << stamp.str() << std::setprecision(std::numeric_limits<double>::max_digits10);
  for (const double value : { truth.translation().x(), truth.translation().y(), truth.translation().z(), rotation.x(),
                              rotation.y(), rotation.z(), rotation.w() })
  {
    gold_ << ',' << value;
  }
  gold_ << '\n';
  for (std::size_t d = 0; d < detectors_.size(); ++d)
  {
    std::ostringstream name;
    name << detectors_[d] << '_' << std::setw(4) << std::setfill('0') << exposures_ << ".png";
    const std::string path = (folder_ / name.str()).string();
    if (!cv::imwrite(path, images.at(d), { cv::IMWRITE_PNG_COMPRESSION, 1 }))
    {
      throw std::runtime_error(path + ": cannot be written");
    }
    frames_ << stamp.str() << ',' << detectors_[d] << ',' << name.str() << '\n';
  }
  ++exposures_;
}

void SequenceFiles::close()
{
  frames_.close();
  gold_.close();
  if (!frames_ || !gold_)
  {
    throw std::runtime_error(folder_.string() + ": cannot be written");
  }
}
}  // namespace xray_tracking
