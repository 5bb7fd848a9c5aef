#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include <ros/time.h>

#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
/// What is added to a sequence's stamps to make bag times: sequences start at 0, which ROS takes for "no time".
constexpr std::int64_t kPlaybackEpochNs = 1000LL * 1000000000LL;

/// Bag time of a sequence's stamp. @throws std::invalid_argument naming the stamp if ros::Time cannot hold it
ros::Time playbackTime(std::int64_t stamp_ns);

/// Keeps the first `frames` exposures of a sequence. @throws std::invalid_argument if there are fewer, or frames < 1
void keepFirstExposures(Sequence& sequence, int frames);

/// Writes what a detector driver would have published (docs/playback.md): `/<detector>/image_raw` (mono16, pixel
/// values as in the files), `/<detector>/camera_info`, and `/patient_ground_truth` where there is a gold standard;
/// message stamps and bag times are playbackTime() of the exposures. And, at the beginning and an
/// interval after the end, `/run_description`
/// (recording.h) with the setup and the gold standard as the files have them. Nothing is left of an unfinished file.
/// @param progress called after every exposure with (exposures written, exposures in all)
/// @throws std::runtime_error or std::invalid_argument naming the file
void writeSequenceBag(const Sequence& sequence, const std::string& bag_path,
                      const std::function<void(std::size_t, std::size_t)>& progress);
}  // namespace xray_tracking
