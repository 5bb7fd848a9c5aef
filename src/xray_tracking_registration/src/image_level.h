#pragma once

#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "bodies.h"
#include "xray_tracking_core/projection/pixel_grid.h"

namespace xray_tracking
{
/// Poses of the two bodies: room_from_patient of each.
struct PosePair
{
  RigidTransform target;
  RigidTransform rest;
};

/// What moves, and so the unknowns: twists about the target's centre in the room.
enum class Moving
{
  TARGET,    ///< 6: the rest, if there is one, stays
  TOGETHER,  ///< 6: both as one
  BOTH       ///< 12: the target's, then the rest's
};

/// At what resolution images are compared, in mm on the detector.
struct Resolution
{
  double bin_mm;       ///< edge of the bins
  double highpass_mm;  ///< standard deviation of the Gaussian that is taken away
};

/// What one view's model image says of a pose: normalised image and its derivatives by the unknowns.
struct ViewModel
{
  Eigen::VectorXf image;        ///< mean 0, norm 1
  Eigen::MatrixXf derivatives;  ///< pixels x unknowns
};

/// One view's image at one resolution, and its model.
class ViewLevel
{
public:
  static constexpr int kMinEdge = 5;  ///< fewest bins along a region's edge that can be compared

  /// @param attenuation whole image
  /// @param region pixels to compare [px]
  /// @param ends of the CT: what lies behind them does not count
  /// @throws std::invalid_argument naming the view: region outside the image or too small, constant image, a CT that
  ///         ends before half of the region is seen
  ViewLevel(const ProjectionGeometry& geometry, const cv::Mat& attenuation, const cv::Rect& region,
            const Resolution& resolution, const std::vector<PlacedEnds>& ends = {});

  const ProjectionGeometry& geometry() const { return *geometry_; }
  /// Measured image, high-passed, mean 0, norm 1; row by row.
  const Eigen::VectorXf& measured() const { return measured_; }
  const cv::Size& size() const { return size_; }
  /// 1 for pixels that count, 0 where the CT ends; row by row.
  const Eigen::VectorXf& valid() const { return valid_; }

  /// Model of the poses with its derivatives. A model without contrast has image 0.
  void model(const Bodies& bodies, const PosePair& poses, Moving moving, ViewModel& model) const;
  /// The high-passed model image alone, not normalised, CV_32FC1.
  void modelImage(const Bodies& bodies, const PosePair& poses, cv::Mat& image) const;
  /// Measured image, high-passed, not normalised, CV_32FC1.
  const cv::Mat& measuredImage() const { return measured_image_; }

private:
  void leaveOut(const std::vector<PlacedEnds>& ends);
  cv::Mat highPassed(const cv::Mat& image) const;
  /// Brings to mean 0 and norm 1 over the valid pixels; 0 if there is nothing but rounding. @return the norm
  float normalise(Eigen::VectorXf& image) const;

  const ProjectionGeometry* geometry_;
  PixelGrid grid_;  ///< with a border that the high-pass needs
  double sigma_;    ///< of the high-pass [bins]
  int border_;      ///< [bins]
  cv::Size size_;   ///< without the border [bins]
  cv::Mat measured_image_;
  Eigen::VectorXf measured_;
  cv::Mat inside_ct_;  ///< of the grid, as valid_; empty if all count
  Eigen::VectorXf valid_;
};
}  // namespace xray_tracking
