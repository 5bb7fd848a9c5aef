#include "xray_tracking_core/sequence/sequence.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <locale>
#include <sstream>
#include <stdexcept>

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

  [[noreturn]] void fail(const std::string& problem) const
  {
    throw std::runtime_error(path_ + ", line " + std::to_string(line_number_) + ": " + problem);
  }

private:
  std::string path_;
  std::ifstream file_;
  int line_number_ = 0;
  std::vector<std::string> header_;
  std::vector<std::string> row_;
};

std::size_t detectorIndex(const TreatmentSetup& setup, const CsvReader& row)
{
  try
  {
    return &setup.detector(row.text("detector")) - setup.detectors.data();
  }
  catch (const std::invalid_argument& error)
  {
    row.fail(error.what());
  }
}

void checkComplete(const TreatmentSetup& setup, const Exposure& exposure, const CsvReader& row)
{
  for (std::size_t i = 0; i < exposure.files.size(); ++i)
  {
    if (exposure.files[i].empty())
    {
      row.fail("the exposure before this has no image of " + setup.detectors[i].name() +
               " (are stamps of one exposure farther apart than pairing_tolerance in sequence.yaml?)");
    }
  }
}

/// Rows whose stamps are at most `tolerance` [ns] from that of the first row of an exposure belong to it, unless it has
/// an image of their detector already. The exposure's stamp is that of the first detector.
std::vector<Exposure> readExposures(const TreatmentSetup& setup, const std::filesystem::path& path,
                                    std::int64_t tolerance)
{
  std::vector<Exposure> exposures;
  CsvReader row(path.string(), { "stamp_s", "detector", "file" });
  std::int64_t first = 0;
  while (row.next())
  {
    const std::int64_t stamp = row.stamp();
    const std::size_t detector = detectorIndex(setup, row);
    const bool near = !exposures.empty() && std::abs(stamp - first) <= tolerance;
    if (!exposures.empty() && !near && stamp < first)
    {
      row.fail("stamp_s " + row.text("stamp_s") + " is before that of the line above: expected stamps that grow");
    }
    if (!near || (stamp > first && !exposures.back().files[detector].empty()))
    {
      if (!exposures.empty())
      {
        checkComplete(setup, exposures.back(), row);
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
      row.fail("a second image of " + setup.detectors[detector].name() + " at " + row.text("stamp_s") + " s");
    }
    file = (path.parent_path() / row.text("file")).lexically_normal().string();
    if (!std::filesystem::is_regular_file(file))
    {
      row.fail("image " + file + " is missing");
    }
  }
  if (exposures.empty())
  {
    row.fail("no exposures");
  }
  checkComplete(setup, exposures.back(), row);
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
      std::ostringstream seconds;
      seconds << std::fixed << std::setprecision(9) << exposure.stamp_ns * 1e-9;
      throw std::runtime_error(path.string() + ": no pose for the exposure at " + seconds.str() + " s");
    }
    poses.push_back({ exposure.stamp_ns, nearest->room_from_patient });
  }
  return poses;
}
}  // namespace

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

Sequence loadSequence(const std::string& directory)
{
  const std::filesystem::path folder = std::filesystem::absolute(directory);
  const std::string path = (folder / "sequence.yaml").string();
  Sequence sequence;
  sequence.setup = loadTreatmentSetup(path);
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
  sequence.tables = { path, (folder / root.get("frames").text()).string() };
  sequence.exposures = readExposures(sequence.setup, sequence.tables.back(), tolerance_ns);
  if (const auto gold_standard = root.find("gold_standard"))
  {
    sequence.tables.push_back((folder / gold_standard->text()).string());
    sequence.gold_standard = readGoldStandard(sequence.exposures, sequence.tables.back(), tolerance_ns);
  }
  return sequence;
}
}  // namespace xray_tracking
