#pragma once

#include <OgreMaterial.h>
#include <OgreTexture.h>

#include "anatomy.h"

namespace Ogre
{
class ManualObject;
class SceneManager;
class SceneNode;
}  // namespace Ogre

namespace xray_tracking
{
/// A plane of the CT in the 3D scene. For the GUI thread alone.
class SliceObject
{
public:
  SliceObject(Ogre::SceneManager* scene, Ogre::SceneNode* parent);
  ~SliceObject();

  SliceObject(const SliceObject&) = delete;
  SliceObject& operator=(const SliceObject&) = delete;

  /// @param slice [mm], which become metres
  void setSlice(const CtSlice& slice);
  void setWindow(double level, double window);
  void setOpacity(double opacity);
  void setVisible(bool visible);

private:
  void draw();

  Ogre::SceneManager* scene_;
  Ogre::SceneNode* node_;
  Ogre::ManualObject* plane_;
  Ogre::MaterialPtr material_;
  Ogre::TexturePtr texture_;
  CtSlice slice_;
  double level_ = 100.0, window_ = 1000.0;  ///< [HU]
};
}  // namespace xray_tracking
