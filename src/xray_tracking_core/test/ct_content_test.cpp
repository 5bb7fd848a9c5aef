#include "xray_tracking_core/volume/ct_content.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <random>
#include <string>

#include <gtest/gtest.h>

#include "shared_data.h"
#include "test_helpers.h"
#include "xray_tracking_core/projection/exact_projection.h"
#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
/// Shells of cortical bone filled with marrow: of 14 mm about the middle, and of 5 mm beside it if asked for; in a
/// background.
CtVolume shells(std::int16_t background, bool second)
{
  CtVolume ct;
  ct.grid.size = { 60, 60, 60 };
  ct.grid.patient_from_index = Eigen::Translation3d(-29.5, -29.5, -29.5);
  const auto shell = [](const Eigen::Vector3d& from_centre, double radius, std::int16_t& hu)
  {
    const double distance = from_centre.norm();
    hu = distance > radius ? hu : static_cast<std::int16_t>(distance > radius - 2.0 ? 1200 : -40);
  };
  for (int k = 0; k < 60; ++k)
  {
    for (int j = 0; j < 60; ++j)
    {
      for (int i = 0; i < 60; ++i)
      {
        const Eigen::Vector3d point = ct.grid.patient_from_index * Eigen::Vector3d(i, j, k);
        std::int16_t hu = background;
        shell(point, 14.0, hu);
        if (second)
        {
          shell(point - Eigen::Vector3d(22.0, 0.0, 0.0), 5.0, hu);
        }
        ct.hu.push_back(hu);
      }
    }
  }
  return ct;
}

/// The same inside a ball of soft tissue of 25 mm in air.
CtVolume inTissue()
{
  CtVolume ct = shells(-1000, false);
  for (std::size_t n = 0; n < ct.hu.size(); ++n)
  {
    const Eigen::Vector3d index(static_cast<double>(n % 60), static_cast<double>(n / 60 % 60),
                                static_cast<double>(n / 3600));
    if (ct.hu[n] == -1000 && (ct.grid.patient_from_index * index).norm() < 25.0)
    {
      ct.hu[n] = static_cast<std::int16_t>(40 + n % 7);
    }
  }
  return ct;
}

/// Labels of every point on the shells' grid.
CtVolume labelled(const std::function<int(const Eigen::Vector3d&)>& label)
{
  CtVolume ct = shells(0, false);
  for (std::size_t n = 0; n < ct.hu.size(); ++n)
  {
    const Eigen::Vector3d index(static_cast<double>(n % 60), static_cast<double>(n / 60 % 60),
                                static_cast<double>(n / 3600));
    ct.hu[n] = static_cast<std::int16_t>(label(ct.grid.patient_from_index * index));
  }
  return ct;
}

double sumOf(const ScalarVolume& volume)
{
  return std::accumulate(volume.values.begin(), volume.values.end(), 0.0);
}

/// A NRRD of floats, which writeCtVolume does not write: cubes of 4 voxels with the given values.
void writeFloats(const TemporaryFolder& folder, const std::string& name, const std::vector<float>& cubes)
{
  std::string file = "NRRD0004\ntype: float\ndimension: 3\nspace: left-posterior-superior\nsizes: 4 4 " +
                     std::to_string(4 * cubes.size()) +
                     "\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (0,0,0)\nendian: little\n"
                     "encoding: raw\n\n";
  for (const float value : cubes)
  {
    for (int n = 0; n < 64; ++n)
    {
      file.append(reinterpret_cast<const char*>(&value), sizeof(value));
    }
  }
  folder.write(name, file);
}

const Eigen::AlignedBox3d kBox(Eigen::Vector3d::Constant(-15.0), Eigen::Vector3d::Constant(15.0));
}  // namespace

TEST(CtContent, IsRecognised)
{
  EXPECT_EQ(recognisedContent(shells(-1000, false)), CtContent::BONE_IN_AIR);
  EXPECT_EQ(recognisedContent(shells(0, true)), CtContent::BONE_IN_AIR) << "a background of water";
  EXPECT_EQ(recognisedContent(shells(-3024, true)), CtContent::BONE_IN_AIR) << "a background of padding";
  EXPECT_EQ(recognisedContent(inTissue()), CtContent::FULL);
}

TEST_F(SharedDataTest, CtContentIsRecognised)
{
  const auto content = [&](const std::string& path) { return readPatientCt(folder_ + path).content; };
  EXPECT_EQ(content("/thorax_ct"), CtContent::FULL);
  EXPECT_EQ(content("/lumbar_pelvis_ct/ct.nii.gz"), CtContent::FULL);
  EXPECT_EQ(content("/lumbar_pelvis_ct/labels.nii.gz"), CtContent::LABELS);
  EXPECT_EQ(content("/rtstruct/ct"), CtContent::FULL);
  EXPECT_EQ(content("/sequences/portal_real/ct.nii.gz"), CtContent::FULL);
  EXPECT_EQ(content("/sequences/wrist_real/ct.nii.gz"), CtContent::BONE_IN_AIR);
  EXPECT_EQ(content("/sequences/knee_real/ct_both.nii.gz"), CtContent::BONE_IN_AIR);
}

TEST(CtContent, BoneInAirIsWhatItAddsToWater)
{
  const CtVolume ct = shells(-1000, false);
  const BodyModel bodies = bodiesOf(recognisedCt(ct), targetMaskFromBone(ct, kBox));
  EXPECT_TRUE(bodies.rest.values.empty()) << "nothing is outside of the target";
  double sum = 0.0;
  for (const float value : bodies.target.values)
  {
    sum += value;
  }
  // Only the bone counts: neither marrow, which has less than water, nor air.
  const auto bone = std::count(ct.hu.begin(), ct.hu.end(), 1200);
  EXPECT_NEAR(sum, 1.2 * kWaterAttenuation * static_cast<double>(bone), 1e-4 * sum);
}

TEST(CtContent, BodiesAreTwoWhereThereIsARest)
{
  const CtVolume ct = shells(-1000, true);
  EXPECT_FALSE(bodiesOf(recognisedCt(ct), targetMaskFromBone(ct, kBox)).rest.values.empty());
  EXPECT_TRUE(bodiesOf(recognisedCt(ct), std::nullopt).rest.values.empty());
  const CtVolume full = inTissue();
  const BodyModel bodies = bodiesOf(recognisedCt(full), targetMaskFromBone(full, kBox));
  double sum = 0.0;
  for (const ScalarVolume* volume : { &bodies.target, &bodies.rest })
  {
    for (const float value : volume->values)
    {
      sum += value;
    }
  }
  double whole = 0.0;
  for (const float value : attenuationVolume(full).values)
  {
    whole += value;
  }
  EXPECT_NEAR(sum, whole, 1e-4 * whole);
}

TEST(CtContent, LabelsAreSolidBone)
{
  constexpr double kRadius = 20.0;
  const CtVolume labels = labelled([](const Eigen::Vector3d& point) { return point.norm() < kRadius ? 7 : 0; });
  const Eigen::AlignedBox3d box(Eigen::Vector3d::Constant(-22.0), Eigen::Vector3d::Constant(22.0));
  const BodyModel bodies = bodiesOf({ labels, CtContent::LABELS }, targetMaskFromLabels(labels, box));
  EXPECT_TRUE(bodies.rest.values.empty()) << "nothing but the one label";

  // As HU of cortical bone in air, which is rounded to whole HU: one in 1592, half of one.
  CtVolume bone = labels;
  for (std::int16_t& value : bone.hu)
  {
    value = static_cast<std::int16_t>(value != 0 ? 1592 : -1000);
  }
  const BodyModel same = bodiesOf({ bone, CtContent::BONE_IN_AIR }, std::nullopt);
  ASSERT_EQ(bodies.target.values.size(), same.target.values.size());
  EXPECT_TRUE(std::equal(same.target.values.begin(), same.target.values.end(), bodies.target.values.begin()));

  // Chords of a ball. Both ends lie on a staircase of 1 mm: off by up to a voxel's diagonal along a ray that meets the
  // surface at 30 degrees or more, on average by next to nothing.
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> across(0.0, 0.85 * kRadius);
  double sum = 0.0;
  constexpr int kRays = 500;
  for (int n = 0; n < kRays; ++n)
  {
    const Eigen::Vector3d direction = Eigen::Vector3d(normal(random), normal(random), normal(random)).normalized();
    const double distance = across(random);
    const Eigen::Vector3d nearest =
        distance * direction.cross(Eigen::Vector3d(normal(random), normal(random), normal(random))).normalized();
    const double chord = 2.0 * std::sqrt(kRadius * kRadius - distance * distance);
    const double integral = integrateTrilinear(bodies.target, { nearest - 100.0 * direction, direction });
    const double error = integral / (kBoneAttenuation - kWaterAttenuation) - chord;
    EXPECT_LT(std::abs(error), 2.0 * std::sqrt(3.0)) << "at " << distance << " mm";
    sum += error;
  }
  EXPECT_LT(std::abs(sum) / kRays, 0.1);
}

TEST(CtContent, TargetIsTheLabelInTheBox)
{
  // Two blocks that touch, and a third one far away.
  const CtVolume labels = labelled(
      [](const Eigen::Vector3d& point)
      {
        const Eigen::Vector3d size = point.cwiseAbs();
        return size.y() > 10.0 || size.z() > 10.0 ? 0 : size.x() < 10.0 ? (point.x() < 0.0 ? 2 : 7) : size.x() > 25.0;
      });
  const PatientCt ct{ labels, CtContent::LABELS };
  const Eigen::AlignedBox3d box(Eigen::Vector3d(-4.0, -12.0, -12.0), Eigen::Vector3d(12.0, 12.0, 12.0));
  const TargetMask mask = targetMaskOf(ct, box, { 180.0, 2.0, 0.2, 0.8 });
  EXPECT_NEAR(sumOf(mask), 10.0 * 20.0 * 20.0, 1.0) << "label 7, and nothing of what it touches";
  const BodyModel bodies = bodiesOf(ct, mask);
  const double voxel = kBoneAttenuation - kWaterAttenuation;
  EXPECT_NEAR(sumOf(bodies.target), 4000.0 * voxel, 1e-4 * 4000.0 * voxel);
  const auto others = static_cast<double>(
      std::count_if(labels.hu.begin(), labels.hu.end(), [](int label) { return label == 1 || label == 2; }));
  EXPECT_NEAR(sumOf(bodies.rest), others * voxel, 1e-4 * others * voxel);
  EXPECT_TRUE(bodiesOf(ct, std::nullopt).rest.values.empty());

  const Eigen::AlignedBox3d between(Eigen::Vector3d(12.0, -5.0, -5.0), Eigen::Vector3d(20.0, 5.0, 5.0));
  expectError<std::runtime_error>([&] { targetMaskOf(ct, between); }, { "target box", "12, -5, -5", "no label" });
}

TEST(CtContent, LabelMapsAreRecognisedOrDeclared)
{
  const TemporaryFolder folder;
  const CtVolume labels =
      labelled([](const Eigen::Vector3d& point) { return point.norm() < 20.0 ? 1
                                                         : point.x() > 25.0  ? 7
                                                                             : 0; });
  for (const char* name : { "labels.nrrd", "labels.nii.gz", "labels.mha" })
  {
    SCOPED_TRACE(name);
    const std::string path = folder.path(name);
    writeCtVolume(labels, path);
    for (const CtContent content : { CtContent::RECOGNISED, CtContent::LABELS })
    {
      const PatientCt ct = readPatientCt(path, content);
      EXPECT_EQ(ct.content, CtContent::LABELS);
      EXPECT_EQ(ct.volume.hu, labels.hu);
    }
    for (const CtContent content : { CtContent::FULL, CtContent::BONE_IN_AIR })
    {
      expectError<std::runtime_error>([&] { readPatientCt(path, content); },
                                      { path, "ct_content is " + nameOf(content), "no Hounsfield units", "air" });
    }
    expectError<std::runtime_error>([&] { readCtVolume(path); }, { path, "not Hounsfield units, but labels" });
  }
  writeFloats(folder, "floats.nrrd", { 0.0f, 1.0f, 0.0f });
  EXPECT_EQ(readPatientCt(folder.path("floats.nrrd")).content, CtContent::LABELS);
  const std::string hu = folder.path("hu.nrrd");
  writeCtVolume(inTissue(), hu);
  EXPECT_EQ(readPatientCt(hu).content, CtContent::FULL);
  EXPECT_EQ(readPatientCt(hu, CtContent::BONE_IN_AIR).content, CtContent::BONE_IN_AIR) << "who declares knows better";
  expectError<std::runtime_error>([&] { readPatientCt(hu, CtContent::LABELS); },
                                  { hu, "ct_content is labels", "-1000", "0 for the background" });
}

TEST(CtContent, WhatIsNoLabelMapIsRefused)
{
  const TemporaryFolder folder;
  const auto expectRefused = [&](const std::string& name, const std::vector<std::string>& parts)
  {
    SCOPED_TRACE(name);
    const std::string path = folder.path(name);
    for (const CtContent content : { CtContent::RECOGNISED, CtContent::LABELS })
    {
      std::vector<std::string> expected = parts;
      expected.push_back(path);
      expected.push_back(content == CtContent::LABELS ? "ct_content is labels" : "neither Hounsfield units");
      expectError<std::runtime_error>([&] { readPatientCt(path, content); }, expected);
    }
    EXPECT_THROW(readLabelMap(path), std::runtime_error);
  };
  const auto expectValuesRefused =
      [&](const std::string& name, const std::function<int(int)>& value, const std::vector<std::string>& parts)
  {
    int n = 0;
    writeCtVolume(labelled([&](const Eigen::Vector3d&) { return value(n++); }), folder.path(name));
    expectRefused(name, parts);
  };
  expectValuesRefused("constant.nrrd", [](int) { return 3; }, { "all voxels are 3" });
  expectValuesRefused("empty.nrrd", [](int) { return 0; }, { "all voxels are 0" });
  expectValuesRefused("negative.nrrd", [](int n) { return n / 60 % 2 - 1; }, { "lowest value is -1" });
  expectValuesRefused("no_background.nrrd", [](int n) { return n / 60 % 2 + 1; }, { "lowest value is 1" });
  expectValuesRefused("unsigned.nrrd", [](int n) { return n / 50; }, { "holds 4319 values above 0", "200 labels" });
  writeFloats(folder, "probability.nrrd", { 0.0f, 0.25f, 1.0f });
  expectRefused("probability.nrrd", { "0.25", "whole numbers" });

  // Few grey values, such as a percentage or a narrow window: a label map only if somebody says so.
  std::mt19937 random(1);
  const CtVolume grey = labelled([&](const Eigen::Vector3d& point)
                                 { return point.norm() < 25.0 ? 50 + static_cast<int>(random() % 100) : 0; });
  writeCtVolume(grey, folder.path("grey.nrrd"));
  expectError<std::runtime_error>([&] { readPatientCt(folder.path("grey.nrrd")); }, { "differ from voxel to voxel" });
  EXPECT_EQ(readPatientCt(folder.path("grey.nrrd"), CtContent::LABELS).content, CtContent::LABELS);
}

TEST(CtContent, NamesAreNamed)
{
  for (const CtContent content : { CtContent::RECOGNISED, CtContent::FULL, CtContent::BONE_IN_AIR, CtContent::LABELS })
  {
    EXPECT_EQ(ctContentNamed(nameOf(content)), content);
  }
  try
  {
    ctContentNamed("bones");
    FAIL();
  }
  catch (const std::invalid_argument& error)
  {
    EXPECT_NE(std::string(error.what()).find("bones"), std::string::npos);
  }
}
}  // namespace xray_tracking
