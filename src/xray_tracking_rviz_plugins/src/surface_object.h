#pragma once

#include <string>

#include <OgreColourValue.h>
#include <OgreMaterial.h>
#include <OgreMesh.h>

#include "surface_mesh.h"

namespace Ogre
{
class Entity;
class SceneManager;
class SceneNode;
}  // namespace Ogre

namespace xray_tracking
{
/// A surface in the 3D scene, lit, of one colour. For the GUI thread alone.
class SurfaceObject
{
public:
  SurfaceObject(Ogre::SceneManager* scene, Ogre::SceneNode* parent);
  ~SurfaceObject();

  SurfaceObject(const SurfaceObject&) = delete;
  SurfaceObject& operator=(const SurfaceObject&) = delete;

  Ogre::SceneNode* node() const { return node_; }

  /// @param mesh [mm], which become metres; empty: nothing is shown
  void setMesh(const SurfaceMesh& mesh);
  /// The mesh of another one, which has to live as long.
  void setMesh(const SurfaceObject& other);
  void setColour(const Ogre::ColourValue& colour, float opacity);
  void setVisible(bool visible);

private:
  void clear();
  void show(const Ogre::MeshPtr& mesh);

  Ogre::SceneManager* scene_;
  Ogre::SceneNode* node_;
  Ogre::Entity* entity_ = nullptr;
  Ogre::MeshPtr mesh_;  ///< its own
  Ogre::MaterialPtr material_;
  bool visible_ = true;
};
}  // namespace xray_tracking
