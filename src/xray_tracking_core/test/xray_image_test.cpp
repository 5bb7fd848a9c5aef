#include <fstream>
#include <iterator>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "test_helpers.h"
#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
namespace
{
const Eigen::Vector2i kSize(6, 4);

/// A data element of a DICOM file, explicit VR little endian.
std::string dicomElement(int group, int element, const std::string& vr, std::string value)
{
  const auto littleEndian = [](std::size_t number, int bytes)
  {
    std::string text;
    for (int i = 0; i < bytes; ++i)
    {
      text += static_cast<char>(number >> (8 * i) & 0xFF);
    }
    return text;
  };
  if (value.size() % 2 != 0)
  {
    value += vr == "UI" ? '\0' : ' ';
  }
  const bool is_long = vr == "OB" || vr == "OW";
  return littleEndian(group, 2) + littleEndian(element, 2) + vr + (is_long ? std::string(2, '\0') : "") +
         littleEndian(value.size(), is_long ? 4 : 2) + value;
}

/// A digital X-ray image as a detector exports it, written by hand.
std::string dicomImage(const cv::Mat& image)
{
  const std::string sop_class = "1.2.840.10008.5.1.4.1.1.1.1";
  const auto number = [](int value) {
    return std::string{ static_cast<char>(value & 0xFF), static_cast<char>(value >> 8) };
  };
  const std::string meta = dicomElement(2, 0x0001, "OB", std::string("\0\1", 2)) +
                           dicomElement(2, 0x0002, "UI", sop_class) + dicomElement(2, 0x0003, "UI", "1.2.3.4") +
                           dicomElement(2, 0x0010, "UI", "1.2.840.10008.1.2.1") +
                           dicomElement(2, 0x0012, "UI", "1.2.3.5");
  return std::string(128, '\0') + "DICM" +
         dicomElement(2, 0x0000, "UL", number(static_cast<int>(meta.size())) + std::string(2, '\0')) + meta +
         dicomElement(8, 0x0016, "UI", sop_class) + dicomElement(8, 0x0018, "UI", "1.2.3.4") +
         dicomElement(8, 0x0060, "CS", "DX") + dicomElement(0x28, 0x0002, "US", number(1)) +
         dicomElement(0x28, 0x0004, "CS", "MONOCHROME2") + dicomElement(0x28, 0x0010, "US", number(image.rows)) +
         dicomElement(0x28, 0x0011, "US", number(image.cols)) + dicomElement(0x28, 0x0100, "US", number(16)) +
         dicomElement(0x28, 0x0101, "US", number(16)) + dicomElement(0x28, 0x0102, "US", number(15)) +
         dicomElement(0x28, 0x0103, "US", number(image.type() == CV_16SC1)) +
         dicomElement(0x7FE0, 0x0010, "OW", std::string(reinterpret_cast<const char*>(image.data), 2 * image.total()));
}

cv::Mat ramp(int type)
{
  cv::Mat image(kSize.y(), kSize.x(), CV_16UC1);
  for (int i = 0; i < static_cast<int>(image.total()); ++i)
  {
    image.at<std::uint16_t>(i / kSize.x(), i % kSize.x()) = static_cast<std::uint16_t>(i * i);
  }
  image.at<std::uint16_t>(0, 1) = type == CV_16UC1 ? 65535 : 255;
  image.convertTo(image, type);
  return image;
}

void expectSame(const cv::Mat& image, const cv::Mat& expected)
{
  ASSERT_EQ(image.type(), CV_16UC1);
  ASSERT_EQ(image.size(), expected.size());
  cv::Mat values;
  expected.convertTo(values, CV_16U);
  EXPECT_EQ(cv::countNonZero(image != values), 0);
}

TEST(XrayImage, ReadsEveryKind)
{
  const TemporaryFolder folder;
  for (const int type : { CV_8UC1, CV_16UC1 })
  {
    for (const char* name : { "image.png", "image.tif" })
    {
      cv::imwrite(folder.path(name), ramp(type));
      expectSame(readXrayImage(folder.path(name), kSize), ramp(type));
    }
  }
  for (const int type : { CV_16UC1, CV_16SC1 })
  {
    folder.write("image.dcm", dicomImage(ramp(type)));
    expectSame(readXrayImage(folder.path("image.dcm"), kSize), ramp(type));
  }
}

TEST(XrayImage, RejectsOthers)
{
  const TemporaryFolder folder;
  const auto expectRejected = [&folder](const std::string& name, const std::vector<std::string>& parts)
  { expectError<std::runtime_error>([&] { readXrayImage(folder.path(name), kSize); }, parts); };
  const auto content = [&folder](const std::string& name)
  {
    std::ifstream file(folder.path(name), std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  };
  expectRejected("none.png", { "none.png", "missing" });
  expectRejected("", { "missing" });

  cv::Mat noise(kSize.y(), kSize.x(), CV_16UC1);
  cv::randu(noise, 0, 65535);
  for (const char* name : { "cut.png", "cut.tif" })
  {
    cv::imwrite(folder.path(name), noise);
    folder.write(name, content(name).substr(0, content(name).size() / 2));
    expectRejected(name, { name, "truncated" });
  }
  const std::string dicom = dicomImage(ramp(CV_16UC1));
  folder.write("cut.dcm", dicom.substr(0, dicom.size() - 10));
  expectRejected("cut.dcm", { "cut.dcm", "truncated" });
  cv::Mat negative = ramp(CV_16SC1);
  negative.at<std::int16_t>(2, 2) = -7;
  folder.write("negative.dcm", dicomImage(negative));
  expectRejected("negative.dcm", { "negative.dcm", "-7", "65535" });

  cv::imwrite(folder.path("colour.png"), cv::Mat(4, 6, CV_8UC3, cv::Scalar(1, 2, 3)));
  expectRejected("colour.png", { "colour.png", "3 channels", "one channel" });
  cv::imwrite(folder.path("float.tif"), cv::Mat(4, 6, CV_32FC1, cv::Scalar(1)));
  expectRejected("float.tif", { "float.tif", "32 bit" });
  cv::imwrite(folder.path("lossy.jpg"), ramp(CV_8UC1));
  expectRejected("lossy.jpg", { "lossy.jpg", "PNG, TIFF or DICOM" });
  folder.write("text.png", "not an image");
  expectRejected("text.png", { "text.png", "PNG, TIFF or DICOM" });
  folder.write("empty.png", "");
  expectRejected("empty.png", { "empty.png", "PNG, TIFF or DICOM" });
  cv::imwrite(folder.path("turned.png"), cv::Mat(6, 4, CV_16UC1, cv::Scalar(1)));
  expectRejected("turned.png", { "turned.png", "4 x 6", "6 x 4" });
}

}  // namespace
}  // namespace xray_tracking
