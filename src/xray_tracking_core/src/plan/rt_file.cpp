#include "rt_file.h"

#include <filesystem>
#include <stdexcept>

#include "../volume/dicom_extent.h"
#include "../volume/short_uids.h"

namespace xray_tracking
{
namespace
{
const gdcm::Tag kCharacterSet(0x0008, 0x0005);
const gdcm::Tag kSopClass(0x0008, 0x0016);
const gdcm::Tag kModality(0x0008, 0x0060);

/// The largest structure sets are some 200 MB.
constexpr std::uintmax_t kMostBytes = std::uintmax_t(1) << 30;

std::string inWords(const std::string& modality)
{
  return modality == "RTSTRUCT" ? "RTSTRUCT, a structure set"
         : modality == "RTPLAN" ? "RTPLAN, a treatment plan"
                                : modality;
}
}  // namespace

void failRt(const std::string& path, const std::string& what)
{
  throw std::runtime_error(withShortUids(path + ": " + what));
}

DicomData readRtFile(const std::string& path, const std::string& modality)
{
  namespace fs = std::filesystem;
  if (!fs::is_regular_file(path))
  {
    failRt(path,
           (fs::exists(path) ? "not a file" : "no such file") + std::string(", expected DICOM ") + inWords(modality));
  }
  if (fs::file_size(path) > kMostBytes)
  {
    failRt(path, "is " + std::to_string(fs::file_size(path) >> 20) + " MB, expected DICOM " + inWords(modality) +
                     ", of at most " + std::to_string(kMostBytes >> 20) + " MB");
  }
  // GDCM would read what it can of another, or end the process.
  const DicomExtent extent = dicomExtent(path);
  const std::optional<DicomHeader> file =
      extent.state == DicomExtent::State::WHOLE ? readDicomHeader(path) : std::nullopt;
  if (!file)
  {
    failRt(path, (extent.why.empty() ? "not readable as DICOM" : extent.why) + ": expected DICOM " + inWords(modality) +
                     ", whole and as the standard has it; export it again");
  }
  const std::string found = file->data.text(kModality);
  if (found != modality)
  {
    failRt(path, "Modality (0008,0060) is " + (found.empty() ? "absent" : inWords(found)) + ": expected " +
                     inWords(modality));
  }
  const std::string expected =
      modality == "RTSTRUCT" ? "1.2.840.10008.5.1.4.1.1.481.3" : "1.2.840.10008.5.1.4.1.1.481.5";
  const std::string sop_class = file->data.text(kSopClass);
  if (sop_class != expected)
  {
    const std::string ion = sop_class == "1.2.840.10008.5.1.4.1.1.481.8" ? " (ion plan)" : "";
    failRt(path, "SOPClassUID (0008,0016) is " + (sop_class.empty() ? "absent" : sop_class + ion) + ", expected " +
                     expected + ", " + inWords(modality));
  }
  return file->data;
}

std::string rtName(const DicomData& file, const DicomData& item, const gdcm::Tag& tag)
{
  const std::string character_set = file.text(kCharacterSet);
  std::string name;
  for (const char letter : item.text(tag))
  {
    const auto code = static_cast<unsigned char>(letter);
    if (code < 0x20 || code == 0x7F)
    {
      name += ' ';
    }
    else if (code < 0x80 || character_set == "ISO_IR 192")
    {
      name += letter;
    }
    else if (character_set == "ISO_IR 100")
    {
      name += static_cast<char>(0xC0 | code >> 6);
      name += static_cast<char>(0x80 | (code & 0x3F));
    }
    else
    {
      name += '?';
    }
  }
  return name;
}
}  // namespace xray_tracking
