#include "readers.h"

#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <typeinfo>

#include <XmlRpcException.h>
#include <XmlRpcValue.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <xray_tracking_msgs/RefinementRequest.h>
#include <xray_tracking_msgs/TrackedRegion.h>

#include "ros/tracked_view_message.h"
#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_conversions/image_pixels.h"
#include "xray_tracking_core/geometry/geometry_import.h"
#include "xray_tracking_core/plan/structure.h"
#include "xray_tracking_core/plan/treatment_plan.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_core/volume/ct_volume.h"
#include "xray_tracking_detector_simulator/simulator_parameters.h"
#include "xray_tracking_hyperplane_tracker/tracker_parameters.h"
#include "xray_tracking_motion_estimation/motion_estimation_parameters.h"
#include "xray_tracking_motion_estimation/motion_estimator.h"
#include "xray_tracking_motion_estimation/region_patch.h"
#include "xray_tracking_registration/refinement_messages.h"
#include "xray_tracking_registration/registration_parameters.h"
#include "xray_tracking_tools/recording.h"

namespace xray_tracking
{
namespace
{
namespace fs = std::filesystem;

/// Of what a message is about: the file, the topic, an option, a field.
std::string expected_name;

/// A folder of this process, gone when it ends.
class Folder
{
public:
  Folder()
  {
    std::string name = (fs::temp_directory_path() / "xray_tracking_readers_XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr)
    {
      throw std::logic_error("no folder for temporary files");
    }
    path_ = name;
    for (const char* image : { "a_0.png", "a_1.png", "b_0.png", "b_1.png" })
    {
      write(image, "");  // is only looked for
    }
  }
  ~Folder() { fs::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  const std::string& path() const { return path_; }

  std::string write(const std::string& name, const std::string& bytes) const
  {
    const std::string path = path_ + "/" + name;
    std::ofstream(path, std::ios::binary) << bytes;
    expected_name = path;
    return path;
  }

private:
  std::string path_;
};

const Folder& folder()
{
  static const Folder only;
  return only;
}

std::string corpusFile(const std::string& name)
{
  std::ifstream file(std::string(FUZZ_FOLDER) + "/" + name, std::ios::binary);
  if (!file)
  {
    throw std::logic_error(name + " is missing");
  }
  return std::string(std::istreambuf_iterator<char>(file), {});
}

/// The setup of the other readers: two views of 8 x 6 pixels.
const TreatmentSetup& setup()
{
  static const TreatmentSetup only = treatmentSetupFromText(corpusFile("corpus/sequence/table.yaml"), "table.yaml");
  return only;
}

void require(bool holds, const char* what)
{
  if (!holds)
  {
    throw std::logic_error(std::string("read, but ") + what);
  }
}

void readSequence(const std::string& bytes)
{
  folder().write("frames.csv", corpusFile("corpus/frames/frames.csv"));
  folder().write("gold_standard.csv", corpusFile("corpus/poses/poses.csv"));
  folder().write("detectors.yaml", corpusFile("corpus/detectors/detectors.yaml"));
  const std::string path = folder().write("sequence.yaml", bytes);
  expected_name = folder().path();  // of what it names, too
  selfContainedSetup(path);
  const Sequence sequence = loadSequence(folder().path());
  require(isRigid(sequence.setup.room_from_patient), "its pose is not rigid");
  require(sequence.setup.detectors.size() >= 2 && !sequence.exposures.empty(), "has no exposures or detectors");
}

void readFrames(const std::string& bytes)
{
  folder().write("sequence.yaml", corpusFile("corpus/sequence/table.yaml"));
  folder().write("gold_standard.csv", corpusFile("corpus/poses/poses.csv"));
  folder().write("frames.csv", bytes);
  expected_name = folder().path();
  require(!loadSequence(folder().path()).exposures.empty(), "has no exposures");
}

void readPoses(const std::string& bytes)
{
  for (const StampedPose& pose : loadPoses(folder().write("poses.csv", bytes)))
  {
    require(isRigid(pose.room_from_patient), "a pose is not rigid");
  }
}

void importFrom(const std::vector<std::string>& files, const GeometryImportOptions& options)
{
  const ImportedGeometry geometry = importGeometry(files, options);
  require(geometry.detectors.size() >= 2, "has fewer than two detectors");
  writeDetectors(geometry, folder().path() + "/imported.yaml", "");
}

GeometryImportOptions withPitch()
{
  GeometryImportOptions options;
  options.pixel_pitch = Eigen::Vector2d(30.0, 30.0);
  return options;
}

void readMayaCam(const std::string& bytes)
{
  const std::string other = folder().write("b.txt", corpusFile("companions/detector_b.txt"));
  importFrom({ folder().write("a.txt", bytes), other }, withPitch());
}

void readMatrices(const std::string& bytes)
{
  GeometryImportOptions options = withPitch();
  options.image_size = Eigen::Vector2i(8, 6);
  importFrom({ folder().write("matrices.txt", bytes) }, options);
}

void readRtk(const std::string& bytes)
{
  GeometryImportOptions options = withPitch();
  options.image_size = Eigen::Vector2i(8, 6);
  options.projections = { 0, 1 };
  options.flip_rows = { "detector_a", "detector_b" };
  importFrom({ folder().write("rtk.xml", bytes) }, options);
}

void readDetectors(const std::string& bytes)
{
  const std::string path = folder().write("detectors.yaml", bytes);
  expected_name = folder().path();  // of a file that it names, too
  loadDistortions(path, loadDetectors(path));
  importFrom({ path }, {});
}

void readDicomGeometry(const std::string& bytes)
{
  GeometryImportOptions options;
  options.flip_columns = { "detector_b" };
  if (bytes.find("XA") != std::string::npos)
  {
    options.flip_columns.insert("detector_a");
  }
  const std::string other = folder().write("b.dcm", corpusFile("companions/xa.dcm"));
  const std::string path = folder().write("a.dcm", bytes);
  expected_name = folder().path();
  importFrom({ path, other }, options);
}

void readImage(const std::string& bytes, const std::string& name)
{
  const cv::Mat image = readXrayImage(folder().write(name, bytes), setup().detectors[0], setup().intensity);
  require(image.type() == CV_16UC1 && image.size() == cv::Size(8, 6), "is not of the detector's size");
}

void readPng(const std::string& bytes)
{
  readImage(bytes, "image.png");
}

void readTiff(const std::string& bytes)
{
  readImage(bytes, "image.tif");
}

void readDicomImage(const std::string& bytes)
{
  readImage(bytes, "image.dcm");
}

void check(const CtVolume& volume)
{
  require(volume.hu.size() == volume.grid.voxelCount(), "has another number of voxels");
  require(volume.grid.patient_from_index.matrix().allFinite(), "its grid is not finite");
}

void readVolume(const std::string& path)
{
  if (!refusalOf({ "labels", [](const std::string& volume) { check(readLabelMap(volume)); } }, path).empty())
  {
    check(readCtVolume(path));
  }
}

void readNrrd(const std::string& bytes)
{
  readVolume(folder().write("ct.nrrd", bytes));
}

void readMeta(const std::string& bytes)
{
  readVolume(folder().write("ct.mha", bytes));
}

void readNifti(const std::string& bytes)
{
  const bool packed = bytes.compare(0, 2, "\x1f\x8b") == 0;
  readVolume(folder().write(packed ? "ct.nii.gz" : "ct.nii", bytes));
}

void readCtFile(const std::string& bytes)
{
  readVolume(folder().write("enhanced.dcm", bytes));
}

void readCtSlice(const std::string& bytes)
{
  fs::create_directory(folder().path() + "/ct");
  folder().write("ct/0.dcm", corpusFile("companions/slice_0.dcm"));
  folder().write("ct/1.dcm", bytes);
  folder().write("ct/2.dcm", corpusFile("companions/slice_2.dcm"));
  expected_name = folder().path() + "/ct";
  readVolume(expected_name);
}

void readStructureSet(const std::string& bytes)
{
  const Structure structure = Structure::read({ folder().write("structures.dcm", bytes), "C4" });
  require(structure.box().min().allFinite() && structure.box().max().allFinite(), "its box is not finite");
}

void readPlan(const std::string& bytes)
{
  const TreatmentPlan plan = readTreatmentPlan(folder().write("plan.dcm", bytes));
  require(isRigid(roomFromPatient(chosenBeam(plan, std::nullopt))), "its pose is not rigid");
}

void readRunDescription(const std::string& bytes)
{
  expected_name = kRunDescriptionTopic;
  const RunDescription description = runDescriptionFromText(bytes);
  treatmentSetupFromText(description.setup, kRunDescriptionTopic);
}

/// Fields of a message, one after the other. What is not there is zero. (As roscpp serialises them they are not taken:
/// it makes room for as many elements as a message claims before it looks for them.)
class Fields
{
public:
  explicit Fields(const std::string& bytes) : bytes_(bytes) {}

  template <typename Number>
  void read(Number& number)
  {
    number = Number();
    const std::size_t count = std::min(sizeof(number), bytes_.size() - at_);
    std::memcpy(&number, bytes_.data() + at_, count);
    at_ += count;
  }

  template <typename Numbers>
  void readAll(Numbers& numbers)
  {
    for (auto& number : numbers)
    {
      read(number);
    }
  }

  void read(std::string& text)
  {
    std::uint8_t length = 0;
    read(length);
    text = bytes_.substr(at_, length);
    at_ += text.size();
  }

  void read(sensor_msgs::RegionOfInterest& region)
  {
    read(region.x_offset);
    read(region.y_offset);
    read(region.width);
    read(region.height);
  }

  std::string rest() const { return bytes_.substr(at_); }

private:
  const std::string& bytes_;
  std::size_t at_ = 0;
};

void requireReadable(const cv::Mat& pixels)
{
  require(pixels.depth() <= CV_16U && cv::countNonZero(pixels) <= static_cast<int>(pixels.total()), "has no pixels");
}

void readImageMessage(const std::string& bytes)
{
  sensor_msgs::Image message;
  Fields fields(bytes);
  fields.read(message.height);
  fields.read(message.width);
  fields.read(message.is_bigendian);
  fields.read(message.step);
  fields.read(message.encoding);
  const std::string data = fields.rest();
  message.data.assign(data.begin(), data.end());
  expected_name = "image";
  requireReadable(pixelsFromMsg(message));
}

void readCompressedImage(const std::string& bytes)
{
  sensor_msgs::CompressedImage message;
  Fields fields(bytes);
  fields.read(message.format);
  const std::string data = fields.rest();
  message.data.assign(data.begin(), data.end());
  expected_name = "image.format";
  requireReadable(pixelsFromMsg(message));
}

void readCameraInfo(const std::string& bytes)
{
  sensor_msgs::CameraInfo message;
  Fields fields(bytes);
  fields.read(message.height);
  fields.read(message.width);
  fields.readAll(message.K);
  fields.readAll(message.R);
  fields.readAll(message.P);
  fields.read(message.binning_x);
  fields.read(message.binning_y);
  fields.read(message.roi);
  fields.read(message.distortion_model);
  message.D.resize(std::min<std::size_t>(fields.rest().size() / sizeof(double), 20));
  fields.readAll(message.D);
  expected_name = "";
  const ProjectionGeometry& detector = setup().detectors[0];
  const ProjectionGeometry geometry =
      geometryFromCameraInfo(detector.name(), message, detector.roomFromOptical(), detector.sourceToDetector());
  require(geometry.project({ 0.0, 0.0, 0.0 }).allFinite(), "it projects nothing");
}

std::optional<ViewMeasurement> measurementOf(const std::string& bytes)
{
  xray_tracking_msgs::TrackedRegion message;
  Fields fields(bytes);
  fields.read(message.state);
  fields.read(message.model);
  fields.read(message.reference_stamp.sec);
  fields.read(message.reference_stamp.nsec);
  fields.read(message.region);
  fields.read(message.displacement_x);
  fields.read(message.displacement_y);
  fields.readAll(message.linear);
  fields.readAll(message.covariance);
  fields.read(message.fault);
  const TrackedView view = trackedViewFromMsg(message, 0);
  const bool found = view.state == RegionState::TRACKING || view.state == RegionState::DEGRADED;
  return found ? std::make_optional(ViewMeasurement{ setup().room_from_patient, view.track }) : std::nullopt;
}

void readTrackedRegion(const std::string& bytes)
{
  static const MotionEstimator estimator({}, setup().detectors, setup().targetCentre(),
                                         TargetShape::isotropic(setup().targetCentre()), setup().room_from_patient);
  const MotionEstimate estimate =
      estimator.estimate({ measurementOf(bytes), measurementOf(corpusFile("corpus/tracked_region/found")) });
  require((estimate.status == EstimateStatus::OK) == estimate.reason.empty(), "its status and reason contradict");
  require(isRigid(estimate.room_from_patient) && estimate.covariance.allFinite() &&
              estimate.pose_covariance.allFinite() && estimate.translation.allFinite() && estimate.rotation.allFinite(),
          "the estimate is not finite");
  if (estimate.status != EstimateStatus::OK)
  {
    throw std::runtime_error(expected_name + estimate.reason);
  }
}

void readRefinementRequest(const std::string& bytes)
{
  xray_tracking_msgs::RefinementRequest message;
  Fields fields(bytes);
  for (double* number :
       { &message.seed.position.x, &message.seed.position.y, &message.seed.position.z, &message.seed.orientation.x,
         &message.seed.orientation.y, &message.seed.orientation.z, &message.seed.orientation.w,
         &message.max_translation, &message.max_rotation, &message.time_budget })
  {
    fields.read(*number);
  }
  fields.read(message.search);
  std::uint8_t regions = 0;
  fields.read(regions);
  message.regions.resize(regions);
  for (sensor_msgs::RegionOfInterest& region : message.regions)
  {
    fields.read(region);
  }
  expected_name = "";
  RegistrationRequest request;
  for (const ProjectionGeometry& detector : setup().detectors)
  {
    request.views.push_back({ detector, cv::Mat(6, 8, CV_16UC1, cv::Scalar(1000)) });
  }
  request.search = searchOf(message);
  applyRequest(message, setup(), request);
  require(isRigid(request.room_from_patient), "its seed is not rigid");
}

/// A node's parameters, as the parameter server sends them.
ParameterReader parametersOf(const std::string& bytes)
{
  expected_name = "";  // any of them
  int at = 0;
  XmlRpc::XmlRpcValue values;
  try
  {
    values.fromXml(bytes, &at);
  }
  catch (const XmlRpc::XmlRpcException& error)
  {
    throw std::runtime_error(error.getMessage());  // roscpp's own to handle
  }
  return { "/node", values };
}

void readTracker(const std::string& bytes)
{
  TrackerParameters parameters = readTrackerParameters(parametersOf(bytes), "detector_a");
  parameters.adopt(setup());
  HyperplaneTracker{ parameters.tracker };
}

void readMotionEstimation(const std::string& bytes)
{
  const MotionEstimationParameters parameters = readMotionEstimationParameters(parametersOf(bytes));
  MotionMonitor{ parameters.monitor, setup().room_from_patient, setup().target_box };
}

void readRegistration(const std::string& bytes)
{
  readRegistrationParameters(parametersOf(bytes));
}

void readSimulator(const std::string& bytes)
{
  readParameters(parametersOf(bytes));
}
}  // namespace

const std::vector<Reader>& readers()
{
  static const std::vector<Reader> all{ { "sequence", readSequence },
                                        { "frames", readFrames },
                                        { "poses", readPoses },
                                        { "mayacam", readMayaCam },
                                        { "matrices", readMatrices },
                                        { "rtk", readRtk },
                                        { "detectors", readDetectors },
                                        { "dicom_geometry", readDicomGeometry },
                                        { "png", readPng },
                                        { "tiff", readTiff },
                                        { "dicom_image", readDicomImage },
                                        { "nrrd", readNrrd },
                                        { "meta", readMeta },
                                        { "nifti", readNifti },
                                        { "ct_file", readCtFile },
                                        { "ct_slice", readCtSlice },
                                        { "structure_set", readStructureSet },
                                        { "plan", readPlan },
                                        { "run_description", readRunDescription },
                                        { "image", readImageMessage },
                                        { "compressed_image", readCompressedImage },
                                        { "camera_info", readCameraInfo },
                                        { "tracked_region", readTrackedRegion },
                                        { "refinement_request", readRefinementRequest },
                                        { "tracker_parameters", readTracker },
                                        { "motion_parameters", readMotionEstimation },
                                        { "registration_parameters", readRegistration },
                                        { "simulator_parameters", readSimulator } };
  return all;
}

std::string refusalOf(const Reader& reader, const std::string& bytes)
{
  try
  {
    reader.read(bytes);
    return "";
  }
  catch (const std::exception& error)
  {
    const std::string message = error.what();
    // Those that derive from them are of libraries, which know nothing of the file.
    if (typeid(error) != typeid(std::runtime_error) && typeid(error) != typeid(std::invalid_argument))
    {
      throw std::logic_error(reader.name + " let through " + typeid(error).name() + ": " + message);
    }
    const bool of_option = message.compare(0, 2, "--") == 0;
    if (message.empty() || (!of_option && message.find(expected_name) == std::string::npos))
    {
      throw std::logic_error(reader.name + " names nothing: " + message);
    }
    return message;
  }
}
}  // namespace xray_tracking
