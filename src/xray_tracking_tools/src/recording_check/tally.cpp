#include "tally.h"

#include <cinttypes>
#include <cstdio>

namespace xray_tracking
{
namespace
{
/// Whether it is an error.
enum class Weight
{
  WARNING,
  ERROR,
  BY_SHARE  ///< if half of the messages or more are so: of single exposures the graph has no pose, and says so
};

struct Kind
{
  const char* code;
  Weight weight;
  const char* expected;
  const char* advice;
};

constexpr Kind kKinds[] = {
  { "stamp_zero", Weight::ERROR, "the time of the exposure", "have the driver stamp its messages" },
  { "time_backward", Weight::ERROR, "stamps that grow",
    "cut the recording where another run begins, or mend the driver's clock" },
  { "stamp_repeated", Weight::ERROR, "one a stamp", "leave the second one out" },
  { "stamp_ahead", Weight::ERROR, "stamps at most 1 s ahead of when they were recorded",
    "synchronise the driver's clock: the graph drops these" },
  { "stamp_behind", Weight::WARNING, "stamps at most 1 s before they were recorded",
    "synchronise the driver's clock, or look for what delays its messages" },
  { "image_unreadable", Weight::BY_SHARE, "an image of one channel of 8 or 16 bit, of the detector's size",
    "export it again" },
  { "image_encoding", Weight::ERROR, "mono16, mono8, 16UC1 or 8UC1",
    "have the driver publish grey values as they were measured" },
  { "image_size", Weight::ERROR, "the detector's image_size",
    "mend image_size, or export whole images without scaling" },
  { "image_nothing", Weight::BY_SHARE, "an X-ray image of the patient",
    "look whether X-rays were on; the graph has no pose of these" },
  { "image_frozen", Weight::ERROR, "an image that differs from those before by its noise at least",
    "look why panel, grabber or export repeats images; what they show is of the past" },
  { "image_mixed_rows", Weight::BY_SHARE, "rows of one exposure", "have the grabber deliver whole frames" },
  { "image_saturated", Weight::WARNING, "at most 2 % of what is seen of the target at an end of the range",
    "another dose or gain; give intensity.offset and air_counts as the detector has them" },
  { "image_dead_lines", Weight::WARNING, "no dead rows or columns",
    "calibrate the panel; until then they are put in order, which costs accuracy where they cross the target" },
  { "image_stuck", Weight::WARNING, "at most 1 % of what is seen of the target stuck or written over",
    "calibrate the panel, and export without annotations" },
  { "image_collimated", Weight::BY_SHARE, "the target inside the field of X-rays",
    "open the collimator, or take a smaller target_box_mm or region" },
  { "camera_info_invalid", Weight::ERROR, "a pinhole camera without distortion, binning or a cut-out",
    "undistort the images by the node image_rectifier, and record what it publishes" },
  { "camera_info_changed", Weight::ERROR, "the same camera_info in all of a recording",
    "cut the recording where the geometry changes" },
  { "camera_info_differs", Weight::ERROR, "the setup's detector", "take the setup of this room, or calibrate anew" },
  { "camera_info_frame", Weight::WARNING, "<detector>_optical_frame", "have the driver name its optical frame" },
  { "tf_differs", Weight::ERROR, "the setup's detector", "take the setup of this room, or mend what publishes tf" },
  { "gold_standard_invalid", Weight::ERROR, "a finite pose with a quaternion of norm 1", "mend or leave out the row" },
};
}  // namespace

std::string secondsText(std::int64_t ns)
{
  char text[40];
  const std::int64_t size = ns < 0 ? -ns : ns;
  std::snprintf(text, sizeof(text), "%s%" PRId64 ".%09" PRId64 " s", ns < 0 ? "-" : "", size / 1000000000,
                size % 1000000000);
  return text;
}

void Tally::add(const std::string& code, const std::string& thing, std::int64_t stamp_ns, const std::string& words,
                double amount)
{
  Entry& entry = entries_[{ thing, code }];
  if (entry.count == 0)
  {
    entry.first_ns = stamp_ns;
  }
  if (entry.count == 0 || amount > entry.worst)
  {
    entry.worst = amount;
    entry.words = words;
  }
  ++entry.count;
}

std::vector<Finding> Tally::findings(const std::map<std::string, std::size_t>& of) const
{
  std::vector<Finding> findings;
  for (const auto& [key, entry] : entries_)
  {
    const auto& [thing, code] = key;
    const auto total = of.find(thing);
    for (const Kind& kind : kKinds)
    {
      if (code != kind.code)
      {
        continue;
      }
      const bool most = total != of.end() && 2 * entry.count >= total->second;
      const bool error = kind.weight == Weight::ERROR || (kind.weight == Weight::BY_SHARE && most);
      findings.push_back({ code, error ? Severity::ERROR : Severity::WARNING, thing,
                           std::to_string(entry.count) +
                               (total != of.end() ? " of " + std::to_string(total->second) : "") + ", the first at " +
                               secondsText(entry.first_ns) + ": " + entry.words,
                           kind.expected, kind.advice });
    }
  }
  return findings;
}
}  // namespace xray_tracking
