#pragma once

#include <memory>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_hyperplane_tracker/region_tracker.h"

namespace xray_tracking
{
struct BinnedImage;

/// How a template is registered.
struct TemplateRegistrationOptions
{
  enum class Similarity
  {
    NORMALISED_MUTUAL_INFORMATION,
    GRADIENT_CORRELATION
  };

  Similarity similarity = Similarity::NORMALISED_MUTUAL_INFORMATION;
  MotionModel model = MotionModel::TRANSLATION;  ///< TRANSLATION or EUCLIDEAN
  /// Of the joint histogram, a side; 4..256. For mutual information.
  int bins = 32;
  /// Around the last place, tried out on a grid before the local search [px]; 1..200.
  double range = 30.0;
  /// Below this correlation, of what is sharp alone, the region is lost; 0..1.
  double min_correlation = 0.4;
  /// A lost region is found again above this correlation; min_correlation..1.
  double found_correlation = 0.5;

  /// @throws std::invalid_argument naming the option, its value and what was expected
  void validate() const;
};

/// Follows a region by intensity-based registration of its template to each image: the motion of greatest similarity,
/// over all of the region's pixels. Slower than HyperplaneTracker by orders of magnitude and without any training:
/// something to compare it with.
///
/// Values: attenuation, smoothed, without what is slow (the mean over a box of 17 px): soft tissue moves otherwise than
/// bone, and the sharper what is left, the less it draws the answer away. Coarse to fine, pixels binned by 4 and 2: on
/// the coarse level all displacements within `range` of the last place, then on each level the downhill simplex method
/// (Nelder and Mead 1965).
///
/// The covariance is the Cramer-Rao bound for the residual's variance, as if that was white noise: what the answers of
/// any method scatter by at least.
/// Correlation and covariance are of those pixels that are a linear function of the template's, without what lies over
/// a part of the region; DEGRADED where this is more than 15 %, lost where it is more than half. Not thread-safe.
class TemplateRegistration : public RegionTracker
{
public:
  /// @throws std::invalid_argument, see TemplateRegistrationOptions::validate
  explicit TemplateRegistration(const TemplateRegistrationOptions& options, const IntensityModel& intensity = {});
  ~TemplateRegistration() override;
  TemplateRegistration(TemplateRegistration&&) noexcept;
  TemplateRegistration& operator=(TemplateRegistration&&) noexcept;

  void train(const cv::Mat& image, const cv::Rect& region) override;
  void reset() override;
  bool trained() const override { return template_ != nullptr; }
  cv::Rect region() const override;
  const TrackResult& track(const cv::Mat& image) override;
  const TrackResult& trackFrom(const cv::Mat& image, const Eigen::Vector2d& displacement) override;
  void setLost() override { lost_ = true; }
  const TrackResult& result() const override { return result_; }

private:
  struct Template;

  const TrackResult& registerFrom(const cv::Mat& image, const Eigen::Vector3d& start);
  void judge(const BinnedImage& image, const Eigen::Vector3d& motion, const cv::Rect& whole);

  TemplateRegistrationOptions options_;
  IntensityModel intensity_;
  std::unique_ptr<Template> template_;
  Eigen::Vector3d last_good_ = Eigen::Vector3d::Zero();  ///< displacement [px], rotation [rad]
  bool lost_ = false;
  TrackResult result_;
};
}  // namespace xray_tracking
