#include "anatomy_display.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include <OgreSceneManager.h>
#include <OgreSceneNode.h>
#include <rviz/display_context.h>
#include <rviz/frame_manager.h>
#include <rviz/ogre_helpers/billboard_line.h>
#include <rviz/ogre_helpers/movable_text.h>
#include <rviz/ogre_helpers/shape.h>
#include <rviz/properties/bool_property.h>
#include <rviz/properties/color_property.h>
#include <rviz/properties/float_property.h>
#include <Eigen/Eigenvalues>
#include <pluginlib/class_list_macros.hpp>

#include "anatomy_loader.h"
#include "bag_recorder.h"
#include "look.h"
#include "pose_message.h"
#include "slice_object.h"
#include "surface_object.h"
#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
using rviz::StatusProperty;

constexpr double kOldPose = 2.0;        ///< from when on a pose is told as old [s]
constexpr double kAlignmentLife = 1.5;  ///< of a pose that is being tried out by hand [s]
constexpr float kFaded = 0.25F;         ///< of the opacity, where no pose is known now
constexpr double kEllipsoid = 12.0;     ///< semi-axis that an ellipsoid has at least [mm]
const Ogre::ColourValue kGhost(0.25F, 0.95F, 0.55F);

Ogre::Vector3 metres(const Eigen::Vector3d& point)
{
  const Eigen::Vector3f p = (point / kMillimetresPerMetre).cast<float>();
  return { p.x(), p.y(), p.z() };
}

Ogre::Quaternion ogre(const Eigen::Matrix3d& rotation)
{
  const Eigen::Quaternionf q(rotation.cast<float>());
  return { q.w(), q.x(), q.y(), q.z() };
}

void place(Ogre::SceneNode* node, const RigidTransform& transform)
{
  node->setPosition(metres(transform.translation()));
  node->setOrientation(ogre(transform.linear()));
}

double age(const ros::SteadyTime& since)
{
  return (ros::SteadyTime::now() - since).toSec();
}
}  // namespace

AnatomyDisplay::AnatomyDisplay()
{
  const auto flag = [this](const char* name, bool on, const char* description, rviz::Property* parent = nullptr) {
    return new rviz::BoolProperty(name, on, description, parent != nullptr ? parent : this, SLOT(updateLook()), this);
  };
  const auto number =
      [this](const char* name, float value, float least, float most, const char* description, rviz::Property* parent)
  {
    auto* property = new rviz::FloatProperty(name, value, description, parent, SLOT(updateLook()), this);
    property->setMin(least);
    property->setMax(most);
    return property;
  };
  bones_ = flag("Bones", true, "The bones of the CT, but for the target");
  bone_colour_ =
      new rviz::ColorProperty("Colour", QColor(0xdc, 0xd2, 0xbc), "Of the bones", bones_, SLOT(updateLook()), this);
  bone_opacity_ = number("Opacity", 1.0F, 0.0F, 1.0F, "Of the bones", bones_);
  target_ = flag("Target", true, "The bone that is followed");
  target_colour_ = new rviz::ColorProperty("Colour", look::kTarget, "Of the target", target_, SLOT(updateLook()), this);
  target_opacity_ = number("Opacity", 1.0F, 0.0F, 1.0F, "Of the target", target_);
  box_ = flag("Target box", true, "The setup file's target box, over which errors are counted");
  auto* planes = new rviz::Property("CT planes", QVariant(), "Planes of the CT through the target's centre", this);
  slices_ = { flag("Sagittal", false, "From front to back", planes),
              flag("Coronal", false, "From left to right", planes), flag("Axial", false, "Across", planes) };
  level_ = number("Level", 150.0F, -1024.0F, 3000.0F, "HU that is shown in middle grey", planes);
  window_ = number("Window", 1200.0F, 1.0F, 6000.0F, "Difference of HU from black to white", planes);
  slice_opacity_ = number("Opacity", 1.0F, 0.0F, 1.0F, "Of the planes", planes);
  truth_ = flag("True target", true, "Where the target really is, if something on patient_ground_truth says so");
  truth_opacity_ = number("Opacity", 0.35F, 0.0F, 1.0F, "Of the true target", truth_);
  ellipsoid_ = flag("Uncertainty", true,
                    "Standard deviation of the target's centre in all directions, by the covariance of patient_pose, "
                    "enlarged as is written beside it");
}

AnatomyDisplay::~AnatomyDisplay()
{
  pose_subscriber_.shutdown();
  truth_subscriber_.shutdown();
  alignment_subscriber_.shutdown();
  volume_subscriber_.shutdown();
  if (initialized())
  {
    bone_surface_.reset();
    target_surface_.reset();
    ghost_.reset();
    slice_objects_ = {};
    box_lines_.reset();
    ellipsoid_shape_.reset();
    text_node_->detachAllObjects();
    ellipsoid_text_.reset();
    scene_manager_->destroySceneNode(text_node_);
    scene_manager_->destroySceneNode(patient_node_);
    scene_manager_->destroySceneNode(room_node_);
  }
}

void AnatomyDisplay::onInitialize()
{
  room_node_ = scene_node_->createChildSceneNode();
  patient_node_ = room_node_->createChildSceneNode();
  bone_surface_ = std::make_unique<SurfaceObject>(scene_manager_, patient_node_);
  target_surface_ = std::make_unique<SurfaceObject>(scene_manager_, patient_node_);
  // Before the target, whose mesh it borrows, it goes.
  ghost_ = std::make_unique<SurfaceObject>(scene_manager_, room_node_);
  for (auto& slice : slice_objects_)
  {
    slice = std::make_unique<SliceObject>(scene_manager_, patient_node_);
  }
  box_lines_ = std::make_unique<rviz::BillboardLine>(scene_manager_, patient_node_);
  ellipsoid_shape_ = std::make_unique<rviz::Shape>(rviz::Shape::Sphere, scene_manager_, room_node_);
  ellipsoid_text_ =
      std::make_unique<rviz::MovableText>(" ", "Liberation Sans", 0.012F, Ogre::ColourValue(0.85F, 0.95F, 1.0F));
  ellipsoid_text_->setTextAlignment(rviz::MovableText::H_LEFT, rviz::MovableText::V_CENTER);
  // Seen through the bone that it is in.
  ellipsoid_text_->showOnTop(true);
  ellipsoid_shape_->getMaterial()->setDepthCheckEnabled(false);
  text_node_ = room_node_->createChildSceneNode();
  text_node_->attachObject(ellipsoid_text_.get());
  loader_ = std::make_unique<AnatomyLoader>((dataFolder() + "/anatomy").toStdString());
  updateLook();
}

void AnatomyDisplay::onEnable()
{
  watch_ = std::make_unique<RoomWatch>(update_nh_);
  pose_subscriber_ = update_nh_.subscribe("patient_pose", 1, &AnatomyDisplay::poseCb, this);
  truth_subscriber_ = update_nh_.subscribe("patient_ground_truth", 1, &AnatomyDisplay::truthCb, this);
  alignment_subscriber_ = update_nh_.subscribe("alignment_pose", 1, &AnatomyDisplay::alignmentCb, this);
  volume_subscriber_ = update_nh_.subscribe("registration/volume", 1, &AnatomyDisplay::volumeCb, this);
}

void AnatomyDisplay::onDisable()
{
  pose_subscriber_.shutdown();
  truth_subscriber_.shutdown();
  alignment_subscriber_.shutdown();
  volume_subscriber_.shutdown();
  watch_.reset();
}

void AnatomyDisplay::reset()
{
  rviz::Display::reset();
  pose_.reset();
  truth_message_.reset();
  alignment_.reset();
}

void AnatomyDisplay::poseCb(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& message)
{
  pose_ = message;
  pose_arrival_ = ros::SteadyTime::now();
}

void AnatomyDisplay::truthCb(const geometry_msgs::PoseStamped::ConstPtr& message)
{
  truth_message_ = message;
  truth_arrival_ = ros::SteadyTime::now();
}

void AnatomyDisplay::volumeCb(const std_msgs::String::ConstPtr& message)
{
  wanted_ = wanted_ || volume_ != message->data;
  volume_ = message->data;
}

void AnatomyDisplay::alignmentCb(const geometry_msgs::PoseStamped::ConstPtr& message)
{
  alignment_ = message;
  alignment_arrival_ = ros::SteadyTime::now();
}

void AnatomyDisplay::updateLook()
{
  if (!bone_surface_)
  {
    return;  // before onInitialize()
  }
  const auto truth_opacity = truth_opacity_->getFloat();
  const float fading = faded_ ? kFaded : 1.0F;
  bone_surface_->setColour(bone_colour_->getOgreColor(), fading * bone_opacity_->getFloat());
  bone_surface_->setVisible(bones_->getBool());
  target_surface_->setColour(target_colour_->getOgreColor(), fading * target_opacity_->getFloat());
  target_surface_->setVisible(target_->getBool());
  ghost_->setColour(kGhost, std::min(truth_opacity, 0.99F));
  for (std::size_t i = 0; i < slices_.size(); ++i)
  {
    slice_objects_[i]->setWindow(level_->getFloat(), window_->getFloat());
    slice_objects_[i]->setOpacity(slice_opacity_->getFloat());
    slice_objects_[i]->setVisible(slices_[i]->getBool());
  }
  box_lines_->getSceneNode()->setVisible(box_->getBool());
  context_->queueRender();
}

void AnatomyDisplay::followRoom()
{
  const Room room = watch_->room();
  const bool changed = room.setup != setup_;
  setup_ = room.setup;
  if (!setup_)
  {
    setStatusStd(StatusProperty::Warn, "CT", room.asked ? room.setup_fault : "asking for the treatment room's setup");
    return;
  }
  wanted_ = wanted_ || changed;
  if (wanted_ && loader_->busy())
  {
    loader_->cancel();
  }
  else if (wanted_)
  {
    std::string source = setup_->ct_path.empty() ? "phantom" : "ct";
    // Kept up to date by the master itself: no call to it from here.
    if (!update_nh_.getParamCached("registration/source", source))
    {
      update_nh_.getParamCached("detector_simulator/source", source);
    }
    // The registration's own word goes before.
    const std::string ct_path = volume_.value_or(source == "phantom" ? "" : setup_->ct_path);
    shown_ = ct_path.empty() ? "the neck phantom" : ct_path;
    AnatomySource anatomy{ ct_path.empty(), ct_path, setup_->ct_content, setup_->target_box, setup_->ct_choice, {} };
    if (!ct_path.empty() && ct_path != setup_->ct_path)
    {
      anatomy.data_folder = room.data_folder;  // anybody may publish a path
    }
    loader_->load(anatomy);
    wanted_ = false;
  }
  const std::string& what = shown_;
  if (!loader_->fault().empty())
  {
    setStatusStd(StatusProperty::Error, "CT", loader_->fault());
  }
  else if (loader_->busy())
  {
    setStatusStd(StatusProperty::Warn, "CT", "finding the bones of " + what + " ...");
  }
  else
  {
    setStatusStd(StatusProperty::Ok, "CT", what);
  }
}

void AnatomyDisplay::take(const Anatomy& anatomy)
{
  ghost_->setMesh(SurfaceMesh());
  bone_surface_->setMesh(anatomy.rest);
  target_surface_->setMesh(anatomy.target);
  ghost_->setMesh(*target_surface_);
  for (std::size_t i = 0; i < slices_.size(); ++i)
  {
    slice_objects_[i]->setSlice(anatomy.slices[i]);
  }
  box_lines_->clear();
  box_lines_->setLineWidth(0.0008F);
  const Ogre::ColourValue colour = target_colour_->getOgreColor();
  box_lines_->setColor(colour.r, colour.g, colour.b, 0.9F);
  box_lines_->setNumLines(12);
  box_lines_->setMaxPointsPerLine(2);
  const auto corner = [&](int i)
  { return metres(setup_->target_box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(i))); };
  bool first = true;
  for (int a = 0; a < 8; ++a)
  {
    for (const int bit : { 1, 2, 4 })
    {
      if ((a & bit) == 0)
      {
        if (!first)
        {
          box_lines_->newLine();
        }
        first = false;
        box_lines_->addPoint(corner(a));
        box_lines_->addPoint(corner(a | bit));
      }
    }
  }
  updateLook();
}

bool AnatomyDisplay::placeRoom()
{
  Ogre::Vector3 position;
  Ogre::Quaternion orientation;
  const bool known = context_->getFrameManager()->getTransform(kRoomFrame, ros::Time(), position, orientation);
  if (known)
  {
    room_node_->setPosition(position);
    room_node_->setOrientation(orientation);
    deleteStatus("Room");
  }
  else
  {
    setStatusStd(StatusProperty::Error, "Room",
                 "no transform from " + std::string(kRoomFrame) +
                     " to the fixed frame: set Global Options, Fixed Frame "
                     "to " +
                     kRoomFrame + ", and see whether treatment_room_publisher runs");
  }
  return known;
}

void AnatomyDisplay::placePatient()
{
  if (alignment_ && age(alignment_arrival_) < kAlignmentLife)
  {
    if (const std::optional<RigidTransform> tried = rigidOf(alignment_->pose))
    {
      fade(false);
      place(patient_node_, *tried);
      setStatusStd(StatusProperty::Warn, "Pose", "as it is being aligned by hand, not the patient's");
      return;
    }
  }
  // The pose itself and not the last transform of tf, which does not say how old it is.
  const std::optional<RigidTransform> pose = pose_ ? rigidOf(pose_->pose.pose) : std::nullopt;
  const bool old = age(pose_arrival_) > kOldPose;
  fade(!pose || old);
  place(patient_node_, pose ? *pose : setup_->room_from_patient);
  if (pose_ && !pose)
  {
    setStatusStd(StatusProperty::Error, "Pose",
                 "what came on patient_pose is no pose: shown at the setup's initial pose");
  }
  else if (!pose)
  {
    setStatusStd(StatusProperty::Warn, "Pose", "nothing on patient_pose so far: shown at the setup's initial pose");
  }
  else if (old)
  {
    setStatus(StatusProperty::Warn, "Pose", "no pose since " + QString::number(age(pose_arrival_), 'f', 0) + " s");
  }
  else
  {
    setStatusStd(StatusProperty::Ok, "Pose", "as on patient_pose");
  }
}

void AnatomyDisplay::fade(bool faded)
{
  if (faded != faded_)
  {
    faded_ = faded;
    updateLook();
  }
}

void AnatomyDisplay::placeGhost()
{
  const std::optional<RigidTransform> pose =
      truth_message_ && age(truth_arrival_) < kOldPose ? rigidOf(truth_message_->pose) : std::nullopt;
  if (pose)
  {
    place(ghost_->node(), *pose);
  }
  ghost_->setVisible(pose && truth_->getBool());
}

void AnatomyDisplay::placeEllipsoid()
{
  const std::optional<RigidTransform> pose = pose_ ? rigidOf(pose_->pose.pose) : std::nullopt;
  std::optional<Eigen::Matrix3d> covariance;
  if (pose && ellipsoid_->getBool() && age(pose_arrival_) < kOldPose)
  {
    try
    {
      covariance = pointCovariance(covarianceFromPoseMsg(pose_->pose), pose->linear() * setup_->targetCentre());
    }
    catch (const std::exception&)  // of numbers that are none
    {
    }
  }
  ellipsoid_shape_->getRootNode()->setVisible(covariance.has_value());
  text_node_->setVisible(covariance.has_value());
  if (!covariance)
  {
    return;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(*covariance);
  const Eigen::Vector3d sigmas = axes.eigenvalues().cwiseMax(1e-8).cwiseSqrt();
  const double scale = readableScale(sigmas[2], kEllipsoid);
  Eigen::Matrix3d rotation = axes.eigenvectors();
  rotation.col(2) *= rotation.determinant();
  const Ogre::Vector3 centre = metres(*pose * setup_->targetCentre());
  ellipsoid_shape_->setPosition(centre);
  ellipsoid_shape_->setOrientation(ogre(rotation));
  ellipsoid_shape_->setScale(metres(2.0 * scale * sigmas));
  ellipsoid_shape_->setColor(0.35F, 0.75F, 1.0F, 0.35F);
  const QString text = QString("1 sigma: %1 mm, drawn x %2").arg(sigmas[2], 0, 'f', 2).arg(scale, 0, 'f', 0);
  ellipsoid_text_->setCaption(text.toStdString());
  text_node_->setPosition(centre + Ogre::Vector3(0.0F, 0.0F, static_cast<float>(1e-3 * scale * sigmas[2]) + 0.01F));
}

void AnatomyDisplay::update(float wall_dt, float)
{
  since_room_ += wall_dt;
  if (since_room_ > 0.5F)
  {
    since_room_ = 0.0F;
    followRoom();
  }
  if (const std::shared_ptr<const Anatomy> made = loader_->take(); made && setup_)
  {
    take(*made);
  }
  if (placeRoom() && setup_)
  {
    placePatient();
    placeGhost();
    placeEllipsoid();
  }
}
}  // namespace xray_tracking

PLUGINLIB_EXPORT_CLASS(xray_tracking::AnatomyDisplay, rviz::Display)
