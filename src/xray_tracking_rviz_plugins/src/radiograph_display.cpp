#include "radiograph_display.h"

#include <algorithm>
#include <functional>
#include <iterator>
#include <sstream>

#include <OgreSceneNode.h>
#include <rviz/display_context.h>
#include <rviz/frame_manager.h>
#include <rviz/properties/bool_property.h>
#include <rviz/properties/float_property.h>
#include <rviz/properties/string_property.h>
#include <opencv2/imgproc.hpp>
#include <pluginlib/class_list_macros.hpp>

#include "detector_view.h"
#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
constexpr float kRoomPeriod = 0.5F;  // [s]
constexpr double kOld = 3.0;         // an image, from when on it is said [s]
constexpr int kMaxTexture = 1024;    // pixels that a plane in a scene has use for
}  // namespace

RadiographDisplay::Detector::Detector(const ros::NodeHandle& nh, const std::string& name, Ogre::SceneManager* scene,
                                      Ogre::SceneNode* parent)
  : plane(std::make_unique<RadiographPlane>(scene, parent))
{
  plane->setVisible(false);
  worker_ = std::make_unique<Worker>([this] { convert(); });
  feed_ = std::make_unique<RadiographFeed>(nh, name,
                                           [this](const sensor_msgs::ImageConstPtr& image)
                                           {
                                             {
                                               const std::lock_guard<std::mutex> lock(mutex_);
                                               image_ = image;
                                             }
                                             worker_->wake();
                                           });
}

void RadiographDisplay::Detector::set(const Settings& settings)
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    settings_ = settings;
  }
  worker_->wake();
}

bool RadiographDisplay::Detector::take(cv::Mat& grey, std::string& fault)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  fault = fault_;
  if (!fresh_)
  {
    return false;
  }
  cv::swap(grey, grey_);
  fresh_ = false;
  return true;
}

void RadiographDisplay::Detector::clear()
{
  feed_->clear();
  const std::lock_guard<std::mutex> lock(mutex_);
  fresh_ = false;
  image_.reset();
  fault_.clear();
}

void RadiographDisplay::Detector::convert()
{
  Settings settings;
  sensor_msgs::ImageConstPtr image;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    settings = settings_;
    image = image_;
  }
  if (!image)
  {
    return;
  }
  cv::Mat grey;
  std::string fault;
  try
  {
    cv::Mat pixels = pixelsOf(image);
    const int factor = (std::max(pixels.cols, pixels.rows) + kMaxTexture - 1) / kMaxTexture;
    if (factor > 1)
    {
      cv::resize(pixels, pixels, cv::Size(), 1.0 / factor, 1.0 / factor, cv::INTER_AREA);
    }
    const GreyWindow window =
        settings.automatic ? follower_.follow(automaticWindow(pixels, settings.window.logarithmic)) : settings.window;
    scale_.convert(pixels, window, settings.inverted, grey);
  }
  catch (const std::exception& error)
  {
    fault = error.what();
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  fault_ = fault;
  fresh_ = fault.empty();
  cv::swap(grey_, grey);
}

RadiographDisplay::RadiographDisplay()
{
  detectors_property_ = new rviz::StringProperty(
      "Detectors", "", "Names of the detectors to show, separated by spaces; empty: all that there are.", this,
      SLOT(updateDetectors()));
  automatic_property_ =
      new rviz::BoolProperty("Automatic window", true, "Grey values follow the image: its 1st and 99th percentile.",
                             this, SLOT(updateWindow()));
  black_property_ =
      new rviz::FloatProperty("Black at", 0.0F, "Pixel value that is shown black.", this, SLOT(updateWindow()));
  white_property_ =
      new rviz::FloatProperty("White at", 65535.0F, "Pixel value that is shown white.", this, SLOT(updateWindow()));
  inverted_property_ =
      new rviz::BoolProperty("Inverted", false, "Small pixel values bright.", this, SLOT(updateWindow()));
  opacity_property_ = new rviz::FloatProperty("Opacity", 1.0F, "Of the images, 0 to 1.", this, SLOT(updateLook()));
  opacity_property_->setMin(0.0F);
  opacity_property_->setMax(1.0F);
  rays_property_ =
      new rviz::BoolProperty("Rays", true, "Source, central ray and field of view.", this, SLOT(updateLook()));
  distance_property_ = new rviz::FloatProperty(
      "Panel distance", 1.5F,
      "From the source to the panel [m] where the setup file does not tell: a camera_info leaves it open.", this);
  distance_property_->setMin(0.1F);
  distance_property_->setMax(10.0F);
}

RadiographDisplay::~RadiographDisplay() = default;

void RadiographDisplay::onInitialize()
{
  updateWindow();
}

void RadiographDisplay::onEnable()
{
  watch_ = std::make_unique<RoomWatch>(update_nh_);
  since_room_ = kRoomPeriod;
}

void RadiographDisplay::onDisable()
{
  detectors_.clear();
  watch_.reset();
  room_ = Room();
  clearStatuses();
}

void RadiographDisplay::reset()
{
  Display::reset();
  for (const auto& detector : detectors_)
  {
    detector->clear();
  }
}

void RadiographDisplay::setTopic(const QString& topic, const QString&)
{
  const std::vector<std::string> names = detectorsOf({ topic.toStdString() }, update_nh_.getNamespace());
  detectors_property_->setString(names.empty() ? QString() : QString::fromStdString(names.front()));
}

RadiographDisplay::Settings RadiographDisplay::settings() const
{
  Settings settings;
  settings.automatic = automatic_property_->getBool();
  settings.window.low = black_property_->getFloat();
  settings.window.high = std::max<double>(white_property_->getFloat(), settings.window.low + 1.0);
  settings.window.logarithmic = !room_.setup || room_.setup->intensity.kind == IntensityModel::Kind::COUNTS;
  settings.inverted = inverted_property_->getBool();
  return settings;
}

void RadiographDisplay::updateWindow()
{
  black_property_->setHidden(automatic_property_->getBool());
  white_property_->setHidden(automatic_property_->getBool());
  for (const auto& detector : detectors_)
  {
    detector->set(settings());
  }
}

void RadiographDisplay::updateLook()
{
  for (const auto& detector : detectors_)
  {
    detector->plane->setOpacity(opacity_property_->getFloat());
  }
}

void RadiographDisplay::updateDetectors()
{
  since_room_ = kRoomPeriod;
}

void RadiographDisplay::followRoom(float wall_dt)
{
  since_room_ += wall_dt;
  if (since_room_ < kRoomPeriod || !watch_)
  {
    return;
  }
  since_room_ = 0.0F;
  const std::shared_ptr<const TreatmentSetup> last_setup = room_.setup;
  room_ = watch_->room();
  if (room_.setup != last_setup)
  {
    updateWindow();
  }
  std::istringstream wished(detectors_property_->getStdString());
  std::vector<std::string> names(std::istream_iterator<std::string>(wished), {});
  if (names.empty())
  {
    names = room_.detectors;
    // One whose publisher has gone stays, with what it showed last, until another room is there.
    if (names.empty())
    {
      for (const auto& detector : detectors_)
      {
        names.push_back(detector->feed().detector());
      }
    }
  }
  const auto wanted = [&](const std::unique_ptr<Detector>& detector)
  { return std::find(names.begin(), names.end(), detector->feed().detector()) != names.end(); };
  for (const auto& detector : detectors_)
  {
    if (!wanted(detector))
    {
      deleteStatusStd(detector->feed().detector());
    }
  }
  detectors_.erase(std::remove_if(detectors_.begin(), detectors_.end(), std::not_fn(wanted)), detectors_.end());
  for (const std::string& name : names)
  {
    if (std::none_of(detectors_.begin(), detectors_.end(),
                     [&](const auto& detector) { return detector->feed().detector() == name; }))
    {
      detectors_.push_back(std::make_unique<Detector>(update_nh_, name, scene_manager_, scene_node_));
      detectors_.back()->set(settings());
      detectors_.back()->plane->setOpacity(opacity_property_->getFloat());
    }
  }
  if (room_.asked && !room_.master)
  {
    setStatus(rviz::StatusProperty::Error, "Master", "The ROS master does not answer: start roscore or a launch file.");
  }
  else
  {
    deleteStatus("Master");
  }
  if (detectors_.empty() && room_.asked)
  {
    setStatus(rviz::StatusProperty::Warn, "Detectors",
              "No topic */image_raw so far: start a launch file, a detector's driver or a playback.");
  }
  else
  {
    deleteStatus("Detectors");
  }
}

std::string RadiographDisplay::place(Detector& detector)
{
  const RadiographFeed::Messages messages = detector.feed().messages();
  const sensor_msgs::CameraInfoConstPtr& info = messages.camera_info;
  const std::string& name = detector.feed().detector();
  if (!info)
  {
    return "No " + name + "/camera_info so far: where the panel stands is not known.";
  }
  Ogre::Vector3 position;
  Ogre::Quaternion orientation;
  if (!context_->getFrameManager()->getTransform(info->header.frame_id, ros::Time(), position, orientation))
  {
    return "No transform from " + info->header.frame_id + " to " + fixed_frame_.toStdString() +
           ": treatment_room_publisher sends it; the fixed frame has to be " + kRoomFrame + ".";
  }
  const double distance = panelDistance(*info, room_.setup.get(), name,
                                        kMillimetresPerMetre * static_cast<double>(distance_property_->getFloat()));
  if (!detector.shown_info || !sameProjection(*info, *detector.shown_info) || distance != detector.shown_distance)
  {
    try
    {
      const std::string plain = name.substr(name.rfind('/') + 1);
      detector.plane->setGeometry(geometryFromCameraInfo(plain, *info, RigidTransform::Identity(), distance));
    }
    catch (const std::exception& error)
    {
      detector.shown_info.reset();
      return error.what();
    }
    detector.shown_info = info;
    detector.shown_distance = distance;
  }
  detector.plane->node()->setPosition(position);
  detector.plane->node()->setOrientation(orientation);
  const sensor_msgs::ImageConstPtr image = messages.images.newest();
  if (!image)
  {
    return "No " + name + "/image_raw so far.";
  }
  if (image->width != info->width || image->height != info->height)
  {
    return "The image has " + std::to_string(image->width) + " x " + std::to_string(image->height) +
           " pixels, its camera_info " + std::to_string(info->width) + " x " + std::to_string(info->height) +
           ": expected the same.";
  }
  return std::string();
}

void RadiographDisplay::update(float wall_dt, float)
{
  followRoom(wall_dt);
  bool drawn = false;
  for (const auto& detector : detectors_)
  {
    std::string fault;
    if (detector->take(grey_, fault))
    {
      detector->plane->setImage(grey_);
      drawn = true;
    }
    const std::string missing = place(*detector);
    if (fault.empty())
    {
      fault = missing;
    }
    detector->plane->setVisible(fault.empty());
    detector->plane->setRaysVisible(fault.empty() && rays_property_->getBool());
    if (since_room_ == 0.0F)
    {
      show(*detector, fault);
    }
  }
  if (drawn)
  {
    context_->queueRender();
  }
}

void RadiographDisplay::show(const Detector& detector, const std::string& fault)
{
  const RadiographFeed::Messages messages = detector.feed().messages();
  const std::string& name = detector.feed().detector();
  if (!fault.empty())
  {
    setStatusStd(rviz::StatusProperty::Error, name, fault);
  }
  else if (messages.image_age > kOld)
  {
    setStatusStd(rviz::StatusProperty::Warn, name,
                 "No image for " + std::to_string(static_cast<int>(messages.image_age)) + " s: shown is the last one.");
  }
  else
  {
    setStatus(rviz::StatusProperty::Ok, QString::fromStdString(name),
              QString("%1 images a second").arg(messages.rate, 0, 'f', 1));
  }
}
}  // namespace xray_tracking

PLUGINLIB_EXPORT_CLASS(xray_tracking::RadiographDisplay, rviz::Display)
