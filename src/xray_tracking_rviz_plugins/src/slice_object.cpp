#include "slice_object.h"

#include <OgreHardwarePixelBuffer.h>
#include <OgreManualObject.h>
#include <OgreMaterialManager.h>
#include <OgreSceneManager.h>
#include <OgreSceneNode.h>
#include <OgreTechnique.h>
#include <OgreTextureManager.h>

namespace xray_tracking
{
SliceObject::SliceObject(Ogre::SceneManager* scene, Ogre::SceneNode* parent)
  : scene_(scene), node_(parent->createChildSceneNode())
{
  static int count = 0;
  const std::string name = "xray_tracking_slice_" + std::to_string(count++);
  plane_ = scene_->createManualObject(name);
  plane_->setDynamic(true);
  plane_->setRenderQueueGroup(Ogre::RENDER_QUEUE_6);
  node_->attachObject(plane_);
  material_ =
      Ogre::MaterialManager::getSingleton().create(name, Ogre::ResourceGroupManager::DEFAULT_RESOURCE_GROUP_NAME);
  material_->setReceiveShadows(false);
  material_->setLightingEnabled(false);
  material_->setCullingMode(Ogre::CULL_NONE);
  material_->setSceneBlending(Ogre::SBT_TRANSPARENT_ALPHA);
}

SliceObject::~SliceObject()
{
  scene_->destroyManualObject(plane_);
  scene_->destroySceneNode(node_);
  Ogre::MaterialManager::getSingleton().remove(material_->getName(), material_->getGroup());
  if (texture_)
  {
    Ogre::TextureManager::getSingleton().remove(texture_->getName(), texture_->getGroup());
  }
}

void SliceObject::setSlice(const CtSlice& slice)
{
  slice_ = slice;
  const auto point = [&](double column, double row)
  {
    const Eigen::Vector3d p = 1e-3 * (slice.origin + column * slice.column_step + row * slice.row_step);
    return Ogre::Vector3(static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z()));
  };
  const double right = slice.hu.cols - 0.5;
  const double bottom = slice.hu.rows - 0.5;
  plane_->clear();
  plane_->begin(material_->getName(), Ogre::RenderOperation::OT_TRIANGLE_STRIP);
  plane_->position(point(-0.5, -0.5));
  plane_->textureCoord(0.0F, 0.0F);
  plane_->position(point(-0.5, bottom));
  plane_->textureCoord(0.0F, 1.0F);
  plane_->position(point(right, -0.5));
  plane_->textureCoord(1.0F, 0.0F);
  plane_->position(point(right, bottom));
  plane_->textureCoord(1.0F, 1.0F);
  plane_->end();
  draw();
}

void SliceObject::setWindow(double level, double window)
{
  level_ = level;
  window_ = window;
  draw();
}

void SliceObject::draw()
{
  if (slice_.hu.empty())
  {
    return;
  }
  const auto columns = static_cast<Ogre::uint32>(slice_.hu.cols);
  const auto rows = static_cast<Ogre::uint32>(slice_.hu.rows);
  if (!texture_)
  {
    texture_ = Ogre::TextureManager::getSingleton().createManual(
        material_->getName() + "_texture", Ogre::ResourceGroupManager::DEFAULT_RESOURCE_GROUP_NAME, Ogre::TEX_TYPE_2D,
        columns, rows, 0, Ogre::PF_BYTE_LA);
    Ogre::Pass* pass = material_->getTechnique(0)->getPass(0);
    pass->createTextureUnitState(texture_->getName())->setTextureFiltering(Ogre::TFO_BILINEAR);
  }
  // What is air is not shown.
  const cv::Mat grey = windowed(slice_.hu, level_, window_);
  cv::Mat alpha = slice_.hu > -500;
  cv::Mat both;
  cv::merge(std::vector<cv::Mat>{ grey, alpha }, both);
  texture_->getBuffer()->blitFromMemory(Ogre::PixelBox(columns, rows, 1, Ogre::PF_BYTE_LA, both.data));
}

void SliceObject::setOpacity(double opacity)
{
  Ogre::Pass* pass = material_->getTechnique(0)->getPass(0);
  if (pass->getNumTextureUnitStates() > 0)
  {
    pass->getTextureUnitState(0)->setAlphaOperation(Ogre::LBX_MODULATE, Ogre::LBS_TEXTURE, Ogre::LBS_MANUAL, 1.0,
                                                    opacity);
  }
  pass->setDepthWriteEnabled(opacity > 0.99);
}

void SliceObject::setVisible(bool visible)
{
  plane_->setVisible(visible);
}
}  // namespace xray_tracking
