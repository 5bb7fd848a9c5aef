#include "detector_pane.h"

#include <cmath>

#include <QHBoxLayout>
#include <QLabel>
#include <QPushButton>
#include <QSignalBlocker>
#include <QSpinBox>
#include <QVBoxLayout>

#include "detector_view.h"
#include "pose_message.h"
#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
using xray_tracking_msgs::TrackedRegion;
using xray_tracking_msgs::TrainRegion;

constexpr double kPatience = 0.3;  // with what belongs to an exposure and is late [s]
constexpr double kRendered = 1.0;  // for which newer images wait for what was rendered [s]
constexpr double kLive = 1.0;      // a stream that ended no longer before the last exposures [s]
constexpr double kOld = 2.0;       // an exposure, from when on it is said [s]
constexpr std::chrono::seconds kTrainingTime(30);

QColor colourOf(Mood mood)
{
  switch (mood)
  {
    case Mood::GOOD:
      return look::kGood;
    case Mood::WARNING:
      return look::kWarning;
    case Mood::BAD:
      return look::kBad;
    default:
      return look::kQuiet;
  }
}

QString number(double value, int decimals)
{
  return QLocale::c().toString(value, 'f', decimals);
}

template <typename Message>
void addIfLive(const Recent<Message>& stream, const std::vector<ros::Time>& images,
               std::vector<std::vector<ros::Time>>& streams)
{
  if (stream.empty())
  {
    return;
  }
  const ros::Time last = stream.newest()->header.stamp;
  const ros::Time before = images[images.size() > 1 ? images.size() - 2 : 0];  // the newest one's may be yet to come
  if ((before - last).toSec() <= kLive && (last - images.back()).toSec() <= kLive)
  {
    streams.push_back(stampsOf(stream));
  }
}
}  // namespace

DetectorPane::DetectorPane(const ros::NodeHandle& nh, const std::string& detector, QWidget* parent)
  : QWidget(parent), view_(new RadiographView(this)), region_row_(new QWidget(this)), nh_(nh)
{
  auto* layout = new QVBoxLayout(this);
  layout->setContentsMargins(0, 0, 0, 0);
  layout->setSpacing(4);
  layout->addWidget(view_, 1);
  layout->addWidget(region_row_);
  buildRegionRow();
  region_row_->hide();
  connect(view_, &RadiographView::regionEdited, this, &DetectorPane::showFields);
  connect(view_, &RadiographView::pointerMoved, this, &DetectorPane::showReadOut);
  connect(view_, &RadiographView::pictureChanged, this, &DetectorPane::showReadOut);
  feed_ = std::make_unique<RadiographFeed>(nh_, detector, nullptr);
  trainer_ = std::make_unique<ServiceCaller<TrainRegion>>(
      nh_, detector + "/train_region", [this](const auto& response, const auto& why) { answered(response, why); });
}

DetectorPane::~DetectorPane()
{
  trainer_->shutdown();
}

void DetectorPane::buildRegionRow()
{
  auto* rows = new QVBoxLayout(region_row_);
  rows->setContentsMargins(6, 2, 6, 4);
  rows->setSpacing(4);
  auto* row = new QHBoxLayout;
  row->setSpacing(6);
  const char* names[] = { "x", "y", "width", "height" };
  for (int i = 0; i < 4; ++i)
  {
    auto* label = new QLabel(names[i], region_row_);
    label->setStyleSheet("color: " + look::kQuiet.name());
    row->addWidget(label);
    fields_[i] = new QSpinBox(region_row_);
    fields_[i]->setObjectName(QString("region_") + names[i]);
    fields_[i]->setButtonSymbols(QAbstractSpinBox::NoButtons);
    fields_[i]->setRange(0, 16384);
    fields_[i]->setKeyboardTracking(false);
    fields_[i]->setFixedWidth(66);
    row->addWidget(fields_[i]);
    connect(fields_[i], QOverload<int>::of(&QSpinBox::valueChanged), this, &DetectorPane::takeFields);
  }
  row->addStretch(1);
  undo_button_ = new QPushButton("Undo", region_row_);
  undo_button_->setObjectName("undo");
  undo_button_->setToolTip("Track the region again that was tracked before.");
  undo_button_->setEnabled(false);
  train_button_ = new QPushButton("Apply", region_row_);
  train_button_->setObjectName("apply");
  train_button_->setProperty("primary", true);
  train_button_->setToolTip(
      "Learn this region from the next exposure, and track it from then on.\n"
      "The present region is tracked until then.");
  row->addWidget(undo_button_);
  row->addWidget(train_button_);
  connect(train_button_, &QPushButton::clicked, this, &DetectorPane::train);
  connect(undo_button_, &QPushButton::clicked, this, &DetectorPane::undo);
  rows->addLayout(row);
  message_ = new QLabel(region_row_);
  message_->setObjectName("message");
  message_->setWordWrap(true);
  message_->setMinimumHeight(18);
  rows->addWidget(message_);
}

void DetectorPane::setEditing(bool editing)
{
  region_row_->setVisible(editing);
  view_->setEditing(editing);
  if (editing)
  {
    if (!view_->region())
    {
      proposeRegion();
    }
    showFields();
    if (!asked_)
    {
      say("Draw a rectangle around the target's bone, or move and resize the one that is there.", look::kQuiet);
    }
  }
}

void DetectorPane::proposeRegion()
{
  if (!region_)
  {
    return;
  }
  if (const std::optional<Outline> outline = outlineNow(*region_))
  {
    Eigen::AlignedBox2d box;
    for (const Eigen::Vector2d& corner : *outline)
    {
      box.extend(corner);
    }
    const Eigen::Vector2d low = box.min().array() + 0.5, size = box.sizes();
    view_->setRegion({ static_cast<int>(std::lround(low.x())), static_cast<int>(std::lround(low.y())),
                       static_cast<int>(std::lround(size.x())), static_cast<int>(std::lround(size.y())) });
  }
  else if (region_->region.width > 0)
  {
    view_->setRegion(rectFromRegionMsg(region_->region));
  }
}

void DetectorPane::showFields()
{
  const std::optional<cv::Rect>& region = view_->region();
  const int values[] = { region ? region->x : 0, region ? region->y : 0, region ? region->width : 0,
                         region ? region->height : 0 };
  for (int i = 0; i < 4; ++i)
  {
    const QSignalBlocker blocker(fields_[i]);
    fields_[i]->setValue(values[i]);
  }
  train_button_->setEnabled(region.has_value() && !asked_);
}

void DetectorPane::takeFields()
{
  view_->setRegion({ fields_[0]->value(), fields_[1]->value(), fields_[2]->value(), fields_[3]->value() });
  showFields();
}

void DetectorPane::train()
{
  if (view_->region())
  {
    ask(*view_->region());
  }
}

void DetectorPane::undo()
{
  if (before_)
  {
    view_->setRegion(*before_);
    showFields();
    ask(*before_);
  }
}

void DetectorPane::ask(const cv::Rect& region)
{
  TrainRegion::Request request;
  request.region = regionMsgFromRect(region);
  if (!trainer_->call(request))
  {
    return;
  }
  replaced_ =
      region_ && region_->region.width > 0 ? std::optional<cv::Rect>(rectFromRegionMsg(region_->region)) : std::nullopt;
  asked_ = region;
  asked_at_ = std::chrono::steady_clock::now();
  train_button_->setEnabled(false);
  undo_button_->setEnabled(false);
  say("Learning from the next exposure; the present region is tracked until then ...", look::kWarning);
}

void DetectorPane::answered(const std::optional<TrainRegion::Response>& response, const std::string& why)
{
  const bool late = std::chrono::steady_clock::now() - asked_at_ > kTrainingTime;
  const cv::Rect region = asked_.value_or(cv::Rect());
  asked_.reset();
  if (response && response->status == TrainRegion::Response::OK)
  {
    before_ = replaced_;
    say(QString("Now tracking %1 x %2 pixels at (%3, %4).")
            .arg(region.width)
            .arg(region.height)
            .arg(region.x)
            .arg(region.y),
        look::kGood);
  }
  else
  {
    const QString reason = response ? QString::fromStdString(response->message)
                           : late   ? QString("no answer within %1 s").arg(kTrainingTime.count())
                                    : QString::fromStdString(why);
    say("Not taken: " + reason + ". What was tracked before still is.", look::kBad);
  }
  undo_button_->setEnabled(before_.has_value());
  showFields();
}

void DetectorPane::say(const QString& text, const QColor& colour)
{
  message_->setText(text);
  message_->setStyleSheet("color: " + colour.name());
}

std::optional<ProjectionGeometry> DetectorPane::geometryOf(const RadiographFeed::Messages& messages,
                                                           tf2_ros::Buffer& transforms, QString& fault) const
{
  if (!messages.camera_info)
  {
    fault = "no " + QString::fromStdString(detector()) + "/camera_info so far";
    return std::nullopt;
  }
  const sensor_msgs::ImageConstPtr image = messages.images.newest();
  if (image && (image->width != messages.camera_info->width || image->height != messages.camera_info->height))
  {
    fault = "the image has another size than its camera_info";
    return std::nullopt;
  }
  const std::string& frame = messages.camera_info->header.frame_id;
  try
  {
    const geometry_msgs::TransformStamped room_from_optical =
        transforms.lookupTransform(kRoomFrame, frame, ros::Time(0));
    const std::string plain = detector().substr(detector().rfind('/') + 1);
    constexpr double kAnyDistance = 1000.0;  // projections do not depend on it
    return geometryFromCameraInfo(plain, *messages.camera_info, rigidFromTransformMsg(room_from_optical.transform),
                                  kAnyDistance);
  }
  catch (const tf2::TransformException&)
  {
    fault = QString("no transform from %1 to %2").arg(QString::fromStdString(frame), kRoomFrame);
  }
  catch (const std::exception& error)
  {
    fault = error.what();
  }
  return std::nullopt;
}

bool DetectorPane::refresh(const Room& room, tf2_ros::Buffer& transforms,
                           const Recent<geometry_msgs::PoseWithCovarianceStamped>& poses, const ShownExposure* rendered)
{
  if (asked_ && std::chrono::steady_clock::now() - asked_at_ > kTrainingTime)
  {
    trainer_->cancelAfter(ros::WallDuration(static_cast<double>(kTrainingTime.count())));
  }
  const RadiographFeed::Messages messages = feed_->messages();
  region_ = messages.regions.newest();
  setup_ = room.setup;

  ShownExposure shown;
  const std::vector<ros::Time> images = stampsOf(messages.images);
  const bool shows_rendered = rendered != nullptr && rendered->image &&
                              replacedFor(images, rendered->image->header.stamp, messages.image_age) <= kRendered;
  if (shows_rendered)
  {
    shown = *rendered;
  }
  else if (!images.empty())
  {
    std::vector<std::vector<ros::Time>> streams;
    addIfLive(messages.regions, images, streams);
    addIfLive(messages.residuals, images, streams);
    addIfLive(poses, images, streams);
    const ros::Time stamp = exposureToShow(images, streams, messages.image_age, kPatience);
    shown.image = messages.images.at(stamp);
    if (const auto pose = poses.at(stamp))
    {
      shown.room_from_patient = rigidOf(pose->pose.pose);
    }
  }

  Drawing drawing;
  drawing.title = QString::fromStdString(detector());
  QString fault;
  geometry_ = geometryOf(messages, transforms, fault);
  if (!shown.image)
  {
    drawing.missing = "Waiting for " + QString::fromStdString(nh_.resolveName(detector() + "/image_raw")) +
                      ":\nstart a launch file, the detector's driver or a playback.";
  }
  else
  {
    const ros::Time stamp = shown.image->header.stamp;
    if (const auto region = messages.regions.at(stamp))
    {
      drawing.began = outlineBegan(*region);
      drawing.now = outlineNow(*region);
      drawing.colour = colourOf(moodOf(*region));
      drawing.state = QString::fromStdString(wordsOf(*region));
      drawing.note =
          drawing.now ? "correlation " + number(region->correlation, 2) : QString::fromStdString(region->fault);
    }
    else
    {
      drawing.state = "not tracked";
      drawing.note = "no " + QString::fromStdString(detector()) + "/tracked_region of this exposure";
    }
    if (const auto residuals = messages.residuals.at(stamp))
    {
      drawing.residuals = dotsOf(*residuals);
    }
    for (const auto& region : messages.regions.messages())
    {
      if (region->header.stamp > stamp)
      {
        break;
      }
      // Another template's centre is another point.
      if (!drawing.trail.empty() && region->reference_stamp != messages.regions.newest()->reference_stamp)
      {
        drawing.trail.clear();
      }
      if (const auto centre = centreNow(*region))
      {
        drawing.trail.push_back(*centre);
      }
    }
    if (shown.room_from_patient && geometry_ && setup_)
    {
      drawing.box = projectedBox(*geometry_, *shown.room_from_patient, setup_->target_box);
    }
    if (messages.image_age > kOld)
    {
      drawing.note = QString("last exposure %1 s ago").arg(static_cast<int>(messages.image_age));
    }
    if (!fault.isEmpty())
    {
      drawing.note += "\n" + fault;
    }
  }
  view_->setCounts(!setup_ || setup_->intensity.kind == IntensityModel::Kind::COUNTS);
  view_->setImage(shown.image, shown.rendering);
  view_->setDrawing(drawing);
  if (region_row_->isVisible() && !view_->region() && !view_->hasFocus())
  {
    proposeRegion();
    showFields();
  }
  return shows_rendered;
}

void DetectorPane::showReadOut()
{
  const std::optional<Eigen::Vector2d> pixel = view_->pointer();
  if (!pixel)
  {
    view_->setReadOut(QString());
    return;
  }
  const int x = static_cast<int>(std::lround(pixel->x())), y = static_cast<int>(std::lround(pixel->y()));
  const Picture& picture = view_->picture();
  const double value =
      picture.pixels.depth() == CV_8U ? picture.pixels.at<std::uint8_t>(y, x) : picture.pixels.at<std::uint16_t>(y, x);
  QString text = QString("(%1, %2)   value %3").arg(x).arg(y).arg(static_cast<int>(value));
  if (setup_)
  {
    if (const auto attenuation = attenuationOf(value, setup_->intensity, picture.largest))
    {
      text += "   attenuation " + number(*attenuation, 2);
    }
  }
  if (geometry_)
  {
    const Eigen::Vector2d mm = atIsocentre(*geometry_, *pixel);
    if (mm.allFinite())
    {
      text += "   at the isocentre " + number(mm.x(), 1) + ", " + number(mm.y(), 1) + " mm";
    }
  }
  view_->setReadOut(text);
}
}  // namespace xray_tracking
