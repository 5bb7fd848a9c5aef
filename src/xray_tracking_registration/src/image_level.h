#pragma once

#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "bodies.h"
#include "pixel_rows.h"
#include "xray_tracking_core/projection/pixel_grid.h"
#include "xray_tracking_registration/attenuation_image.h"

namespace xray_tracking
{
/// Poses of the two bodies: room_from_patient of each; and how the views' attenuation saturates.
///
/// What the saturation k is: RegistrationView::saturation.
struct PosePair
{
  PosePair(const RigidTransform& room_from_target, const RigidTransform& room_from_rest)
    : target(room_from_target), rest(room_from_rest)
  {
  }
  PosePair() = default;

  double saturationOf(std::size_t view) const { return view < saturation.size() ? saturation[view] : kUsualSaturation; }

  RigidTransform target = RigidTransform::Identity();
  RigidTransform rest = RigidTransform::Identity();
  std::vector<double> saturation;  ///< k, one a view; the usual one where there is none
};

/// What moves, and so the unknowns: twists about the target's centre in the room.
enum class Moving
{
  TARGET,    ///< 6: the rest, if there is one, stays
  TOGETHER,  ///< 6: both as one
  BOTH       ///< 12: the target's, then the rest's
};

/// At what resolution images are compared [mm], here at the target, in ViewLevel on the panel.
struct Resolution
{
  double bin_mm;           ///< edge of the bins
  double highpass_mm;      ///< standard deviation of the Gaussian that is taken away
  double around_mm = 0.0;  ///< how far around the region the image is laid out, too
};

/// Takes the local mean away where an image counts.
class HighPass
{
public:
  HighPass() = default;
  /// @param counts of images with their border, CV_32FC1: 1 for what counts, else 0
  /// @param border that what comes out does not have [pixels]
  HighPass(const RunningBlur& blur, const cv::Mat& counts, int border);

  const cv::Mat& counts() const { return counts_; }
  /// @param image CV_32FC1 with its border @return without it, 0 for what does not count
  cv::Mat operator()(const cv::Mat& image) const;
  /// The same with all numbers of a pixel. @param rows with border, times what counts
  PixelRows operator()(const PixelRows& rows) const;

private:
  RunningBlur blur_{ 1.0 };
  cv::Mat counts_;
  cv::Mat counted_inverse_;  ///< the same by the share of what counts about a pixel
  cv::Rect inner_;
};

/// What is measured in and around a region, whether the CT ends there or not.
struct Surroundings
{
  cv::Mat image;     ///< high-passed, CV_32FC1
  cv::Mat counts;    ///< 1 for bins that count, else 0, CV_32FC1; empty if all do
  cv::Point region;  ///< its first bin
};

/// The rest of the body as it was last rendered, to be followed from there to first order. Never written to again, as
/// models share it.
struct RestRendering
{
  cv::Mat line_integrals;  ///< empty if there is none
  cv::Mat derivatives;     ///< by twists about `room_centre`
  RigidTransform room_from_rest = RigidTransform::Identity();
  Eigen::Vector3d room_centre = Eigen::Vector3d::Zero();

  /// Whether the first order does for this pose.
  bool reaches(const RigidTransform& other_room_from_rest) const;
  /// Line integrals there.
  cv::Mat at(const RigidTransform& other_room_from_rest) const;
};

/// What one view's model image says of a pose: the image, times its correlation with the measured one, as what is left
/// is noise, and its derivatives.
struct ViewModel
{
  Eigen::VectorXf image;    ///< mean 0, norm as the similarity
  PixelRows derivatives;    ///< by the twists, then by the view's saturation, then zeros
  int twists = 0;           ///< 6 or 12
  double similarity = 0.0;  ///< correlation coefficient with the measured image
  cv::Mat rest;             ///< line integrals of the rest of the body, of the level's grid
  RestRendering rendered;   ///< what these follow from, where it moves by itself
};

/// One view's image at one resolution, and its model.
class ViewLevel
{
public:
  static constexpr int kMinEdge = 5;  ///< fewest bins along a region's edge that can be compared

  /// @param attenuation whole image
  /// @param usable CV_8UC1 of the image's size, 0 for pixels that do not count; empty: all do
  /// @param region pixels to compare [px]
  /// @param resolution on the panel
  /// @param ends of the CT: what lies behind them does not count
  /// @throws std::invalid_argument naming the view: region outside the image or too small, constant image, less than
  ///         half of the region usable and inside the CT
  ViewLevel(const ProjectionGeometry& geometry, const AttenuationImage& attenuation, const cv::Mat& usable,
            const cv::Rect& region, const Resolution& resolution, const std::vector<PlacedEnds>& ends = {});

  const ProjectionGeometry& geometry() const { return *geometry_; }
  /// Measured image, high-passed, mean 0, norm 1; row by row.
  const Eigen::VectorXf& measured() const { return measured_; }
  const cv::Size& size() const { return size_; }
  double bin() const { return grid_.step.x(); }  ///< edge of the bins [px]
  /// 1 for pixels that count, 0 for unusable ones and where the CT ends; row by row.
  const Eigen::VectorXf& valid() const { return valid_; }

  /// Pixels that stand for all that count; none if none does.
  const std::vector<int>& sample() const { return sample_; }

  /// Model of the poses with its derivatives. A model without contrast has image 0.
  /// @param model in: a rendering of the rest from which it may be followed, or none; out
  void model(const Bodies& bodies, const PosePair& poses, double saturation, Moving moving, ViewModel& model) const;
  /// Moves a model by a small step of its twists and its saturation, to first order.
  void move(const Eigen::VectorXf& step, ViewModel& model) const;
  /// The high-passed model image alone, not normalised, CV_32FC1.
  void modelImage(const Bodies& bodies, const PosePair& poses, double saturation, cv::Mat& image) const;
  /// Correlation coefficient with the poses' model, -1 to 1.
  double similarity(const Bodies& bodies, const PosePair& poses, double saturation) const;
  /// The same with the target elsewhere and the rest where a model has it.
  double similarityAside(const Bodies& bodies, const RigidTransform& room_from_target, const ViewModel& model,
                         double saturation) const;
  /// Measured image, high-passed, not normalised, CV_32FC1.
  const cv::Mat& measuredImage() const { return measured_image_; }
  /// As far around the region as the image is laid out, for a region that is compared alike.
  Surroundings surroundings() const;

private:
  /// @param rest line integrals of the rest, of the grid
  void modelImage(const Bodies& bodies, const RigidTransform& room_from_target, const cv::Mat& rest, double saturation,
                  cv::Mat& image) const;
  /// @param image high-passed model image
  double similarityTo(const cv::Mat& image) const;
  /// @param usable of the grid, CV_32FC1, share of every bin; empty: all
  void leaveOut(const cv::Mat& usable, const std::vector<PlacedEnds>& ends);
  /// Brings to mean 0 and norm 1 over the valid pixels; 0 if there is nothing but rounding. @return the norm
  float normalise(Eigen::VectorXf& image) const;

  const ProjectionGeometry* geometry_;
  PixelGrid grid_;            ///< with a border that the high-pass needs
  RunningBlur blur_;          ///< what the high-pass takes away
  int border_;                ///< [bins]
  cv::Size size_;             ///< without the border [bins]
  AttenuationBins laid_out_;  ///< of the grid and around it
  cv::Point grid_in_it_;      ///< the grid's first bin
  HighPass high_pass_;
  cv::Mat measured_image_;
  Eigen::VectorXf measured_;
  Eigen::VectorXf valid_;
  std::vector<int> sample_;
};
}  // namespace xray_tracking
