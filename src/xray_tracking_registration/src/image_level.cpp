#include "image_level.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include <opencv2/imgproc.hpp>

namespace xray_tracking
{
namespace
{
Eigen::VectorXf flattened(const cv::Mat& image)
{
  Eigen::VectorXf values(image.total());
  for (int row = 0; row < image.rows; ++row)
  {
    values.segment(row * image.cols, image.cols) = Eigen::Map<const Eigen::VectorXf>(image.ptr<float>(row), image.cols);
  }
  return values;
}
}  // namespace

ViewLevel::ViewLevel(const ProjectionGeometry& geometry, const cv::Mat& attenuation, const cv::Rect& region,
                     const Resolution& resolution, const std::vector<PlacedEnds>& ends)
  : geometry_(&geometry)
{
  const int bin = std::max(1, static_cast<int>(std::lround(resolution.bin_mm / geometry.pixelPitch().mean())));
  sigma_ = resolution.highpass_mm / (bin * geometry.pixelPitch().mean());
  // Beyond a few bins the border only has to tell the local mean roughly.
  border_ = static_cast<int>(std::ceil(2.0 * std::min(sigma_, 4.0))) + 1;
  const cv::Rect bins(0, 0, attenuation.cols / bin, attenuation.rows / bin);
  const cv::Point first(static_cast<int>(std::floor(double(region.x) / bin)) - border_,
                        static_cast<int>(std::floor(double(region.y) / bin)) - border_);
  const cv::Point end(static_cast<int>(std::ceil(double(region.x + region.width) / bin)) + border_,
                      static_cast<int>(std::ceil(double(region.y + region.height) / bin)) + border_);
  const cv::Rect bordered = cv::Rect(first, end) & bins;
  size_ = bordered.size() - cv::Size(2 * border_, 2 * border_);
  if (size_.width < kMinEdge || size_.height < kMinEdge)
  {
    throw std::invalid_argument("view " + geometry.name() + ": the region to compare has " +
                                std::to_string(region.width) + " x " + std::to_string(region.height) +
                                " pixels, too few of them in the image: expected at least " +
                                std::to_string(kMinEdge * bin) + " along either edge and some border");
  }
  grid_ = PixelGrid::binnedRegion({ bordered.x * bin, bordered.y * bin },
                                  { bordered.width * bin, bordered.height * bin }, bin);
  cv::Mat binned;
  cv::resize(attenuation(cv::Rect(bordered.x * bin, bordered.y * bin, bordered.width * bin, bordered.height * bin)),
             binned, bordered.size(), 0.0, 0.0, cv::INTER_AREA);
  leaveOut(ends);
  measured_image_ = highPassed(binned).clone();
  measured_ = flattened(measured_image_);
  if (normalise(measured_) == 0.0f)
  {
    throw std::invalid_argument("view " + geometry.name() + ": the image is constant in the region to compare");
  }
}

void ViewLevel::leaveOut(const std::vector<PlacedEnds>& ends)
{
  cv::Mat inside(grid_.size.y(), grid_.size.x(), CV_32FC1, 1.0f);
  for (const PlacedEnds& placed : ends)
  {
    const RigidTransform ct_from_room = placed.room_from_ct.inverse();
    for (int row = 0; row < inside.rows; ++row)
    {
      for (int column = 0; column < inside.cols; ++column)
      {
        const Ray ray = geometry_->backProject(grid_.first + Eigen::Vector2d(column, row).cwiseProduct(grid_.step));
        if (placed.ends.cut({ ct_from_room * ray.source, ct_from_room.linear() * ray.direction }))
        {
          inside.at<float>(row, column) = 0.0f;
        }
      }
    }
  }
  // The pose is not the final one, and a bin's other rays are to be inside too.
  cv::erode(inside, inside, cv::Mat(), cv::Point(-1, -1), 2, cv::BORDER_REFLECT);
  valid_ = flattened(inside(cv::Rect(border_, border_, size_.width, size_.height)));
  if (valid_.mean() < 0.5f)
  {
    throw std::invalid_argument("view " + geometry_->name() + ": the CT ends inside the region to compare, " +
                                std::to_string(static_cast<int>(100.0f * valid_.mean())) +
                                " % of it are left: expected 50 % or more");
  }
  if (cv::countNonZero(inside) < static_cast<int>(inside.total()))
  {
    inside_ct_ = inside;
  }
}

cv::Mat ViewLevel::highPassed(const cv::Mat& image) const
{
  const cv::Rect inside(border_, border_, size_.width, size_.height);
  const auto blurred = [&](const cv::Mat& sharp)
  {
    cv::Mat smooth;
    cv::GaussianBlur(sharp, smooth, cv::Size(), sigma_, sigma_, cv::BORDER_REFLECT);
    return cv::Mat(smooth(inside));
  };
  if (inside_ct_.empty())
  {
    return image(inside) - blurred(image);
  }
  // The local mean of what counts alone.
  cv::Mat counts;
  cv::merge(std::vector<cv::Mat>(image.channels(), inside_ct_), counts);
  cv::Mat shares = blurred(counts);
  cv::max(shares, 1e-3, shares);
  return (image(inside) - blurred(image.mul(counts)).mul(1.0 / shares)).mul(counts(inside));
}

float ViewLevel::normalise(Eigen::VectorXf& image) const
{
  const float mean = image.dot(valid_) / valid_.sum();
  image = (image.array() - mean) * valid_.array();
  const float norm = image.norm();
  if (!(norm > 1e-6f * std::sqrt(static_cast<float>(image.size()))))
  {
    image.setZero();
    return 0.0f;
  }
  image /= norm;
  return norm;
}

void ViewLevel::modelImage(const Bodies& bodies, const PosePair& poses, cv::Mat& image) const
{
  bodies.target->render(*geometry_, grid_, poses.target, poses.target * bodies.centre, image);
  cv::Mat rest;
  bodies.rest->render(*geometry_, grid_, poses.rest, poses.target * bodies.centre, rest);
  image += rest;
  image = highPassed(image);
}

void ViewLevel::model(const Bodies& bodies, const PosePair& poses, Moving moving, ViewModel& model) const
{
  cv::Mat image;
  std::array<cv::Mat, 2> derivatives;
  const Eigen::Vector3d centre = poses.target * bodies.centre;
  bodies.target->renderWithDerivatives(*geometry_, grid_, poses.target, centre, image, derivatives[0]);
  cv::Mat rest;
  if (moving != Moving::TARGET)
  {
    bodies.rest->renderWithDerivatives(*geometry_, grid_, poses.rest, centre, rest, derivatives[1]);
  }
  else
  {
    bodies.rest->render(*geometry_, grid_, poses.rest, centre, rest);
  }
  image += rest;
  if (moving == Moving::TOGETHER)
  {
    derivatives[0] += derivatives[1];
  }
  const int twists = moving == Moving::BOTH ? 2 : 1;
  model.image = flattened(highPassed(image));
  const auto pixels = static_cast<int>(model.image.size());
  model.derivatives.resize(pixels, 6 * twists);
  for (int body = 0; body < twists; ++body)
  {
    const cv::Mat passed = highPassed(derivatives[body]);
    for (int row = 0; row < size_.height; ++row)
    {
      using Rows = Eigen::Matrix<float, Eigen::Dynamic, 6, Eigen::RowMajor>;
      model.derivatives.block(row * size_.width, 6 * body, size_.width, 6) =
          Eigen::Map<const Rows>(passed.ptr<float>(row), size_.width, 6);
    }
  }
  const float norm = normalise(model.image);
  if (norm == 0.0f)
  {
    model.derivatives.setZero();
    return;
  }
  // Derivative of (I - mean(I)) / |I - mean(I)|: what lies along the image itself is taken away.
  for (int n = 0; n < model.derivatives.cols(); ++n)
  {
    auto column = model.derivatives.col(n);
    column.array() -= column.dot(valid_) / valid_.sum() * valid_.array();
    column = (column - model.image * model.image.dot(column)) / norm;
  }
}
}  // namespace xray_tracking
