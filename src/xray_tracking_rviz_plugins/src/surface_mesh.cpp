#include "surface_mesh.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include <vtkCallbackCommand.h>
#include <vtkCellArray.h>
#include <vtkFlyingEdges3D.h>
#include <vtkIdList.h>
#include <vtkImageData.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkPoints.h>
#include <vtkPolyData.h>
#include <vtkQuadricDecimation.h>
#include <Eigen/Geometry>

#include "xray_tracking_core/volume/resampling.h"

namespace xray_tracking
{
namespace
{
constexpr std::size_t kMostVoxels = 12000000;
constexpr double kFine = 0.9;  ///< voxels below this are averaged [mm]

/// Twice the triangle's area times its normal.
Eigen::Vector3d areaVector(const SurfaceMesh& mesh, const std::array<std::uint32_t, 3>& triangle)
{
  const Eigen::Vector3d a = mesh.points[triangle[0]].cast<double>();
  const Eigen::Vector3d b = mesh.points[triangle[1]].cast<double>();
  const Eigen::Vector3d c = mesh.points[triangle[2]].cast<double>();
  return (b - a).cross(c - a);
}

/// With a voxel around it that is lower than all.
vtkNew<vtkImageData> padded(const ScalarVolume& volume)
{
  const Eigen::Vector3i& size = volume.grid.size;
  vtkNew<vtkImageData> image;
  image->SetExtent(-1, size.x(), -1, size.y(), -1, size.z());
  image->AllocateScalars(VTK_FLOAT, 1);
  auto* to = static_cast<float*>(image->GetScalarPointer());
  const auto lowest = std::min_element(volume.values.begin(), volume.values.end());
  std::fill_n(to, static_cast<std::size_t>(image->GetNumberOfPoints()), lowest == volume.values.end() ? 0.0F : *lowest);
  for (int k = 0; k < size.z(); ++k)
  {
    for (int j = 0; j < size.y(); ++j)
    {
      std::copy_n(volume.values.begin() + static_cast<std::ptrdiff_t>(volume.grid.offset(0, j, k)), size.x(),
                  static_cast<float*>(image->GetScalarPointer(0, j, k)));
    }
  }
  return image;
}

void stopIfAsked(vtkObject* caller, unsigned long, void* stop, void*)
{
  if (static_cast<const std::atomic<bool>*>(stop)->load())
  {
    static_cast<vtkAlgorithm*>(caller)->SetAbortExecute(1);
  }
}

void watch(vtkAlgorithm* algorithm, const std::atomic<bool>& stop)
{
  vtkNew<vtkCallbackCommand> command;
  command->SetCallback(stopIfAsked);
  command->SetClientData(const_cast<std::atomic<bool>*>(&stop));
  algorithm->AddObserver(vtkCommand::ProgressEvent, command);
}

SurfaceMesh meshOf(vtkPolyData* surface)
{
  SurfaceMesh mesh;
  mesh.points.resize(static_cast<std::size_t>(surface->GetNumberOfPoints()));
  for (std::size_t i = 0; i < mesh.points.size(); ++i)
  {
    double point[3];
    surface->GetPoint(static_cast<vtkIdType>(i), point);
    mesh.points[i] = Eigen::Vector3d(point[0], point[1], point[2]).cast<float>();
  }
  mesh.triangles.reserve(static_cast<std::size_t>(surface->GetNumberOfPolys()));
  vtkNew<vtkIdList> ids;
  vtkCellArray* polygons = surface->GetPolys();
  polygons->InitTraversal();
  while (polygons->GetNextCell(ids) != 0)
  {
    if (ids->GetNumberOfIds() == 3)
    {
      mesh.triangles.push_back({ static_cast<std::uint32_t>(ids->GetId(0)), static_cast<std::uint32_t>(ids->GetId(1)),
                                 static_cast<std::uint32_t>(ids->GetId(2)) });
    }
  }
  return mesh;
}

/// Keeps the triangles for which keep(index) holds, and the points that they use.
template <typename Keep>
SurfaceMesh part(const SurfaceMesh& mesh, const Keep& keep)
{
  constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();
  SurfaceMesh kept;
  std::vector<std::uint32_t> place(mesh.points.size(), kNone);
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t)
  {
    if (!keep(t))
    {
      continue;
    }
    std::array<std::uint32_t, 3> triangle = mesh.triangles[t];
    for (std::uint32_t& point : triangle)
    {
      if (place[point] == kNone)
      {
        place[point] = static_cast<std::uint32_t>(kept.points.size());
        kept.points.push_back(mesh.points[point]);
        if (!mesh.normals.empty())
        {
          kept.normals.push_back(mesh.normals[point]);
        }
      }
      point = place[point];
    }
    kept.triangles.push_back(triangle);
  }
  return kept;
}

/// Of every point a point that stands for its connected piece.
std::vector<std::uint32_t> piecesOf(const SurfaceMesh& mesh)
{
  std::vector<std::uint32_t> parent(mesh.points.size());
  std::iota(parent.begin(), parent.end(), 0U);
  const auto root = [&](std::uint32_t i)
  {
    while (parent[i] != i)
    {
      i = parent[i] = parent[parent[i]];
    }
    return i;
  };
  for (const auto& triangle : mesh.triangles)
  {
    parent[root(triangle[1])] = root(triangle[0]);
    parent[root(triangle[2])] = root(triangle[0]);
  }
  for (std::uint32_t i = 0; i < parent.size(); ++i)
  {
    parent[i] = root(i);
  }
  return parent;
}

/// Keeps the pieces for which keep(sum of their triangles' weighted areas) holds [mm^2].
template <typename Weight, typename Keep>
SurfaceMesh piecesKept(const SurfaceMesh& mesh, const Weight& weight, const Keep& keep)
{
  const std::vector<std::uint32_t> piece = piecesOf(mesh);
  std::vector<double> sums(mesh.points.size(), 0.0);
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t)
  {
    sums[piece[mesh.triangles[t][0]]] += 0.5 * areaVector(mesh, mesh.triangles[t]).norm() * weight(t);
  }
  return part(mesh, [&](std::size_t t) { return keep(sums[piece[mesh.triangles[t][0]]]); });
}

/// Of every point, whether it is where the mask is 1.
std::vector<bool> within(const SurfaceMesh& mesh, const ScalarVolume& mask)
{
  const Eigen::Affine3d index_from_patient = mask.grid.patient_from_index.inverse();
  std::vector<bool> in(mesh.points.size());
  for (std::size_t i = 0; i < in.size(); ++i)
  {
    const Eigen::Array3i index = (index_from_patient * mesh.points[i].cast<double>()).array().round().cast<int>();
    in[i] = (index >= 0).all() && (index < mask.grid.size.array()).all() &&
            mask.values[mask.grid.offset(index.x(), index.y(), index.z())] >= 0.999F;
  }
  return in;
}

void addNormals(SurfaceMesh& mesh)
{
  std::vector<Eigen::Vector3d> sums(mesh.points.size(), Eigen::Vector3d::Zero());
  for (const auto& triangle : mesh.triangles)
  {
    const Eigen::Vector3d area = areaVector(mesh, triangle);
    for (const std::uint32_t point : triangle)
    {
      sums[point] += area;
    }
  }
  mesh.normals.clear();
  for (const Eigen::Vector3d& sum : sums)
  {
    mesh.normals.push_back((sum.norm() > 0.0 ? sum.normalized() : Eigen::Vector3d::UnitZ()).cast<float>());
  }
}
}  // namespace

double SurfaceMesh::area() const
{
  double sum = 0.0;
  for (const auto& triangle : triangles)
  {
    sum += 0.5 * areaVector(*this, triangle).norm();
  }
  return sum;
}

double SurfaceMesh::volume() const
{
  // From a point nearby: differences of large numbers lose digits.
  const Eigen::Vector3d origin = points.empty() ? Eigen::Vector3d::Zero() : points.front().cast<double>().eval();
  double sum = 0.0;
  for (const auto& triangle : triangles)
  {
    sum += areaVector(*this, triangle).dot(points[triangle[0]].cast<double>() - origin) / 6.0;
  }
  return sum;
}

SurfaceMesh isoSurface(const ScalarVolume& volume, float threshold, std::size_t most_triangles, double least_area,
                       const std::atomic<bool>& stop)
{
  if (volume.values.empty())
  {
    return {};
  }
  if (volume.values.size() > kMostVoxels || volume.grid.spacing().minCoeff() < kFine / 1.5)
  {
    const ScalarVolume coarse = halved(volume);
    if (coarse.values.size() < volume.values.size())
    {
      return stop ? SurfaceMesh() : isoSurface(coarse, threshold, most_triangles, least_area, stop);
    }
  }
  vtkNew<vtkFlyingEdges3D> edges;
  {
    const vtkNew<vtkImageData> image = padded(volume);
    edges->SetInputData(image);
    edges->SetValue(0, threshold);
    edges->ComputeNormalsOff();
    edges->ComputeScalarsOff();
    edges->ComputeGradientsOff();
    watch(edges, stop);
    edges->Update();
  }
  if (stop)
  {
    return {};
  }
  // Before the decimation, which is to keep what is large in millimetres.
  vtkPolyData* surface = edges->GetOutput();
  for (vtkIdType i = 0; i < surface->GetNumberOfPoints(); ++i)
  {
    double point[3];
    surface->GetPoint(i, point);
    const Eigen::Vector3d patient = volume.grid.patient_from_index * Eigen::Vector3d(point[0], point[1], point[2]);
    surface->GetPoints()->SetPoint(i, patient.data());
  }
  const auto count = static_cast<std::size_t>(surface->GetNumberOfPolys());
  SurfaceMesh mesh;
  if (count > most_triangles)
  {
    vtkNew<vtkQuadricDecimation> decimation;
    decimation->SetInputData(surface);
    decimation->SetTargetReduction(1.0 - static_cast<double>(most_triangles) / static_cast<double>(count));
    decimation->VolumePreservationOn();
    watch(decimation, stop);
    decimation->Update();
    mesh = meshOf(decimation->GetOutput());
  }
  else
  {
    mesh = meshOf(surface);
  }
  if (stop)
  {
    return {};
  }
  if (mesh.volume() < 0.0)
  {
    for (auto& triangle : mesh.triangles)
    {
      std::swap(triangle[1], triangle[2]);
    }
  }
  mesh = piecesKept(
      mesh, [](std::size_t) { return 1.0; }, [least_area](double area) { return area >= least_area; });
  addNormals(mesh);
  return mesh;
}

SurfaceMesh piecesWithin(const SurfaceMesh& mesh, const ScalarVolume& mask)
{
  const std::vector<bool> in = within(mesh, mask);
  return piecesKept(
      mesh, [&](std::size_t t) { return in[mesh.triangles[t][0]] ? 1.0 : -1.0; }, [](double sum) { return sum > 0.0; });
}

void splitByMask(const SurfaceMesh& mesh, const ScalarVolume& mask, SurfaceMesh& inside, SurfaceMesh& outside)
{
  const std::vector<bool> in = within(mesh, mask);
  const auto all_in = [&](std::size_t t)
  {
    const auto& triangle = mesh.triangles[t];
    return in[triangle[0]] && in[triangle[1]] && in[triangle[2]];
  };
  inside = part(mesh, all_in);
  outside = part(mesh, [&](std::size_t t) { return !all_in(t); });
}
}  // namespace xray_tracking
