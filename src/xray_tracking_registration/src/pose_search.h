#pragma once

#include <vector>

#include "descender.h"

namespace xray_tracking
{
/// A pose that an exhaustive search found worth a descent.
struct Place
{
  PosePair poses;
  double similarity;  ///< PoseSearch::similarity() there, or what the search's grid has of it
};

/// The neighbourhood to search.
struct SearchBounds
{
  double translation_mm;  ///< of the target's centre from the start
  double rotation_rad;    ///< from the start
};

/// Exhaustive search of a neighbourhood of a start, at coarse resolution and with both bodies as one.
///
/// Orientations are a lattice. A rendering of one serves all shifts: in each view it is slid over the X-ray image, and
/// the correlation at every translation in space is the mean over the views of what they have where it is projected to,
/// so that the views' peaks have to meet. What is compared are gradients, each over the root mean square of those
/// around it: so neither tone, saturation, metal nor the rim of an image intensifier outweighs the rest.
class PoseSearch
{
public:
  /// Keeps the addresses of run and bodies; prepares the images.
  PoseSearch(const Run& run, const Bodies& bodies, const Eigen::AlignedBox3d& target_box, const PosePair& start,
             const SearchBounds& bounds, Moving together);

  /// The most similar places, best first, each apart from the others; `count` at most. None if the run's control says
  /// stop.
  std::vector<Place> places(std::size_t count) const;

  /// Mean over the views of the correlation of normalised gradients, -1 to 1; 0 for a view in which less than half of
  /// the target can be seen.
  double similarity(const PosePair& poses) const;

  /// Root mean square distance over the target's box from which poses are places of their own [mm].
  double separation() const;

private:
  /// What renderings are slid over.
  struct Searched
  {
    cv::Mat gradients;                  ///< CV_32FC2, normalised
    cv::Mat energy;                     ///< their squared norms
    cv::Mat valid;                      ///< 1 or 0
    cv::Mat whole_energy, whole_valid;  ///< sums over the region, wherever it is slid to
  };
  struct View
  {
    const ProjectionGeometry* geometry;
    int bin;             ///< [px]
    double sigma;        ///< of what is around a gradient [bins]
    cv::Rect around;     ///< rendered at the start: the target's region with a border [bins of the panel]
    cv::Rect inside;     ///< the region without the border, in `around`
    cv::Point2d centre;  ///< projected at the start [bins]
    cv::Point searched;  ///< first bin of the image below [bins of the panel]
    Searched image;
    std::vector<cv::Point2f> projected;  ///< of every translation, where the region is slid to
  };
  struct Template
  {
    cv::Mat gradients;
    cv::Mat energy;
    cv::Mat valid;
    bool complete;  ///< all of it counts
  };
  struct Peak
  {
    std::size_t rotation;
    std::size_t translation;
    float similarity;
  };

  View makeView(const RegistrationView& view, const AttenuationImage& attenuation) const;
  Template render(const View& view, const PosePair& poses, const cv::Point& shift) const;
  static cv::Mat correlate(const Searched& image, const Template& drr);
  /// Of one orientation.
  std::vector<Peak> peaks(std::size_t rotation) const;
  PosePair pose(const Eigen::Vector3d& rotation, const Eigen::Vector3d& translation) const;

  const Run& run_;
  const Bodies& bodies_;
  Eigen::AlignedBox3d box_;
  PosePair start_;
  Moving together_;
  Eigen::Vector3d centre_;  ///< of the target at the start, room [mm]
  double step_;             ///< of the translations, and edge of the bins at the target [mm]
  int reach_;               ///< steps from the start along an axis, at most
  std::vector<int> index_;  ///< of the translation at every point of the cubic grid; -1 if out of bounds
  std::vector<Eigen::Vector3d> translations_;
  std::vector<Eigen::Vector3d> rotations_;
  std::vector<View> views_;
};
}  // namespace xray_tracking
