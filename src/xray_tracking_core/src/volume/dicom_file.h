#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <gdcmDataSet.h>
#include <gdcmFile.h>

namespace xray_tracking
{
/// GDCM and ITK write pages to stderr about files that they nevertheless read; what matters is found here and thrown.
void silenceImageLibraries();

/// A DICOM data set, or an item of one of its sequences. What is absent or empty is an empty text or list.
class DicomData
{
public:
  DicomData(std::shared_ptr<const gdcm::File> file, const gdcm::DataSet& data) : file_(std::move(file)), data_(&data) {}

  /// Without the spaces around it; several values with backslashes between them, as DICOM has it.
  std::string text(const gdcm::Tag& tag) const;
  /// Of any VR that holds numbers, whatever the process' locale; empty if one of the values is not a number.
  std::vector<double> numbers(const gdcm::Tag& tag) const;
  /// The first of numbers(), if there is one.
  std::optional<double> number(const gdcm::Tag& tag) const;
  bool has(const gdcm::Tag& tag) const { return data_->FindDataElement(tag); }
  /// Of a sequence.
  std::vector<DicomData> items(const gdcm::Tag& tag) const;

private:
  std::shared_ptr<const gdcm::File> file_;  ///< that owns the data
  const gdcm::DataSet* data_;
};

/// A DICOM file without its pixels.
struct DicomHeader
{
  DicomData data;     ///< none if the file ends within its header
  std::string fault;  ///< if the file ends before it says; the pixels' reader tells of others
};

/// Nothing if it is no DICOM file.
std::optional<DicomHeader> readDicomHeader(const std::string& file);

/// The stored pixel values of a DICOM file of one channel: what the bits BitsStored below HighBit hold, with the sign
/// that PixelRepresentation says; neither rescaled nor inverted.
class DicomPixels
{
public:
  /// @throws std::runtime_error naming the file and the attribute: no pixels, several channels, colours, a palette,
  /// bits that make no sense, or not decodable
  explicit DicomPixels(const std::string& file);

  int columns() const { return columns_; }
  int rows() const { return rows_; }
  int frames() const { return frames_; }
  /// Values of a frame, row by row. @param frame 0 <= frame < frames()
  void read(int frame, std::vector<std::int32_t>& values) const;
  /// The value of an attribute of the pixels' type, e.g. PixelPaddingValue, in whichever VR it was written.
  std::optional<std::int32_t> value(const gdcm::Tag& tag) const;

private:
  std::int32_t sample(std::uint32_t bits) const;

  std::shared_ptr<const gdcm::File> file_;
  std::vector<char> decoded_;    ///< of compressed pixels
  const char* bytes_ = nullptr;  ///< of all frames
  int columns_ = 0, rows_ = 0, frames_ = 1;
  int allocated_ = 16, stored_ = 16, high_bit_ = 15;
  bool is_signed_ = false;
};
}  // namespace xray_tracking
