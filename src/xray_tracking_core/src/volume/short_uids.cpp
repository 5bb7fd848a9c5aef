#include "short_uids.h"

#include <algorithm>
#include <cctype>

namespace xray_tracking
{
namespace
{
constexpr std::size_t kKept = 8;
/// Numbers and versions are shorter, or have fewer points.
constexpr std::size_t kShortest = 20;
constexpr std::ptrdiff_t kFewestPoints = 4;

bool isOfUid(char letter)
{
  return std::isdigit(static_cast<unsigned char>(letter)) != 0 || letter == '.';
}
}  // namespace

std::string withShortUids(const std::string& text)
{
  std::string result;
  for (auto at = text.begin(); at != text.end();)
  {
    if (!isOfUid(*at))
    {
      result += *at++;
      continue;
    }
    auto end = std::find_if_not(at, text.end(), isOfUid);
    const auto next = end;
    while (end != at && *std::prev(end) == '.')  // of the sentence, or before an extension
    {
      --end;
    }
    const std::string uid(at, end);
    const bool is_uid = uid.size() >= kShortest && std::count(uid.begin(), uid.end(), '.') >= kFewestPoints;
    result += is_uid ? "..." + uid.substr(uid.size() - kKept) : uid;
    result.append(end, next);
    at = next;
  }
  return result;
}
}  // namespace xray_tracking
