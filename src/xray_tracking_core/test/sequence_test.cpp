#include <cmath>
#include <filesystem>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "shared_data.h"
#include "test_helpers.h"
#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
namespace
{
const Eigen::Vector2i kSize(6, 4);

std::string replaced(std::string text, const std::string& from, const std::string& to)
{
  const std::size_t at = text.find(from);
  if (at == std::string::npos)
  {
    throw std::logic_error("'" + from + "' is not in the text");
  }
  return text.replace(at, from.size(), to);
}

/// A sequence of two exposures of two views at right angles, with all keys.
class SequenceFolder
{
public:
  SequenceFolder()
  {
    for (const char* name : { "a0.png", "b0.png", "a1.png", "b1.png" })
    {
      cv::imwrite(folder_.path(name), cv::Mat(kSize.y(), kSize.x(), CV_16UC1, cv::Scalar(1000)));
    }
    write();
  }

  void write() const
  {
    folder_.write("sequence.yaml", yaml);
    folder_.write("frames.csv", frames);
    folder_.write("gold.csv", gold);
  }

  Sequence load() const { return loadSequence(folder_.path()); }

  void expectLoadError(const std::vector<std::string>& parts) const
  {
    write();
    expectError<std::runtime_error>([this] { load(); }, parts);
  }

  const TemporaryFolder& folder() const { return folder_; }

  std::string yaml = R"(ct: ct/volume.nrrd
intensity: {kind: counts, offset: 100, air_counts: 60000}
detectors:
  - name: detector_a
    image_size: [6, 4]
    pixel_pitch_mm: [20.0, 30.0]
    source_mm: [0.0, 0.0, 1000.0]
    origin_mm: [-50.0, 45.0, -500.0]
    x_direction: [1.0, 0.0, 0.0]
    y_direction: [0.0, -1.0, 0.0]
  - name: detector_b
    image_size: [6, 4]
    pixel_pitch_mm: [20.0, 30.0]
    source_mm: [0.0, 1000.0, 0.0]
    origin_mm: [-50.0, -500.0, -45.0]
    x_direction: [1.0, 0.0, 0.0]
    y_direction: [0.0, 0.0, 1.0]
frames: frames.csv
gold_standard: gold.csv
initial_pose: {translation_mm: [1, 2, 3.5], rotation_xyzw: [0.5, -0.5, 0.5, -0.5]}
target_box_mm: {min: [-10, -20, -30], max: [10, 22, 36]}
regions:
  detector_a: {x_offset: 1, y_offset: 0, width: 5, height: 4}
site: a key that nobody reads
)";
  std::string frames =
      "stamp_s,detector,file\n"
      "1699999999.123456789,detector_a,a0.png\n"
      "1699999999.123456789,detector_b,b0.png\n"
      "1700000000.1,detector_b,b1.png\n"
      "1700000000.1,detector_a,a1.png\n";
  std::string gold =
      "stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n"
      "1699999999.123456789,1,2,3.5,0.5,-0.5,0.5,-0.5\n"
      "1700000000.1,1.25,-2e1,3,0,0,0,1\n";

private:
  TemporaryFolder folder_;
};

TEST(Sequence, ReadsEverything)
{
  const SequenceFolder folder;
  const Sequence sequence = folder.load();
  const TreatmentSetup& setup = sequence.setup;
  EXPECT_EQ(setup.ct_path, folder.folder().path("ct/volume.nrrd"));
  EXPECT_EQ(setup.intensity.kind, IntensityModel::Kind::COUNTS);
  EXPECT_EQ(setup.intensity.offset, 100.0);
  EXPECT_EQ(setup.intensity.air_counts.value(), 60000.0);
  ASSERT_EQ(setup.detectors.size(), 2u);
  EXPECT_EQ(setup.detector("detector_b").source(), Eigen::Vector3d(0.0, 1000.0, 0.0));
  EXPECT_EQ(setup.detector("detector_b").pixelPitch(), Eigen::Vector2d(20.0, 30.0));
  EXPECT_EQ(setup.room_from_patient.translation(), Eigen::Vector3d(1.0, 2.0, 3.5));
  // The patient lies on the back, head along room x: superior to x, posterior to -z, left to -y.
  EXPECT_LT((setup.room_from_patient.linear() * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitX()).norm(), 1e-12);
  EXPECT_LT((setup.room_from_patient.linear() * Eigen::Vector3d::UnitY() + Eigen::Vector3d::UnitZ()).norm(), 1e-12);
  EXPECT_LT((setup.room_from_patient.linear() * Eigen::Vector3d::UnitX() + Eigen::Vector3d::UnitY()).norm(), 1e-12);
  EXPECT_EQ(setup.targetCentre(), Eigen::Vector3d(0.0, 1.0, 3.0));
  EXPECT_EQ(setup.ct_content, CtContent::RECOGNISED);
  EXPECT_EQ(setup.regions.size(), 1u);
  EXPECT_EQ(setup.regions.at("detector_a"), cv::Rect(1, 0, 5, 4));

  ASSERT_EQ(sequence.exposures.size(), 2u);
  EXPECT_EQ(sequence.exposures[0].stamp_ns, 1699999999123456789);
  EXPECT_EQ(sequence.exposures[1].stamp_ns, 1700000000100000000);
  EXPECT_EQ(sequence.exposures[1].files[0], folder.folder().path("a1.png"));
  EXPECT_EQ(sequence.exposures[1].files[1], folder.folder().path("b1.png"));
  ASSERT_EQ(sequence.gold_standard.size(), 2u);
  EXPECT_EQ(sequence.gold_standard[1].stamp_ns, 1700000000100000000);
  EXPECT_EQ(sequence.gold_standard[1].room_from_patient.translation(), Eigen::Vector3d(1.25, -20.0, 3.0));
  EXPECT_EQ(sequence.gold_standard[1].room_from_patient.linear(), Eigen::Matrix3d::Identity());

  expectError<std::invalid_argument>([&] { setup.detector("detector_c"); }, { "detector_c", "detector_a, detector_b" });
}

TEST(Sequence, OptionalKeysMayLack)
{
  SequenceFolder folder;
  folder.yaml = replaced(folder.yaml, "ct: ct/volume.nrrd\n", "");
  folder.yaml = replaced(folder.yaml, "intensity: {kind: counts, offset: 100, air_counts: 60000}\n", "");
  folder.yaml = replaced(folder.yaml, "gold_standard: gold.csv\n", "");
  folder.yaml = folder.yaml.substr(0, folder.yaml.find("regions:"));
  folder.write();
  const Sequence sequence = folder.load();
  EXPECT_TRUE(sequence.setup.ct_path.empty());
  EXPECT_FALSE(sequence.setup.intensity.air_counts);
  EXPECT_TRUE(sequence.setup.regions.empty());
  EXPECT_TRUE(sequence.gold_standard.empty());
}

TEST(Sequence, ToleratesOtherLineEndings)
{
  SequenceFolder folder;
  std::string windows = "\xEF\xBB\xBF";
  for (const char c : folder.frames)
  {
    windows += c == '\n' ? "\r\n" : std::string(1, c);
  }
  folder.frames = windows + "\r\n\r\n  \n";
  folder.gold.pop_back();  // no line end at the end
  folder.gold += ",and a further column";
  folder.write();
  const Sequence sequence = folder.load();
  ASSERT_EQ(sequence.exposures.size(), 2u);
  EXPECT_EQ(sequence.exposures[1].files[0], folder.folder().path("a1.png"));
  EXPECT_EQ(sequence.gold_standard.size(), 2u);
}

TEST(Sequence, GoldStandardMayHaveFurtherRows)
{
  SequenceFolder folder;
  const std::string further = ",0,0,0,0,0,0,1\n";
  folder.gold = replaced(folder.gold, "1699999999.1", "1699999998" + further + "1699999999.1");
  folder.gold = replaced(folder.gold, "1700000000.1", "1700000000" + further + "1700000000.1") + "1700000001" + further;
  folder.write();
  const Sequence sequence = folder.load();
  ASSERT_EQ(sequence.gold_standard.size(), 2u);
  for (int i = 0; i < 2; ++i)
  {
    EXPECT_EQ(sequence.gold_standard[i].stamp_ns, sequence.exposures[i].stamp_ns);
    EXPECT_EQ(sequence.gold_standard[i].room_from_patient.translation().x(), 1.0 + 0.25 * i);
  }
}

TEST(Sequence, DetectorsMayBeExposedMillisecondsApart)
{
  const auto load = [](const std::string& tolerance, const std::string& stamps)
  {
    SequenceFolder folder;
    folder.yaml += tolerance;
    folder.yaml = replaced(folder.yaml, "gold_standard: gold.csv\n", "");
    folder.frames = "stamp_s,detector,file\n" + stamps;
    folder.write();
    return folder.load();
  };
  const std::string first = "10.000,detector_b,b0.png\n10.003,detector_a,a0.png\n";
  const Sequence sequence = load("", first + "10.0331,detector_a,a1.png\n10.0302,detector_b,b1.png\n");
  ASSERT_EQ(sequence.exposures.size(), 2u);
  EXPECT_EQ(sequence.exposures[0].stamp_ns, 10003000000) << "that of the first detector";
  EXPECT_EQ(sequence.exposures[1].stamp_ns, 10033100000);
  EXPECT_NE(sequence.exposures[1].files[1].find("b1.png"), std::string::npos);
  // Two exposures within the tolerance are still two.
  EXPECT_EQ(load("", first + "10.004,detector_a,a1.png\n10.004,detector_b,b1.png\n").exposures.size(), 2u);

  const std::string late = "10.000,detector_a,a0.png\n10.009,detector_b,b0.png\n";
  expectError<std::runtime_error>([&] { load("", late); }, { "frames.csv, line 3", "pairing_tolerance" });
  EXPECT_EQ(load("pairing_tolerance: 0.01\n", late).exposures.size(), 1u);
  expectError<std::runtime_error>([&] { load("pairing_tolerance: 0.0\n", first); }, { "frames.csv, line 3" });
  for (const char* bad : { "-0.1", "1.5", "soon", ".nan" })
  {
    expectError<std::runtime_error>([&] { load(std::string("pairing_tolerance: ") + bad + "\n", first); },
                                    { "sequence.yaml", "pairing_tolerance", bad });
  }
}

/// By the numbers in their names, however these are written.
TEST(Sequence, FramesMayBePatternsOfFiles)
{
  SequenceFolder folder;
  std::filesystem::create_directory(folder.folder().path("cam1"));
  std::filesystem::create_directory(folder.folder().path("cam2"));
  for (int k = 0; k < 12; ++k)
  {
    const cv::Mat image(kSize.y(), kSize.x(), CV_16UC1, cv::Scalar(1000 + k));
    cv::imwrite(folder.folder().path("cam1/run2_" + std::to_string(k + 1) + ".png"), image);  // 1, 2, .. 12
    cv::imwrite(folder.folder().path("cam2/f" + std::string(k < 10 ? "00" : "0") + std::to_string(k) + ".png"), image);
  }
  folder.yaml = replaced(folder.yaml, "frames: frames.csv",
                         "frames: {rate: 30, files: {detector_a: cam1/*.png, detector_b: 'cam2/f???.png'}}");
  folder.yaml = replaced(folder.yaml, "gold_standard: gold.csv\n", "");
  folder.write();
  const Sequence sequence = folder.load();
  ASSERT_EQ(12u, sequence.exposures.size());
  EXPECT_EQ(1u, sequence.tables.size());
  for (int k = 0; k < 12; ++k)
  {
    const auto at = static_cast<std::size_t>(k);
    EXPECT_EQ(std::llround(k / 30.0 * 1e9), sequence.exposures[at].stamp_ns);
    EXPECT_EQ(1000 + k, sequence.image(at, 0).at<std::uint16_t>(0, 0)) << sequence.exposures[at].files[0];
    EXPECT_EQ(1000 + k, sequence.image(at, 1).at<std::uint16_t>(0, 0)) << sequence.exposures[at].files[1];
  }

  const std::string good = "{rate: 30, files: {detector_a: cam1/*.png, detector_b: 'cam2/f???.png'}}";
  const auto refused = [&](const std::string& from, const std::string& to, const std::vector<std::string>& parts)
  {
    const std::string yaml = folder.yaml;
    folder.yaml = replaced(yaml, good, replaced(good, from, to));
    folder.expectLoadError(parts);
    folder.yaml = yaml;
  };
  refused("rate: 30", "rate: 0", { "sequence.yaml, line", "frames.rate", "exposures a second" });
  refused("rate: 30", "rate: .nan", { "frames.rate", "finite" });
  refused("rate: 30, ", "", { "frames.rate", "missing" });
  refused("files:", "images:", { "frames.files", "missing" });
  refused("cam1/*.png", "cam1/*.tif", { "frames.files.detector_a", "cam1/*.tif", "files that are there" });
  refused("cam1/*.png", "cam1/*2.png", { "frames.files.detector_b", "as many files as detector_a has, 2, not 12" });
  refused("detector_b: 'cam2", "detector_c: 'cam2", { "frames.files.detector_c", "detector_a, detector_b" });
  refused(", detector_b: 'cam2/f???.png'", "", { "no image of detector_b" });
  std::filesystem::remove(folder.folder().path("cam1/run2_5.png"));
  std::filesystem::remove(folder.folder().path("cam2/f007.png"));
  refused("rate: 30", "rate: 20", { "frames.files.detector_a", "run2_4.png and ", "run2_6.png 1 are missing" });
  cv::imwrite(folder.folder().path("cam1/run2_03.png"), cv::Mat(kSize.y(), kSize.x(), CV_16UC1, cv::Scalar(7)));
  refused("rate: 30", "rate: 20", { "frames.files.detector_a", "run2_03.png", "run2_3.png" });
}

/// It is the files' matter alone: images come out straight, and what a graph or a bag is told has none.
TEST(Sequence, DistortedImagesAreReadStraight)
{
  SequenceFolder folder;
  cv::Mat slope(kSize.y(), kSize.x(), CV_16UC1);
  for (int u = 0; u < slope.cols; ++u)
  {
    slope.col(u) = 1000 + 100 * u;
  }
  cv::imwrite(folder.folder().path("b0.png"), slope);
  // detector_b: fx = 75, cx = 2.5; p1 moves y by p1 r^2, nothing else of note. k1: x by 75 k1 (x / 75)^3.
  folder.yaml = replaced(folder.yaml, "    y_direction: [0.0, 0.0, 1.0]\n",
                         "    y_direction: [0.0, 0.0, 1.0]\n"
                         "    distortion: {model: plumb_bob, coefficients: [-100, 0, 0, 0]}\n");
  folder.write();
  const Sequence sequence = folder.load();
  ASSERT_EQ(2u, sequence.distortions.size());
  EXPECT_TRUE(sequence.distortions[0].none());
  EXPECT_FALSE(sequence.distortions[1].none());
  const auto& [b, intensity] = std::tie(sequence.setup.detectors[1], sequence.setup.intensity);
  const cv::Mat stored = readXrayImage(folder.folder().path("b0.png"), b, intensity);
  EXPECT_EQ(0, cv::norm(slope, stored, cv::NORM_INF));
  // Pixel (4, 1), of y = 30 (1 - 1.5) / 1500: r^2 = 0.02^2 + 0.01^2, so that it is found 100 r^2 = 5 % nearer to 2.5.
  EXPECT_NEAR(1000.0 + 100.0 * (2.5 + 1.5 * 0.95), sequence.image(0, 1).at<std::uint16_t>(1, 4), 100.0 / 64.0 + 0.5);
  EXPECT_EQ(1000, sequence.image(0, 0).at<std::uint16_t>(1, 4));

  const std::string text = selfContainedSetup(folder.folder().path("sequence.yaml"));
  EXPECT_EQ(text.find("distortion"), std::string::npos) << text;
  EXPECT_EQ(2u, treatmentSetupFromText(text, "setup").detectors.size());

  const auto refused = [&](const std::string& distortion, const std::vector<std::string>& parts)
  {
    SequenceFolder other;
    other.yaml = replaced(folder.yaml, "{model: plumb_bob, coefficients: [-100, 0, 0, 0]}", distortion);
    other.expectLoadError(parts);
  };
  refused("{model: fisheye, coefficients: [0, 0, 0, 0]}",
          { "sequence.yaml, line", "detectors[1].distortion", "fisheye" });
  refused("{coefficients: [0, 0, 0, 0]}", { "detectors[1].distortion.model", "missing" });
  refused("{model: plumb_bob}", { "detectors[1].distortion.coefficients", "missing" });
  refused("{model: plumb_bob, coefficients: 0.1}", { "detectors[1].distortion.coefficients", "a list" });
  refused("{model: plumb_bob, coefficients: [0, .nan, 0, 0]}", { "coefficients[1]", "nan", "finite" });
  refused("{model: plumb_bob, coefficients: [1e9, 0, 0, 0]}", { "detectors[1].distortion", "is moved by" });
  refused("0.1", { "detectors[1].distortion", "keys with values" });
}

TEST(TreatmentSetup, ChoiceOfWhatACtHolds)
{
  SequenceFolder folder;
  folder.yaml += "ct_series: '1.2.3 AcquisitionNumber=2'\nct_nifti_form: sform\n";
  folder.write();
  const TreatmentSetup setup = folder.load().setup;
  saveTreatmentSetup(setup, folder.folder().path("saved.yaml"));
  const TreatmentSetup saved = loadTreatmentSetup(folder.folder().path("saved.yaml"));
  for (const CtChoice& choice : { setup.ct_choice, saved.ct_choice })
  {
    EXPECT_EQ(choice.series, "1.2.3 AcquisitionNumber=2");
    EXPECT_EQ(choice.nifti_form, NiftiForm::SFORM);
  }
  folder.yaml = replaced(folder.yaml, "form: sform", "form: both");
  folder.expectLoadError({ "sequence.yaml", "ct_nifti_form", "both", "qform or sform" });
}

TEST(Sequence, StampsAreExactToTheNanosecond)
{
  SequenceFolder folder;
  const auto first = [&folder](const std::string& stamp)
  {
    folder.yaml = replaced(folder.yaml, "gold_standard: gold.csv\n", "gold_standard:\n");
    folder.frames = "stamp_s,detector,file\n" + stamp + ",detector_a,a0.png\n" + stamp + ",detector_b,b0.png\n";
    folder.write();
    folder.yaml = replaced(folder.yaml, "gold_standard:\n", "gold_standard: gold.csv\n");
    return folder.load().exposures.front().stamp_ns;
  };
  EXPECT_EQ(first("0.0000"), 0);
  EXPECT_EQ(first("7"), 7000000000);
  EXPECT_EQ(first("7."), 7000000000);
  EXPECT_EQ(first("0.000000001"), 1);
  EXPECT_EQ(first("1234567890.987654321"), 1234567890987654321);
  EXPECT_EQ(first("0.0000000015"), 2);  // beyond the ninth digit: rounded
  EXPECT_EQ(first("4294967295.999999999"), 4294967295999999999);

  for (const std::string stamp :
       { "4294967296", "99999999999", "-1.0", "+1.0", "1e3", ".", "nan", "1.5.2", "1.-5", "x" })
  {
    expectError<std::runtime_error>([&] { first(stamp); }, { "frames.csv", "line 2", stamp, "decimal" });
  }
}

TEST(Sequence, RejectsBadFrames)
{
  const auto expectRejected = [](const std::string& from, const std::string& to, const std::vector<std::string>& parts)
  {
    SequenceFolder folder;
    folder.frames = replaced(folder.frames, from, to);
    folder.expectLoadError(parts);
  };
  const std::string last = "1700000000.1,detector_a,a1.png\n";
  expectRejected("detector_a,a0.png", "detector_a,none.png", { "frames.csv, line 2", "none.png", "missing" });
  expectRejected(last, "", { "frames.csv", "no image of detector_a" });
  expectRejected("1699999999.123456789,detector_b,b0.png\n", "", { "frames.csv, line 3", "no image of detector_b" });
  expectRejected(last, last + last, { "frames.csv, line 6", "second image of detector_a" });
  expectRejected(last, last + "1699999998,detector_a,a1.png", { "frames.csv, line 6", "1699999998", "grow" });
  expectRejected("detector_b,b1.png", "detector_c,b1.png", { "frames.csv, line 4", "detector_c", "detector_a" });
  expectRejected("detector_b,b1.png", "detector_b", { "frames.csv, line 4", "file is empty" });
  expectRejected("stamp_s,", "time,", { "frames.csv, line 1", "column stamp_s" });

  SequenceFolder folder;
  folder.frames = "stamp_s,detector,file\n";
  folder.expectLoadError({ "frames.csv", "no exposures" });
  folder.frames = "";
  folder.expectLoadError({ "frames.csv", "column stamp_s" });
  folder.yaml = replaced(folder.yaml, "frames: frames.csv", "frames: other.csv");
  folder.expectLoadError({ "other.csv", "missing" });
}

TEST(Sequence, RejectsBadGoldStandards)
{
  const auto expectRejected = [](const std::string& from, const std::string& to, const std::vector<std::string>& parts)
  {
    SequenceFolder folder;
    folder.gold = replaced(folder.gold, from, to);
    folder.expectLoadError(parts);
  };
  expectRejected("1.25", "nan", { "gold.csv, line 3", "tx_mm", "nan", "finite" });
  expectRejected("1.25", "1.25mm", { "gold.csv, line 3", "tx_mm", "1.25mm" });
  expectRejected(",0,0,0,1", ",0,0,0,0", { "gold.csv, line 3", "quaternion", "unit norm" });
  expectRejected(",0,0,0,1", ",0,0,0", { "gold.csv, line 3", "qw is empty" });
  expectRejected("1700000000.1,", "1700000000.2,", { "gold.csv", "no pose for the exposure at 1700000000.1" });
  expectRejected("1700000000.1,", "1699999999.1,", { "gold.csv, line 3", "1699999999.1", "grow" });
}

TEST(TreatmentSetup, RejectsBadFiles)
{
  const auto expectRejected = [](const std::string& from, const std::string& to, const std::vector<std::string>& parts)
  {
    SequenceFolder folder;
    folder.yaml = replaced(folder.yaml, from, to);
    folder.expectLoadError(parts);
  };
  const std::string file = "sequence.yaml, line ";
  expectRejected("kind: counts", "kind: film", { file + "2", "intensity.kind", "film", "attenuation" });
  expectRejected("air_counts: 60000", "air_counts: 50", { "intensity.air_counts", "50", "above offset" });
  expectRejected("offset: 100", "offset: .nan", { "intensity.offset", "nan", "finite" });
  expectRejected("name: detector_b", "name: detector_a", { "detectors[1].name", "detector_a", "no other" });
  expectRejected("name: detector_b", "title: x", { "detectors[1].name", "missing" });
  expectRejected("[6, 4]", "[6, 4.5]", { file + "5", "detectors[0].image_size[1]", "4.5", "whole" });
  expectRejected("[6, 4]", "[6]", { "detectors[0].image_size", "[6]", "2 numbers" });
  expectRejected("[0.0, 1000.0, 0.0]", "[0.0, .inf, 0.0]", { file + "14", "detectors[1].source_mm[1]", "inf" });
  expectRejected("y_direction: [0.0, -1.0, 0.0]", "y_direction: [1.0, 0.0, 0.0]",
                 { "detectors[0]", "detector_a", "y_direction", "right angle" });
  expectRejected("y_direction: [0.0, -1.0, 0.0]", "y_direction: [0.1, -0.99498744, 0.0]",
                 { "detectors[0]", "y_direction", "right angle" });
  expectRejected("[1, 2, 3.5]", "[1, 2, .nan]", { "initial_pose.translation_mm[2]", "nan", "finite" });
  expectRejected("[0.5, -0.5, 0.5, -0.5]", "[0.5, -0.5, 0.5, 0]", { "initial_pose", "unit norm" });
  expectRejected("initial_pose:", "pose:", { "initial_pose", "missing" });
  expectRejected("max: [10, 22, 36]", "max: [10, -22, 36]", { "target_box_mm", "-22", "below" });
  expectRejected("site: a key", "ct_content: bones\nsite: a key", { "ct_content", "bones", "bone_in_air or labels" });
  expectRejected("  detector_a: {x", "  detector_c: {x", { "regions.detector_c", "detector_a, detector_b" });
  expectRejected("width: 5", "width: 6", { "regions.detector_a", "inside the image of 6 x 4" });
  expectRejected("width: 5", "width: 0", { "regions.detector_a", "inside the image" });
  expectRejected("x_offset: 1", "x_offset: -2147483648", { "regions.detector_a", "inside the image" });
  expectRejected("regions:\n", "regions: 3\nother:\n", { "regions", "3", "keys" });
  expectRejected("detectors:\n", "detectors: others.yaml\nother:\n", { "others.yaml", "missing" });
  expectRejected("detectors:\n", "detectors: sequence.yaml\nother:\n", { "detectors", "a list" });
  expectRejected("detectors:\n", "detectors: []\nother:\n", { "detectors", "two or more" });
  expectRejected("detectors:\n", "detectors: [\n", { "sequence.yaml", "not YAML" });

  // A second value, or one that is spelt so that nobody reads it.
  expectRejected("site: a key", "site: a\nintensity: {kind: attenuation}\nother: a key",
                 { "sequence.yaml, line", "intensity is there twice" });
  expectRejected("max: [10, 22, 36]}", "max: [10, 22, 36], min: [0, 0, 0]}", { "target_box_mm.min is there twice" });
  expectRejected("site: a key", "<<: {ct: other}\nsite: a key", { "merged keys are not read" });
  expectRejected("site: a key that nobody reads\n", "---\nsite: b\n", { "2 documents" });
  expectRejected("air_counts: 60000", "air_count: 60000", { "intensity.air_count", "did you mean air_counts?" });
  expectRejected("regions:\n", "region:\n", { "line", "did you mean regions?" });
  expectRejected("    y_direction: [0.0, 0.0, 1.0]\n", "    y_direction: [0.0, 0.0, 1.0]\n    distorsion: 0\n",
                 { "detectors[1].distorsion", "did you mean distortion?" });

  const TemporaryFolder empty;
  expectError<std::runtime_error>([&] { loadSequence(empty.path()); }, { "sequence.yaml", "missing" });
  empty.write("sequence.yaml", "");
  expectError<std::runtime_error>([&] { loadSequence(empty.path()); }, { "sequence.yaml", "keys" });
}

TEST(TreatmentSetup, DetectorsMayStandInAnotherFile)
{
  SequenceFolder folder;
  const std::size_t begin = folder.yaml.find("detectors:");
  const std::size_t end = folder.yaml.find("frames:");
  std::filesystem::create_directory(folder.folder().path("geometry"));
  folder.folder().write("geometry/room.yaml", folder.yaml.substr(begin, end - begin));
  folder.yaml.replace(begin, end - begin, "detectors: geometry/room.yaml\n");
  folder.write();
  EXPECT_EQ(folder.load().setup.detector("detector_b").source(), Eigen::Vector3d(0.0, 1000.0, 0.0));
  EXPECT_EQ(loadDetectors(folder.folder().path("geometry/room.yaml")).size(), 2u);
}

TEST(TreatmentSetup, ComesBackAsWritten)
{
  SequenceFolder folder;
  TreatmentSetup setup = folder.load().setup;
  setup.intensity.kind = IntensityModel::Kind::ATTENUATION;
  setup.room_from_patient = motionAbout({ 1.0 / 3.0, 2.0, 3.0 }, Twist::Constant(0.1));
  const std::string path = folder.folder().path("setup.yaml");
  setup.ct_content = CtContent::BONE_IN_AIR;
  saveTreatmentSetup(setup, path);
  const TreatmentSetup back = loadTreatmentSetup(path);
  EXPECT_EQ(back.ct_content, CtContent::BONE_IN_AIR);
  EXPECT_EQ(back.ct_path, setup.ct_path);
  EXPECT_EQ(back.intensity.kind, setup.intensity.kind);
  EXPECT_EQ(back.intensity.offset, setup.intensity.offset);
  EXPECT_EQ(back.intensity.air_counts, setup.intensity.air_counts);
  EXPECT_LT((back.room_from_patient.matrix() - setup.room_from_patient.matrix()).norm(), 1e-14);
  EXPECT_EQ(back.target_box.min(), setup.target_box.min());
  EXPECT_EQ(back.target_box.max(), setup.target_box.max());
  EXPECT_EQ(back.regions, setup.regions);
  ASSERT_EQ(back.detectors.size(), setup.detectors.size());
  for (std::size_t i = 0; i < back.detectors.size(); ++i)
  {
    EXPECT_EQ(back.detectors[i].name(), setup.detectors[i].name());
    EXPECT_EQ(back.detectors[i].imageSize(), setup.detectors[i].imageSize());
    EXPECT_LT((back.detectors[i].project({ 9.0, 8.0, 7.0 }) - setup.detectors[i].project({ 9.0, 8.0, 7.0 })).norm(),
              1e-12);
  }
  expectError<std::runtime_error>([&] { saveTreatmentSetup(setup, folder.folder().path("none/setup.yaml")); },
                                  { "none/setup.yaml", "written" });
}

/// What a file names is found from wherever the new one stands.
TEST(TreatmentSetup, StaysAsItIsButForThePose)
{
  SequenceFolder folder;
  const RigidTransform pose = motionAbout({ 1.0 / 3.0, 2.0, 3.0 }, Twist::Constant(0.1));
  const std::string original = folder.folder().path("sequence.yaml");
  std::filesystem::create_directory(folder.folder().path("other"));
  const std::string table = folder.yaml;
  for (const std::string& yaml :
       { table, replaced(table, "frames: frames.csv",
                         "frames: {rate: 1.02354147, files: {detector_a: a*.png, detector_b: b*.png}}") })
  {
    folder.yaml = yaml == table ? table : replaced(yaml, "gold_standard: gold.csv\n", "");
    folder.write();
    const Sequence before = folder.load();
    for (const char* name : { "other/sequence.yaml", "sequence.yaml" })
    {
      saveWithInitialPose(original, pose, folder.folder().path(name));
      const Sequence after = loadSequence(std::filesystem::path(folder.folder().path(name)).parent_path().string());
      EXPECT_LT((after.setup.room_from_patient.matrix() - pose.matrix()).norm(), 1e-12);
      EXPECT_EQ(after.setup.ct_path, before.setup.ct_path);
      EXPECT_EQ(after.setup.regions, before.setup.regions);
      EXPECT_EQ(after.gold_standard.size(), before.gold_standard.size());
      ASSERT_EQ(after.exposures.size(), before.exposures.size());
      for (std::size_t k = 0; k < before.exposures.size(); ++k)
      {
        EXPECT_EQ(after.exposures[k].stamp_ns, before.exposures[k].stamp_ns);
        EXPECT_EQ(after.exposures[k].files, before.exposures[k].files);
      }
    }
  }
  expectError<std::runtime_error>([&] { saveWithInitialPose(original, pose, folder.folder().path("none/x.yaml")); },
                                  { "none/x.yaml", "written" });
  expectError<std::runtime_error>([&] { saveWithInitialPose(folder.folder().path("no.yaml"), pose, original); },
                                  { "no.yaml", "missing" });
}

TEST(TreatmentSetup, PhantomPreset)
{
  const TreatmentSetup setup =
      loadTreatmentSetup((std::filesystem::path(__FILE__).parent_path() / "../config/phantom_neck.yaml").string());
  EXPECT_EQ(setup.detectors.size(), 2u);
  EXPECT_TRUE(setup.target_box.contains(Eigen::Vector3d(0.0, 0.0, 0.0)));
  EXPECT_EQ(setup.intensity.air_counts.value(), 60000.0);
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    const cv::Rect region = projectedTargetRegion(setup, detector);
    EXPECT_LT(region.width, 250);
    EXPECT_TRUE(region.contains(cv::Point(255, 255)));
  }
}

TEST(TreatmentSetup, TargetRegionHoldsTheProjectedBox)
{
  TreatmentSetup setup =
      loadTreatmentSetup((std::filesystem::path(__FILE__).parent_path() / "../config/phantom_neck.yaml").string());
  setup.room_from_patient = setup.room_from_patient * motionAbout({ 0.0, 0.0, 0.0 }, Twist::Constant(0.2));
  const auto seenRegion = [&setup](const ProjectionGeometry& detector)
  {
    // The pixels that a dense sample of the box falls on.
    cv::Rect seen;
    constexpr int kSteps = 60;
    for (int i = 0; i < (kSteps + 1) * (kSteps + 1) * (kSteps + 1); ++i)
    {
      const Eigen::Array3d share(i % (kSteps + 1), i / (kSteps + 1) % (kSteps + 1), i / (kSteps + 1) / (kSteps + 1));
      const Eigen::Vector3d point = setup.target_box.min().array() + share / kSteps * setup.target_box.sizes().array();
      const Eigen::Vector2d pixel = detector.project(setup.room_from_patient * point);
      seen |= cv::Rect(int(std::lround(pixel.x())), int(std::lround(pixel.y())), 1, 1);
    }
    return seen & cv::Rect(0, 0, detector.imageSize().x(), detector.imageSize().y());
  };
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    EXPECT_EQ(projectedTargetRegion(setup, detector), seenRegion(detector));
  }
  setup.room_from_patient.pretranslate(Eigen::Vector3d(60.0, 0.0, 20.0));  // over the edge
  for (const ProjectionGeometry& detector : setup.detectors)
  {
    EXPECT_EQ(projectedTargetRegion(setup, detector), seenRegion(detector));
    EXPECT_EQ(seenRegion(detector).br().x, 512);
  }
  setup.room_from_patient.pretranslate(Eigen::Vector3d(500.0, 0.0, 0.0));  // out of sight
  EXPECT_TRUE(projectedTargetRegion(setup, setup.detectors[0]).empty());
  setup.room_from_patient.pretranslate(Eigen::Vector3d(-500.0, 4000.0, 4000.0));  // behind the source
  EXPECT_TRUE(projectedTargetRegion(setup, setup.detectors[0]).empty());
}

TEST_F(SharedDataTest, ThoraxSequences)
{
  for (const char* name : { "thorax_01", "thorax_02" })
  {
    const Sequence sequence = loadSequence(folder_ + "/sequences/" + name);
    EXPECT_EQ(sequence.exposures.size(), 20u);
    EXPECT_EQ(sequence.gold_standard.size(), 20u);
    EXPECT_EQ(sequence.setup.regions.size(), 2u);
    EXPECT_TRUE(std::filesystem::is_directory(sequence.setup.ct_path));
    // The setup's pose is the first of the gold standard; its six digits round the quaternion.
    EXPECT_LT((sequence.setup.room_from_patient.matrix() - sequence.gold_standard[0].room_from_patient.matrix()).norm(),
              1e-5);
    for (std::size_t i = 0; i < sequence.setup.detectors.size(); ++i)
    {
      const ProjectionGeometry& detector = sequence.setup.detectors[i];
      EXPECT_EQ(detector.imageSize(), Eigen::Vector2i(512, 512));
      EXPECT_NEAR(detector.sourceToDetector(), 3800.0, 0.01);  // directions of six digits
      const cv::Mat image = readXrayImage(sequence.exposures.back().files[i], detector, sequence.setup.intensity);
      EXPECT_GT(cv::mean(image)[0], sequence.setup.intensity.offset);
      // The region is the target's projection, rounded in its author's way.
      const cv::Rect& drawn = sequence.setup.regions.at(detector.name());
      const cv::Rect seen = projectedTargetRegion(sequence.setup, detector);
      EXPECT_LT(cv::norm(drawn.tl() - seen.tl()), 1.5) << drawn << seen;
      EXPECT_LT(cv::norm(drawn.br() - seen.br()), 1.5) << drawn << seen;
    }
  }
}

TEST(Sequence, FilesOfMoreThanTheyCanHold)
{
  const TemporaryFolder folder;
  for (const char* const name : { "large.yaml", "large.csv" })
  {
    folder.write(name, "stamp_s");
    std::filesystem::resize_file(folder.path(name), std::uintmax_t{ 5 } << 30);  // sparse: it takes no space
  }
  expectError<std::runtime_error>([&] { loadTreatmentSetup(folder.path("large.yaml")); },
                                  { "large.yaml", "is 5120 MB" });
  expectError<std::runtime_error>([&] { loadPoses(folder.path("large.csv")); }, { "large.csv", "is 5120 MB" });
}
}  // namespace
}  // namespace xray_tracking
