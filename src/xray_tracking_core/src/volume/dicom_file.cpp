#include "dicom_file.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <locale>
#include <sstream>
#include <stdexcept>

#include <gdcmByteValue.h>
#include <gdcmDict.h>
#include <gdcmDicts.h>
#include <gdcmGlobal.h>
#include <gdcmImageReader.h>
#include <gdcmReader.h>
#include <gdcmSequenceOfItems.h>
#include <gdcmTrace.h>
#include <itkObject.h>

#include "ct_error.h"
#include "dicom_extent.h"
#include "short_uids.h"
#include "stored_volume.h"

namespace xray_tracking
{
namespace
{
const gdcm::Tag kPixelData(0x7fe0, 0x0010);
const gdcm::Tag kSamplesPerPixel(0x0028, 0x0002);
const gdcm::Tag kPhotometric(0x0028, 0x0004);
const gdcm::Tag kFrames(0x0028, 0x0008);
const gdcm::Tag kRows(0x0028, 0x0010);
const gdcm::Tag kColumns(0x0028, 0x0011);
const gdcm::Tag kBitsAllocated(0x0028, 0x0100);
const gdcm::Tag kBitsStored(0x0028, 0x0101);
const gdcm::Tag kHighBit(0x0028, 0x0102);
const gdcm::Tag kPixelRepresentation(0x0028, 0x0103);

[[noreturn]] void fail(const std::string& file, const std::string& what)
{
  throw std::runtime_error(withShortUids(file + ": " + what));
}

bool isPlain(const gdcm::File& file)
{
  return !file.GetHeader().GetDataSetTransferSyntax().IsEncapsulated();
}

/// Implicit VR: as the dictionary has it.
gdcm::VR vrOf(const gdcm::DataElement& element)
{
  const gdcm::VR vr = element.GetVR();
  return vr != gdcm::VR::INVALID && vr != gdcm::VR::UN
             ? vr
             : gdcm::Global::GetInstance().GetDicts().GetDictEntry(element.GetTag()).GetVR();
}

template <typename Number>
std::vector<double> binaryNumbers(const gdcm::ByteValue& bytes)
{
  std::vector<double> values(bytes.GetLength() / sizeof(Number));
  for (std::size_t n = 0; n < values.size(); ++n)
  {
    Number value;
    std::memcpy(&value, bytes.GetPointer() + n * sizeof(Number), sizeof(Number));
    values[n] = static_cast<double>(value);
  }
  return values;
}

int wholeOr(const DicomData& data, const gdcm::Tag& tag, int otherwise)
{
  const std::optional<double> value = data.number(tag);
  return value ? static_cast<int>(std::isnan(*value) ? -1.0 : std::clamp(*value, -1.0, 1e6)) : otherwise;
}
}  // namespace

void silenceImageLibraries()
{
  gdcm::Trace::WarningOff();
  gdcm::Trace::ErrorOff();
  itk::Object::GlobalWarningDisplayOff();
}

std::string DicomData::text(const gdcm::Tag& tag) const
{
  const gdcm::ByteValue* bytes = has(tag) ? data_->GetDataElement(tag).GetByteValue() : nullptr;
  if (bytes == nullptr || bytes->GetPointer() == nullptr)
  {
    return "";
  }
  const std::string value(bytes->GetPointer(), bytes->GetLength());
  const std::string padding(" \n\r\t\0", 5);
  const auto first = value.find_first_not_of(padding);
  return first == std::string::npos ? "" : value.substr(first, value.find_last_not_of(padding) - first + 1);
}

std::vector<double> DicomData::numbers(const gdcm::Tag& tag) const
{
  const gdcm::ByteValue* bytes = has(tag) ? data_->GetDataElement(tag).GetByteValue() : nullptr;
  if (bytes == nullptr || bytes->GetPointer() == nullptr)
  {
    return {};
  }
  switch (vrOf(data_->GetDataElement(tag)))
  {
    case gdcm::VR::US:
    case gdcm::VR::US_SS:
      return binaryNumbers<std::uint16_t>(*bytes);
    case gdcm::VR::SS:
      return binaryNumbers<std::int16_t>(*bytes);
    case gdcm::VR::UL:
      return binaryNumbers<std::uint32_t>(*bytes);
    case gdcm::VR::SL:
      return binaryNumbers<std::int32_t>(*bytes);
    case gdcm::VR::FL:
      return binaryNumbers<float>(*bytes);
    case gdcm::VR::FD:
      return binaryNumbers<double>(*bytes);
    default:
      break;
  }
  std::vector<double> values;
  std::istringstream fields(text(tag));
  for (std::string field; std::getline(fields, field, '\\');)
  {
    std::istringstream stream(field);
    stream.imbue(std::locale::classic());
    double value = 0.0;
    if (!(stream >> value) || !(stream >> std::ws).eof())
    {
      return {};
    }
    values.push_back(value);
  }
  return values;
}

std::optional<double> DicomData::number(const gdcm::Tag& tag) const
{
  const std::vector<double> values = numbers(tag);
  return values.empty() ? std::nullopt : std::make_optional(values.front());
}

std::vector<DicomData> DicomData::items(const gdcm::Tag& tag) const
{
  std::vector<DicomData> items;
  if (has(tag))
  {
    const auto sequence = data_->GetDataElement(tag).GetValueAsSQ();
    for (gdcm::SequenceOfItems::SizeType n = 1; sequence && n <= sequence->GetNumberOfItems(); ++n)
    {
      // The item belongs to the sequence, which may have been made just now: its data are copied.
      const auto holder = std::make_shared<gdcm::File>();
      holder->SetDataSet(sequence->GetItem(n).GetNestedDataSet());
      items.emplace_back(holder, holder->GetDataSet());
    }
  }
  return items;
}

std::optional<DicomHeader> readDicomHeader(const std::string& path)
{
  silenceImageLibraries();
  gdcm::Reader reader;
  reader.SetFileName(path.c_str());
  if (!reader.CanRead())
  {
    return std::nullopt;
  }
  const DicomExtent extent = dicomExtent(path);
  if (extent.state == DicomExtent::State::NO_DICOM)
  {
    return std::nullopt;
  }
  const bool is_cut = extent.state == DicomExtent::State::CUT || extent.state == DicomExtent::State::UNSAFE;
  if (is_cut && extent.before_pixels)
  {
    const auto nothing = std::make_shared<const gdcm::File>();
    return DicomHeader{ DicomData(nothing, nothing->GetDataSet()), extent.why };
  }
  if (!reader.ReadUpToTag(kPixelData, { kPixelData }))
  {
    return std::nullopt;
  }
  const auto file = std::make_shared<const gdcm::File>(reader.GetFile());
  return DicomHeader{ DicomData(file, file->GetDataSet()), is_cut ? extent.why : "" };
}

DicomPixels::DicomPixels(const std::string& path)
{
  silenceImageLibraries();
  gdcm::Reader reader;
  reader.SetFileName(path.c_str());
  if (!reader.Read())
  {
    fail(path, "not readable or truncated");
  }
  file_ = std::make_shared<const gdcm::File>(reader.GetFile());
  const DicomData data(file_, file_->GetDataSet());
  if (!data.has(kPixelData))
  {
    fail(path, "holds no pixels");
  }
  const std::string photometric = data.text(kPhotometric);
  const int samples = wholeOr(data, kSamplesPerPixel, 1);
  if (samples != 1 || (photometric != "MONOCHROME1" && photometric != "MONOCHROME2"))
  {
    fail(path, "PhotometricInterpretation is " + (photometric.empty() ? "absent" : photometric) + ", SamplesPerPixel " +
                   std::to_string(samples) +
                   ": expected MONOCHROME1 or MONOCHROME2 with 1, the detector's own grey values");
  }
  columns_ = wholeOr(data, kColumns, 0);
  rows_ = wholeOr(data, kRows, 0);
  frames_ = std::max(1, wholeOr(data, kFrames, 1));
  allocated_ = wholeOr(data, kBitsAllocated, 16);
  stored_ = wholeOr(data, kBitsStored, allocated_);
  high_bit_ = wholeOr(data, kHighBit, stored_ - 1);
  is_signed_ = wholeOr(data, kPixelRepresentation, 0) == 1;
  if ((allocated_ != 8 && allocated_ != 16 && allocated_ != 32) || stored_ < 1 || stored_ > allocated_ ||
      high_bit_ < stored_ - 1 || high_bit_ >= allocated_ || (allocated_ == 32 && stored_ == 32 && !is_signed_))
  {
    fail(path, "BitsAllocated " + std::to_string(allocated_) + ", BitsStored " + std::to_string(stored_) +
                   ", HighBit " + std::to_string(high_bit_) +
                   ": expected 8, 16 or 32 bits allocated and those stored within them, less than 2^31");
  }
  if (columns_ < 1 || rows_ < 1)
  {
    fail(path, "is " + std::to_string(columns_) + " x " + std::to_string(rows_) + " pixels");
  }
  const std::size_t samples_in_all = static_cast<std::size_t>(columns_) * rows_ * static_cast<std::size_t>(frames_);
  if (samples_in_all > kMostVoxels)
  {
    fail(path, "is " + std::to_string(columns_) + " x " + std::to_string(rows_) + " pixels in " +
                   std::to_string(frames_) + " frames, expected " + std::to_string(kMostVoxels) + " in all at most");
  }
  const std::size_t expected = samples_in_all * allocated_ / 8;
  std::size_t length = 0;
  if (isPlain(*file_))
  {
    // GDCM leaves the bytes of these as they are.
    const gdcm::TransferSyntax syntax = file_->GetHeader().GetDataSetTransferSyntax();
    const bool is_swapped = syntax == gdcm::TransferSyntax::ImplicitVRBigEndianPrivateGE ||
                            (syntax == gdcm::TransferSyntax::ExplicitVRBigEndian &&
                             file_->GetDataSet().GetDataElement(kPixelData).GetVR() == gdcm::VR::OB);
    if (allocated_ > 8 && is_swapped)
    {
      fail(path, std::string("TransferSyntaxUID (0002,0010) is ") + syntax.GetString() +
                     ", whose pixels are big-endian bytes; export it as Explicit VR Little Endian");
    }
    const gdcm::ByteValue* bytes = file_->GetDataSet().GetDataElement(kPixelData).GetByteValue();
    bytes_ = bytes != nullptr ? bytes->GetPointer() : nullptr;
    length = bytes != nullptr && bytes_ != nullptr ? static_cast<std::size_t>(bytes->GetLength()) : 0;
  }
  else
  {
    if (high_bit_ != stored_ - 1)
    {
      fail(path, "HighBit is " + std::to_string(high_bit_) + " of compressed pixels, expected BitsStored - 1, " +
                     std::to_string(stored_ - 1));
    }
    requireHeld(path, std::filesystem::file_size(path), expected);
    gdcm::ImageReader image_reader;
    image_reader.SetFileName(path.c_str());
    if (image_reader.Read() && image_reader.GetImage().GetPixelFormat().GetBitsAllocated() == allocated_)
    {
      decoded_.resize(image_reader.GetImage().GetBufferLength());
      length = image_reader.GetImage().GetBuffer(decoded_.data()) ? decoded_.size() : 0;
      bytes_ = decoded_.data();
    }
    if (length == 0)
    {
      fail(path, "its compressed pixels cannot be decoded; truncated?");
    }
  }
  if (length < expected)
  {
    fail(path, "truncated: " + std::to_string(length) + " bytes of pixels, expected " + std::to_string(expected));
  }
}

std::int32_t DicomPixels::sample(std::uint32_t bits) const
{
  const std::uint32_t mask = stored_ == 32 ? ~0u : (1u << stored_) - 1;
  bits &= mask;
  const bool negative = is_signed_ && (bits >> (stored_ - 1) & 1u) != 0;
  return static_cast<std::int32_t>(negative ? bits | ~mask : bits);
}

void DicomPixels::read(int frame, std::vector<std::int32_t>& values) const
{
  const std::size_t count = static_cast<std::size_t>(columns_) * rows_;
  const int shift = high_bit_ + 1 - stored_;
  values.resize(count);
  const auto convert = [&](auto word)
  {
    const char* start = bytes_ + static_cast<std::size_t>(frame) * count * sizeof(word);
    for (std::size_t n = 0; n < count; ++n)
    {
      std::memcpy(&word, start + n * sizeof(word), sizeof(word));
      values[n] = sample(static_cast<std::uint32_t>(word) >> shift);
    }
  };
  if (allocated_ == 8)
  {
    convert(std::uint8_t{});
  }
  else if (allocated_ == 16)
  {
    convert(std::uint16_t{});
  }
  else
  {
    convert(std::uint32_t{});
  }
}

std::optional<std::int32_t> DicomPixels::value(const gdcm::Tag& tag) const
{
  const std::optional<double> number = DicomData(file_, file_->GetDataSet()).number(tag);
  if (!number)
  {
    return std::nullopt;
  }
  // A value that the stored bits cannot hold is none of a pixel's: writers have put -2000 beside 12 bits.
  if (!(std::abs(*number) <= std::numeric_limits<std::uint32_t>::max()))
  {
    return std::nullopt;
  }
  const auto wide = static_cast<std::int64_t>(*number);
  const std::int64_t as_read = is_signed_ && wide > 32767 && allocated_ == 16 ? wide - 65536
                               : !is_signed_ && wide < 0                      ? wide + 65536
                                                                              : wide;
  const std::int32_t held = sample(static_cast<std::uint32_t>(as_read));
  return held == as_read ? std::make_optional(held) : std::nullopt;
}
}  // namespace xray_tracking
