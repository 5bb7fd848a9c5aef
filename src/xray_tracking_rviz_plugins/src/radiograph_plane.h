#pragma once

#include <memory>
#include <string>

#include <OgreColourValue.h>
#include <OgreMaterial.h>
#include <OgreTexture.h>
#include <opencv2/core.hpp>

#include "xray_tracking_core/geometry/projection_geometry.h"

namespace Ogre
{
class ManualObject;
class SceneManager;
class SceneNode;
}  // namespace Ogre

namespace rviz
{
class BillboardLine;
class Shape;
}  // namespace rviz

namespace xray_tracking
{
/// A detector in the 3D scene: its image as a plane, its source, central ray and field of view. For the GUI thread
/// alone. Coordinates are those of the detector's optical frame [m], where the parent node is to be put.
class RadiographPlane
{
public:
  RadiographPlane(Ogre::SceneManager* scene, Ogre::SceneNode* parent);
  ~RadiographPlane();

  RadiographPlane(const RadiographPlane&) = delete;
  RadiographPlane& operator=(const RadiographPlane&) = delete;

  Ogre::SceneNode* node() const { return node_; }

  /// @param geometry in whose optical frame the plane stands; its room_from_optical is not used
  void setGeometry(const ProjectionGeometry& geometry);
  /// @param grey CV_8UC1; the texture stays as long as the size does
  void setImage(const cv::Mat& grey);
  void setOpacity(double opacity);
  void setRaysVisible(bool visible);
  void setVisible(bool visible);

private:
  Ogre::SceneManager* scene_;
  Ogre::SceneNode* node_;
  Ogre::SceneNode* rays_node_;
  std::string name_;
  Ogre::ManualObject* plane_;
  Ogre::ManualObject* field_;  ///< faces of the field of view
  Ogre::MaterialPtr material_;
  Ogre::MaterialPtr field_material_;
  Ogre::TexturePtr texture_;
  Ogre::TextureUnitState* texture_unit_ = nullptr;  ///< none before the first image
  double opacity_ = 1.0;
  std::unique_ptr<rviz::BillboardLine> outline_;
  std::unique_ptr<rviz::BillboardLine> edges_;
  std::unique_ptr<rviz::BillboardLine> central_ray_;
  std::unique_ptr<rviz::Shape> source_;
};
}  // namespace xray_tracking
