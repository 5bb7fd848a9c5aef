#include "nifti_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <memory>
#include <sstream>
#include <tuple>
#include <vector>

#include <zlib.h>

#include "ct_error.h"

namespace xray_tracking
{
namespace
{
using GzFile = std::unique_ptr<gzFile_s, int (*)(gzFile)>;
constexpr std::size_t kHeaderSize = 348;
/// Voxels that are read at once.
constexpr std::size_t kChunk = 1 << 20;
/// How far the two forms may be apart at a corner of the volume [mm]: rounding of single precision and of quaternions.
constexpr double kSamePlace = 0.1;
/// Of the cosine between axes, and of the lengths of voxels.
constexpr double kSameAxes = 1e-3;

/// Reads files that are not compressed, too.
GzFile openGz(const std::string& path)
{
  return { gzopen(path.c_str(), "rb"), gzclose };
}

/// The file of a pair with the header or the voxels, `part` being .hdr or .img; a single file is both.
std::string niftiPart(const std::string& path, const std::string& part)
{
  for (const std::string ending : { ".hdr", ".img", ".hdr.gz", ".img.gz" })
  {
    if (path.size() > ending.size() && path.compare(path.size() - ending.size(), ending.size(), ending) == 0)
    {
      const std::string plain = path.substr(0, path.size() - ending.size()) + part;
      return std::filesystem::exists(plain) ? plain : plain + ".gz";
    }
  }
  return path;
}

class NiftiHeader
{
public:
  explicit NiftiHeader(const std::string& path) : path_(path)
  {
    const GzFile file = openGz(niftiPart(path, ".hdr"));
    read_ = file && gzread(file.get(), bytes_.data(), kHeaderSize) == static_cast<int>(kHeaderSize);
    swapped_ = read_ && get<std::int32_t>(0) != static_cast<std::int32_t>(kHeaderSize);
  }

  /// Of its own size, in one order of bytes or the other.
  bool valid() const { return read_ && get<std::int32_t>(0) == static_cast<std::int32_t>(kHeaderSize); }
  bool swapped() const { return swapped_; }
  std::string magic() const { return std::string(&bytes_[344], 3); }

  template <typename Value>
  Value get(std::size_t offset) const
  {
    std::array<char, sizeof(Value)> value;
    std::copy_n(bytes_.begin() + static_cast<std::ptrdiff_t>(offset), value.size(), value.begin());
    if (swapped_)
    {
      std::reverse(value.begin(), value.end());
    }
    Value result;
    std::memcpy(&result, value.data(), sizeof(Value));
    return result;
  }

  /// @param count floats from the offset on. @throws if one is not finite
  std::vector<double> floats(const char* name, std::size_t offset, std::size_t count) const
  {
    std::vector<double> values;
    for (std::size_t n = 0; n < count; ++n)
    {
      values.push_back(get<float>(offset + 4 * n));
      // By its bits: the build may let the compiler take all numbers for finite.
      if ((get<std::uint32_t>(offset + 4 * n) & 0x7f800000u) == 0x7f800000u)
      {
        failCt(path_, std::string("field ") + name + " of its header is not finite");
      }
    }
    return values;
  }

private:
  std::string path_;
  std::array<char, kHeaderSize> bytes_{};
  bool read_ = false;
  bool swapped_ = false;
};

/// From NIfTI's RAS.
Eigen::Affine3d lpsFromRas(const Eigen::Matrix<double, 3, 4>& ras)
{
  Eigen::Affine3d lps = Eigen::Affine3d::Identity();
  lps.affine() = Eigen::Vector3d(-1, -1, 1).asDiagonal() * ras;
  return lps;
}

Eigen::Affine3d qform(const NiftiHeader& header)
{
  const std::vector<double> pixdim = header.floats("pixdim", 76, 4);
  const std::vector<double> b = header.floats("quatern", 256, 3);
  const std::vector<double> offset = header.floats("qoffset", 268, 3);
  const double rest = 1.0 - (b[0] * b[0] + b[1] * b[1] + b[2] * b[2]);
  // Single precision does not hold less.
  const Eigen::Quaterniond rotation(rest > 1e-6 ? std::sqrt(rest) : 0.0, b[0], b[1], b[2]);
  Eigen::Matrix<double, 3, 4> ras;
  ras.leftCols<3>() = rotation.normalized().toRotationMatrix() *
                      Eigen::Vector3d(pixdim[1], pixdim[2], pixdim[0] < 0.0 ? -pixdim[3] : pixdim[3]).asDiagonal();
  ras.col(3) = Eigen::Vector3d(offset.data());
  return lpsFromRas(ras);
}

Eigen::Affine3d sform(const NiftiHeader& header)
{
  const std::vector<double> rows = header.floats("srow", 280, 12);
  return lpsFromRas(Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(rows.data()));
}

std::string inWords(const Eigen::Affine3d& form)
{
  std::ostringstream text;
  const Eigen::IOFormat row(5, Eigen::DontAlignCols, " ", " ", "", "", "(", ")");
  text << "first voxel at LPS " << form.translation().transpose().format(row) << " mm, axes";
  for (int axis = 0; axis < 3; ++axis)
  {
    text << " " << form.linear().col(axis).transpose().format(row);
  }
  return text.str();
}

/// What is wrong with an sform as the place of a patient: axes not at right angles, other voxels than pixdim's.
std::string distortionOf(const Eigen::Affine3d& form, const std::vector<double>& pixdim)
{
  const Eigen::Vector3d spacing = form.linear().colwise().norm();
  const Eigen::Matrix3d axes = form.linear().colwise().normalized();
  std::ostringstream text;
  if (!(axes.transpose() * axes).isIdentity(kSameAxes))
  {
    text << "is sheared";
  }
  else if (!spacing.isApprox(Eigen::Vector3d(pixdim[1], pixdim[2], pixdim[3]), kSameAxes))
  {
    text << "has voxels of " << spacing.transpose() << " mm, pixdim " << pixdim[1] << " " << pixdim[2] << " "
         << pixdim[3];
  }
  return text.str();
}

Eigen::Affine3d patientFromIndex(const NiftiHeader& header, const Eigen::Vector3i& size, NiftiForm form,
                                 const std::string& path)
{
  const bool has_q = header.get<std::int16_t>(252) > 0;
  const bool has_s = header.get<std::int16_t>(254) > 0;
  if (!has_q && !has_s)
  {
    failCt(path, "its header does not say where its axes run: qform_code and sform_code are 0");
  }
  if ((form == NiftiForm::QFORM && !has_q) || (form == NiftiForm::SFORM && !has_s))
  {
    failCt(path, std::string("ct_nifti_form is ") + (has_q ? "sform, but sform" : "qform, but qform") +
                     "_code is 0: expected " + (has_q ? "qform" : "sform") + ", or none");
  }
  const Eigen::Affine3d by_q = qform(header);
  const Eigen::Affine3d by_s = sform(header);
  if (form != NiftiForm::AGREED)
  {
    return form == NiftiForm::QFORM ? by_q : by_s;
  }
  const std::string hint = ": expected both to be the same, or the setup's ct_nifti_form, qform or sform, to choose";
  if (has_s)
  {
    const std::string distortion = distortionOf(by_s, header.floats("pixdim", 76, 4));
    if (!distortion.empty())
    {
      failCt(path, "sform " + distortion + " (" + inWords(by_s) + ")" +
                       (has_q ? "; qform has " + inWords(by_q) : "; there is no qform") + hint);
    }
  }
  if (has_q && has_s)
  {
    double apart = 0.0;
    for (int corner = 0; corner < 8; ++corner)
    {
      const Eigen::Vector3i upper(corner & 1, corner >> 1 & 1, corner >> 2);
      const Eigen::Vector3d index = upper.cwiseProduct((size.array() - 1).matrix()).cast<double>();
      apart = std::max(apart, (by_q * index - by_s * index).norm());
    }
    if (!(apart <= kSamePlace))
    {
      std::ostringstream message;
      message << "qform and sform put its voxels up to " << apart << " mm apart; qform: " << inWords(by_q)
              << "; sform: " << inWords(by_s) << hint;
      failCt(path, message.str());
    }
  }
  // Single precision of the matrix beats the quaternion's.
  return has_s ? by_s : by_q;
}

template <typename Value>
void readVoxels(gzFile file, std::uintmax_t stored_bytes, bool swapped, double slope, double intercept,
                const std::string& path, StoredVolume& stored)
{
  const std::size_t count = stored.volume.grid.voxelCount();
  requireHeld(path, stored_bytes, static_cast<double>(count) * sizeof(Value));
  stored.volume.hu.reserve(count);
  std::vector<Value> values(std::min(count, kChunk));
  std::vector<float> scaled(values.size());
  for (std::size_t done = 0; done < count;)
  {
    const std::size_t wanted = std::min(kChunk, count - done);
    const int bytes = static_cast<int>(wanted * sizeof(Value));
    if (gzread(file, values.data(), bytes) != bytes)
    {
      failCt(path, "truncated: its data end before the last voxel");
    }
    for (std::size_t n = 0; n < wanted; ++n)
    {
      if (swapped)
      {
        char* const start = reinterpret_cast<char*>(&values[n]);
        std::reverse(start, start + sizeof(Value));
      }
      scaled[n] = static_cast<float>(slope * static_cast<double>(values[n]) + intercept);
    }
    appendRounded(scaled.data(), wanted, path, stored);
    done += wanted;
  }
}
}  // namespace

bool isNifti(const std::string& path)
{
  return NiftiHeader(path).valid();
}

std::vector<std::string> niftiFiles(const std::string& path)
{
  std::vector<std::string> files{ path };
  for (const char* const part : { ".hdr", ".img" })
  {
    if (const std::string file = niftiPart(path, part); file != path)
    {
      files.push_back(file);
    }
  }
  return files;
}

StoredVolume readNifti(const std::string& path, NiftiForm form)
{
  const NiftiHeader header(path);
  if (header.magic() != "n+1" && header.magic() != "ni1")
  {
    failCt(path, "its header does not say where its axes run: it is Analyze, expected NIfTI-1");
  }
  int dimensions = header.get<std::int16_t>(40);
  while (dimensions > 3 && dimensions < 8 && header.get<std::int16_t>(40 + 2 * dimensions) == 1)
  {
    --dimensions;
  }
  if (dimensions != 3)
  {
    failCt(path, "has " + std::to_string(dimensions) + " dimensions, expected 3");
  }
  const int unit = header.get<char>(123) & 7;
  if (unit != 0 && unit != 2)
  {
    failCt(path, std::string("is in ") + (unit == 1 ? "m" : unit == 3 ? "um" : "unknown units") + ", expected mm");
  }
  StoredVolume stored;
  VolumeGrid& grid = stored.volume.grid;
  grid.size = { header.get<std::int16_t>(42), header.get<std::int16_t>(44), header.get<std::int16_t>(46) };
  for (const auto& [name, offset, count] : { std::make_tuple("pixdim", 76, 4), std::make_tuple("quatern", 256, 3),
                                             std::make_tuple("qoffset", 268, 3), std::make_tuple("srow", 280, 12) })
  {
    header.floats(name, static_cast<std::size_t>(offset), static_cast<std::size_t>(count));
  }
  grid.patient_from_index = patientFromIndex(header, grid.size, form, path);
  requireUsableGrid(grid, path);

  // As the standard has it, a slope of 0 means values as they are.
  double slope = header.floats("scl_slope", 112, 1)[0];
  const double intercept = slope == 0.0 ? 0.0 : header.floats("scl_inter", 116, 1)[0];
  slope = slope == 0.0 ? 1.0 : slope;
  const std::string data = niftiPart(path, ".img");
  const GzFile file = openGz(data);
  const auto start = static_cast<z_off_t>(std::clamp(header.floats("vox_offset", 108, 1)[0], 0.0, 1e9));
  if (!file || gzseek(file.get(), start, SEEK_SET) != start)
  {
    failCt(path, "truncated: " + data + " cannot be read up to its first voxel");
  }
  const auto read = [&](auto value)
  {
    readVoxels<decltype(value)>(file.get(), std::filesystem::file_size(data), header.swapped(), slope, intercept, path,
                                stored);
  };
  switch (const int type = header.get<std::int16_t>(70))
  {
    case 2:
      read(std::uint8_t{});
      break;
    case 4:
      read(std::int16_t{});
      break;
    case 8:
      read(std::int32_t{});
      break;
    case 16:
      read(float{});
      break;
    case 64:
      read(double{});
      break;
    case 256:
      read(std::int8_t{});
      break;
    case 512:
      read(std::uint16_t{});
      break;
    case 768:
      read(std::uint32_t{});
      break;
    case 1024:
      read(std::int64_t{});
      break;
    case 1280:
      read(std::uint64_t{});
      break;
    default:
      failCt(path, "datatype is " + std::to_string(type) + ", expected whole numbers or floating point, one a voxel");
  }
  return stored;
}
}  // namespace xray_tracking
