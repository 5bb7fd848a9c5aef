#include "xray_tracking_tools/treatment_room_markers.h"

#include <cmath>
#include <sstream>
#include <string>

#include "xray_tracking_conversions/conversions.h"

namespace xray_tracking
{
namespace
{
using visualization_msgs::Marker;
using xray_tracking_msgs::TrackedRegion;

constexpr double kLineWidth = 0.004;     // [m]
constexpr std::size_t kLineLength = 44;  // characters; so much fits between the sources

/// Text in lines that are broken at spaces.
std::string wrapped(const std::string& text)
{
  std::istringstream words(text);
  std::string lines;
  std::size_t length = 0;
  for (std::string word; words >> word; length += word.size())
  {
    if (!lines.empty())
    {
      const bool fits = length + 1 + word.size() <= kLineLength;
      lines += fits ? ' ' : '\n';
      length = fits ? length + 1 : 0;
    }
    lines += word;
  }
  return lines;
}

std_msgs::ColorRGBA colour(float r, float g, float b, float a)
{
  std_msgs::ColorRGBA rgba;
  rgba.r = r;
  rgba.g = g;
  rgba.b = b;
  rgba.a = a;
  return rgba;
}

const std_msgs::ColorRGBA kSourceColour = colour(1.0F, 0.85F, 0.2F, 1.0F);
const std_msgs::ColorRGBA kPanelColour = colour(0.35F, 0.45F, 0.55F, 0.6F);
const std_msgs::ColorRGBA kOutlineColour = colour(0.75F, 0.85F, 0.95F, 1.0F);
const std_msgs::ColorRGBA kRayColour = colour(1.0F, 0.85F, 0.2F, 0.6F);
const std_msgs::ColorRGBA kBeamColour = colour(1.0F, 0.85F, 0.2F, 0.25F);
const std_msgs::ColorRGBA kIsocentreColour = colour(1.0F, 1.0F, 1.0F, 1.0F);
const std_msgs::ColorRGBA kTargetColour = colour(0.9F, 0.3F, 0.9F, 1.0F);
const std_msgs::ColorRGBA kTrailColour = colour(0.3F, 0.8F, 1.0F, 1.0F);
const std_msgs::ColorRGBA kOldColour = colour(0.55F, 0.6F, 0.65F, 0.5F);
const std_msgs::ColorRGBA kOpenColour = colour(0.2F, 0.9F, 0.3F, 1.0F);
const std_msgs::ColorRGBA kHoldColour = colour(1.0F, 0.2F, 0.2F, 1.0F);

Marker makeMarker(const std::string& ns, int id, int type, const std_msgs::ColorRGBA& rgba,
                  const std::string& frame = kRoomFrame)
{
  Marker marker;
  marker.header.frame_id = frame;  // the stamp stays zero: RViz takes the newest transform
  marker.ns = ns;
  marker.id = id;
  marker.type = type;
  marker.action = Marker::ADD;
  marker.pose.orientation.w = 1.0;
  marker.color = rgba;
  marker.scale.x = kLineWidth;
  return marker;
}

Marker makeSphere(const std::string& ns, int id, const Eigen::Vector3d& centre, double diameter,
                  const std_msgs::ColorRGBA& rgba)
{
  Marker marker = makeMarker(ns, id, Marker::SPHERE, rgba);
  marker.pose.position = pointMsgFromMillimetres(centre);
  marker.scale.x = marker.scale.y = marker.scale.z = diameter;
  return marker;
}

/// Room positions of a rectangle of pixels on the panel, round its edge; pixel edges, not centres.
std::vector<Eigen::Vector3d> panelCorners(const ProjectionGeometry& detector, const Eigen::Vector2d& first,
                                          const Eigen::Vector2d& size)
{
  const Eigen::Vector2d low = first - Eigen::Vector2d(0.5, 0.5);
  const Eigen::Vector2d high = low + size;
  return { detector.pixelPosition(low), detector.pixelPosition({ high.x(), low.y() }), detector.pixelPosition(high),
           detector.pixelPosition({ low.x(), high.y() }) };
}

void addClosedLine(const std::vector<Eigen::Vector3d>& corners, Marker& marker)
{
  for (std::size_t i = 0; i <= corners.size(); ++i)
  {
    marker.points.push_back(pointMsgFromMillimetres(corners[i % corners.size()]));
  }
}

Marker makeRay(const std::string& ns, int id, const ProjectionGeometry& detector, const Eigen::Vector2d& pixel,
               const std_msgs::ColorRGBA& rgba)
{
  Marker marker = makeMarker(ns, id, Marker::LINE_LIST, rgba);
  marker.points = { pointMsgFromMillimetres(detector.source()),
                    pointMsgFromMillimetres(detector.pixelPosition(pixel)) };
  return marker;
}

void addDetectorMarkers(const ProjectionGeometry& detector, int id, std::vector<Marker>& markers)
{
  const Eigen::Vector2d size = detector.imageSize().cast<double>();
  const std::vector<Eigen::Vector3d> corners = panelCorners(detector, Eigen::Vector2d::Zero(), size);

  markers.push_back(makeSphere("sources", id, detector.source(), 0.08, kSourceColour));

  Marker panel = makeMarker("panels", id, Marker::TRIANGLE_LIST, kPanelColour);
  panel.scale.x = panel.scale.y = panel.scale.z = 1.0;
  for (const int corner : { 0, 1, 2, 0, 2, 3, 2, 1, 0, 3, 2, 0 })  // both sides
  {
    panel.points.push_back(pointMsgFromMillimetres(corners[corner]));
  }
  markers.push_back(panel);

  Marker outline = makeMarker("panel_outlines", id, Marker::LINE_STRIP, kOutlineColour);
  addClosedLine(corners, outline);
  markers.push_back(outline);

  markers.push_back(makeRay("central_rays", id, detector, detector.foot(), kRayColour));

  Marker beam = makeMarker("beams", id, Marker::LINE_LIST, kBeamColour);
  for (const Eigen::Vector3d& corner : corners)
  {
    beam.points.push_back(pointMsgFromMillimetres(detector.source()));
    beam.points.push_back(pointMsgFromMillimetres(corner));
  }
  markers.push_back(beam);
}

std_msgs::ColorRGBA stateColour(std::uint8_t state)
{
  switch (state)
  {
    case TrackedRegion::TRACKING:
      return kOpenColour;
    case TrackedRegion::DEGRADED:
    case TrackedRegion::TRAINING:
      return colour(1.0F, 0.8F, 0.1F, 1.0F);
    default:
      return kHoldColour;
  }
}

geometry_msgs::TransformStamped stampedTransform(const std::string& parent, const std::string& child,
                                                 const RigidTransform& parent_from_child)
{
  geometry_msgs::TransformStamped message;
  message.header.frame_id = parent;
  message.child_frame_id = child;
  message.transform = transformMsgFromRigid(parent_from_child);
  return message;
}
}  // namespace

std::vector<geometry_msgs::TransformStamped> staticTransforms(const TreatmentSetup& setup)
{
  std::vector<geometry_msgs::TransformStamped> transforms;
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    transforms.push_back(stampedTransform(kRoomFrame, opticalFrame(detector.name()), detector.roomFromOptical()));
  }
  RigidTransform patient_from_target = RigidTransform::Identity();
  patient_from_target.translation() = setup.targetCentre();
  transforms.push_back(stampedTransform(kPatientFrame, kTargetFrame, patient_from_target));
  return transforms;
}

std::vector<Marker> staticMarkers(const TreatmentSetup& setup)
{
  std::vector<Marker> markers;
  for (std::size_t d = 0; d < setup.detectors.size(); ++d)
  {
    addDetectorMarkers(setup.detectors[d], static_cast<int>(d), markers);
  }
  markers.push_back(makeSphere("isocentre", 0, Eigen::Vector3d::Zero(), 0.008, kIsocentreColour));

  Marker box = makeMarker("target_box", 0, Marker::LINE_LIST, kTargetColour, kPatientFrame);
  box.scale.x = 0.001;
  box.frame_locked = true;
  // Corners whose indices differ in one bit share an edge.
  using Corner = Eigen::AlignedBox3d::CornerType;
  for (int corner = 0; corner < 8; ++corner)
  {
    for (const int bit : { 1, 2, 4 })
    {
      if ((corner & bit) == 0)
      {
        box.points.push_back(pointMsgFromMillimetres(setup.target_box.corner(static_cast<Corner>(corner))));
        box.points.push_back(pointMsgFromMillimetres(setup.target_box.corner(static_cast<Corner>(corner | bit))));
      }
    }
  }
  markers.push_back(box);
  return markers;
}

std::vector<Marker> regionMarkers(const ProjectionGeometry& detector, int id, const TrackedRegion& region)
{
  const Eigen::Vector2d size(region.region.width, region.region.height);
  const Eigen::Vector2d reference =
      Eigen::Vector2d(region.region.x_offset, region.region.y_offset) + 0.5 * (size - Eigen::Vector2d::Ones());
  Eigen::Vector2d displacement(region.displacement_x, region.displacement_y);
  Eigen::Matrix2d linear = Eigen::Map<const Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(region.linear.data());
  const bool found = region.state == TrackedRegion::TRACKING || region.state == TrackedRegion::DEGRADED;
  if (!found || !displacement.allFinite() || !linear.allFinite())
  {
    displacement.setZero();
    linear.setIdentity();
  }
  const Eigen::Vector2d centre = reference + displacement;
  const std_msgs::ColorRGBA rgba = stateColour(region.state);

  Marker outline = makeMarker("regions", id, Marker::LINE_STRIP, rgba);
  outline.scale.x = 0.0015;
  std::vector<Eigen::Vector3d> corners;
  for (const Eigen::Vector2d& sign : { Eigen::Vector2d(-1.0, -1.0), { 1.0, -1.0 }, { 1.0, 1.0 }, { -1.0, 1.0 } })
  {
    corners.push_back(detector.pixelPosition(centre + linear * (0.5 * size.cwiseProduct(sign))));
  }
  addClosedLine(corners, outline);
  Marker ray = makeRay("region_rays", id, detector, centre, rgba);
  if (region.state == TrackedRegion::UNTRAINED)
  {
    outline.action = ray.action = Marker::DELETE;
  }
  return { ray, outline };
}

void fade(std::vector<Marker>& markers)
{
  for (Marker& marker : markers)
  {
    marker.color = kOldColour;
  }
}

Marker trailMarker(const std::vector<geometry_msgs::Point>& points)
{
  Marker trail = makeMarker("trail", 0, Marker::LINE_STRIP, kTrailColour);
  trail.scale.x = 0.0008;
  trail.points = points;
  if (points.size() < 2)
  {
    trail.action = Marker::DELETE;
  }
  return trail;
}

Marker gateMarker(bool open, const std::string& why)
{
  Marker marker = makeMarker("beam_gate", 0, Marker::TEXT_VIEW_FACING, open ? kOpenColour : kHoldColour);
  marker.pose.position.z = 0.5;
  marker.scale.z = 0.08;
  marker.text = wrapped((open ? "beam gate open: " : "HOLD: ") + why);
  return marker;
}
}  // namespace xray_tracking
