#include <cmath>
#include <string>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "shared_data.h"
#include "xray_tracking_core/projection/shear_warp_renderer.h"
#include "xray_tracking_core/sequence/sequence.h"
#include "xray_tracking_core/volume/attenuation.h"

namespace xray_tracking
{
namespace
{
/// Real anatomy imaged by physics that shares nothing with the renderer.
TEST_F(SharedDataTest, DrrLooksLikeTheXRayImage)
{
  const Sequence sequence = loadSequence(folder_ + "/sequences/thorax_01");
  const ShearWarpRenderer renderer(attenuationVolume(readCtVolume(sequence.setup.ct_path)));
  for (std::size_t n = 0; n < sequence.setup.detectors.size(); ++n)
  {
    const ProjectionGeometry& detector = sequence.setup.detectors[n];
    cv::Mat drr;
    renderer.render(detector, sequence.setup.room_from_patient, drr);
    cv::Mat counts;
    readXrayImage(sequence.exposures.front().files[n], detector, sequence.setup.intensity).convertTo(counts, CV_32F);
    cv::Mat xray;
    cv::log((counts - sequence.setup.intensity.offset) /
                (*sequence.setup.intensity.air_counts - sequence.setup.intensity.offset),
            xray);
    xray = -xray;
    cv::Mat centred_drr = drr - cv::mean(drr)[0];
    cv::Mat centred_xray = xray - cv::mean(xray)[0];
    const double correlation =
        centred_drr.dot(centred_xray) / std::sqrt(centred_drr.dot(centred_drr) * centred_xray.dot(centred_xray));
    RecordProperty(detector.name() + "_correlation", std::to_string(correlation));
    EXPECT_GT(correlation, 0.95) << detector.name();
  }
}
}  // namespace
}  // namespace xray_tracking
