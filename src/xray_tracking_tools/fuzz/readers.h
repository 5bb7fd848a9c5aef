#pragma once

#include <string>
#include <vector>

namespace xray_tracking
{
/// A reader of bytes that come from outside: of a file, a message, a bag.
struct Reader
{
  std::string name;  ///< of its folder in the corpus, too
  void (*read)(const std::string& bytes);
};

/// All that there are.
const std::vector<Reader>& readers();

/// Gives a reader bytes. What it may do with them is to read them, or to refuse them by std::runtime_error or
/// std::invalid_argument themselves, whose message names the file or the field.
/// @return the message; empty if it read them. @throws std::logic_error if it refused in another way
std::string refusalOf(const Reader& reader, const std::string& bytes);
}  // namespace xray_tracking
