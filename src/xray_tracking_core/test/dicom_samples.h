#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>

namespace xray_tracking
{
/// Bytes of whole numbers, little endian.
template <typename Number>
std::string bytesOf(std::initializer_list<Number> numbers)
{
  std::string bytes;
  for (const Number number : numbers)
  {
    bytes.append(reinterpret_cast<const char*>(&number), sizeof(number));
  }
  return bytes;
}

inline std::string us(int number)
{
  return bytesOf({ static_cast<std::uint16_t>(number) });
}

/// VR and value by group and element; values of numbers are little endian.
using DicomElements = std::map<std::pair<int, int>, std::pair<std::string, std::string>>;

/// Explicit VR, written by hand: no library that the reader uses has a part in it.
inline std::string dicomData(const DicomElements& elements, bool big_endian = false)
{
  const auto number = [&](std::size_t value, int bytes)
  {
    std::string text;
    for (int i = 0; i < bytes; ++i)
    {
      text += static_cast<char>(value >> 8 * (big_endian ? bytes - 1 - i : i) & 0xFF);
    }
    return text;
  };
  std::string data;
  for (const auto& [tag, element] : elements)
  {
    const std::string& vr = element.first;
    std::string value = element.second;
    if (value.size() % 2 != 0)
    {
      value += vr == "UI" || vr == "OB" ? '\0' : ' ';
    }
    if (big_endian && (vr == "US" || vr == "SS" || vr == "OW"))
    {
      for (std::size_t n = 0; n + 1 < value.size(); n += 2)
      {
        std::swap(value[n], value[n + 1]);
      }
    }
    const bool is_long = vr == "OB" || vr == "OW" || vr == "SQ";
    data += number(static_cast<std::size_t>(tag.first), 2) + number(static_cast<std::size_t>(tag.second), 2) + vr +
            (is_long ? std::string(2, '\0') : "") + number(value.size(), is_long ? 4 : 2) + value;
  }
  return data;
}

/// An item of a sequence: the value of an SQ is one after the other.
inline std::string dicomItem(const DicomElements& elements)
{
  const std::string data = dicomData(elements);
  return bytesOf<std::uint16_t>({ 0xFFFE, 0xE000 }) + bytesOf({ static_cast<std::uint32_t>(data.size()) }) + data;
}

inline std::string dicomFile(const DicomElements& elements, bool big_endian = false)
{
  const DicomElements meta{ { { 2, 0x0001 }, { "OB", std::string("\0\1", 2) } },
                            { { 2, 0x0002 }, elements.at({ 8, 0x0016 }) },
                            { { 2, 0x0003 }, elements.at({ 8, 0x0018 }) },
                            { { 2, 0x0010 }, { "UI", big_endian ? "1.2.840.10008.1.2.2" : "1.2.840.10008.1.2.1" } },
                            { { 2, 0x0012 }, { "UI", "1.2.3.5" } } };
  const std::string data = dicomData(meta);
  return std::string(128, '\0') + "DICM" +
         dicomData({ { { 2, 0 }, { "UL", bytesOf({ static_cast<std::uint32_t>(data.size()) }) } } }) + data +
         dicomData(elements, big_endian);
}
}  // namespace xray_tracking
