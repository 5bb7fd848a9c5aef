#include "anatomy.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iomanip>
#include <sstream>
#include <stdexcept>

#include <QCryptographicHash>
#include <boost/filesystem.hpp>

#include "xray_tracking_core/volume/data_folder.h"
#include "xray_tracking_core/volume/neck_phantom.h"

namespace xray_tracking
{
namespace
{
namespace fs = boost::filesystem;

constexpr const char* kVersion = "anatomy 3";
constexpr std::size_t kMostTriangles = 160000;
constexpr double kLeastArea = 250.0;  ///< of a piece of bone: others are noise and calcifications [mm^2]
constexpr double kSlice = 240.0;      ///< edge of a slice [mm]
constexpr double kSlicePixel = 0.8;   ///< [mm]
constexpr float kAir = 1024.0F;       ///< what is added to HU, so that 0 is below all
constexpr double kCoarse = 4.0;       ///< voxels in which the body is found [mm]
constexpr int kTissue = -300;         ///< HU from which it is tissue
constexpr float kBone = 200.0F;       ///< HU from which bone is shown
const PhantomCtOptions kPhantomCt{ { 200, 200, 200 }, { 1.0, 1.0, 1.0 }, 1.0 };  // as registration has it

float at(const CtVolume& ct, const Eigen::Vector3d& index)
{
  const Eigen::Array3d low = index.array().floor();
  const Eigen::Array3i size = ct.grid.size.array();
  if ((low < 0.0).any() || (low + 1.0 >= size.cast<double>()).any())
  {
    return -kAir;
  }
  const Eigen::Array3d share = index.array() - low;
  const Eigen::Array3i i = low.cast<int>();
  double sum = 0.0;
  for (int corner = 0; corner < 8; ++corner)
  {
    const int x = corner & 1;
    const int y = corner >> 1 & 1;
    const int z = corner >> 2;
    const double weight = (x == 1 ? share.x() : 1.0 - share.x()) * (y == 1 ? share.y() : 1.0 - share.y()) *
                          (z == 1 ? share.z() : 1.0 - share.z());
    sum += weight * ct.hu[ct.grid.offset(i.x() + x, i.y() + y, i.z() + z)];
  }
  return static_cast<float>(sum);
}

// A file of the cache: sizes, then arrays, as they are in this machine's memory; it never leaves it.
template <typename Value>
void put(std::ostream& out, const Value& value)
{
  out.write(reinterpret_cast<const char*>(&value), sizeof(Value));
}

template <typename Value>
Value take(std::istream& in)
{
  Value value{};
  in.read(reinterpret_cast<char*>(&value), sizeof(Value));
  return value;
}

template <typename Value>
void putAll(std::ostream& out, const std::vector<Value>& values)
{
  put<std::uint64_t>(out, values.size());
  out.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(sizeof(Value) * values.size()));
}

template <typename Value>
std::vector<Value> takeAll(std::istream& in)
{
  const auto size = take<std::uint64_t>(in);
  if (!in || size > 100000000)
  {
    throw std::runtime_error("damaged");
  }
  std::vector<Value> values(size);
  in.read(reinterpret_cast<char*>(values.data()), static_cast<std::streamsize>(sizeof(Value) * size));
  return values;
}

void putMesh(std::ostream& out, const SurfaceMesh& mesh)
{
  putAll(out, mesh.points);
  putAll(out, mesh.normals);
  putAll(out, mesh.triangles);
}

SurfaceMesh takeMesh(std::istream& in)
{
  SurfaceMesh mesh;
  mesh.points = takeAll<Eigen::Vector3f>(in);
  mesh.normals = takeAll<Eigen::Vector3f>(in);
  mesh.triangles = takeAll<std::array<std::uint32_t, 3>>(in);
  if (mesh.normals.size() != mesh.points.size())
  {
    throw std::runtime_error("damaged");
  }
  for (const auto& triangle : mesh.triangles)
  {
    if (std::max({ triangle[0], triangle[1], triangle[2] }) >= mesh.points.size())
    {
      throw std::runtime_error("damaged");
    }
  }
  return mesh;
}

void write(std::ostream& out, const std::string& key, const Anatomy& anatomy)
{
  putAll(out, std::vector<char>(key.begin(), key.end()));
  putMesh(out, anatomy.target);
  putMesh(out, anatomy.rest);
  for (const CtSlice& slice : anatomy.slices)
  {
    for (const Eigen::Vector3d& vector : { slice.origin, slice.column_step, slice.row_step })
    {
      put(out, vector.x());
      put(out, vector.y());
      put(out, vector.z());
    }
    put<std::int32_t>(out, slice.hu.cols);
    putAll(out, std::vector<std::int16_t>(slice.hu.begin<std::int16_t>(), slice.hu.end<std::int16_t>()));
  }
  putAll(out, std::vector<char>(key.begin(), key.end()));
}

Anatomy read(std::istream& in, const std::string& key)
{
  const std::vector<char> expected(key.begin(), key.end());
  Anatomy anatomy;
  if (takeAll<char>(in) != expected)
  {
    throw std::runtime_error("another one");
  }
  anatomy.target = takeMesh(in);
  anatomy.rest = takeMesh(in);
  for (CtSlice& slice : anatomy.slices)
  {
    for (Eigen::Vector3d* vector : { &slice.origin, &slice.column_step, &slice.row_step })
    {
      for (int i = 0; i < 3; ++i)
      {
        (*vector)[i] = take<double>(in);
      }
    }
    const auto columns = take<std::int32_t>(in);
    const std::vector<std::int16_t> hu = takeAll<std::int16_t>(in);
    if (columns < 1 || hu.size() % static_cast<std::size_t>(columns) != 0)
    {
      throw std::runtime_error("damaged");
    }
    slice.hu = cv::Mat(hu, true).reshape(1, static_cast<int>(hu.size() / static_cast<std::size_t>(columns)));
  }
  if (takeAll<char>(in) != expected || !in)
  {
    throw std::runtime_error("damaged");
  }
  return anatomy;
}
}  // namespace

std::string AnatomySource::key() const
{
  std::ostringstream text;
  text.imbue(std::locale::classic());
  text << std::setprecision(17) << kVersion << "|" << target_box.min().transpose() << "|"
       << target_box.max().transpose() << "|";
  if (phantom)
  {
    text << "phantom";
    return text.str();
  }
  text << nameOf(content) << "|" << ct_choice.series << "|" << static_cast<int>(ct_choice.nifti_form);
  const auto add = [&](const fs::path& file)
  { text << "|" << file.string() << " " << fs::last_write_time(file) << " " << fs::file_size(file); };
  try
  {
    if (fs::is_directory(ct_path))
    {
      std::vector<fs::path> files(fs::recursive_directory_iterator(ct_path), fs::recursive_directory_iterator{});
      std::sort(files.begin(), files.end());
      for (const fs::path& file : files)
      {
        if (fs::is_regular_file(file))
        {
          add(file);
        }
      }
    }
    else
    {
      add(ct_path);
    }
  }
  catch (const fs::filesystem_error& error)
  {
    throw std::runtime_error(error.what());
  }
  return text.str();
}

CtSlice sliceOf(const CtVolume& ct, const Eigen::Vector3d& centre, const Eigen::Vector3d& column_step,
                const Eigen::Vector3d& row_step, const cv::Size& size)
{
  CtSlice slice{ centre - 0.5 * (size.width - 1) * column_step - 0.5 * (size.height - 1) * row_step, column_step,
                 row_step, cv::Mat(size, CV_16SC1) };
  const Eigen::Affine3d index_from_patient = ct.grid.patient_from_index.inverse();
  slice.hu.forEach<std::int16_t>(
      [&](std::int16_t& value, const int* pixel)
      {
        const Eigen::Vector3d point = slice.origin + pixel[1] * column_step + pixel[0] * row_step;
        value = cv::saturate_cast<std::int16_t>(at(ct, index_from_patient * point));
      });
  return slice;
}

ScalarVolume bodyOf(const CtVolume& ct)
{
  const Eigen::Vector3d spacing = ct.grid.spacing();
  const Eigen::Array3i every = (kCoarse / spacing.array()).round().cast<int>().max(1);
  ScalarVolume body;
  body.grid.size = (ct.grid.size.array() / every).max(1).matrix();
  body.grid.patient_from_index = ct.grid.patient_from_index * Eigen::Scaling(every.cast<double>().matrix().eval());
  const Eigen::Vector3i size = body.grid.size;
  body.values.resize(body.grid.voxelCount());
  for (int k = 0; k < size.z(); ++k)
  {
    for (int j = 0; j < size.y(); ++j)
    {
      for (int i = 0; i < size.x(); ++i)
      {
        body.values[body.grid.offset(i, j, k)] =
            ct.hu[ct.grid.offset(i * every.x(), j * every.y(), k * every.z())] > kTissue ? 1.0F : 0.0F;
      }
    }
  }
  const auto neighbours = [&](std::size_t at, const auto& visit)
  {
    const auto i = static_cast<int>(at) % size.x();
    const auto j = static_cast<int>(at) / size.x() % size.y();
    const auto k = static_cast<int>(at) / (size.x() * size.y());
    for (int axis = 0; axis < 3; ++axis)
    {
      for (const int step : { -1, 1 })
      {
        Eigen::Vector3i next(i, j, k);
        next[axis] += step;
        // Beyond the CT the patient goes on.
        visit((next.array() >= 0).all() && (next.array() < size.array()).all()
                  ? body.grid.offset(next.x(), next.y(), next.z())
                  : at);
      }
    }
  };
  const auto grow = [&](float value, int voxels)
  {
    for (int n = 0; n < voxels; ++n)
    {
      const std::vector<float> before = body.values;
      for (std::size_t at = 0; at < before.size(); ++at)
      {
        neighbours(at, [&](std::size_t next) { body.values[at] = before[next] == value ? value : body.values[at]; });
      }
    }
  };
  grow(0.0F, 1);
  std::vector<int> piece(body.values.size(), -1);
  std::vector<std::size_t> sizes;
  for (std::size_t start = 0; start < piece.size(); ++start)
  {
    if (body.values[start] == 0.0F || piece[start] >= 0)
    {
      continue;
    }
    const auto name = static_cast<int>(sizes.size());
    sizes.push_back(0);
    std::vector<std::size_t> front{ start };
    piece[start] = name;
    while (!front.empty())
    {
      const std::size_t at = front.back();
      front.pop_back();
      ++sizes.back();
      neighbours(at,
                 [&](std::size_t next)
                 {
                   if (body.values[next] > 0.0F && piece[next] < 0)
                   {
                     piece[next] = name;
                     front.push_back(next);
                   }
                 });
    }
  }
  const auto largest = static_cast<int>(std::max_element(sizes.begin(), sizes.end()) - sizes.begin());
  for (std::size_t at = 0; at < piece.size(); ++at)
  {
    body.values[at] = !sizes.empty() && piece[at] == largest ? 1.0F : 0.0F;
  }
  grow(1.0F, 3);
  return body;
}

cv::Mat windowed(const cv::Mat& hu, double level, double window)
{
  cv::Mat grey;
  const double scale = 255.0 / std::max(window, 1.0);
  hu.convertTo(grey, CV_8U, scale, scale * (0.5 * window - level));
  return grey;
}

Anatomy makeAnatomy(const AnatomySource& source, const std::atomic<bool>& stop)
{
  Anatomy anatomy;
  const PatientCt ct = source.phantom ? PatientCt{ NeckPhantom().sampleCt(kPhantomCt), CtContent::FULL }
                                      : readPatientCt(source.ct_path, source.content, source.ct_choice);
  if (stop)
  {
    return anatomy;
  }
  const bool labels = ct.content == CtContent::LABELS;
  const Eigen::Vector3d centre = source.target_box.center();
  const int edge = static_cast<int>(kSlice / kSlicePixel);
  const Eigen::Matrix3d step = kSlicePixel * Eigen::Matrix3d::Identity();
  const int axes[3][2] = { { 1, 2 }, { 0, 2 }, { 0, 1 } };
  for (std::size_t i = 0; i < 3; ++i)
  {
    // Superior is up.
    const Eigen::Vector3d row = axes[i][1] == 2 ? Eigen::Vector3d(-step.col(2)) : Eigen::Vector3d(step.col(1));
    anatomy.slices[i] = sliceOf(ct.volume, centre, step.col(axes[i][0]), row, { edge, edge });
    if (labels)
    {
      anatomy.slices[i].hu = (anatomy.slices[i].hu > 0) * 4;  // 255 becomes some thousand, as 0 stays
      anatomy.slices[i].hu.convertTo(anatomy.slices[i].hu, CV_16S);
    }
  }
  ScalarVolume values{ ct.volume.grid, std::vector<float>(ct.volume.hu.size()) };
  std::transform(ct.volume.hu.begin(), ct.volume.hu.end(), values.values.begin(),
                 [labels](std::int16_t hu) { return labels ? (hu > 0 ? 1.0F : 0.0F) : std::max(0.0F, hu + kAir); });
  SurfaceMesh bone = isoSurface(values, labels ? 0.5F : kBone + kAir, kMostTriangles, kLeastArea, stop);
  if (stop)
  {
    return anatomy;
  }
  if (ct.content == CtContent::FULL)
  {
    bone = piecesWithin(bone, bodyOf(ct.volume));
  }
  try
  {
    splitByMask(bone, targetMaskOf(ct, source.target_box), anatomy.target, anatomy.rest);
  }
  catch (const std::runtime_error&)  // no bone in the target box: there is none to be coloured
  {
    anatomy.rest = bone;
  }
  return anatomy;
}

Anatomy cachedAnatomy(const AnatomySource& source, const std::string& folder, const std::atomic<bool>& stop)
{
  if (source.data_folder)
  {
    ctBelow(source.ct_path, *source.data_folder);
  }
  // Paths and UIDs do not go into the cache.
  const std::string key = QCryptographicHash::hash(QByteArray::fromStdString(source.key()), QCryptographicHash::Sha256)
                              .toHex()
                              .toStdString();
  const fs::path file = fs::path(folder) / (key.substr(0, 16) + ".anatomy");
  {
    std::ifstream in(file.string(), std::ios::binary);
    if (in)
    {
      try
      {
        return read(in, key);
      }
      catch (const std::exception&)  // made anew
      {
      }
    }
  }
  Anatomy anatomy = makeAnatomy(source, stop);
  if (!stop)
  {
    boost::system::error_code error;
    fs::create_directories(folder, error);
    const fs::path unfinished = file.string() + "." + fs::unique_path().string();
    std::ofstream out(unfinished.string(), std::ios::binary);
    write(out, key, anatomy);
    out.close();
    if (out)
    {
      fs::permissions(unfinished, fs::owner_read | fs::owner_write, error);  // a patient's bones
      fs::rename(unfinished, file, error);
    }
    else
    {
      fs::remove(unfinished, error);
    }
  }
  return anatomy;
}

Eigen::Matrix3d pointCovariance(const Eigen::Matrix<double, 6, 6>& covariance, const Eigen::Vector3d& arm)
{
  Eigen::Matrix<double, 3, 6> derivative;
  derivative.leftCols<3>().setIdentity();
  // A small rotation w moves the point by w x arm.
  derivative.rightCols<3>() << 0.0, arm.z(), -arm.y(), -arm.z(), 0.0, arm.x(), arm.y(), -arm.x(), 0.0;
  return derivative * covariance * derivative.transpose();
}

double readableScale(double length, double wanted)
{
  for (const double scale : { 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0 })
  {
    if (scale * length >= wanted)
    {
      return scale;
    }
  }
  return 1000.0;
}
}  // namespace xray_tracking
