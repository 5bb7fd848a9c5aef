#include "view_camera.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Dense>

#include "import_words.h"

namespace xray_tracking
{
namespace
{
/// Of a panel that has none; the pixels' edges move by it at most.
constexpr double kMaxSkew = 0.5;         // px
constexpr double kNoMatrix = 1e-9;       // of other rows' norms: no camera
constexpr double kLeastDistance = 0.01;  // mm: in metres by mistake, it shall be told
}  // namespace

Camera cameraOf(const ImportedView& view)
{
  const Eigen::Matrix3d m = view.matrix.leftCols<3>() / view.matrix.row(2).head<3>().norm();
  Camera camera;
  const Eigen::Vector3d normal = m.row(2);
  camera.foot = m.topRows<2>() * normal;
  Eigen::Vector3d along_rows = m.row(1).transpose() - camera.foot.y() * normal;
  camera.focal_length.y() = along_rows.norm();
  along_rows /= camera.focal_length.y();
  Eigen::Vector3d along_columns = m.row(0).transpose() - camera.foot.x() * normal;
  const double skew = along_columns.dot(along_rows);
  along_columns -= skew * along_rows;
  camera.focal_length.x() = along_columns.norm();
  along_columns /= camera.focal_length.x();
  camera.axes << along_columns.transpose(), along_rows.transpose(), normal.transpose();
  camera.source = -view.matrix.leftCols<3>().inverse() * view.matrix.col(3);
  const double edge = std::max(std::abs(camera.foot.y()), std::abs(view.image_size.y() - 1.0 - camera.foot.y()));
  camera.skew = std::abs(skew) * edge / camera.focal_length.y();
  return camera;
}

void checkMatrix(const ImportedView& view)
{
  const Eigen::Matrix3d m = view.matrix.leftCols<3>();
  const double last = m.row(2).norm();
  if (!view.matrix.allFinite() || !(last > kNoMatrix * view.matrix.topLeftCorner<2, 3>().norm()))
  {
    fail(view.where, "the third row of the matrix begins with " + listOf(m.row(2)) +
                         ": expected the direction from the source to the panel; parallel rays have none");
  }
  const Camera camera = cameraOf(view);
  if (!camera.source.allFinite() || !(camera.focal_length.array() > kNoMatrix * (1.0 + camera.foot.norm())).all())
  {
    fail(view.where, "the matrix " +
                         listOf(Eigen::Map<const Eigen::VectorXd>(
                             Eigen::Matrix<double, 4, 3>(view.matrix.transpose()).data(), 12)) +
                         " is no camera's: expected rows that are independent in their first three columns");
  }
  if (!(camera.skew <= kMaxSkew))
  {
    fail(view.where,
         sentence("its pixels are skewed, by ", camera.skew,
                  " px at the image's edge: expected columns and rows at right angles, to ", kMaxSkew, " px"));
  }
}

ImportedView viewOf(const DetectorDescription& description, const std::string& where)
{
  ImportedView view;
  view.where = where;
  view.image_size = description.image_size;
  view.pixel_pitch = description.pixel_pitch;
  view.front_is_known = true;
  Eigen::Vector3d normal = description.x_direction.cross(description.y_direction).normalized();
  Eigen::Vector3d origin = description.origin - description.source;
  if (origin.dot(normal) < 0.0)
  {
    normal = -normal;
  }
  const double sdd = origin.dot(normal);
  if (!(sdd >= kLeastDistance))
  {
    fail(where, "the source is at " + placeOf(description.source) + ", " + sentence(sdd) +
                    " mm from the panel's plane: expected a distance");
  }
  const Eigen::Vector2d foot =
      -Eigen::Vector2d(origin.dot(description.x_direction), origin.dot(description.y_direction))
           .cwiseQuotient(description.pixel_pitch);
  Eigen::Matrix3d camera = Eigen::Matrix3d::Identity();
  camera.diagonal().head<2>() = sdd * description.pixel_pitch.cwiseInverse();
  camera.topRightCorner<2, 1>() = foot;
  Eigen::Matrix3d axes;
  axes << description.x_direction.transpose(), description.y_direction.transpose(), normal.transpose();
  view.matrix << camera * axes, -camera * axes * description.source;
  return view;
}
}  // namespace xray_tracking
