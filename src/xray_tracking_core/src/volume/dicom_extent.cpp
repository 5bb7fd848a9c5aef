#include "dicom_extent.h"

#include <array>
#include <cstring>
#include <fstream>
#include <ios>
#include <sstream>

namespace xray_tracking
{
namespace
{
using State = DicomExtent::State;

constexpr std::uint32_t kUndefined = 0xFFFFFFFF;
constexpr std::uint32_t kItem = 0xFFFEE000;
constexpr std::uint32_t kItemEnd = 0xFFFEE00D;
constexpr std::uint32_t kSequenceEnd = 0xFFFEE0DD;
constexpr std::uint32_t kTransferSyntax = 0x00020010;
constexpr std::uint32_t kPixelData = 0x7FE00010;
/// RT objects nest by six.
constexpr int kMostNested = 32;

/// What ends the walk.
struct Found
{
  State state;
  bool before_pixels;
  std::string why;
};

std::string nameOf(std::uint32_t tag)
{
  std::ostringstream text;
  text << std::hex << std::uppercase;
  text.fill('0');
  text << '(';
  text.width(4);
  text << (tag >> 16) << ',';
  text.width(4);
  text << (tag & 0xFFFF) << ')';
  return text.str();
}

class Walk
{
public:
  explicit Walk(const std::string& path) : file_(path, std::ios::binary)
  {
    file_.seekg(0, std::ios::end);
    if (!file_)
    {
      throw Found{ State::NO_DICOM, false, "not readable" };
    }
    size_ = static_cast<std::uint64_t>(file_.tellg());
    seek(0);
  }

  void whole()
  {
    std::array<char, 132> start{};
    if (size_ >= start.size())
    {
      readBytes(start.data(), start.size(), 0);
    }
    const bool has_preamble = size_ >= start.size() && std::memcmp(start.data() + 128, "DICM", 4) == 0;
    seek(has_preamble ? start.size() : 0);
    if (!has_preamble)
    {
      // Without one it begins with its meta information or with group 8.
      const std::uint16_t group = static_cast<std::uint16_t>(static_cast<unsigned char>(start[0])) |
                                  static_cast<std::uint16_t>(static_cast<unsigned char>(start[1]) << 8);
      if (size_ < start.size() || (group != 2 && group != 8))
      {
        throw Found{ State::NO_DICOM, false, "not a DICOM file by its first bytes" };
      }
    }
    const std::uint64_t start_of_meta = position_;
    const std::string syntax = metaInformation();
    if (has_preamble && position_ == start_of_meta && position_ < size_)
    {
      throw Found{ State::UNSAFE, true, "no meta information follows its preamble; export it again" };
    }
    if (position_ == size_)
    {
      throw Found{ State::CUT, true, "truncated: nothing follows its meta information" };
    }
    if (syntax == "1.2.840.10008.1.2.1.99")
    {
      throw Found{ State::UNSAFE, true, "deflated; export it as Explicit VR Little Endian" };
    }
    big_endian_ = syntax == "1.2.840.10008.1.2.2";
    const bool is_explicit = syntax.empty() ? looksExplicit() : syntax != "1.2.840.10008.1.2";
    elements(size_, false, is_explicit, 0);
    if (!has_no_vr_.empty())
    {
      throw Found{ State::IRREGULAR, false, has_no_vr_ };
    }
  }

private:
  struct Element
  {
    std::uint32_t tag;
    std::string vr;  ///< empty: implicit
    std::uint32_t length;
    std::uint64_t start;
  };

  void seek(std::uint64_t position)
  {
    position_ = position;
    file_.clear();
    file_.seekg(static_cast<std::streamoff>(position));
  }

  /// @param tag of the element that they belong to; 0: none
  void readBytes(char* bytes, std::size_t count, std::uint32_t tag)
  {
    if (count > size_ - position_)
    {
      cut(tag, position_, count);
    }
    file_.read(bytes, static_cast<std::streamsize>(count));
    if (!file_)
    {
      throw Found{ State::CUT, true, "not readable from byte " + std::to_string(position_) + " on" };
    }
    position_ += count;
  }

  std::uint32_t number(int bytes)
  {
    std::array<unsigned char, 4> data{};
    readBytes(reinterpret_cast<char*>(data.data()), static_cast<std::size_t>(bytes), 0);
    std::uint32_t value = 0;
    for (int n = 0; n < bytes; ++n)
    {
      value = value << 8 | data[static_cast<std::size_t>(big_endian_ ? n : bytes - 1 - n)];
    }
    return value;
  }

  std::uint32_t tag()
  {
    const std::uint32_t group = number(2);
    return group << 16 | number(2);
  }

  [[noreturn]] void cut(std::uint32_t tag, std::uint64_t start, std::uint64_t length) const
  {
    throw Found{ State::CUT, tag != kPixelData,
                 "truncated: " + std::to_string(size_) + " bytes, expected " + std::to_string(start + length) +
                     (tag == 0 ? " or more" : " for " + nameOf(tag)) };
  }

  [[noreturn]] void irregular(std::uint32_t tag, const std::string& what) const
  {
    throw Found{ State::UNSAFE, true,
                 nameOf(tag) + " before byte " + std::to_string(position_) + " " + what + "; export it again" };
  }

  /// @return the transfer syntax; empty if there is none
  std::string metaInformation()
  {
    in_meta_ = true;
    std::string syntax;
    while (position_ < size_)
    {
      const std::uint64_t before = position_;
      const std::uint32_t group = number(2);
      seek(before);
      if (group != 2)
      {
        break;
      }
      const Element element = header(true);
      if (element.length == kUndefined)
      {
        irregular(element.tag, "has no length");
      }
      if (element.vr == "SQ")
      {
        irregular(element.tag, "is a sequence, of which meta information has none");
      }
      requireWithin(element, size_);
      if (element.tag == kTransferSyntax)
      {
        syntax.resize(element.length);
        readBytes(syntax.data(), syntax.size(), element.tag);
        syntax.erase(syntax.find_last_not_of(std::string(" \0", 2)) + 1);
      }
      seek(element.start + element.length);
    }
    in_meta_ = false;
    return syntax;
  }

  bool looksExplicit()
  {
    const std::uint64_t before = position_;
    std::array<char, 6> start{};
    readBytes(start.data(), start.size(), 0);
    seek(before);
    return isVr({ start[4], start[5] });
  }

  /// @param list of two letters each, with a space between them
  static bool isOneOf(const std::string& vr, const std::string& list)
  {
    const std::size_t place = list.find(vr);
    return place != std::string::npos && place % 3 == 0;
  }

  static bool isVr(const std::string& vr)
  {
    static const std::string kAll =
        "AE AS AT CS DA DS DT FD FL IS LO LT OB OD OF OL OV OW PN SH SL SQ SS ST SV TM UC UI "
        "UL UN UR US UT UV";
    return isOneOf(vr, kAll);
  }

  static bool isLong(const std::string& vr)
  {
    static const std::string kLong = "OB OD OF OL OV OW SQ SV UC UN UR UT UV";
    return isOneOf(vr, kLong);
  }

  Element header(bool is_explicit)
  {
    Element element{ tag(), "", 0, 0 };
    if (is_explicit && element.tag >> 16 != 0xFFFE)
    {
      element.vr.resize(2);
      readBytes(element.vr.data(), 2, 0);
      if (!isVr(element.vr))
      {
        if (element.vr != std::string(2, '\0'))
        {
          throw Found{ State::UNSAFE, true, nameOf(element.tag) + " has no VR of the standard; export it again" };
        }
        if (in_meta_)
        {
          irregular(element.tag, "has no VR");
        }
        // GDCM takes it for implicit.
        seek(position_ - 2);
        element.vr.clear();
        element.length = number(4);
        has_no_vr_ = nameOf(element.tag) + " before byte " + std::to_string(position_) + " has no VR";
      }
      else if (isLong(element.vr))
      {
        number(2);
        element.length = number(4);
      }
      else
      {
        element.length = number(2);
      }
    }
    else
    {
      element.length = number(4);
    }
    element.start = position_;
    return element;
  }

  void requireWithin(const Element& element, std::uint64_t end) const
  {
    if (element.length > size_ - element.start)
    {
      cut(element.tag, element.start, element.length);
    }
    if (element.start + element.length > end)
    {
      irregular(element.tag, "is longer than what it is in");
    }
  }

  /// GDCM makes room for what a delimiter says that it holds.
  void requireEmpty(const Element& delimiter) const
  {
    if (delimiter.length != 0)
    {
      irregular(delimiter.tag, "has a length");
    }
  }

  /// Elements up to `end`, or to a delimiter if `open`.
  void elements(std::uint64_t end, bool open, bool is_explicit, int depth)
  {
    bool had_pixels = false;
    while (open || position_ < end)
    {
      if (depth == 0 && had_pixels && end - position_ < 4)
      {
        return;  // a byte or two that fill up the file: GDCM takes four for a tag
      }
      const Element element = header(is_explicit);
      if (element.tag == kItemEnd && open)
      {
        requireEmpty(element);
        return;
      }
      if (element.tag >> 16 == 0xFFFE)
      {
        irregular(element.tag, "outside of a sequence");
      }
      value(element, end, is_explicit, depth);
      had_pixels = had_pixels || element.tag == kPixelData;
    }
  }

  void value(const Element& element, std::uint64_t end, bool is_explicit, int depth)
  {
    if (element.length == kUndefined)
    {
      const bool fragments = element.tag == kPixelData;
      if (!fragments && is_explicit && element.vr != "SQ" && element.vr != "UN")
      {
        irregular(element.tag, "has no length");
      }
      if (fragments && is_explicit && !isOneOf(element.vr, "OB OW UN"))
      {
        irregular(element.tag, "is in fragments, which its VR has none of");
      }
      // Of unknown VR: implicit within, by the standard.
      items(end, true, is_explicit && element.vr != "UN", fragments, depth + 1);
      return;
    }
    requireWithin(element, end);
    const std::uint64_t after = element.start + element.length;
    if (element.vr == "SQ" && element.length > 0)
    {
      items(after, false, is_explicit, false, depth + 1);
    }
    else if (element.vr.empty() && element.length >= 8)
    {
      // Without a VR a sequence is told by its first item.
      const bool is_sequence = tag() == kItem;
      seek(element.start);
      if (is_sequence)
      {
        items(after, false, false, false, depth + 1);
      }
    }
    seek(after);
  }

  void items(std::uint64_t end, bool open, bool is_explicit, bool fragments, int depth)
  {
    if (depth > kMostNested)
    {
      throw Found{ State::CUT, true, "sequences within sequences deeper than " + std::to_string(kMostNested) };
    }
    while (open || position_ < end)
    {
      const Element item = header(false);
      if (item.tag == kSequenceEnd && open)
      {
        requireEmpty(item);
        return;
      }
      if (item.tag != kItem)
      {
        irregular(item.tag, "in the place of an item");
      }
      if (item.length == kUndefined && fragments)
      {
        irregular(item.tag, "has no length");
      }
      if (item.length == kUndefined)
      {
        elements(end, true, is_explicit, depth);
        continue;
      }
      if (fragments && item.length > size_ - item.start)
      {
        cut(kPixelData, item.start, item.length);
      }
      requireWithin(item, end);
      if (!fragments)
      {
        elements(item.start + item.length, false, is_explicit, depth);
      }
      seek(item.start + item.length);
    }
  }

  std::ifstream file_;
  std::uint64_t size_ = 0;
  std::uint64_t position_ = 0;
  bool big_endian_ = false;
  bool in_meta_ = false;   ///< in the meta information
  std::string has_no_vr_;  ///< where that is so though others have; in words
};
}  // namespace

DicomExtent dicomExtent(const std::string& path)
{
  try
  {
    Walk(path).whole();
  }
  catch (const Found& found)
  {
    return { found.state, found.before_pixels, found.why };
  }
  return {};
}
}  // namespace xray_tracking
