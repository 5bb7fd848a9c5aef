#pragma once

#include <memory>
#include <string>

#include <sensor_msgs/Image.h>
#include <opencv2/core.hpp>

#include "grey_scale.h"
#include "view_mapping.h"

namespace xray_tracking
{
/// How a rendering of the CT is laid over a radiograph.
enum class Overlay
{
  NONE,
  BLEND,         ///< both, by their share
  EDGES,         ///< the rendering's edges upon the radiograph
  CHECKERBOARD,  ///< one beside the other
  DIFFERENCE     ///< brought to the same mean and contrast; mid grey where they are alike
};

/// Line integrals of the CT at a grid of points on a panel.
struct Rendering
{
  cv::Mat line_integrals;  ///< CV_32FC1
  Eigen::Vector2d first;   ///< of the grid [px]
  double step = 1.0;       ///< [px]
};

/// What is to be seen.
struct PictureRequest
{
  sensor_msgs::ImageConstPtr image;
  bool automatic = true;  ///< `window` is the image's own
  GreyWindow window;
  bool inverted = false;
  bool counts = true;  ///< pixel values are counts, with dark bone; else attenuation
  ViewMapping mapping;
  cv::Size size;  ///< of the picture, screen pixels
  Overlay overlay = Overlay::NONE;
  double share = 0.5;                          ///< of the overlay, 0 to 1
  std::shared_ptr<const Rendering> rendering;  ///< of the overlay; may be null
};

/// What is seen: the widget's whole area.
struct Picture
{
  cv::Mat colours;  ///< CV_8UC4, blue first, of the requested size; empty if there is a fault
  std::string fault;
  PictureRequest request;
  GreyWindow window;     ///< that was used
  cv::Mat pixels;        ///< of the image; as long as `request` keeps the image
  double largest = 0.0;  ///< of the pixel values
};

/// Makes pictures of radiographs for the screen. Keeps what the next picture can use; one thread at a time.
class PictureMaker
{
public:
  Picture make(const PictureRequest& request);

private:
  cv::Mat overlaid(const PictureRequest& request, const cv::Mat& grey) const;

  WindowFollower follower_;
  sensor_msgs::ImageConstPtr last_;  ///< that the follower has seen
  GreyWindow last_window_;
  double last_largest_ = 0.0;
  GreyScale scale_;
};
}  // namespace xray_tracking
