#include <gtest/gtest.h>

#include "setup_picture/drawing.h"
#include "setup_picture/setup_picture.h"

namespace xray_tracking
{
namespace
{
/// A view from above, its rows towards -y: as one who stands at the patient's feet and looks down has it.
ProjectionGeometry fromAbove()
{
  return ProjectionGeometry::fromDescription(
      { "above", { 400, 300 }, { 0.5, 0.5 }, { 0, 0, 1000 }, { -100, 75, -500 }, { 1, 0, 0 }, { 0, -1, 0 } });
}

ProjectionGeometry fromTheSide()
{
  return ProjectionGeometry::fromDescription(
      { "side", { 400, 300 }, { 0.5, 0.5 }, { 0, 1000, 0 }, { -100, -500, -75 }, { 1, 0, 0 }, { 0, 0, 1 } });
}

/// docs/frames.md: supine, superior along x, posterior along -z, left along -y.
RigidTransform supine()
{
  return makeRigidTransform(Eigen::Vector3d::Zero(), Eigen::Quaterniond(-0.5, 0.5, -0.5, 0.5));
}

TreatmentSetup setupOf(const RigidTransform& pose)
{
  TreatmentSetup setup;
  setup.detectors = { fromAbove(), fromTheSide() };
  setup.room_from_patient = pose;
  setup.target_box = { Eigen::Vector3d(-20, -20, -20), Eigen::Vector3d(20, 20, 20) };
  return setup;
}

/// Pixels of a part of the picture that have nearly a colour.
int countColour(const cv::Mat& picture, const cv::Scalar& colour)
{
  cv::Mat mask;
  cv::inRange(picture, colour - cv::Scalar::all(12), colour + cv::Scalar::all(12), mask);
  return cv::countNonZero(mask);
}

TEST(PatientLetters, nameDirections)
{
  EXPECT_EQ("L", patientLetters({ 1, 0, 0 }));
  EXPECT_EQ("A", patientLetters({ 0.1, -2, 0.2 }));
  EXPECT_EQ("IR", patientLetters({ -0.6, 0, -0.8 }));
  EXPECT_EQ("PSL", patientLetters({ 0.5, 0.7, 0.6 }));
}

TEST(PatientLetters, ofViews)
{
  const auto right = [](const ProjectionGeometry& view, const RigidTransform& pose)
  { return patientLetters(viewFromPatient(view, pose).transpose() * Eigen::Vector3d::UnitX()); };
  const auto down = [](const ProjectionGeometry& view, const RigidTransform& pose)
  { return patientLetters(viewFromPatient(view, pose).transpose() * Eigen::Vector3d::UnitY()); };
  EXPECT_EQ("S", right(fromAbove(), supine()));
  EXPECT_EQ("L", down(fromAbove(), supine()));
  EXPECT_EQ("S", right(fromTheSide(), supine()));
  EXPECT_EQ("A", down(fromTheSide(), supine()));
  // Prone.
  const RigidTransform prone = supine() * RigidTransform(Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitZ()));
  EXPECT_EQ("R", down(fromAbove(), prone));
  EXPECT_EQ("P", down(fromTheSide(), prone));
}

TEST(OrientationCube, showsTheFaceTowardsTheSource)
{
  const cv::Scalar anterior(170, 225, 170), right(170, 170, 235);  // of their faces
  const auto cube = [](const ProjectionGeometry& view, const RigidTransform& pose)
  {
    cv::Mat canvas(120, 120, CV_8UC3, cv::Scalar::all(255));
    drawCube(canvas, { 60, 60 }, 30, viewFromPatient(view, pose));
    return canvas;
  };
  // The source above a supine patient sees his front, the one at +y his right side.
  EXPECT_GT(countColour(cube(fromAbove(), supine()), anterior), 1000);
  EXPECT_EQ(0, countColour(cube(fromAbove(), supine()), right));
  EXPECT_GT(countColour(cube(fromTheSide(), supine()), right), 1000);
  EXPECT_EQ(0, countColour(cube(fromTheSide(), supine()), anterior));
}

TEST(SetupPicture, isDrawnWithWhateverThereIs)
{
  const TreatmentSetup setup = setupOf(supine());
  SetupPictureContent content;
  content.title = "setup.yaml";
  const cv::Mat bare = drawSetup(setup, content);
  EXPECT_EQ(CV_8UC3, bare.type());
  EXPECT_GT(countColour(bare, kTarget), 100);

  content.faults = { std::string(400, 'w') + " " + std::string(300, 'w') };
  content.xrays.assign(2, cv::Mat(300, 400, CV_16UC1, cv::Scalar(1000)));
  content.drrs.assign(2, cv::Mat::zeros(300, 400, CV_32FC1));
  for (int corner = 0; corner < 8; ++corner)
  {
    content.ct_corners.emplace_back(corner & 1 ? 200 : -200, corner & 2 ? 200 : -200, corner & 4 ? 300 : -300);
  }
  const cv::Mat whole = drawSetup(setup, content);
  EXPECT_GT(whole.rows, bare.rows);  // the fault's lines
  EXPECT_GT(countColour(whole, kFault), 100);
}

TEST(SetupPicture, survivesSetupsThatAreWrong)
{
  SetupPictureContent content;
  content.xrays.assign(2, cv::Mat(300, 400, CV_8UC1, cv::Scalar(0)));
  for (const Eigen::Vector3d& place : { Eigen::Vector3d(0, 0, 1e3), Eigen::Vector3d(0, 1e9, 0),
                                        Eigen::Vector3d(1e5, 0, 0), Eigen::Vector3d(0, 0, 1e200) })
  {
    RigidTransform pose = supine();
    pose.translation() = place;
    EXPECT_FALSE(drawSetup(setupOf(pose), content).empty());
  }
  for (const std::size_t count : { 4U, 11U })
  {
    TreatmentSetup setup = setupOf(supine());
    setup.detectors.resize(count, fromAbove());
    EXPECT_FALSE(drawSetup(setup, {}).empty());
  }
}
}  // namespace
}  // namespace xray_tracking
