#include "surface_object.h"

#include <OgreEntity.h>
#include <OgreHardwareBufferManager.h>
#include <OgreMaterialManager.h>
#include <OgreMeshManager.h>
#include <OgreSceneManager.h>
#include <OgreSceneNode.h>
#include <OgreSubMesh.h>
#include <OgreTechnique.h>

namespace xray_tracking
{
namespace
{
constexpr float kMetre = 1e-3F;

std::string uniqueName(const char* what)
{
  static int count = 0;
  return std::string("xray_tracking_") + what + "_" + std::to_string(count++);
}
}  // namespace

SurfaceObject::SurfaceObject(Ogre::SceneManager* scene, Ogre::SceneNode* parent)
  : scene_(scene), node_(parent->createChildSceneNode())
{
  material_ = Ogre::MaterialManager::getSingleton().create(uniqueName("surface_material"),
                                                           Ogre::ResourceGroupManager::DEFAULT_RESOURCE_GROUP_NAME);
  material_->setReceiveShadows(false);
  material_->getTechnique(0)->setLightingEnabled(true);
  material_->setCullingMode(Ogre::CULL_NONE);
}

SurfaceObject::~SurfaceObject()
{
  clear();
  Ogre::MaterialManager::getSingleton().remove(material_->getName(), material_->getGroup());
  scene_->destroySceneNode(node_);
}

void SurfaceObject::clear()
{
  if (entity_ != nullptr)
  {
    node_->detachObject(entity_);
    scene_->destroyEntity(entity_);
    entity_ = nullptr;
  }
  if (mesh_)
  {
    Ogre::MeshManager::getSingleton().remove(mesh_->getName(), mesh_->getGroup());
    mesh_.reset();
  }
}

void SurfaceObject::setMesh(const SurfaceMesh& mesh)
{
  clear();
  if (mesh.triangles.empty())
  {
    return;
  }
  const Ogre::MeshPtr made = Ogre::MeshManager::getSingleton().createManual(
      uniqueName("surface"), Ogre::ResourceGroupManager::DEFAULT_RESOURCE_GROUP_NAME);
  Ogre::SubMesh* part = made->createSubMesh();
  part->useSharedVertices = false;
  part->vertexData = new Ogre::VertexData;
  part->vertexData->vertexCount = mesh.points.size();
  Ogre::VertexDeclaration* declaration = part->vertexData->vertexDeclaration;
  declaration->addElement(0, 0, Ogre::VET_FLOAT3, Ogre::VES_POSITION);
  declaration->addElement(0, 3 * sizeof(float), Ogre::VET_FLOAT3, Ogre::VES_NORMAL);
  auto& buffers = Ogre::HardwareBufferManager::getSingleton();
  const Ogre::HardwareVertexBufferSharedPtr vertices =
      buffers.createVertexBuffer(6 * sizeof(float), mesh.points.size(), Ogre::HardwareBuffer::HBU_STATIC_WRITE_ONLY);
  Eigen::AlignedBox3f box;
  auto* to = static_cast<float*>(vertices->lock(Ogre::HardwareBuffer::HBL_DISCARD));
  for (std::size_t i = 0; i < mesh.points.size(); ++i, to += 6)
  {
    const Eigen::Vector3f point = kMetre * mesh.points[i];
    box.extend(point);
    std::copy_n(point.data(), 3, to);
    std::copy_n(mesh.normals[i].data(), 3, to + 3);
  }
  vertices->unlock();
  part->vertexData->vertexBufferBinding->setBinding(0, vertices);
  const Ogre::HardwareIndexBufferSharedPtr indices = buffers.createIndexBuffer(
      Ogre::HardwareIndexBuffer::IT_32BIT, 3 * mesh.triangles.size(), Ogre::HardwareBuffer::HBU_STATIC_WRITE_ONLY);
  indices->writeData(0, indices->getSizeInBytes(), mesh.triangles.data(), true);
  part->indexData->indexBuffer = indices;
  part->indexData->indexCount = 3 * mesh.triangles.size();
  made->_setBounds(
      Ogre::AxisAlignedBox(box.min().x(), box.min().y(), box.min().z(), box.max().x(), box.max().y(), box.max().z()));
  made->_setBoundingSphereRadius(box.max().cwiseAbs().cwiseMax(box.min().cwiseAbs()).norm());
  made->load();
  mesh_ = made;
  show(mesh_);
}

void SurfaceObject::setMesh(const SurfaceObject& other)
{
  clear();
  if (other.mesh_)
  {
    show(other.mesh_);
  }
}

void SurfaceObject::show(const Ogre::MeshPtr& mesh)
{
  entity_ = scene_->createEntity(mesh);
  entity_->setMaterial(material_);
  entity_->setVisible(visible_);
  node_->attachObject(entity_);
}

void SurfaceObject::setColour(const Ogre::ColourValue& colour, float opacity)
{
  Ogre::ColourValue with = colour;
  with.a = opacity;
  Ogre::Technique* technique = material_->getTechnique(0);
  technique->setAmbient(0.35F * colour);
  technique->setDiffuse(with);
  technique->setSpecular(0.08F, 0.08F, 0.08F, opacity);
  technique->setShininess(20.0F);
  const bool transparent = opacity < 0.999F;
  technique->setSceneBlending(transparent ? Ogre::SBT_TRANSPARENT_ALPHA : Ogre::SBT_REPLACE);
  technique->setDepthWriteEnabled(!transparent);
  // Transparent surfaces from behind are clutter.
  material_->setCullingMode(transparent ? Ogre::CULL_CLOCKWISE : Ogre::CULL_NONE);
}

void SurfaceObject::setVisible(bool visible)
{
  visible_ = visible;
  if (entity_ != nullptr)
  {
    entity_->setVisible(visible);
  }
}
}  // namespace xray_tracking
