#include "method_record.h"

#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <locale>
#include <stdexcept>

namespace xray_tracking
{
/// A CSV table with a frame and its stamp in every row.
class CsvTable
{
public:
  CsvTable(const std::filesystem::path& path, const std::string& header) : path_(path.string()), file_(path)
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

namespace
{
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

/// Of the region where the track has it, clockwise from the first pixel's: x1, y1, ... y4 [px]; not numbers if it has
/// none.
std::array<double, 8> cornersOf(const TrackedView& view)
{
  std::array<double, 8> corners;
  corners.fill(std::numeric_limits<double>::quiet_NaN());
  if (view.state == RegionState::TRACKING || view.state == RegionState::DEGRADED)
  {
    const double left = view.region.x;
    const double top = view.region.y;
    const double right = left + view.region.width - 1.0;
    const double bottom = top + view.region.height - 1.0;
    const std::array<Eigen::Vector2d, 4> template_corners{
      { { left, top }, { right, top }, { right, bottom }, { left, bottom } }
    };
    for (std::size_t i = 0; i < template_corners.size(); ++i)
    {
      Eigen::Map<Eigen::Vector2d>(corners.data() + 2 * i) =
          view.track.centre + view.track.displacement + view.track.linear * (template_corners[i] - view.track.centre);
    }
  }
  return corners;
}

}  // namespace

RecordWriter::RecordWriter(const std::string& folder, const std::vector<std::string>& detectors) : detectors_(detectors)
{
  const std::filesystem::path path(folder);
  exposures_ = std::make_unique<CsvTable>(
      path / "exposures.csv",
      "frame,stamp_s,method,source,reason,gate,gate_text,disagreement_px,chi_square,degrees_of_freedom,"
      "c11,c12,c13,c14,c15,c16,c22,c23,c24,c25,c26,c33,c34,c35,c36,c44,c45,c46,c55,c56,c66");
  views_ = std::make_unique<CsvTable>(path / "views.csv",
                                      "frame,stamp_s,method,detector,state,fault,x1,y1,x2,y2,x3,y3,x4,y4");
  times_ = std::make_unique<CsvTable>(path / "times.csv", "frame,stamp_s,method,cpu_s,wall_s,registration_cpu_s");
}

RecordWriter::~RecordWriter() = default;

void RecordWriter::add(std::size_t frame, std::int64_t stamp_ns, const std::string& method,
                       const ExposureRecord& record)
{
  exposures_->begin(frame, stamp_ns);
  for (const std::string& text : { method, record.source, record.reason, record.gate, record.gate_text })
  {
    exposures_->add(text);
  }
  exposures_->add(record.disagreement_px);
  exposures_->add(record.chi_square);
  exposures_->add(static_cast<double>(record.degrees_of_freedom));
  for (int row = 0; row < 6; ++row)
  {
    for (int column = row; column < 6; ++column)
    {
      exposures_->add(record.covariance ? (*record.covariance)(row, column) : std::numeric_limits<double>::quiet_NaN());
    }
  }
  for (std::size_t d = 0; d < record.views.size(); ++d)
  {
    const TrackedView& view = record.views[d];
    views_->begin(frame, stamp_ns);
    for (const std::string& text : { method, detectors_.at(d), std::string(nameOf(view.state)), view.fault })
    {
      views_->add(text);
    }
    for (const double coordinate : cornersOf(view))
    {
      views_->add(coordinate);
    }
  }
  times_->begin(frame, stamp_ns);
  times_->add(method);
  for (const double value : { record.cpu_s, record.wall_s, record.registration_cpu_s })
  {
    times_->add(value);
  }
}

void RecordWriter::close()
{
  exposures_->close();
  views_->close();
  times_->close();
}

void writeGoldStandard(const Evaluation& evaluation, const std::string& folder)
{
  const std::filesystem::path path = std::filesystem::path(folder) / "gold_standard.csv";
  if (evaluation.gold_standard.empty())
  {
    std::filesystem::remove(path);  // of an earlier evaluation
    return;
  }
  CsvTable table(path, "frame,stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw");
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
}  // namespace xray_tracking
