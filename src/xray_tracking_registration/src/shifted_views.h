#pragma once

#include <optional>
#include <vector>

#include "descender.h"

namespace xray_tracking
{
/// How the views at a pose compare with the same rendering elsewhere.
struct Distinctness
{
  double here = 0.0;   ///< mean correlation of the views at the pose, -1 to 1
  double rival = 0.0;  ///< the largest one elsewhere, more than 5 mm away
  double z = 0.0;      ///< of `here`, in standard deviations of what there is elsewhere above their mean
};

/// The views at a pose, and with the target shifted in space: every view's model is slid over its image, and the views'
/// correlations are put together where their shifts meet.
class ShiftedViews
{
public:
  /// @param views levels at the pose; without what lies around their regions in the images they cannot be slid
  /// @param models of the views at the pose, high-passed, CV_32FC1
  /// @param room_centre of the target at the pose
  /// @param reach of the shifts along the room's axes [mm]
  /// @throws std::invalid_argument naming the view that cannot be slid
  ShiftedViews(const Run& run, const std::vector<ViewLevel>& views, const std::vector<cv::Mat>& models,
               const Eigen::Vector3d& room_centre, double reach);

  /// Mean over the views of the correlation with the target shifted, -1 to 1; nothing where a view does not show
  /// enough.
  std::optional<double> correlation(const Eigen::Vector3d& shift) const;
  /// The same without a shift, as far as bins allow.
  double here() const;

private:
  struct View
  {
    cv::Mat correlation;                 ///< CV_32FC1 wherever the model is slid to; below -1 where it is not known
    cv::Point here;                      ///< where the model is at the pose
    Eigen::Matrix<double, 2, 3> shifts;  ///< by a shift of the target in the room [bins / mm]
  };

  static View slide(const RegistrationView& view, const AttenuationImage& attenuation, const ViewLevel& level,
                    const cv::Mat& model, const Eigen::Vector3d& room_centre, double reach);

  std::vector<View> views_;
};

/// How distinct a pose is, by shifts of up to 25 mm. What is right by chance is not much better than the best of many
/// other places, and no better the more of noise, tissue and other bodies there is to be like. All zero if a view
/// cannot be slid.
/// @param fine the views at the pose, as they were compared
/// @param room_centre of the target there
Distinctness distinctnessOf(const Run& run, const FineLevel& fine, const Eigen::Vector3d& room_centre);

/// The shift, of at most `reach` along the room's axes, with which the views are most alike; none if a view cannot be
/// slid [mm].
Eigen::Vector3d mostAlikeShift(const Run& run, const Bodies& bodies, const std::vector<ViewLevel>& views,
                               const PosePair& poses, double reach);
}  // namespace xray_tracking
