#include <stdexcept>

#include "../sequence/yaml_field.h"
#include "imported_view.h"

namespace xray_tracking
{
std::vector<ImportedView> readDetectorList(const std::string& path, const GeometryImportOptions& options)
{
  refuseOptions(path, { { "--image_size", options.image_size.has_value() },
                        { "--pitch", options.pixel_pitch.has_value() },
                        { "--sdd", options.source_to_detector.has_value() },
                        { "--unit", options.unit.value_or(1.0) != 1.0 },
                        { "--projections", !options.projections.empty() } });
  std::vector<ImportedView> views;
  YamlField::fromFile(path)
      .get("detectors")
      .forEachItem(
          [&](const YamlField& item)
          {
            DetectorDescription description;
            description.name = item.get("name").text();
            description.image_size = item.get("image_size").vector<int, 2>();
            description.pixel_pitch = item.get("pixel_pitch_mm").vector<double, 2>();
            if (!(description.pixel_pitch.minCoeff() > 0.0))
            {
              item.get("pixel_pitch_mm").fail("positive numbers");
            }
            description.source = item.get("source_mm").vector<double, 3>();
            description.origin = item.get("origin_mm").vector<double, 3>();
            description.x_direction = item.get("x_direction").vector<double, 3>();
            description.y_direction = item.get("y_direction").vector<double, 3>();
            for (const auto& [key, direction] : { std::make_pair("x_direction", description.x_direction),
                                                  std::make_pair("y_direction", description.y_direction) })
            {
              if (!(std::abs(direction.norm() - 1.0) <= 1e-4))
              {
                item.get(key).fail("a direction of unit norm to 1e-4");
              }
            }
            if (!(std::abs(description.x_direction.dot(description.y_direction)) <= 1e-4))
            {
              item.get("y_direction").fail("a right angle to x_direction to 1e-4");
            }
            ImportedView view = viewOf(description, item.where());
            view.name = description.name;
            if (const auto distortion = item.find("distortion"))
            {
              view.distortion.model = distortion->get("model").text();
              distortion->get("coefficients")
                  .forEachItem([&](const YamlField& value)
                               { view.distortion.values.push_back(value.number<double>()); });
              if (view.distortion.values.size() < 4)
              {
                distortion->get("coefficients").fail("k1, k2, p1, p2 and more");
              }
            }
            view.is_in_mm = true;
            views.push_back(view);
          });
  return views;
}
}  // namespace xray_tracking
