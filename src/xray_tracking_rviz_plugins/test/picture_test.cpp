#include "picture.h"

#include <gtest/gtest.h>
#include <boost/make_shared.hpp>

namespace xray_tracking
{
namespace
{
constexpr int kSize = 400;
const cv::Rect kSquare(240, 80, 40, 60);

/// Bright, with a dark square.
PictureRequest requestOf(int value, int square)
{
  auto image = boost::make_shared<sensor_msgs::Image>();
  image->encoding = "mono16";
  image->width = image->height = kSize;
  image->step = 2 * kSize;
  image->data.resize(std::size_t{ 2 } * kSize * kSize);
  cv::Mat pixels(kSize, kSize, CV_16UC1, image->data.data());
  pixels.setTo(value);
  pixels(kSquare).setTo(square);
  PictureRequest request;
  request.image = image;
  request.automatic = false;
  request.window = { 100.0, 50000.0, true };
  request.size = { 300, 500 };
  request.mapping = ViewMapping::fit({ kSize, kSize }, request.size);
  return request;
}

/// Blue at where a pixel coordinate is seen.
int at(const Picture& picture, double u, double v)
{
  const Eigen::Vector2d widget = picture.request.mapping.toWidget({ u, v });
  return picture.colours.at<cv::Vec4b>(static_cast<int>(std::floor(widget.y())),
                                       static_cast<int>(std::floor(widget.x())))[0];
}

TEST(Picture, ShowsPixelsWhereTheMappingSays)
{
  PictureMaker maker;
  PictureRequest request = requestOf(40000, 200);
  for (const double zoom : { 0.3, 0.5, 1.0, 3.0, 20.0 })
  {
    request.mapping = ViewMapping::fit({ kSize, kSize }, request.size).zoomed(zoom, { 160.0, 130.0 });
    // The square's lower right corner in the middle.
    const Eigen::Vector2d corner(kSquare.br().x - 0.5, kSquare.br().y - 0.5);
    request.mapping = request.mapping.moved(Eigen::Vector2d(150.0, 250.0) - request.mapping.toWidget(corner));
    const Picture picture = maker.make(request);
    ASSERT_TRUE(picture.fault.empty()) << picture.fault;
    ASSERT_EQ(picture.colours.size(), request.size);
    const double away = 2.5 / request.mapping.scale;  // screen pixels, as an edge is as wide as a pixel of either
    EXPECT_LT(at(picture, corner.x() - away, corner.y() - away), 60) << zoom;
    EXPECT_GT(at(picture, corner.x() + away, corner.y() - away), 200) << zoom;
    EXPECT_GT(at(picture, corner.x() - away, corner.y() + away), 200) << zoom;
  }
}

TEST(Picture, IsBareOutsideTheImage)
{
  const Picture picture = PictureMaker().make(requestOf(40000, 200));
  EXPECT_EQ(picture.colours.at<cv::Vec4b>(20, 150), cv::Vec4b(0x1a, 0x15, 0x12, 0xff));
  EXPECT_GT(at(picture, 10, 10), 200);
}

/// The rendering's square lies on the radiograph's if its grid is taken as it is meant.
TEST(Picture, LaysTheRenderingWhereItBelongs)
{
  PictureRequest request = requestOf(40000, 2000);
  auto rendering = std::make_shared<Rendering>();
  rendering->step = 4.0;
  rendering->first = { 1.5, 1.5 };  // bins of 4 x 4 pixels
  rendering->line_integrals = cv::Mat(100, 100, CV_32FC1, cv::Scalar(0.2));
  rendering->line_integrals(cv::Rect(kSquare.x / 4, kSquare.y / 4, kSquare.width / 4, kSquare.height / 4)).setTo(3.0);
  request.rendering = rendering;
  const Eigen::Vector2d middle(kSquare.x + 20, kSquare.y + 30);

  request.overlay = Overlay::BLEND;
  request.share = 1.0;
  PictureMaker maker;
  Picture picture = maker.make(request);
  ASSERT_TRUE(picture.fault.empty()) << picture.fault;
  EXPECT_LT(at(picture, middle.x(), middle.y()), 60);
  EXPECT_GT(at(picture, kSquare.x - 6, middle.y()), 200);
  EXPECT_LT(at(picture, kSquare.x + 6, middle.y()), 60);
  EXPECT_GT(at(picture, kSquare.br().x + 6, middle.y()), 200);
  EXPECT_GT(at(picture, middle.x(), kSquare.y - 6), 200);
  EXPECT_GT(at(picture, middle.x(), kSquare.br().y + 6), 200);

  // Alike but for the edges: mid grey.
  request.overlay = Overlay::DIFFERENCE;
  picture = maker.make(request);
  EXPECT_NEAR(at(picture, middle.x(), middle.y()), 128, 12);
  EXPECT_NEAR(at(picture, 60, 300), 128, 12);

  // Orange at the square's border and nowhere else.
  request.overlay = Overlay::EDGES;
  picture = maker.make(request);
  int nearest = 1000;
  for (int row = 0; row < picture.colours.rows; ++row)
  {
    for (int column = 0; column < picture.colours.cols; ++column)
    {
      const cv::Vec4b colour = picture.colours.at<cv::Vec4b>(row, column);
      if (colour[2] != colour[0] && colour != cv::Vec4b(0x1a, 0x15, 0x12, 0xff))
      {
        const Eigen::Vector2d pixel = request.mapping.toPixel({ column + 0.5, row + 0.5 });
        const double dx = std::min(std::abs(pixel.x() - kSquare.x), std::abs(pixel.x() - kSquare.br().x));
        const double dy = std::min(std::abs(pixel.y() - kSquare.y), std::abs(pixel.y() - kSquare.br().y));
        EXPECT_LT(std::min(dx, dy), 12.0) << pixel.transpose();
        nearest = std::min(nearest, static_cast<int>(std::min(dx, dy)));
      }
    }
  }
  EXPECT_LT(nearest, 4);

  // Bright bone where attenuation is shown, or counts inverted.
  request.overlay = Overlay::BLEND;
  request.inverted = true;
  EXPECT_GT(at(maker.make(request), middle.x(), middle.y()), 200);
}

TEST(Picture, SaysWhatIsWrong)
{
  PictureMaker maker;
  EXPECT_FALSE(maker.make(PictureRequest()).fault.empty());
  PictureRequest request = requestOf(40000, 200);
  auto colours = boost::make_shared<sensor_msgs::Image>(*request.image);
  colours->encoding = "bgr8";
  request.image = colours;
  EXPECT_NE(maker.make(request).fault.find("bgr8"), std::string::npos);
  EXPECT_TRUE(maker.make(requestOf(40000, 200)).fault.empty());
}
}  // namespace
}  // namespace xray_tracking
