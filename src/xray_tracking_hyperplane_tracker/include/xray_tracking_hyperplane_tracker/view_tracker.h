#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_hyperplane_tracker/exposure_check.h"
#include "xray_tracking_hyperplane_tracker/recovering_tracker.h"
#include "xray_tracking_hyperplane_tracker/region_tracker.h"

namespace xray_tracking
{
/// What a tracker says of one exposure.
struct ViewAnswer
{
  enum class State : std::uint8_t  ///< numbers of TrackedRegion.msg
  {
    UNTRAINED = 0,
    TRACKING = 2,
    LOST = 3,
    DEGRADED = 4,
    BLIND = 5
  };

  State state = State::UNTRAINED;
  std::string fault;   ///< in words, why there is no motion; empty where there is
  bool error = false;  ///< whether the fault is one of the image, or of the region that was to be learnt from it
  MotionModel model = MotionModel::TRANSLATION;
  /// All finite. Displacement, linear part and covariance are those of no motion unless found(); the status is not
  /// used.
  TrackResult motion;
  cv::Rect region;                      ///< of the template [px]; empty if there is none
  std::int64_t reference_stamp_ns = 0;  ///< of the exposure that the template was learnt on; 0 if there is none

  bool found() const { return state == State::TRACKING || state == State::DEGRADED; }
};

/// What is to be learnt from an exposure.
struct Training
{
  enum class Kind
  {
    REGION,  ///< a new template, of `region`
    AGAIN,   ///< the predictors of the one in use
    ANEW  ///< all is forgotten, also a region of an earlier REGION, and the configured region learnt, if there is one
  };
  Kind kind = Kind::REGION;
  cv::Rect region;  ///< [px]; of REGION only
};

/// Follows a region through one detector's exposures: looks at what an image shows (ExposureCheck), learns the first
/// template, tracks, looks for what is lost (RecoveringTracker) and changes templates without a gap. Without ROS; the
/// same live and offline.
///
/// While there is no template an exposure is the first one: the template is learnt on it, and it answers as the
/// reference, at zero. Where there is one, that answers the exposure which a new one is learnt on, so that the new
/// reference has a place in the old one's terms; the next exposure is the new one's. A training that fails leaves the
/// template in use.
///
///   answer = tracker.answer(image, stamp, training);   // then out with the answer, as learning takes long
///   if (training) outcome = tracker.learn(image);
///
/// Not thread-safe. No allocation for an exposure that is tracked, but for OpenCV's own where ExposureCheck looks at
/// it.
class ViewTracker
{
public:
  /// @param reduction as RegionSearch's
  /// @param model_by_data of a Euclidean tracker: a rotation that is not told from none (tellsRotation) is none
  /// @param region to learn the first template of [px]; none: only that of a Training
  /// @param image_size of the detector [px]: another one's pixels are of another size or place, and its motion is not
  /// told; none: any
  ViewTracker(std::unique_ptr<RegionTracker> tracker, const IntensityModel& intensity, int reduction, MotionModel model,
              bool model_by_data, const std::optional<cv::Rect>& region,
              const std::optional<cv::Size>& image_size = std::nullopt);

  /// Takes in the next exposure. Never throws: what is wrong with it is the answer's fault.
  /// @param image as RegionTracker takes it; @param stamp_ns newer than those before
  /// @param training what else is to be learnt from it, now (there is no template) or by learn()
  const ViewAnswer& answer(const cv::Mat& image, std::int64_t stamp_ns,
                           const std::optional<Training>& training = std::nullopt);

  /// As answer(), of an exposure whose image cannot be read. @param fault why
  const ViewAnswer& answerUnreadable(const std::string& fault);

  /// Learns what answer() was last asked to learn, unless that has been done. @param image the same one
  /// @return why it could not; empty: it is learnt, or there was nothing to learn
  std::string learn(const cv::Mat& image);

  /// The next exposure is the first one, as of another run. The region to learn stays.
  void startAnew();

  /// Takes up the template of another tracker of the same detector. It counts as lost: there is no track before an
  /// exposure proves that it is there. With no template so far.
  /// @param image, stamp_ns that it was learnt on; @param wanted its wantedRegion(); @param usual its
  /// usualUnexplained(), which proves what is found
  /// @throws std::invalid_argument as RegionTracker::train, or if the image is of another size
  void takeUp(const cv::Mat& image, std::int64_t stamp_ns, const cv::Rect& wanted, const std::optional<double>& usual);
  /// As RecoveringTracker's.
  const std::optional<double>& usualUnexplained() const { return tracker_.usualUnexplained(); }

  bool trained() const { return tracker_.trained(); }
  /// That a template is learnt of while there is none.
  const std::optional<cv::Rect>& wantedRegion() const { return wanted_region_; }
  /// The template's: less than wanted where a part of that is outside the X-ray field.
  cv::Rect region() const { return tracker_.region(); }
  std::int64_t referenceStamp() const { return reference_stamp_ns_; }
  /// Of the last exposure that was tracked, as it was found.
  const TrackResult& lastTrack() const { return tracker_.result(); }

private:
  /// @throws std::invalid_argument if it is not
  void requireSize(const cv::Mat& image) const;
  void begin(std::int64_t stamp_ns, const std::optional<Training>& training);
  /// With what is known of the template.
  const ViewAnswer& finished();
  void answerUsable(const cv::Mat& image);
  void track(const cv::Mat& image);
  /// @return why the training asked for could not be done
  std::string serve(const cv::Mat& image);
  std::string serveAgain(const cv::Mat& image);
  /// @param anew stuck pixels and images before are forgotten. @return what is wrong with the region or the image
  std::string train(const cv::Mat& image, const cv::Rect& region, bool anew);

  RecoveringTracker tracker_;
  ExposureCheck check_;
  IntensityModel intensity_;
  MotionModel model_;
  bool model_by_data_;
  std::optional<cv::Size> image_size_;
  std::optional<cv::Rect> configured_region_;
  std::optional<cv::Rect> wanted_region_;
  std::int64_t reference_stamp_ns_ = 0;

  ViewAnswer answer_;
  bool was_found_ = false;  ///< in the exposure before
  // Of the last exposure.
  std::int64_t stamp_ns_ = 0;
  bool usable_ = false;  ///< it shows something new
  std::optional<Training> training_;
  std::optional<std::string> outcome_;  ///< of the training
};
}  // namespace xray_tracking
