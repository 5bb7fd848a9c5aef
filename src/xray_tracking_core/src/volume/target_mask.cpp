#include "xray_tracking_core/volume/target_mask.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <sstream>
#include <stdexcept>

#include <itkBinaryBallStructuringElement.h>
#include <itkBinaryMorphologicalClosingImageFilter.h>
#include <itkConnectedComponentImageFilter.h>
#include <itkImage.h>
#include <itkSignedMaurerDistanceMapImageFilter.h>

namespace xray_tracking
{
namespace
{
using Binary = itk::Image<unsigned char, 3>;
using IsTarget = std::function<bool(int i, int j, int k)>;

/// Apart from this, grids of two files are the same: formats differ in their numbers' precision [voxels].
constexpr double kGridTolerance = 1e-3;

const Eigen::IOFormat kVectorFormat(6, Eigen::DontAlignCols, ", ", ", ", "", "", "(", ")");

/// A box of voxels: first index and size.
struct IndexBox
{
  Eigen::Vector3i first;
  Eigen::Vector3i size;
};

std::string describe(const Eigen::AlignedBox3d& box)
{
  std::ostringstream text;
  text << box.min().transpose().format(kVectorFormat) << " to " << box.max().transpose().format(kVectorFormat) << " mm";
  return text.str();
}

std::string describe(const VolumeGrid& grid)
{
  std::ostringstream text;
  text << grid.size.x() << " x " << grid.size.y() << " x " << grid.size.z() << " voxels of "
       << grid.spacing().transpose().format(kVectorFormat) << " mm about "
       << grid.centre().transpose().format(kVectorFormat) << " mm";
  return text.str();
}

/// The voxels that a box of the patient frame reaches, widened by a distance, in the grid.
IndexBox indicesOf(const VolumeGrid& grid, const Eigen::AlignedBox3d& box, double margin)
{
  const Eigen::Affine3d index_from_patient = grid.patient_from_index.inverse();
  Eigen::AlignedBox3d indices;
  for (int corner = 0; corner < 8; ++corner)
  {
    indices.extend(index_from_patient * box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner)));
  }
  const Eigen::Vector3d reach = (margin / grid.spacing().array()).matrix();
  const Eigen::Vector3d last = (grid.size.array() - 1).matrix().cast<double>();
  const Eigen::Vector3d lower = (indices.min() - reach).cwiseMax(0.0).cwiseMin(last);
  const Eigen::Vector3d upper = (indices.max() + reach).cwiseMax(0.0).cwiseMin(last);
  IndexBox result;
  result.first = lower.array().floor().cast<int>();
  result.size = upper.array().ceil().cast<int>() + 1 - result.first.array();
  return result;
}

Binary::Pointer makeBinary(const VolumeGrid& grid, const IndexBox& box, const IsTarget& is_target)
{
  auto image = Binary::New();
  Binary::SizeType size;
  Binary::SpacingType spacing;
  for (int axis = 0; axis < 3; ++axis)
  {
    size[axis] = box.size[axis];
    spacing[axis] = grid.spacing()[axis];
  }
  image->SetRegions(size);
  image->SetSpacing(spacing);
  image->Allocate();
  unsigned char* voxel = image->GetBufferPointer();
  for (int k = 0; k < box.size.z(); ++k)
  {
    for (int j = 0; j < box.size.y(); ++j)
    {
      for (int i = 0; i < box.size.x(); ++i)
      {
        *voxel++ = is_target(box.first.x() + i, box.first.y() + j, box.first.z() + k) ? 1 : 0;
      }
    }
  }
  return image;
}

Binary::Pointer closed(const Binary::Pointer& image, double radius)
{
  using Ball = itk::BinaryBallStructuringElement<unsigned char, 3>;
  Ball ball;
  Ball::SizeType voxels;
  bool nothing = true;
  for (int axis = 0; axis < 3; ++axis)
  {
    voxels[axis] = static_cast<itk::SizeValueType>(std::lround(radius / image->GetSpacing()[axis]));
    nothing = nothing && voxels[axis] == 0;
  }
  if (nothing)
  {
    return image;
  }
  ball.SetRadius(voxels);
  ball.CreateStructuringElement();
  auto filter = itk::BinaryMorphologicalClosingImageFilter<Binary, Binary, Ball>::New();
  filter->SetInput(image);
  filter->SetKernel(ball);
  filter->SetForegroundValue(1);
  filter->Update();
  return filter->GetOutput();
}

void keepLargestComponent(const Binary::Pointer& image)
{
  using Labels = itk::Image<int, 3>;
  auto filter = itk::ConnectedComponentImageFilter<Binary, Labels>::New();
  filter->SetInput(image);
  filter->FullyConnectedOn();
  filter->Update();
  const int* label = filter->GetOutput()->GetBufferPointer();
  const std::size_t count = image->GetLargestPossibleRegion().GetNumberOfPixels();
  std::map<int, std::size_t> voxels;
  for (std::size_t n = 0; n < count; ++n)
  {
    if (label[n] != 0)
    {
      ++voxels[label[n]];
    }
  }
  const int largest =
      std::max_element(voxels.begin(), voxels.end(), [](const auto& a, const auto& b) { return a.second < b.second; })
          ->first;
  for (std::size_t n = 0; n < count; ++n)
  {
    image->GetBufferPointer()[n] = label[n] == largest ? 1 : 0;
  }
}

TargetMask weightsAround(const VolumeGrid& grid, const IndexBox& box, const Binary::Pointer& target,
                         const TargetMaskOptions& options)
{
  using Distances = itk::Image<float, 3>;
  auto filter = itk::SignedMaurerDistanceMapImageFilter<Binary, Distances>::New();
  filter->SetInput(target);
  filter->SquaredDistanceOff();
  filter->UseImageSpacingOn();
  filter->Update();
  const float* distance = filter->GetOutput()->GetBufferPointer();

  TargetMask mask;
  mask.grid.size = box.size;
  mask.grid.patient_from_index = grid.patient_from_index * Eigen::Translation3d(box.first.cast<double>());
  mask.values.resize(mask.grid.voxelCount());
  for (float& weight : mask.values)
  {
    const double share = std::clamp((options.outer_mm - *distance++) / (options.outer_mm - options.inner_mm), 0.0, 1.0);
    weight = static_cast<float>(share * share * (3.0 - 2.0 * share));
  }
  return mask;
}

bool isEmpty(const Binary::Pointer& image)
{
  const unsigned char* voxel = image->GetBufferPointer();
  const std::size_t count = image->GetLargestPossibleRegion().GetNumberOfPixels();
  return std::find(voxel, voxel + count, 1) == voxel + count;
}

/// About the largest connected piece of the box's voxels that have the right value, closed.
/// @param what they are, for the message if there are none
TargetMask maskOfLargestPiece(const CtVolume& ct, const Eigen::AlignedBox3d& target_box,
                              const TargetMaskOptions& options, const std::string& what,
                              const std::function<bool(int)>& is_target)
{
  options.validate();
  const IndexBox box = indicesOf(ct.grid, target_box, options.outer_mm);
  Binary::Pointer target =
      makeBinary(ct.grid, box,
                 [&](int i, int j, int k)
                 {
                   return is_target(ct.hu[ct.grid.offset(i, j, k)]) &&
                          target_box.contains(ct.grid.patient_from_index * Eigen::Vector3d(i, j, k));
                 });
  if (isEmpty(target))
  {
    throw std::runtime_error("target box " + describe(target_box) + " holds no " + what);
  }
  target = closed(target, options.closing_mm);
  keepLargestComponent(target);
  return weightsAround(ct.grid, box, target, options);
}

void checkRange(const char* option, double value, double min, double max)
{
  if (!(value >= min && value <= max))
  {
    std::ostringstream text;
    text << option << " is " << value << ": expected " << min << " to " << max;
    throw std::invalid_argument(text.str());
  }
}
}  // namespace

void TargetMaskOptions::validate() const
{
  checkRange("threshold_hu", threshold_hu, -1000.0, 3000.0);
  checkRange("closing_mm", closing_mm, 0.0, 10.0);
  checkRange("inner_mm", inner_mm, 0.0, 50.0);
  checkRange("outer_mm", outer_mm, std::nextafter(inner_mm, 1e3), 100.0);
}

TargetMask targetMaskFromBone(const CtVolume& ct, const Eigen::AlignedBox3d& target_box,
                              const TargetMaskOptions& options)
{
  std::ostringstream bone;
  bone << "bone of the CT (" << options.threshold_hu << " HU or more)";
  return maskOfLargestPiece(ct, target_box, options, bone.str(), [&](int hu) { return hu >= options.threshold_hu; });
}

TargetMask targetMaskFromLabels(const CtVolume& labels, const Eigen::AlignedBox3d& target_box,
                                const TargetMaskOptions& options)
{
  const IndexBox box = indicesOf(labels.grid, target_box, 0.0);
  std::map<int, std::size_t> voxels;
  for (int k = box.first.z(); k < box.first.z() + box.size.z(); ++k)
  {
    for (int j = box.first.y(); j < box.first.y() + box.size.y(); ++j)
    {
      for (int i = box.first.x(); i < box.first.x() + box.size.x(); ++i)
      {
        const int label = labels.hu[labels.grid.offset(i, j, k)];
        voxels[label] += label != 0 && target_box.contains(labels.grid.patient_from_index * Eigen::Vector3d(i, j, k));
      }
    }
  }
  const int target =
      std::max_element(voxels.begin(), voxels.end(), [](const auto& a, const auto& b) { return a.second < b.second; })
          ->first;
  return maskOfLargestPiece(labels, target_box, options, "label of the CT",
                            [&](int label) { return label != 0 && label == target; });
}

TargetMask targetMaskFromLabels(const VolumeGrid& ct_grid, const CtVolume& labels, int label,
                                const TargetMaskOptions& options)
{
  options.validate();
  if (labels.grid.size != ct_grid.size || !(ct_grid.patient_from_index.inverse() * labels.grid.patient_from_index)
                                               .isApprox(Eigen::Affine3d::Identity(), kGridTolerance))
  {
    throw std::runtime_error("label map of " + describe(labels.grid) + ", expected the CT's grid of " +
                             describe(ct_grid));
  }
  Eigen::AlignedBox3i voxels;
  std::size_t n = 0;
  for (int k = 0; k < ct_grid.size.z(); ++k)
  {
    for (int j = 0; j < ct_grid.size.y(); ++j)
    {
      for (int i = 0; i < ct_grid.size.x(); ++i)
      {
        if (labels.hu[n++] == label)
        {
          voxels.extend(Eigen::Vector3i(i, j, k));
        }
      }
    }
  }
  if (voxels.isEmpty())
  {
    throw std::runtime_error("label " + std::to_string(label) + " does not occur in the label map");
  }
  const Eigen::Vector3i reach = (options.outer_mm / ct_grid.spacing().array()).ceil().cast<int>();
  IndexBox box;
  box.first = (voxels.min() - reach).cwiseMax(0);
  box.size =
      (voxels.max() + reach).cwiseMin(ct_grid.size - Eigen::Vector3i::Ones()) - box.first + Eigen::Vector3i::Ones();
  const Binary::Pointer target =
      makeBinary(ct_grid, box, [&](int i, int j, int k) { return labels.hu[ct_grid.offset(i, j, k)] == label; });
  return weightsAround(ct_grid, box, target, options);
}

TargetMask targetMaskFromBox(const VolumeGrid& ct_grid, const Eigen::AlignedBox3d& target_box,
                             const TargetMaskOptions& options)
{
  options.validate();
  const IndexBox box = indicesOf(ct_grid, target_box, options.outer_mm);
  const Binary::Pointer target = makeBinary(
      ct_grid, box,
      [&](int i, int j, int k) { return target_box.contains(ct_grid.patient_from_index * Eigen::Vector3d(i, j, k)); });
  if (isEmpty(target))
  {
    throw std::runtime_error("target box " + describe(target_box) + " holds no voxel of the CT");
  }
  return weightsAround(ct_grid, box, target, options);
}

void writeTargetMask(const TargetMask& mask, const std::string& path)
{
  CtVolume volume{ mask.grid, std::vector<std::int16_t>(mask.values.size()) };
  std::transform(mask.values.begin(), mask.values.end(), volume.hu.begin(),
                 [](float weight) { return static_cast<std::int16_t>(std::lround(1000.0f * weight)); });
  writeCtVolume(volume, path);
}
}  // namespace xray_tracking
