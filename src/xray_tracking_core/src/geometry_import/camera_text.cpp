#include <algorithm>
#include <cctype>
#include <cmath>
#include <locale>
#include <map>
#include <sstream>
#include <stdexcept>

#include <Eigen/Dense>

#include "import_words.h"
#include "imported_view.h"

namespace xray_tracking
{
namespace
{
/// More is no calibration, and overflows together.
constexpr double kLargest = 1e15;
/// Files are rounded.
constexpr double kRotationTolerance = 1e-3;

std::string lowerCase(std::string text)
{
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

/// A part of a MayaCam file: its heading and the lines of numbers below.
struct Section
{
  std::string where;
  std::vector<std::vector<double>> rows;
};

using Sections = std::map<std::string, Section>;

Sections sectionsOf(const std::string& path, const std::string& text)
{
  static const std::vector<std::string> kKnown{ "image size", "camera matrix", "rotation", "translation",
                                                "distortion" };
  Sections sections;
  Section* current = nullptr;
  for (const TextLine& line : linesOf(path, text))
  {
    // An exponent is no heading.
    if (std::isalpha(static_cast<unsigned char>(line.text.front())) == 0 ||
        lowerCase(line.text).compare(0, 3, "nan") == 0 || lowerCase(line.text).compare(0, 3, "inf") == 0)
    {
      if (current == nullptr)
      {
        fail(line.where, quoted(line.text) + ": expected the line \"image size\" first, as MayaCam 2.0");
      }
      current->rows.push_back(numbersOf(line.text, line.where));
      continue;
    }
    const std::string heading = lowerCase(line.text);
    if (std::find(kKnown.begin(), kKnown.end(), heading) == kKnown.end())
    {
      fail(line.where,
           quoted(line.text) +
               ": expected image size, camera matrix, rotation, translation or distortion, and numbers below");
    }
    if (sections.count(heading) != 0)
    {
      fail(line.where, quoted(line.text) + " a second time: expected one camera a file");
    }
    current = &sections[heading];
    current->where = line.where;
  }
  return sections;
}

Eigen::MatrixXd numbersOf(const Sections& sections, const std::string& path, const std::string& heading, int rows,
                          int columns)
{
  const auto found = sections.find(heading);
  if (found == sections.end())
  {
    fail(path, "\"" + heading + "\" is missing: expected image size, camera matrix, rotation and translation");
  }
  std::vector<double> values;
  bool is_table = static_cast<int>(found->second.rows.size()) == rows;
  for (const std::vector<double>& row : found->second.rows)
  {
    is_table = is_table && static_cast<int>(row.size()) == columns;
    values.insert(values.end(), row.begin(), row.end());
  }
  // A column may be written as a line.
  const bool is_line = columns == 1 && found->second.rows.size() == 1 && static_cast<int>(values.size()) == rows;
  if (!is_table && !is_line)
  {
    fail(found->second.where,
         heading + " has " + std::to_string(values.size()) + " numbers in " +
             std::to_string(found->second.rows.size()) + " lines: expected " + std::to_string(rows) +
             (rows == 1 ? " line" : " lines") + " of " + std::to_string(columns) +
             (static_cast<int>(values.size()) > rows * columns ? ". Are there decimal commas? Expected points" : ""));
  }
  return Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(values.data(), rows,
                                                                                            columns);
}

/// OpenCV's order. All zero: none.
DistortionCoefficients distortionOf(const Sections& sections)
{
  DistortionCoefficients distortion;
  const auto found = sections.find("distortion");
  if (found == sections.end())
  {
    return distortion;
  }
  for (const std::vector<double>& row : found->second.rows)
  {
    distortion.values.insert(distortion.values.end(), row.begin(), row.end());
  }
  const std::size_t count = distortion.values.size();
  if (count != 4 && count != 5 && count != 8)
  {
    fail(found->second.where,
         "distortion has " + std::to_string(count) + " numbers: expected k1, k2, p1, p2, and perhaps k3, or k3 to k6");
  }
  const bool is_none =
      std::all_of(distortion.values.begin(), distortion.values.end(), [](double value) { return value == 0.0; });
  distortion.model = is_none ? "" : count == 8 ? "rational_polynomial" : "plumb_bob";
  return distortion;
}

void checkCameraMatrix(const Eigen::Matrix3d& camera, const std::string& where)
{
  std::ostringstream text;
  text << "camera matrix is [" << camera.format(Eigen::IOFormat(6, Eigen::DontAlignCols, ", ", "; ")) << "]: expected ";
  const bool is_bottom_row = camera.row(2).isApprox(Eigen::RowVector3d(0.0, 0.0, 1.0), 1e-9);
  if (!is_bottom_row && camera.col(2).isApprox(Eigen::Vector3d(0.0, 0.0, 1.0), 1e-9))
  {
    fail(where, text.str() + "fx, 0, cx; 0, fy, cy; 0, 0, 1; it is the transpose");
  }
  if (!is_bottom_row || camera(1, 0) != 0.0 || camera(0, 0) == 0.0 || camera(1, 1) == 0.0)
  {
    fail(where, text.str() + "fx, 0, cx; 0, fy, cy; 0, 0, 1");
  }
}

Eigen::Vector2i wholeSize(const Eigen::Vector2d& size, const std::string& where)
{
  if (!(size.array() == size.array().round()).all() || size.minCoeff() < 1.0 || size.maxCoeff() > 16384.0)
  {
    std::ostringstream text;
    text << "image size is " << size.x() << ", " << size.y() << ": expected columns, rows, whole numbers to 16384";
    fail(where, text.str());
  }
  return size.cast<int>();
}

bool isWithin(const Eigen::Vector2d& pixel, const Eigen::Vector2i& size)
{
  return pixel.minCoeff() >= 0.0 && pixel.x() < size.x() && pixel.y() < size.y();
}
}  // namespace

std::string quoted(const std::string& text)
{
  std::string shown = text.substr(0, 40);
  std::replace_if(
      shown.begin(), shown.end(), [](unsigned char c) { return std::isprint(c) == 0; }, '?');
  return '"' + shown + '"';
}

std::vector<TextLine> linesOf(const std::string& path, const std::string& text)
{
  std::vector<TextLine> lines;
  std::istringstream stream(text);
  int number = 0;
  for (std::string line; std::getline(stream, line);)
  {
    ++number;
    if (number == 1 && line.compare(0, 3, "\xEF\xBB\xBF") == 0)  // byte order mark
    {
      line.erase(0, 3);
    }
    const auto first = line.find_first_not_of(" \t\r");
    if (first != std::string::npos)
    {
      lines.push_back({ line.substr(first, line.find_last_not_of(" \t\r") - first + 1),
                        path + ", line " + std::to_string(number) });
    }
  }
  return lines;
}

std::vector<double> numbersOf(const std::string& text, const std::string& where)
{
  std::string plain = text;
  std::replace_if(
      plain.begin(), plain.end(), [](char c) { return std::string(",;[](){}\t\r\n").find(c) != std::string::npos; },
      ' ');
  std::vector<double> values;
  std::istringstream words(plain);
  for (std::string word; words >> word;)
  {
    std::istringstream stream(word);
    stream.imbue(std::locale::classic());
    double value = 0.0;
    if (!(stream >> value) || stream.peek() != std::char_traits<char>::eof() || !(std::abs(value) <= kLargest))
    {
      fail(where, quoted(word) + ": expected a finite number, at most 1e15");
    }
    values.push_back(value);
  }
  return values;
}

std::vector<ImportedView> readMayaCam(const std::string& path, const std::string& text,
                                      const GeometryImportOptions& options)
{
  refuseOptions(path, { { "--projections", !options.projections.empty() } });
  const Sections sections = sectionsOf(path, text);
  const Eigen::Vector2d size = numbersOf(sections, path, "image size", 1, 2).transpose();
  const Eigen::Matrix3d camera = numbersOf(sections, path, "camera matrix", 3, 3);
  const Eigen::Matrix3d rotation = numbersOf(sections, path, "rotation", 3, 3);
  const Eigen::Vector3d translation = numbersOf(sections, path, "translation", 3, 1);
  checkCameraMatrix(camera, sections.at("camera matrix").where);
  const double off = (rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(off <= kRotationTolerance))
  {
    std::ostringstream what;
    what << "rotation times its transpose is off the identity by " << off << ": expected a rotation matrix";
    fail(sections.at("rotation").where, what.str());
  }
  ImportedView view;
  view.where = path;
  view.image_size = options.image_size.value_or(wholeSize(size, sections.at("image size").where));
  const Eigen::Vector2d foot(camera(0, 2), camera(1, 2));
  if (!isWithin(foot, view.image_size) && isWithin(foot, view.image_size.reverse()))
  {
    std::ostringstream what;
    what << "image size is " << view.image_size.x() << ", " << view.image_size.y() << ", with the principal point at "
         << foot.x() << ", " << foot.y() << ": expected columns, rows. Is it rows, columns? Then give --image_size "
         << view.image_size.y() << " " << view.image_size.x();
    fail(sections.at("image size").where, what.str());
  }
  view.matrix << camera * rotation, camera * translation;
  view.matrix.leftCols<3>() /= options.unit.value_or(1.0);
  view.distortion = distortionOf(sections);
  // A negative focal length turns the axis.
  if (camera(0, 0) < 0.0)
  {
    turnTangential(view.distortion, 3);
  }
  if (camera(1, 1) < 0.0)
  {
    turnTangential(view.distortion, 2);
  }
  view.hint =
      "if the images are right: is the rotation that of a camera with y up and z backwards (OpenGL)? Then change the "
      "sign of the second and third row of rotation and translation; or are rotation and translation the camera's pose "
      "(camera to room)? Then invert them";
  return { view };
}

std::vector<ImportedView> readMatrices(const std::string& path, const std::string& text,
                                       const GeometryImportOptions& options)
{
  refuseOptions(path, { { "--projections", !options.projections.empty() } });
  std::vector<double> values;
  std::string where;
  std::size_t rows_of_three = 0;
  std::vector<TextLine> lines = linesOf(path, text);
  for (TextLine& line : lines)
  {
    line.text = line.text.substr(0, line.text.find('#'));
    const std::vector<double> row = numbersOf(line.text, line.where);
    rows_of_three += row.size() == 3 ? 1 : 0;
    if (row.size() != 0 && row.size() != 4 && row.size() != 12 && row.size() != 3)
    {
      fail(line.where, "has " + std::to_string(row.size()) +
                           (row.size() == 11 ? " numbers: expected 4 or 12 a line. Are they DLT coefficients? Then put "
                                               "1 behind them"
                                             : " numbers: expected 4 a line, three lines a matrix, or 12 a line"));
    }
    if (row.size() == 12 && values.size() % 12 != 0)
    {
      fail(line.where, "has 12 numbers within a matrix of 4 a line: expected 4");
    }
    values.insert(values.end(), row.begin(), row.end());
    where = line.where;
  }
  if (rows_of_three == 5 && values.size() == 15)
  {
    fail(path, "is 5 lines of 3 numbers, as MayaCam 1.0: expected MayaCam 2.0 or 3 x 4 projection matrices");
  }
  if (rows_of_three > 0 && rows_of_three % 4 == 0 && values.size() == 3 * rows_of_three)
  {
    fail(path, "is 4 lines of 3 numbers, the transpose as MATLAB has it: expected 3 lines of 4");
  }
  if (values.empty() || values.size() % 12 != 0 || rows_of_three != 0)
  {
    fail(where.empty() ? path : where, "ends after " + std::to_string(values.size()) +
                                           " numbers in all: expected 12 a matrix, 3 lines of 4, one after the other");
  }
  std::vector<ImportedView> views;
  for (std::size_t n = 0; 12 * n < values.size(); ++n)
  {
    ImportedView view;
    view.where = path + (values.size() > 12 ? ", matrix " + std::to_string(n + 1) : "");
    view.image_size = imageSizeOf(options, path);
    view.matrix = Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(values.data() + 12 * n);
    view.matrix.leftCols<3>() /= options.unit.value_or(1.0);
    view.hint =
        "if the images are right: are columns and rows swapped, or does a row of the matrix have the wrong sign?";
    views.push_back(view);
  }
  return views;
}
}  // namespace xray_tracking
