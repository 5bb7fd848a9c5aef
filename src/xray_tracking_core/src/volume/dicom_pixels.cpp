#include "dicom_pixels.h"

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <stdexcept>

#include <gdcmAttribute.h>
#include <gdcmReader.h>

namespace xray_tracking
{
namespace
{
template <std::uint16_t GROUP, std::uint16_t ELEMENT>
std::uintmax_t number(const gdcm::DataSet& data)
{
  gdcm::Attribute<GROUP, ELEMENT> attribute;
  attribute.SetFromDataSet(data);
  return static_cast<std::uintmax_t>(std::max<std::int64_t>(attribute.GetValue(), 0));
}

bool isPlain(const gdcm::TransferSyntax& syntax)
{
  return syntax == gdcm::TransferSyntax::ImplicitVRLittleEndian ||
         syntax == gdcm::TransferSyntax::ExplicitVRLittleEndian || syntax == gdcm::TransferSyntax::ExplicitVRBigEndian;
}
}  // namespace

void requireAllDicomPixels(const std::string& file)
{
  const gdcm::Tag pixel_data(0x7fe0, 0x0010);
  gdcm::Reader reader;
  reader.SetFileName(file.c_str());
  reader.ReadUpToTag(pixel_data, { pixel_data });
  const std::size_t start = reader.GetStreamCurrentPosition();
  if (start == static_cast<std::size_t>(-1))
  {
    throw std::runtime_error(file + ": holds no pixels");
  }
  if (!isPlain(reader.GetFile().GetHeader().GetDataSetTransferSyntax()))
  {
    return;
  }
  const gdcm::DataSet& data = reader.GetFile().GetDataSet();
  const std::uintmax_t columns = number<0x0028, 0x0011>(data);
  const std::uintmax_t rows = number<0x0028, 0x0010>(data);
  const std::uintmax_t samples = std::max<std::uintmax_t>(1, number<0x0028, 0x0002>(data));
  const std::uintmax_t expected = start + columns * rows * samples * number<0x0028, 0x0100>(data) / 8;
  const std::uintmax_t size = std::filesystem::file_size(file);
  if (size < expected)
  {
    throw std::runtime_error(file + ": truncated: " + std::to_string(size) + " bytes, expected " +
                             std::to_string(expected));
  }
}
}  // namespace xray_tracking
