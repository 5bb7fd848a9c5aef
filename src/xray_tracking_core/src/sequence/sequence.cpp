#include "xray_tracking_core/sequence/sequence.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <locale>
#include <sstream>
#include <stdexcept>

#include "frame_files.h"
#include "setup_node.h"
#include "yaml_field.h"

namespace xray_tracking
{
namespace
{
constexpr std::int64_t kMaxSeconds = 4294967295;  // what a ROS time stamp holds

/// A comma separated table, read row by row; fields are asked for by their column's name.
class CsvReader
{
public:
  CsvReader(const std::string& path, const std::vector<std::string>& columns) : path_(path), file_(path)
  {
    if (!file_)
    {
      throw std::runtime_error(path + ": missing or not readable");
    }
    std::error_code error;
    if (const std::uintmax_t bytes = std::filesystem::file_size(path, error); !error && bytes > kMostBytes)
    {
      throw std::runtime_error(path + ": is " + std::to_string(bytes >> 20) + " MB, expected a table of " +
                               std::to_string(kMostBytes >> 20) + " MB at most");
    }
    next();
    if (!row_.empty() && row_.front().compare(0, 3, "\xEF\xBB\xBF") == 0)  // byte order mark
    {
      row_.front().erase(0, 3);
    }
    header_ = row_;
    for (const std::string& column : columns)
    {
      if (std::find(header_.begin(), header_.end(), column) == header_.end())
      {
        fail("column " + column + " is missing from the header");
      }
    }
  }

  /// Goes to the next row that is not blank. @return false at the end
  bool next()
  {
    std::string line;
    while (std::getline(file_, line))
    {
      ++line_number_;
      row_.clear();
      std::istringstream fields(line);
      for (std::string field; std::getline(fields, field, ',');)
      {
        const auto first = field.find_first_not_of(" \t\r");
        const auto last = field.find_last_not_of(" \t\r");
        row_.push_back(first == std::string::npos ? "" : field.substr(first, last - first + 1));
      }
      if (std::any_of(row_.begin(), row_.end(), [](const std::string& field) { return !field.empty(); }))
      {
        return true;
      }
    }
    if (file_.bad())
    {
      fail("reading failed");
    }
    row_.clear();
    return false;
  }

  const std::string& text(const std::string& column) const
  {
    const std::size_t index = std::find(header_.begin(), header_.end(), column) - header_.begin();
    if (index >= row_.size() || row_[index].empty())
    {
      fail(column + " is empty");
    }
    return row_[index];
  }

  double number(const std::string& column) const
  {
    const std::string& field = text(column);
    std::istringstream stream(field);
    stream.imbue(std::locale::classic());
    double value = 0.0;
    if (!(stream >> value) || !stream.eof() || !std::isfinite(value))
    {
      fail(column + " '" + field + "': expected a finite number");
    }
    return value;
  }

  /// Decimal seconds to nanoseconds, digit by digit: a double holds no nanoseconds of today's date.
  std::int64_t stamp() const
  {
    const std::string& field = text("stamp_s");
    const std::size_t point = std::min(field.find('.'), field.size());
    const std::string seconds = field.substr(0, point);
    std::string fraction = field.substr(std::min(point + 1, field.size()));
    const std::string digits = seconds + fraction;
    if (seconds.empty() || seconds.size() > 10 || digits.find_first_not_of("0123456789") != std::string::npos ||
        std::stoll(seconds) > kMaxSeconds)
    {
      fail("stamp_s '" + field + "': expected seconds as a decimal number, zero or more and less than 2^32");
    }
    fraction.resize(10, '0');
    const std::int64_t tenths = std::stoll(fraction);
    return std::stoll(seconds) * 1'000'000'000 + (tenths + 5) / 10;
  }

  std::string where() const { return path_ + ", line " + std::to_string(line_number_); }

  [[noreturn]] void fail(const std::string& problem) const { throw std::runtime_error(where() + ": " + problem); }

private:
  static constexpr std::uintmax_t kMostBytes = 256 << 20;  // some million exposures

  std::string path_;
  std::ifstream file_;
  int line_number_ = 0;
  std::vector<std::string> header_;
  std::vector<std::string> row_;
};

std::size_t detectorIndex(const TreatmentSetup& setup, const FrameRow& row)
{
  try
  {
    return &setup.detector(row.detector) - setup.detectors.data();
  }
  catch (const std::invalid_argument& error)
  {
    throw std::runtime_error(row.where + ": " + error.what());
  }
}

std::string secondsText(std::int64_t stamp_ns)
{
  std::ostringstream seconds;
  seconds << stamp_ns / 1'000'000'000 << '.' << std::setw(9) << std::setfill('0') << stamp_ns % 1'000'000'000;
  return seconds.str();
}

void checkComplete(const TreatmentSetup& setup, const Exposure& exposure, const std::string& where)
{
  for (std::size_t i = 0; i < exposure.files.size(); ++i)
  {
    if (exposure.files[i].empty())
    {
      throw std::runtime_error(where + ": the exposure before this has no image of " + setup.detectors[i].name() +
                               " (are stamps of one exposure farther apart than pairing_tolerance in sequence.yaml?)");
    }
  }
}

/// Rows whose stamps are at most `tolerance` [ns] from that of the first row of an exposure belong to it, unless it has
/// an image of their detector already. The exposure's stamp is that of the first detector.
std::vector<Exposure> pairExposures(const TreatmentSetup& setup, const std::vector<FrameRow>& rows,
                                    std::int64_t tolerance)
{
  std::vector<Exposure> exposures;
  std::int64_t first = 0;
  for (const FrameRow& row : rows)
  {
    const std::int64_t stamp = row.stamp_ns;
    const std::size_t detector = detectorIndex(setup, row);
    const bool near = !exposures.empty() && std::abs(stamp - first) <= tolerance;
    if (!exposures.empty() && !near && stamp < first)
    {
      throw std::runtime_error(row.where + ": stamp_s " + secondsText(stamp) +
                               " is before that of the line above: expected stamps that grow");
    }
    if (!near || (stamp > first && !exposures.back().files[detector].empty()))
    {
      if (!exposures.empty())
      {
        checkComplete(setup, exposures.back(), row.where);
      }
      exposures.push_back({ stamp, std::vector<std::string>(setup.detectors.size()) });
      first = stamp;
    }
    if (detector == 0)
    {
      exposures.back().stamp_ns = stamp;
    }
    std::string& file = exposures.back().files[detector];
    if (!file.empty())
    {
      throw std::runtime_error(row.where + ": a second image of " + row.detector + " at " + secondsText(stamp) + " s");
    }
    file = row.file;
    if (!std::filesystem::is_regular_file(file))
    {
      throw std::runtime_error(row.where + ": image " + file + " is missing");
    }
  }
  checkComplete(setup, exposures.back(), rows.back().where);
  return exposures;
}

/// The poses nearest to the exposures, within the tolerance [ns]; the table may hold further ones in between.
std::vector<StampedPose> readGoldStandard(const std::vector<Exposure>& exposures, const std::filesystem::path& path,
                                          std::int64_t tolerance)
{
  const std::vector<StampedPose> table = loadPoses(path.string());
  std::vector<StampedPose> poses;
  for (const Exposure& exposure : exposures)
  {
    const auto away = [&](const StampedPose& pose) { return std::abs(pose.stamp_ns - exposure.stamp_ns); };
    auto nearest = std::lower_bound(table.begin(), table.end(), exposure.stamp_ns,
                                    [](const StampedPose& pose, std::int64_t stamp) { return pose.stamp_ns < stamp; });
    if (nearest != table.begin() && (nearest == table.end() || away(*std::prev(nearest)) < away(*nearest)))
    {
      --nearest;
    }
    if (nearest == table.end() || away(*nearest) > tolerance)
    {
      throw std::runtime_error(path.string() + ": no pose for the exposure at " + secondsText(exposure.stamp_ns) +
                               " s");
    }
    poses.push_back({ exposure.stamp_ns, nearest->room_from_patient });
  }
  return poses;
}
LensDistortion readDistortion(const YamlField& field, const ProjectionGeometry& detector)
{
  field.refuseMisspelt({ "model", "coefficients" });
  std::vector<double> coefficients;
  field.get("coefficients").forEachItem([&](const YamlField& item) { coefficients.push_back(item.number<double>()); });
  try
  {
    return { field.get("model").text(), coefficients, detector };
  }
  catch (const std::invalid_argument& error)
  {
    throw std::runtime_error(field.where() + ": " + error.what());
  }
}
}  // namespace

cv::Mat Sequence::image(std::size_t exposure, std::size_t detector) const
{
  const cv::Mat image = readXrayImage(exposures[exposure].files[detector], setup.detectors[detector], setup.intensity);
  return distortions[detector].undo(image, setup.intensity.kind);
}

std::vector<LensDistortion> loadDistortions(const std::string& path, const std::vector<ProjectionGeometry>& detectors)
{
  std::vector<LensDistortion> distortions;
  detectorList(YamlField::fromFile(path), path)
      .forEachItem(
          [&](const YamlField& item)
          {
            const auto distortion = item.find("distortion");
            distortions.push_back(distortion ? readDistortion(*distortion, detectors.at(distortions.size()))
                                             : LensDistortion());
          });
  return distortions;
}

std::vector<StampedPose> loadPoses(const std::string& path)
{
  std::vector<StampedPose> poses;
  CsvReader row(path, { "stamp_s", "tx_mm", "ty_mm", "tz_mm", "qx", "qy", "qz", "qw" });
  while (row.next())
  {
    const std::int64_t stamp = row.stamp();
    if (!poses.empty() && stamp <= poses.back().stamp_ns)
    {
      row.fail("stamp_s " + row.text("stamp_s") + " is not after that of the line above: expected stamps that grow");
    }
    const Eigen::Vector3d translation(row.number("tx_mm"), row.number("ty_mm"), row.number("tz_mm"));
    const Eigen::Quaterniond rotation(row.number("qw"), row.number("qx"), row.number("qy"), row.number("qz"));
    try
    {
      poses.push_back({ stamp, makeRigidTransform(translation, rotation) });
    }
    catch (const std::invalid_argument& error)
    {
      row.fail(error.what());
    }
  }
  return poses;
}

std::vector<FrameRow> loadFrameTable(const std::string& directory)
{
  const std::filesystem::path folder = std::filesystem::absolute(directory);
  const YamlField frames = YamlField::fromFile((folder / "sequence.yaml").string()).get("frames");
  if (!frames.isScalar())
  {
    return frameFiles(frames, folder.string());
  }
  const std::filesystem::path path = folder / frames.text();
  std::vector<FrameRow> rows;
  CsvReader row(path.string(), { "stamp_s", "detector", "file" });
  while (row.next())
  {
    rows.push_back({ row.stamp(), row.text("detector"),
                     (path.parent_path() / row.text("file")).lexically_normal().string(), row.where() });
  }
  if (rows.empty())
  {
    row.fail("no exposures");
  }
  return rows;
}

std::string goldStandardPath(const std::string& directory)
{
  const std::filesystem::path folder = std::filesystem::absolute(directory);
  const auto path = YamlField::fromFile((folder / "sequence.yaml").string()).find("gold_standard");
  return path ? (folder / path->text()).string() : "";
}

Sequence loadSequence(const std::string& directory)
{
  const std::filesystem::path folder = std::filesystem::absolute(directory);
  const std::string path = (folder / "sequence.yaml").string();
  Sequence sequence;
  sequence.setup = loadTreatmentSetup(path);
  sequence.distortions = loadDistortions(path, sequence.setup.detectors);
  const YamlField root = YamlField::fromFile(path);
  double tolerance_s = kPairingTolerance;
  if (const auto tolerance = root.find("pairing_tolerance"))
  {
    tolerance_s = tolerance->number<double>();
    if (!(tolerance_s >= 0.0 && tolerance_s <= 1.0))
    {
      tolerance->fail("0 to 1 s, less than half the time between exposures");
    }
  }
  const auto tolerance_ns = static_cast<std::int64_t>(std::llround(tolerance_s * 1e9));
  sequence.tables = { path };
  if (const YamlField frames = root.get("frames"); frames.isScalar())
  {
    sequence.tables.push_back((folder / frames.text()).string());
  }
  if (sequence.setup.target_structure)
  {
    sequence.tables.push_back(sequence.setup.target_structure->file);
  }
  sequence.exposures = pairExposures(sequence.setup, loadFrameTable(directory), tolerance_ns);
  const std::string gold_standard = goldStandardPath(directory);
  if (!gold_standard.empty())
  {
    sequence.tables.push_back(gold_standard);
    sequence.gold_standard = readGoldStandard(sequence.exposures, gold_standard, tolerance_ns);
  }
  return sequence;
}
}  // namespace xray_tracking
