#include "radiograph_plane.h"

#include <array>
#include <atomic>

#include <OgreHardwarePixelBuffer.h>
#include <OgreManualObject.h>
#include <OgreMaterialManager.h>
#include <OgreSceneManager.h>
#include <OgreSceneNode.h>
#include <OgreTechnique.h>
#include <OgreTextureManager.h>
#include <rviz/ogre_helpers/billboard_line.h>
#include <rviz/ogre_helpers/shape.h>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
const Ogre::ColourValue kOutlineColour(0.55F, 0.65F, 0.75F, 0.9F);
const Ogre::ColourValue kRayColour(1.0F, 0.83F, 0.35F, 0.8F);
const Ogre::ColourValue kEdgeColour(1.0F, 0.83F, 0.35F, 0.3F);
const Ogre::ColourValue kFieldColour(1.0F, 0.83F, 0.35F, 0.035F);
constexpr float kLineWidth = 0.0012F;     // [m]
constexpr float kSourceDiameter = 0.05F;  // [m]

/// All of a line in one colour; setting it is what makes a line of rviz's transparent.
void colourLine(rviz::BillboardLine& line, const Ogre::ColourValue& colour)
{
  line.setColor(colour.r, colour.g, colour.b, colour.a);
}

Ogre::MaterialPtr makeMaterial(const std::string& name)
{
  Ogre::MaterialPtr material =
      Ogre::MaterialManager::getSingleton().create(name, Ogre::ResourceGroupManager::DEFAULT_RESOURCE_GROUP_NAME, true);
  material->setReceiveShadows(false);
  material->setLightingEnabled(false);
  material->setCullingMode(Ogre::CULL_NONE);
  return material;
}

/// A pixel position on the panel, optical frame [m].
Ogre::Vector3 onPanel(const ProjectionGeometry& geometry, double u, double v)
{
  const double distance = geometry.sourceToDetector() / kMillimetresPerMetre;
  const Eigen::Array2d slope = (Eigen::Array2d(u, v) - geometry.foot().array()) / geometry.focalLength().array();
  return { static_cast<float>(slope.x() * distance), static_cast<float>(slope.y() * distance),
           static_cast<float>(distance) };
}
}  // namespace

RadiographPlane::RadiographPlane(Ogre::SceneManager* scene, Ogre::SceneNode* parent)
  : scene_(scene), node_(parent->createChildSceneNode()), rays_node_(node_->createChildSceneNode())
{
  static std::atomic<int> count{ 0 };
  name_ = "xray_tracking_radiograph_" + std::to_string(count++);
  plane_ = scene_->createManualObject(name_ + "_plane");
  field_ = scene_->createManualObject(name_ + "_field");
  plane_->setDynamic(true);
  field_->setDynamic(true);
  // After all that is opaque, and the field after the image that it ends at.
  plane_->setRenderQueueGroup(Ogre::RENDER_QUEUE_6);
  field_->setRenderQueueGroup(Ogre::RENDER_QUEUE_7);
  node_->attachObject(plane_);
  rays_node_->attachObject(field_);
  material_ = makeMaterial(name_ + "_image");
  field_material_ = makeMaterial(name_ + "_field");
  field_material_->setSceneBlending(Ogre::SBT_TRANSPARENT_ALPHA);
  field_material_->setDepthWriteEnabled(false);
  outline_ = std::make_unique<rviz::BillboardLine>(scene_, node_);
  edges_ = std::make_unique<rviz::BillboardLine>(scene_, rays_node_);
  central_ray_ = std::make_unique<rviz::BillboardLine>(scene_, rays_node_);
  source_ = std::make_unique<rviz::Shape>(rviz::Shape::Sphere, scene_, rays_node_);
  source_->setScale(Ogre::Vector3(kSourceDiameter));
  source_->setColor(kRayColour.r, kRayColour.g, kRayColour.b, 1.0F);
}

RadiographPlane::~RadiographPlane()
{
  outline_.reset();
  edges_.reset();
  central_ray_.reset();
  source_.reset();
  scene_->destroyManualObject(plane_);
  scene_->destroyManualObject(field_);
  Ogre::MaterialManager::getSingleton().remove(material_->getName());
  Ogre::MaterialManager::getSingleton().remove(field_material_->getName());
  if (texture_unit_ != nullptr)
  {
    Ogre::TextureManager::getSingleton().remove(texture_->getName());
  }
  scene_->destroySceneNode(rays_node_);
  scene_->destroySceneNode(node_);
}

void RadiographPlane::setGeometry(const ProjectionGeometry& geometry)
{
  const Eigen::Vector2d size = geometry.imageSize().cast<double>();
  // Edges of pixels, not their centres.
  const std::array<Ogre::Vector3, 4> corners{ onPanel(geometry, -0.5, -0.5), onPanel(geometry, size.x() - 0.5, -0.5),
                                              onPanel(geometry, size.x() - 0.5, size.y() - 0.5),
                                              onPanel(geometry, -0.5, size.y() - 0.5) };
  const std::array<Ogre::Vector2, 4> texture_corners{ { { 0, 0 }, { 1, 0 }, { 1, 1 }, { 0, 1 } } };

  plane_->clear();
  plane_->begin(material_->getName(), Ogre::RenderOperation::OT_TRIANGLE_LIST);
  for (std::size_t i = 0; i < corners.size(); ++i)
  {
    plane_->position(corners[i]);
    plane_->textureCoord(texture_corners[i]);
  }
  plane_->quad(0, 1, 2, 3);
  plane_->end();

  field_->clear();
  field_->begin(field_material_->getName(), Ogre::RenderOperation::OT_TRIANGLE_LIST);
  field_->position(Ogre::Vector3::ZERO);
  field_->colour(kFieldColour);
  for (const Ogre::Vector3& corner : corners)
  {
    field_->position(corner);
    field_->colour(kFieldColour);
  }
  for (std::uint32_t i = 0; i < 4; ++i)
  {
    field_->triangle(0, 1 + i, 1 + (i + 1) % 4);
  }
  field_->end();

  outline_->clear();
  outline_->setNumLines(1);
  outline_->setMaxPointsPerLine(5);
  outline_->setLineWidth(kLineWidth);
  edges_->clear();
  edges_->setNumLines(4);
  edges_->setMaxPointsPerLine(2);
  edges_->setLineWidth(0.6F * kLineWidth);
  for (std::size_t i = 0; i < 5; ++i)
  {
    outline_->addPoint(corners[i % 4], kOutlineColour);
  }
  for (std::size_t i = 0; i < 4; ++i)
  {
    edges_->addPoint(Ogre::Vector3::ZERO, kEdgeColour);
    edges_->addPoint(corners[i], kEdgeColour);
    if (i < 3)
    {
      edges_->newLine();
    }
  }
  central_ray_->clear();
  central_ray_->setNumLines(1);
  central_ray_->setMaxPointsPerLine(2);
  central_ray_->setLineWidth(kLineWidth);
  central_ray_->addPoint(Ogre::Vector3::ZERO, kRayColour);
  central_ray_->addPoint(onPanel(geometry, geometry.foot().x(), geometry.foot().y()), kRayColour);
  colourLine(*outline_, kOutlineColour);
  colourLine(*edges_, kEdgeColour);
  colourLine(*central_ray_, kRayColour);
}

void RadiographPlane::setImage(const cv::Mat& grey)
{
  const auto width = static_cast<std::uint32_t>(grey.cols), height = static_cast<std::uint32_t>(grey.rows);
  if (texture_unit_ == nullptr || texture_->getWidth() != width || texture_->getHeight() != height)
  {
    Ogre::Pass* pass = material_->getTechnique(0)->getPass(0);
    pass->removeAllTextureUnitStates();
    if (texture_unit_ != nullptr)
    {
      Ogre::TextureManager::getSingleton().remove(texture_->getName());
    }
    texture_ = Ogre::TextureManager::getSingleton().createManual(
        name_ + "_texture", Ogre::ResourceGroupManager::DEFAULT_RESOURCE_GROUP_NAME, Ogre::TEX_TYPE_2D, width, height,
        0, Ogre::PF_L8, Ogre::TU_DYNAMIC_WRITE_ONLY_DISCARDABLE);
    texture_unit_ = pass->createTextureUnitState(texture_->getName());
    texture_unit_->setTextureAddressingMode(Ogre::TextureUnitState::TAM_CLAMP);
    texture_unit_->setTextureFiltering(Ogre::TFO_BILINEAR);
    setOpacity(opacity_);
  }
  const cv::Mat tight = grey.isContinuous() ? grey : grey.clone();
  texture_->getBuffer()->blitFromMemory(Ogre::PixelBox(width, height, 1, Ogre::PF_L8, tight.data));
}

void RadiographPlane::setOpacity(double opacity)
{
  opacity_ = opacity;
  const bool clear = opacity < 0.999;
  material_->setSceneBlending(clear ? Ogre::SBT_TRANSPARENT_ALPHA : Ogre::SBT_REPLACE);
  material_->setDepthWriteEnabled(!clear);
  if (texture_unit_ != nullptr)
  {
    texture_unit_->setAlphaOperation(Ogre::LBX_SOURCE1, Ogre::LBS_MANUAL, Ogre::LBS_CURRENT,
                                     static_cast<float>(opacity));
  }
}

void RadiographPlane::setRaysVisible(bool visible)
{
  rays_node_->setVisible(visible);
}

void RadiographPlane::setVisible(bool visible)
{
  node_->setVisible(visible);
}
}  // namespace xray_tracking
