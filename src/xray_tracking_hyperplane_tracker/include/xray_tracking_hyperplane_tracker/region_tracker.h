#pragma once

#include <stdexcept>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Motions of a region within the image; the number of parameters.
enum class MotionModel
{
  TRANSLATION = 2,
  EUCLIDEAN = 3,   ///< and rotation
  SIMILARITY = 4,  ///< and scale
  AFFINE = 6       ///< and anisotropic scale and shear
};

/// What was found in one image.
struct TrackResult
{
  enum class Status
  {
    TRACKED,          ///< the warp and its covariance are valid
    DEGRADED,         ///< so are these, but much of the region does not look like the template
    LOW_CORRELATION,  ///< what was found does not look like the template
    DIVERGED,         ///< the search did not settle
    OUT_OF_IMAGE      ///< more than a quarter of the template lies outside the image
  };

  Status status = Status::TRACKED;
  /// Where the region's centre is, less where it was in the template's image [px].
  Eigen::Vector2d displacement = Eigen::Vector2d::Zero();
  /// What was at x is now at centre + displacement + linear (x - centre), with the region's centre in the template's
  /// image; the identity for translations.
  Eigen::Matrix2d linear = Eigen::Matrix2d::Identity();
  /// Of (displacement x, y, linear 11, 12, 21, 22) [px and 1]; zero where the model does not let a parameter move.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  double correlation = 0.0;  ///< of the template and what was found, both without slow shading; -1..1
  double quality = 0.0;      ///< the correlation times the share of the region that it was found in; 0..1
  int iterations = 0;        ///< steps of the search, all levels

  bool found() const { return status == Status::TRACKED || status == Status::DEGRADED; }
};

/// Whether a rotation has been measured, three standard deviations away from none; for the Euclidean model.
bool tellsRotation(const TrackResult& result);

/// What a translation is of a result: for a target that is not seen to turn, whose rotation would only be an error.
TrackResult withoutLinearPart(TrackResult result);

/// Follows a region that was learnt in one image through others of the same detector.
class RegionTracker
{
public:
  virtual ~RegionTracker() = default;

  /// Learns a new template; the displacement starts again at zero.
  /// @param image CV_8UC1 or CV_16UC1; @param region [px], inside the image, 16 px or more in both directions
  /// @throws std::invalid_argument saying what is wrong with the image or the region; an earlier template stays.
  virtual void train(const cv::Mat& image, const cv::Rect& region) = 0;

  /// Learns anew, from an image in which the region is found, what may be learnt from more than the first; the
  /// displacement goes on. @return whether the region was found; else nothing is learnt
  /// @throws std::logic_error where the tracker has nothing of the kind
  virtual bool retrain(const cv::Mat& /*image*/)
  {
    throw std::logic_error("the tracker does not learn from more than the first exposure");
  }

  /// Forgets the template.
  virtual void reset() = 0;

  virtual bool trained() const = 0;
  /// The template's region in its image; empty if there is no template.
  virtual cv::Rect region() const = 0;

  /// Finds the template. @param image of the template's size and type
  /// @throws std::invalid_argument naming both sizes and types if they differ; std::logic_error without a template
  virtual const TrackResult& track(const cv::Mat& image) = 0;

  /// As track(), from another start than the last good place, for a search of the whole image (RegionSearch) or a
  /// prediction. Where the template is not found, the last good place and whether it counts as lost are as before.
  /// @param displacement of the region's centre, to within about 10 px: what is farther away, as a neighbouring
  /// vertebra
  ///        is, is not looked at; the linear part starts as the identity
  virtual const TrackResult& trackFrom(const cv::Mat& image, const Eigen::Vector2d& displacement) = 0;

  /// The region counts as lost until it is found, by the threshold of what is lost.
  virtual void setLost() = 0;

  /// The last result of track() or trackFrom(); zero displacement after training.
  virtual const TrackResult& result() const = 0;
};
}  // namespace xray_tracking
