#pragma once

#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

namespace xray_tracking
{
/// A folder that goes away with its owner.
class TemporaryFolder
{
public:
  TemporaryFolder()
    : path_(std::filesystem::temp_directory_path() / ("xray_tracking_tools_" + std::to_string(getpid())))
  {
    std::filesystem::remove_all(path_);
    std::filesystem::create_directories(path_);
  }
  ~TemporaryFolder() { std::filesystem::remove_all(path_); }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  std::string file(const std::string& name) const { return (path_ / name).string(); }
  void write(const std::string& name, const std::string& text) const { std::ofstream(path_ / name) << text; }

private:
  std::filesystem::path path_;
};

struct CommandResult
{
  int status = -1;
  std::string output;  ///< stdout and stderr
};

/// Runs a shell command.
inline CommandResult runShell(const std::string& command)
{
  CommandResult result;
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  char buffer[256];
  while (std::fgets(buffer, sizeof(buffer), pipe) != nullptr)
  {
    result.output += buffer;
  }
  const int status = pclose(pipe);
  result.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return result;
}

constexpr int kColumns = 8;
constexpr int kRows = 6;

/// Value of a test image's pixel: no two of them alike, and all 16 bits used.
inline int testValue(int frame, int detector, int row, int column)
{
  return 12000 * frame + 6001 * detector + 97 * row + column;
}

inline cv::Mat testImage(int frame, int detector)
{
  cv::Mat image(kRows, kColumns, CV_16UC1);
  for (int row = 0; row < kRows; ++row)
  {
    for (int column = 0; column < kColumns; ++column)
    {
      image.at<std::uint16_t>(row, column) = static_cast<std::uint16_t>(testValue(frame, detector, row, column));
    }
  }
  return image;
}

/// A sequence folder of five exposures at 0, 0.25, ... 1 s, gold standard: the k-th moved by k mm along room x. Two
/// panels of 8 x 6 pixels of 0.5 x 0.25 mm, source to panel 1000 mm, foot at pixel (3, 2) of detector_a.
inline void writeTestSequence(const TemporaryFolder& folder)
{
  folder.write("sequence.yaml", R"(intensity: {kind: counts, offset: 0}
detectors:
  - {name: detector_a, image_size: [8, 6], pixel_pitch_mm: [0.5, 0.25], source_mm: [0, 0, 600],
     origin_mm: [-1.5, 0.5, -400], x_direction: [1, 0, 0], y_direction: [0, -1, 0]}
  - {name: detector_b, image_size: [8, 6], pixel_pitch_mm: [0.5, 0.25], source_mm: [0, 600, 0],
     origin_mm: [-1.5, -400, -0.5], x_direction: [1, 0, 0], y_direction: [0, 0, 1]}
frames: frames.csv
gold_standard: gold_standard.csv
initial_pose: {translation_mm: [10, 20, 30], rotation_xyzw: [0, 0, 0, 1]}
target_box_mm: {min: [-12, -21, -31], max: [-8, -19, -29]}
)");
  std::ostringstream frames, gold;
  frames << "stamp_s,detector,file\n";
  gold << "stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
  for (int k = 0; k < 5; ++k)
  {
    for (int d = 0; d < 2; ++d)
    {
      const std::string name = std::string("image_") + "ab"[d] + std::to_string(k) + ".png";
      cv::imwrite(folder.file(name), testImage(k, d));
      frames << 0.25 * k << ",detector_"
             << "ab"[d] << ',' << name << '\n';
    }
    gold << 0.25 * k << ',' << 10 + k << ",20,30,0,0,0,1\n";
  }
  folder.write("frames.csv", frames.str());
  folder.write("gold_standard.csv", gold.str());
}
}  // namespace xray_tracking
