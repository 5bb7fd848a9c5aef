#include <algorithm>
#include <cmath>
#include <map>
#include <sstream>
#include <stdexcept>

#include <tinyxml2.h>
#include <Eigen/Geometry>
#include <boost/math/constants/constants.hpp>

#include "import_words.h"
#include "imported_view.h"

namespace xray_tracking
{
namespace
{
constexpr double kDegree = boost::math::constants::degree<double>();
/// As RTK's reader has it.
constexpr double kMatrixTolerance = 1e-3;

const std::vector<std::string> kParameters{ "SourceToIsocenterDistance",
                                            "SourceToDetectorDistance",
                                            "GantryAngle",
                                            "OutOfPlaneAngle",
                                            "InPlaneAngle",
                                            "SourceOffsetX",
                                            "SourceOffsetY",
                                            "ProjectionOffsetX",
                                            "ProjectionOffsetY" };

class RtkFile
{
public:
  RtkFile(const std::string& path, const std::string& text) : path_(path)
  {
    if (document_.Parse(text.data(), text.size()) != tinyxml2::XML_SUCCESS)
    {
      fail(path_ + ", line " + std::to_string(document_.ErrorLineNum()),
           std::string("not XML: ") + document_.ErrorName() + "; truncated?");
    }
    root_ = document_.RootElement();
    const std::string name = root_ != nullptr ? root_->Name() : "";
    if (name != "RTKThreeDCircularGeometry")
    {
      fail(path_, "the root is <" + name + ">: expected <RTKThreeDCircularGeometry>");
    }
    const char* version = root_->Attribute("version");
    if (version == nullptr || (std::string(version) != "2" && std::string(version) != "3"))
    {
      fail(where(*root_), std::string("version is ") + (version != nullptr ? version : "absent") + ": expected 2 or 3");
    }
    for (const auto* element = root_->FirstChildElement(); element != nullptr; element = element->NextSiblingElement())
    {
      if (std::string(element->Name()) == "Projection")
      {
        projections_.push_back(element);
      }
      else
      {
        takeParameter(*element, common_);
      }
    }
    if (projections_.empty())
    {
      fail(path_, "has no <Projection>");
    }
  }

  std::size_t size() const { return projections_.size(); }

  std::string where(const tinyxml2::XMLElement& element) const
  {
    return path_ + ", line " + std::to_string(element.GetLineNum()) + ": " + element.Name();
  }

  std::string whereProjection(std::size_t n) const
  {
    return path_ + ", line " + std::to_string(projections_[n]->GetLineNum()) + ": projection " + std::to_string(n);
  }

  /// The parameters of a projection; those that the file has not are 0.
  std::map<std::string, double> parameters(std::size_t n) const
  {
    std::map<std::string, double> values = common_;
    std::map<std::string, double> own;
    for (const auto* element = projections_[n]->FirstChildElement(); element != nullptr;
         element = element->NextSiblingElement())
    {
      if (std::string(element->Name()) != "Matrix")
      {
        takeParameter(*element, own);
      }
    }
    for (const auto& [name, value] : own)
    {
      values[name] = value;
    }
    for (const std::string& name : kParameters)
    {
      if (values.count(name) != 0)
      {
        continue;
      }
      // RTK would take the value of the projection before.
      for (std::size_t other = 0; other < size(); ++other)
      {
        if (projections_[other]->FirstChildElement(name.c_str()) != nullptr)
        {
          fail(whereProjection(n), name + " is missing, which projection " + std::to_string(other) + " has");
        }
      }
      if (name.find("Distance") != std::string::npos)
      {
        fail(whereProjection(n), name + " is missing");
      }
      values[name] = 0.0;
    }
    return values;
  }

  /// That the file has beside the parameters.
  void checkMatrix(std::size_t n, const ProjectionMatrix& expected) const
  {
    const auto* element = projections_[n]->FirstChildElement("Matrix");
    if (element == nullptr)
    {
      return;
    }
    const char* text = element->GetText();
    const std::vector<double> values = numbersOf(text != nullptr ? text : "", where(*element));
    if (values.size() != 12)
    {
      fail(where(*element), "has " + std::to_string(values.size()) + " numbers: expected 3 x 4");
    }
    const ProjectionMatrix matrix = Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(values.data());
    if (!((matrix - expected).array().abs() <= kMatrixTolerance + 1e-6 * expected.array().abs()).all())
    {
      std::ostringstream what;
      const Eigen::IOFormat line(9, Eigen::DontAlignCols, ", ", "; ");
      what << "is [" << matrix.format(line) << "], but the parameters make [" << expected.format(line)
           << "]: expected the same";
      fail(where(*element), what.str());
    }
  }

private:
  void takeParameter(const tinyxml2::XMLElement& element, std::map<std::string, double>& values) const
  {
    const std::string name = element.Name();
    if (name.compare(0, 11, "Collimation") == 0)
    {
      return;  // where jaws are, not the panel
    }
    const bool is_radius = name == "RadiusCylindricalDetector";
    if (!is_radius && std::find(kParameters.begin(), kParameters.end(), name) == kParameters.end())
    {
      fail(where(element), "is unknown: expected the parameters of ThreeDCircularProjectionGeometry");
    }
    if (values.count(name) != 0)
    {
      fail(where(element), "a second time");
    }
    const char* text = element.GetText();
    const std::vector<double> numbers = numbersOf(text != nullptr ? text : "", where(element));
    if (numbers.size() != 1)
    {
      fail(where(element), "is \"" + std::string(text != nullptr ? text : "") + "\": expected a number");
    }
    if (is_radius && numbers.front() != 0.0)
    {
      fail(where(element), "is " + std::to_string(numbers.front()) + ": expected 0, a flat panel");
    }
    values[name] = numbers.front();
  }

  std::string path_;
  tinyxml2::XMLDocument document_;
  const tinyxml2::XMLElement* root_ = nullptr;
  std::vector<const tinyxml2::XMLElement*> projections_;
  std::map<std::string, double> common_;
};
}  // namespace

std::vector<ImportedView> readRtkGeometry(const std::string& path, const std::string& text,
                                          const GeometryImportOptions& options)
{
  refuseOptions(path, { { "--sdd", options.source_to_detector.has_value() } });
  const RtkFile file(path, text);
  if (options.projections.empty())
  {
    throw std::invalid_argument(path + " has " + std::to_string(file.size()) +
                                " projections: expected --projections with those to take, 0 to " +
                                std::to_string(file.size() - 1));
  }
  const Eigen::Vector2i size = imageSizeOf(options, path);
  const Eigen::Vector2d pitch = pixelPitchOf(options, path);
  const double unit = options.unit.value_or(1.0);
  std::vector<ImportedView> views;
  for (const int n : options.projections)
  {
    if (n < 0 || n >= static_cast<int>(file.size()))
    {
      throw std::invalid_argument("--projections: " + std::to_string(n) + ": expected 0 to " +
                                  std::to_string(file.size() - 1) + ", which " + path + " has");
    }
    std::map<std::string, double> of = file.parameters(static_cast<std::size_t>(n));
    const double sid = of["SourceToIsocenterDistance"];
    const double sdd = of["SourceToDetectorDistance"];
    const std::string where = file.whereProjection(static_cast<std::size_t>(n));
    if (sdd == 0.0)
    {
      fail(where, "SourceToDetectorDistance is 0, parallel rays: expected a source");
    }
    if (!(sid > 0.0 && sdd > 0.0))
    {
      fail(where, sentence("SourceToIsocenterDistance is ", sid, ", SourceToDetectorDistance ", sdd,
                           ": expected positive distances"));
    }
    if (sid >= sdd)
    {
      std::ostringstream what;
      what << "SourceToIsocenterDistance is " << sid << ", SourceToDetectorDistance " << sdd
           << ": expected the panel beyond the isocentre; are they swapped?";
      fail(where, what.str());
    }
    // RTK's documentation, "3D Projection Geometry": everything in the axes of the panel.
    const Eigen::Matrix3d panel_from_room =
        (Eigen::AngleAxisd(-of["InPlaneAngle"] * kDegree, Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(-of["OutOfPlaneAngle"] * kDegree, Eigen::Vector3d::UnitX()) *
         Eigen::AngleAxisd(-of["GantryAngle"] * kDegree, Eigen::Vector3d::UnitY()))
            .toRotationMatrix();
    const Eigen::Vector3d source(of["SourceOffsetX"], of["SourceOffsetY"], sid);
    const Eigen::Vector3d panel(of["ProjectionOffsetX"], of["ProjectionOffsetY"], sid - sdd);
    ProjectionMatrix matrix;
    matrix << panel_from_room, -source;
    Eigen::Matrix3d projection;
    projection << -sdd, 0.0, source.x() - panel.x(), 0.0, -sdd, source.y() - panel.y(), 0.0, 0.0, 1.0;
    file.checkMatrix(static_cast<std::size_t>(n), projection * matrix);

    DetectorDescription description;
    description.image_size = size;
    description.pixel_pitch = pitch;
    description.source = panel_from_room.transpose() * source * unit;
    description.x_direction = panel_from_room.row(0);
    description.y_direction = panel_from_room.row(1);
    // The image's middle is RTK's origin.
    const Eigen::Vector2d corner = -0.5 * (size.cast<double>().array() - 1.0).matrix().cwiseProduct(pitch);
    description.origin = panel_from_room.transpose() * panel * unit + description.x_direction * corner.x() +
                         description.y_direction * corner.y();
    ImportedView view = viewOf(description, where);
    view.flip = "rows";
    view.hint = "RTK's second axis points up: as its first row, an image has what is lowest";
    views.push_back(view);
  }
  return views;
}
}  // namespace xray_tracking
