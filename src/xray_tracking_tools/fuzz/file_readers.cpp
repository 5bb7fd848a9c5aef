// Readers of files.
#include <filesystem>
#include <optional>
#include <stdexcept>

#include "reader_tools.h"
#include "xray_tracking_core/geometry/geometry_import.h"
#include "xray_tracking_core/plan/structure.h"
#include "xray_tracking_core/plan/treatment_plan.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_core/volume/ct_volume.h"

namespace xray_tracking
{
namespace
{
void readSequence(const std::string& bytes)
{
  writeFile("frames.csv", corpusFile("corpus/frames/frames.csv"));
  writeFile("gold_standard.csv", corpusFile("corpus/poses/poses.csv"));
  writeFile("detectors.yaml", corpusFile("corpus/detectors/detectors.yaml"));
  const std::string path = writeFile("sequence.yaml", bytes);
  expected_name = folder();  // of what it names, too
  selfContainedSetup(path);
  const Sequence sequence = loadSequence(folder());
  require(isRigid(sequence.setup.room_from_patient), "its pose is not rigid");
  require(sequence.setup.detectors.size() >= 2 && !sequence.exposures.empty(), "has no exposures or detectors");
}

void readFrames(const std::string& bytes)
{
  writeFile("sequence.yaml", corpusFile("corpus/sequence/table.yaml"));
  writeFile("gold_standard.csv", corpusFile("corpus/poses/poses.csv"));
  writeFile("frames.csv", bytes);
  expected_name = folder();
  require(!loadSequence(folder()).exposures.empty(), "has no exposures");
}

void readPoses(const std::string& bytes)
{
  for (const StampedPose& pose : loadPoses(writeFile("poses.csv", bytes)))
  {
    require(isRigid(pose.room_from_patient), "a pose is not rigid");
  }
}

void importFrom(const std::vector<std::string>& files, const GeometryImportOptions& options)
{
  const ImportedGeometry geometry = importGeometry(files, options);
  require(geometry.detectors.size() >= 2, "has fewer than two detectors");
  writeDetectors(geometry, folder() + "/imported.yaml", "");
}

GeometryImportOptions withPitch()
{
  GeometryImportOptions options;
  options.pixel_pitch = Eigen::Vector2d(30.0, 30.0);
  return options;
}

void readMayaCam(const std::string& bytes)
{
  const std::string other = writeFile("b.txt", corpusFile("companions/detector_b.txt"));
  const std::string path = writeFile("a.txt", bytes);
  expected_name = folder();  // one file may contradict the other
  importFrom({ path, other }, withPitch());
}

void readMatrices(const std::string& bytes)
{
  GeometryImportOptions options = withPitch();
  options.image_size = Eigen::Vector2i(8, 6);
  importFrom({ writeFile("matrices.txt", bytes) }, options);
}

void readRtk(const std::string& bytes)
{
  GeometryImportOptions options = withPitch();
  options.image_size = Eigen::Vector2i(8, 6);
  options.projections = { 0, 1 };
  options.flip_rows = { "detector_a", "detector_b" };
  importFrom({ writeFile("rtk.xml", bytes) }, options);
}

void readDetectors(const std::string& bytes)
{
  const std::string path = writeFile("detectors.yaml", bytes);
  expected_name = folder();  // of a file that it names, too
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
  const std::string other = writeFile("b.dcm", corpusFile("companions/xa.dcm"));
  const std::string path = writeFile("a.dcm", bytes);
  expected_name = folder();
  importFrom({ path, other }, options);
}

void readImage(const std::string& bytes, const std::string& name)
{
  const cv::Mat image = readXrayImage(writeFile(name, bytes), setup().detectors[0], setup().intensity);
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
  readVolume(writeFile("ct.nrrd", bytes));
}

void readMeta(const std::string& bytes)
{
  readVolume(writeFile("ct.mha", bytes));
}

void readNifti(const std::string& bytes)
{
  const bool packed = bytes.compare(0, 2, "\x1f\x8b") == 0;
  readVolume(writeFile(packed ? "ct.nii.gz" : "ct.nii", bytes));
}

void readCtFile(const std::string& bytes)
{
  readVolume(writeFile("enhanced.dcm", bytes));
}

void readCtSlice(const std::string& bytes)
{
  std::filesystem::create_directory(folder() + "/ct");
  writeFile("ct/0.dcm", corpusFile("companions/slice_0.dcm"));
  writeFile("ct/1.dcm", bytes);
  writeFile("ct/2.dcm", corpusFile("companions/slice_2.dcm"));
  expected_name = folder() + "/ct";
  readVolume(expected_name);
}

void readStructureSet(const std::string& bytes)
{
  const Structure structure = Structure::read({ writeFile("structures.dcm", bytes), "C4" });
  require(structure.box().min().allFinite() && structure.box().max().allFinite(), "its box is not finite");
}

void readPlan(const std::string& bytes)
{
  const TreatmentPlan plan = readTreatmentPlan(writeFile("plan.dcm", bytes));
  require(isRigid(roomFromPatient(chosenBeam(plan, std::nullopt))), "its pose is not rigid");
}

}  // namespace

std::vector<Reader> fileReaders()
{
  return { { "sequence", readSequence },
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
           { "plan", readPlan } };
}
}  // namespace xray_tracking
