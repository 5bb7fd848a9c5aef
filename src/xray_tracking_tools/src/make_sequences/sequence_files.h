#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <vector>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// A sequence folder that is being written.
class SequenceFiles
{
public:
  /// @param folder is made; @param setup as it is to stand in sequence.yaml
  /// @throws std::runtime_error as saveTreatmentSetup()
  SequenceFiles(const std::filesystem::path& folder, const TreatmentSetup& setup);

  /// The next exposure. @param truth room_T_patient; @param images CV_16UC1, one of each of the setup's detectors
  /// @throws std::runtime_error naming an image that cannot be written
  void add(double stamp_s, const RigidTransform& truth, const std::vector<cv::Mat>& images);

  /// After the last exposure. @throws std::runtime_error naming the folder if a table was not written
  void close();

private:
  std::filesystem::path folder_;
  std::vector<std::string> detectors_;
  int exposures_ = 0;
  std::ofstream frames_;
  std::ofstream gold_;
};
}  // namespace xray_tracking
