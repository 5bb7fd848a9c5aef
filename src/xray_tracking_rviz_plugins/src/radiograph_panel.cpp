#include "radiograph_panel.h"

#include <algorithm>
#include <cstring>

#include <QComboBox>
#include <QHBoxLayout>
#include <QLabel>
#include <QPushButton>
#include <QSlider>
#include <QTimer>
#include <QVBoxLayout>

#include <rviz/frame_manager.h>
#include <rviz/visualization_manager.h>
#include <sensor_msgs/image_encodings.h>
#include <pluginlib/class_list_macros.hpp>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::RenderViews;

constexpr int kRefreshPeriod = 33;                          // [ms]
constexpr std::chrono::milliseconds kRenderingPeriod(100);  // at least
constexpr std::chrono::milliseconds kAlignmentPeriod(50);   // the same while somebody aligns the CT by hand
const ros::WallDuration kRenderingTime(5.0);                // then it is given up
constexpr std::chrono::milliseconds kAlignmentLife(1500);   // of an alignment pose
constexpr double kRenderingLife = 1.0;                      // behind the newest pose [s]
constexpr std::uint32_t kRenderingSize = 256;

std::shared_ptr<const Rendering> renderingOf(const xray_tracking_msgs::RenderedView& view)
{
  const sensor_msgs::Image& image = view.line_integrals;
  const bool usable = image.encoding == sensor_msgs::image_encodings::TYPE_32FC1 && image.width > 0 &&
                      image.height > 0 && image.step >= image.width * sizeof(float) &&
                      image.data.size() >= std::size_t{ image.step } * image.height && view.step > 0.0 &&
                      std::isfinite(view.first_x) && std::isfinite(view.first_y) && !image.is_bigendian;
  if (!usable)
  {
    return nullptr;
  }
  auto rendering = std::make_shared<Rendering>();
  rendering->line_integrals.create(static_cast<int>(image.height), static_cast<int>(image.width), CV_32FC1);
  for (std::uint32_t row = 0; row < image.height; ++row)
  {
    std::memcpy(rendering->line_integrals.ptr(static_cast<int>(row)), image.data.data() + row * image.step,
                image.width * sizeof(float));
  }
  rendering->first = { view.first_x, view.first_y };
  rendering->step = view.step;
  return rendering;
}
}  // namespace

RadiographPanel::RadiographPanel(QWidget* parent) : rviz::Panel(parent)
{
  setAttribute(Qt::WA_StyledBackground);
  setStyleSheet(look::styleSheet());
  auto* layout = new QVBoxLayout(this);
  layout->setContentsMargins(6, 6, 6, 6);
  layout->setSpacing(6);
  auto* tools = new QHBoxLayout;
  buildTools(tools);
  layout->addLayout(tools);
  panes_layout_ = new QHBoxLayout;
  panes_layout_->setSpacing(6);
  layout->addLayout(panes_layout_, 1);
  empty_label_ = new QLabel("Looking for detectors ...", this);
  empty_label_->setAlignment(Qt::AlignCenter);
  empty_label_->setWordWrap(true);
  empty_label_->setMinimumSize(240, 200);
  empty_label_->setStyleSheet("font-size: 12pt; color: " + look::kQuiet.name());
  panes_layout_->addWidget(empty_label_);
  timer_ = new QTimer(this);
  connect(timer_, &QTimer::timeout, this, &RadiographPanel::refresh);
}

RadiographPanel::~RadiographPanel()
{
  if (renderer_)
  {
    renderer_->shutdown();
  }
}

void RadiographPanel::buildTools(QHBoxLayout* tools)
{
  tools->setSpacing(8);
  overlay_box_ = new QComboBox(this);
  overlay_box_->setObjectName("overlay");
  overlay_box_->addItems({ "No overlay", "CT blended", "CT edges", "CT checkerboard", "CT difference" });
  overlay_box_->setToolTip("How the CT at the present pose is laid over the radiographs.");
  share_slider_ = new QSlider(Qt::Horizontal, this);
  share_slider_->setObjectName("share");
  share_slider_->setRange(0, 100);
  share_slider_->setValue(50);
  share_slider_->setFixedWidth(110);
  share_slider_->setToolTip("Strength of the overlay.");
  automatic_button_ = new QPushButton("Auto window", this);
  automatic_button_->setObjectName("automatic");
  automatic_button_->setCheckable(true);
  automatic_button_->setChecked(true);
  automatic_button_->setToolTip(
      "Grey values follow the image. Drag with the right button to set your own:\n"
      "up and down for brightness, left and right for contrast.");
  inverted_button_ = new QPushButton("Inverted", this);
  inverted_button_->setObjectName("inverted");
  inverted_button_->setCheckable(true);
  residuals_button_ = new QPushButton("Residuals", this);
  residuals_button_->setObjectName("residuals");
  residuals_button_->setCheckable(true);
  residuals_button_->setToolTip(
      "Where the tracked region differs from its template: from green, not at all,\n"
      "to red, by as much as the template's contrast.");
  region_button_ = new QPushButton("Draw region", this);
  region_button_->setObjectName("draw_region");
  region_button_->setCheckable(true);
  region_button_->setToolTip("Draw, move and resize the region that is tracked.");
  rendering_label_ = new QLabel(this);
  rendering_label_->setObjectName("rendering");
  rendering_label_->setStyleSheet("color: " + look::kWarning.name());
  tools->addWidget(overlay_box_);
  tools->addWidget(share_slider_);
  tools->addWidget(automatic_button_);
  tools->addWidget(inverted_button_);
  tools->addWidget(residuals_button_);
  tools->addWidget(region_button_);
  tools->addWidget(rendering_label_, 1);
  connect(overlay_box_, QOverload<int>::of(&QComboBox::currentIndexChanged), this, &RadiographPanel::setOverlay);
  connect(share_slider_, &QSlider::valueChanged, this, &RadiographPanel::setOverlay);
  connect(automatic_button_, &QPushButton::toggled, this, &RadiographPanel::setAutomatic);
  connect(inverted_button_, &QPushButton::toggled, this, &RadiographPanel::setInverted);
  connect(residuals_button_, &QPushButton::toggled, this, &RadiographPanel::setResiduals);
  connect(region_button_, &QPushButton::toggled, this, &RadiographPanel::setEditing);
  setOverlay();
}

void RadiographPanel::onInitialize()
{
  watch_ = std::make_unique<RoomWatch>(nh_);
  const boost::function<void(const geometry_msgs::PoseWithCovarianceStampedConstPtr&)> pose =
      [this](const auto& message) { poses_.add(message); };
  const boost::function<void(const geometry_msgs::PoseStampedConstPtr&)> alignment = [this](const auto& message)
  {
    if (!aligning() && overlay() == Overlay::NONE)
    {
      overlay_box_->setCurrentIndex(static_cast<int>(Overlay::BLEND));  // or nothing would be seen of it
    }
    alignment_ = message;
    alignment_came_ = std::chrono::steady_clock::now();
  };
  subscribers_ = { nh_.subscribe<geometry_msgs::PoseWithCovarianceStamped>("patient_pose", 20, pose),
                   nh_.subscribe<geometry_msgs::PoseStamped>("alignment_pose", 1, alignment) };
  renderer_ = std::make_unique<ServiceCaller<RenderViews>>(
      nh_, "registration/render", [this](const auto& response, const auto& why) { takeRendering(response, why); });
  timer_->start(kRefreshPeriod);
}

std::vector<DetectorPane*> RadiographPanel::panes() const
{
  std::vector<DetectorPane*> panes;
  for (const auto& pane : panes_)
  {
    panes.push_back(pane.get());
  }
  return panes;
}

Overlay RadiographPanel::overlay() const
{
  return static_cast<Overlay>(overlay_box_->currentIndex());
}

void RadiographPanel::arrange()
{
  const double count = std::max<double>(1.0, static_cast<double>(panes_.size()));
  const double side_by_side = std::min(width() / count, static_cast<double>(height()));
  const double stacked = std::min<double>(width(), height() / count);
  panes_layout_->setDirection(stacked > side_by_side ? QBoxLayout::TopToBottom : QBoxLayout::LeftToRight);
}

void RadiographPanel::resizeEvent(QResizeEvent* event)
{
  rviz::Panel::resizeEvent(event);
  arrange();
}

void RadiographPanel::setOverlay()
{
  share_slider_->setEnabled(overlay() == Overlay::BLEND || overlay() == Overlay::EDGES);
  for (const auto& pane : panes_)
  {
    pane->view().setOverlay(overlay(), share_slider_->value() / 100.0);
  }
  Q_EMIT configChanged();
}

void RadiographPanel::setInverted(bool inverted)
{
  for (const auto& pane : panes_)
  {
    pane->view().setInverted(inverted);
  }
  Q_EMIT configChanged();
}

void RadiographPanel::setResiduals(bool shown)
{
  for (const auto& pane : panes_)
  {
    pane->feed().listenForResiduals(shown);
  }
  Q_EMIT configChanged();
}

void RadiographPanel::setAutomatic(bool automatic)
{
  for (const auto& pane : panes_)
  {
    pane->view().setWindow(automatic ? std::nullopt : std::optional<GreyWindow>(pane->view().picture().window));
  }
  Q_EMIT configChanged();
}

void RadiographPanel::windowSet()
{
  // One detector's window is the user's; the others keep theirs as they are.
  automatic_button_->setChecked(false);
  Q_EMIT configChanged();
}

void RadiographPanel::setEditing(bool editing)
{
  for (const auto& pane : panes_)
  {
    pane->setEditing(editing);
  }
}

void RadiographPanel::addPane(const std::string& detector)
{
  auto pane = std::make_unique<DetectorPane>(nh_, detector, this);
  RadiographView& view = pane->view();
  view.setOverlay(overlay(), share_slider_->value() / 100.0);
  view.setInverted(inverted_button_->isChecked());
  pane->feed().listenForResiduals(residuals_button_->isChecked());
  if (const auto window = saved_windows_.find(detector); window != saved_windows_.end())
  {
    view.setWindow(window->second);
  }
  pane->setEditing(region_button_->isChecked());
  connect(&view, &RadiographView::windowSet, this, &RadiographPanel::windowSet);
  const auto place =
      std::find_if(panes_.begin(), panes_.end(), [&](const auto& other) { return other->detector() > detector; });
  panes_layout_->insertWidget(static_cast<int>(place - panes_.begin()), pane.get(), 1);
  panes_.insert(place, std::move(pane));
  arrange();
}

void RadiographPanel::followRoom()
{
  room_ = watch_->room();
  if (!room_.detectors.empty())
  {
    // A detector that has gone stays as long as there is no other one: a driver that was restarted is not a new room.
    const auto gone = [&](const std::unique_ptr<DetectorPane>& pane)
    { return std::find(room_.detectors.begin(), room_.detectors.end(), pane->detector()) == room_.detectors.end(); };
    panes_.erase(std::remove_if(panes_.begin(), panes_.end(), gone), panes_.end());
    for (const std::string& detector : room_.detectors)
    {
      if (std::none_of(panes_.begin(), panes_.end(), [&](const auto& pane) { return pane->detector() == detector; }))
      {
        addPane(detector);
      }
    }
  }
  empty_label_->setVisible(panes_.empty());
  if (panes_.empty() && room_.asked)
  {
    empty_label_->setText(room_.master ? "No detector so far (no topic */image_raw).\n"
                                         "Start a launch file, a detector's driver or a playback."
                                       : "The ROS master does not answer.\nStart roscore or a launch file.");
  }
}

void RadiographPanel::refresh()
{
  followRoom();
  if (!isVisible() || vis_manager_ == nullptr)
  {
    return;
  }
  askForRendering();
  const bool live = renderingIsLive();
  bool shown = false;
  for (const auto& pane : panes_)
  {
    const auto exposure = rendered_.exposures.find(pane->detector());
    shown = pane->refresh(room_, *vis_manager_->getFrameManager()->getTF2BufferPtr(), poses_,
                          live && exposure != rendered_.exposures.end() ? &exposure->second : nullptr) ||
            shown;
  }
  rendering_label_->setText(overlay() == Overlay::NONE  ? QString()
                            : !rendering_fault_.empty() ? "No CT: " + QString::fromStdString(rendering_fault_)
                            : shown && aligning()       ? QString("CT at the pose of the manual alignment")
                            : shown                     ? QString()
                            : aligning() || asked_      ? QString("Rendering the CT ...")
                            : poses_.empty()            ? QString("No CT: no patient_pose so far")
                            : live                      ? QString("No CT: these exposures have no patient_pose")
                                                        : QString("Rendering the CT ..."));
}

bool RadiographPanel::aligning() const
{
  return alignment_ && std::chrono::steady_clock::now() - alignment_came_ < kAlignmentLife;
}

bool RadiographPanel::renderingIsLive() const
{
  if (overlay() == Overlay::NONE || rendered_.exposures.empty() || !rendering_fault_.empty())
  {
    return false;
  }
  return aligning() || (!poses_.empty() && poses_.at(rendered_.stamp) != nullptr &&
                        (poses_.newest()->header.stamp - rendered_.stamp).toSec() <= kRenderingLife);
}

void RadiographPanel::askForRendering()
{
  const auto now = std::chrono::steady_clock::now();
  if (asked_)
  {
    renderer_->cancelAfter(kRenderingTime);
    return;
  }
  if (overlay() == Overlay::NONE || now - asked_at_ < (aligning() ? kAlignmentPeriod : kRenderingPeriod) ||
      (!aligning() && poses_.empty()))
  {
    return;
  }
  geometry_msgs::Pose pose;
  Rendered rendered;
  if (aligning())
  {
    pose = alignment_->pose;
    rendered.stamp = alignment_->header.stamp;
  }
  else
  {
    pose = poses_.newest()->pose.pose;
    rendered.stamp = poses_.newest()->header.stamp;
    if (!rendered_.exposures.empty() && rendered.stamp == rendered_.stamp)
    {
      return;
    }
  }
  RenderViews::Request request;
  request.pose = pose;
  request.max_size = kRenderingSize;
  for (const auto& pane : panes_)
  {
    const RadiographFeed::Messages messages = pane->feed().messages();
    if (!messages.camera_info)
    {
      continue;
    }
    ShownExposure exposure;
    exposure.image = aligning() ? messages.images.newest() : messages.images.at(rendered.stamp);
    if (!exposure.image)
    {
      continue;
    }
    try
    {
      exposure.room_from_patient = rigidFromPoseMsg(pose);
    }
    catch (const std::exception& error)
    {
      rendering_fault_ = error.what();
      return;
    }
    rendered.exposures.emplace(pane->detector(), std::move(exposure));
    request.camera_infos.push_back(*messages.camera_info);
  }
  if (!request.camera_infos.empty() && renderer_->call(request))
  {
    asked_ = std::move(rendered);
    asked_at_ = now;
  }
}

void RadiographPanel::takeRendering(const std::optional<RenderViews::Response>& response, const std::string& why)
{
  if (!asked_)
  {
    return;
  }
  Rendered rendered = std::move(*asked_);
  asked_.reset();
  rendering_fault_ = !response ? why : !response->success ? response->message : std::string();
  if (!rendering_fault_.empty())
  {
    asked_at_ = std::chrono::steady_clock::now() + std::chrono::seconds(1);  // not again at once
    return;
  }
  std::size_t view = 0;  // in the order of the request, which is that of the names
  for (auto& exposure : rendered.exposures)
  {
    if (view < response->views.size())
    {
      exposure.second.rendering = renderingOf(response->views[view++]);
    }
  }
  rendered_ = std::move(rendered);
}

void RadiographPanel::load(const rviz::Config& config)
{
  rviz::Panel::load(config);
  int overlay = 0, share = 50;
  bool inverted = false, residuals = false;
  if (config.mapGetInt("Overlay", &overlay))
  {
    overlay_box_->setCurrentIndex(std::clamp(overlay, 0, overlay_box_->count() - 1));
  }
  if (config.mapGetInt("Share", &share))
  {
    share_slider_->setValue(share);
  }
  if (config.mapGetBool("Inverted", &inverted))
  {
    inverted_button_->setChecked(inverted);
  }
  if (config.mapGetBool("Residuals", &residuals))
  {
    residuals_button_->setChecked(residuals);
  }
  const rviz::Config windows = config.mapGetChild("Windows");
  for (rviz::Config::MapIterator window = windows.mapIterator(); window.isValid(); window.advance())
  {
    float low = 0.0F, high = 0.0F;
    const rviz::Config entry = window.currentChild();
    if (entry.mapGetFloat("Black", &low) && entry.mapGetFloat("White", &high) && low < high)
    {
      saved_windows_[window.currentKey().toStdString()] = { low, high, true };
    }
  }
  if (!saved_windows_.empty())
  {
    automatic_button_->setChecked(false);
    for (const auto& pane : panes_)
    {
      if (const auto window = saved_windows_.find(pane->detector()); window != saved_windows_.end())
      {
        pane->view().setWindow(window->second);
      }
    }
  }
}

void RadiographPanel::save(rviz::Config config) const
{
  rviz::Panel::save(config);
  config.mapSetValue("Overlay", overlay_box_->currentIndex());
  config.mapSetValue("Share", share_slider_->value());
  config.mapSetValue("Inverted", inverted_button_->isChecked());
  config.mapSetValue("Residuals", residuals_button_->isChecked());
  if (!automatic_button_->isChecked())
  {
    // Of detectors that have shown nothing so far, as it was.
    std::map<std::string, GreyWindow> shown = saved_windows_;
    for (const auto& pane : panes_)
    {
      if (!pane->view().picture().pixels.empty())
      {
        shown[pane->detector()] = pane->view().picture().window;
      }
    }
    rviz::Config windows = config.mapMakeChild("Windows");
    for (const auto& [detector, window] : shown)
    {
      rviz::Config entry = windows.mapMakeChild(QString::fromStdString(detector));
      entry.mapSetValue("Black", window.low);
      entry.mapSetValue("White", window.high);
    }
  }
}
}  // namespace xray_tracking

PLUGINLIB_EXPORT_CLASS(xray_tracking::RadiographPanel, rviz::Panel)
