#include "method_record.h"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <locale>
#include <stdexcept>

namespace xray_tracking
{
namespace
{
class Table
{
public:
  Table(const std::filesystem::path& path, const std::string& header) : path_(path.string()), file_(path)
  {
    file_.imbue(std::locale::classic());
    file_ << std::setprecision(10) << header;
  }

  void begin(std::size_t frame, std::int64_t stamp_ns)
  {
    file_ << '\n'
          << frame << ',' << stamp_ns / 1'000'000'000 << '.' << std::setw(9) << std::setfill('0')
          << stamp_ns % 1'000'000'000;
  }
  void add(double value)
  {
    file_ << ',';
    if (std::isfinite(value))
    {
      file_ << value;
    }
  }
  /// Quoted as RFC 4180 has it.
  void add(const std::string& text)
  {
    file_ << ",\"";
    for (const char c : text)
    {
      file_ << (c == '"' ? "\"\"" : std::string(1, c));
    }
    file_ << '"';
  }
  void close()
  {
    file_ << '\n';
    file_.close();
    if (!file_)
    {
      throw std::runtime_error(path_ + ": cannot be written");
    }
  }

private:
  std::string path_;
  std::ofstream file_;
};

const char* nameOf(RegionState state)
{
  switch (state)
  {
    case RegionState::UNTRAINED:
      return "untrained";
    case RegionState::TRAINING:
      return "training";
    case RegionState::TRACKING:
      return "tracking";
    case RegionState::LOST:
      return "lost";
    case RegionState::DEGRADED:
      return "degraded";
    case RegionState::BLIND:
      return "blind";
  }
  return "";
}

void writeGoldStandard(const Evaluation& evaluation, const std::filesystem::path& folder)
{
  if (evaluation.gold_standard.empty())
  {
    std::filesystem::remove(folder / "gold_standard.csv");  // of an earlier evaluation
    return;
  }
  Table table(folder / "gold_standard.csv", "frame,stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw");
  for (std::size_t k = 0; k < evaluation.stamps_ns.size(); ++k)
  {
    const RigidTransform& pose = evaluation.gold_standard[k];
    table.begin(k, evaluation.stamps_ns[k]);
    for (const double value : { pose.translation().x(), pose.translation().y(), pose.translation().z() })
    {
      table.add(value);
    }
    const Eigen::Quaterniond rotation(pose.linear());
    for (const double value : { rotation.x(), rotation.y(), rotation.z(), rotation.w() })
    {
      table.add(value);
    }
  }
  table.close();
}

void addCovariance(const std::optional<PoseCovariance>& covariance, Table& table)
{
  for (int row = 0; row < 6; ++row)
  {
    for (int column = row; column < 6; ++column)
    {
      table.add(covariance ? (*covariance)(row, column) : std::numeric_limits<double>::quiet_NaN());
    }
  }
}

/// Corners of the region where the track has it, clockwise from the first pixel's [px].
void addCorners(const TrackedView& view, Table& table)
{
  const bool found = view.state == RegionState::TRACKING || view.state == RegionState::DEGRADED;
  const cv::Rect& region = view.region;
  for (const cv::Point& corner : { region.tl(), cv::Point(region.x + region.width - 1, region.y),
                                   cv::Point(region.x + region.width - 1, region.y + region.height - 1),
                                   cv::Point(region.x, region.y + region.height - 1) })
  {
    const Eigen::Vector2d now = view.track.centre + view.track.displacement +
                                view.track.linear * (Eigen::Vector2d(corner.x, corner.y) - view.track.centre);
    table.add(found ? now.x() : std::numeric_limits<double>::quiet_NaN());
    table.add(found ? now.y() : std::numeric_limits<double>::quiet_NaN());
  }
}
}  // namespace

void writeRecords(const Evaluation& evaluation, const std::vector<MethodRecord>& records,
                  const std::vector<std::string>& detectors, const std::string& folder)
{
  const std::filesystem::path path(folder);
  writeGoldStandard(evaluation, path);
  Table exposures(path / "exposures.csv",
                  "frame,stamp_s,method,source,reason,gate,gate_text,disagreement_px,chi_square,degrees_of_freedom,"
                  "c11,c12,c13,c14,c15,c16,c22,c23,c24,c25,c26,c33,c34,c35,c36,c44,c45,c46,c55,c56,c66");
  Table views(path / "views.csv", "frame,stamp_s,method,detector,state,fault,x1,y1,x2,y2,x3,y3,x4,y4");
  Table times(path / "times.csv", "frame,stamp_s,method,cpu_s,wall_s,registration_cpu_s");
  for (std::size_t k = 0; k < evaluation.stamps_ns.size(); ++k)
  {
    const std::int64_t stamp = evaluation.stamps_ns[k];
    for (const MethodRecord& record : records)
    {
      const ExposureRecord& exposure = record.exposures.at(k);
      exposures.begin(k, stamp);
      for (const std::string& text :
           { record.method, exposure.source, exposure.reason, exposure.gate, exposure.gate_text })
      {
        exposures.add(text);
      }
      exposures.add(exposure.disagreement_px);
      exposures.add(exposure.chi_square);
      exposures.add(static_cast<double>(exposure.degrees_of_freedom));
      addCovariance(exposure.covariance, exposures);
      times.begin(k, stamp);
      times.add(record.method);
      for (const double value : { exposure.cpu_s, exposure.wall_s, exposure.registration_cpu_s })
      {
        times.add(value);
      }
      for (std::size_t d = 0; d < exposure.views.size(); ++d)
      {
        views.begin(k, stamp);
        for (const std::string& text :
             { record.method, detectors.at(d), std::string(nameOf(exposure.views[d].state)), exposure.views[d].fault })
        {
          views.add(text);
        }
        addCorners(exposure.views[d], views);
      }
    }
  }
  exposures.close();
  views.close();
  times.close();
}
}  // namespace xray_tracking
