#include <algorithm>
#include <cmath>
#include <fstream>
#include <functional>
#include <iterator>
#include <limits>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "dicom_samples.h"
#include "test_helpers.h"
#include "xray_tracking_core/sequence/sequence.h"

namespace xray_tracking
{
namespace
{
const Eigen::Vector2i kSize(6, 4);
const ProjectionGeometry kDetector = ProjectionGeometry::fromDescription(
    { "detector_a", kSize, { 0.4, 0.3 }, { 0, 0, -1000 }, { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 } });
const IntensityModel kCounts;
const IntensityModel kAttenuation{ IntensityModel::Kind::ATTENUATION, 0.0, {} };

/// A digital X-ray image as a detector exports it, written by hand.
DicomElements dicomElements(const cv::Mat& image)
{
  return {
    { { 8, 0x0016 }, { "UI", "1.2.840.10008.5.1.4.1.1.1.1" } },
    { { 8, 0x0018 }, { "UI", "1.2.3.4" } },
    { { 8, 0x0060 }, { "CS", "DX" } },
    { { 0x28, 0x0002 }, { "US", us(1) } },
    { { 0x28, 0x0004 }, { "CS", "MONOCHROME2" } },
    { { 0x28, 0x0010 }, { "US", us(image.rows) } },
    { { 0x28, 0x0011 }, { "US", us(image.cols) } },
    { { 0x28, 0x0100 }, { "US", us(8 * static_cast<int>(image.elemSize())) } },
    { { 0x28, 0x0101 }, { "US", us(8 * static_cast<int>(image.elemSize())) } },
    { { 0x28, 0x0102 }, { "US", us(8 * static_cast<int>(image.elemSize()) - 1) } },
    { { 0x28, 0x0103 }, { "US", us(image.depth() == CV_16S) } },
    { { 0x7FE0, 0x0010 },
      { image.elemSize() == 1 ? "OB" : "OW",
        std::string(reinterpret_cast<const char*>(image.data), image.total() * image.elemSize()) } },
  };
}

std::string dicomImage(const cv::Mat& image)
{
  return dicomFile(dicomElements(image));
}

/// An entry of a TIFF directory.
struct TiffEntry
{
  int tag;
  int bytes;  ///< a value: 2 or 4
  std::vector<std::uint32_t> values;
  std::uint32_t count = 0;  ///< of values elsewhere in the file, if not 0: then `values` has their place
};

/// One strip, without compression, written by hand.
/// @param pages entries but for those of the strip. @param pixels in the order of bytes that is asked for
std::string tiffFile(const std::vector<std::vector<TiffEntry>>& pages, const std::string& pixels,
                     bool big_endian = false)
{
  std::string file;
  const auto put = [&](std::uint32_t value, int bytes)
  {
    for (int i = 0; i < bytes; ++i)
    {
      file += static_cast<char>(value >> 8 * (big_endian ? bytes - 1 - i : i) & 0xFF);
    }
  };
  file = big_endian ? "MM" : "II";
  put(42, 2);
  put(static_cast<std::uint32_t>(8 + pixels.size()), 4);
  file += pixels;
  for (std::size_t page = 0; page < pages.size(); ++page)
  {
    std::vector<TiffEntry> entries = pages[page];
    entries.push_back({ 273, 4, { 8 } });
    entries.push_back({ 279, 4, { static_cast<std::uint32_t>(pixels.size()) } });
    std::sort(entries.begin(), entries.end(), [](const auto& a, const auto& b) { return a.tag < b.tag; });
    const std::size_t end = file.size() + 2 + 12 * entries.size() + 4;
    put(static_cast<std::uint32_t>(entries.size()), 2);
    for (const TiffEntry& entry : entries)
    {
      put(static_cast<std::uint32_t>(entry.tag), 2);
      put(entry.bytes == 2 ? 3 : 4, 2);
      put(entry.count > 0 ? entry.count : static_cast<std::uint32_t>(entry.values.size()), 4);
      const int bytes = entry.count > 0 ? 4 : entry.bytes;
      for (const std::uint32_t value : entry.values)
      {
        put(value, bytes);
      }
      file.append(4 - bytes * entry.values.size(), '\0');
    }
    put(page + 1 < pages.size() ? static_cast<std::uint32_t>(end) : 0, 4);
  }
  return file;
}

/// @param photometric 0: MinIsWhite; @param format 1: without sign, 2: with, 3: floating point
std::vector<TiffEntry> tiffPage(std::uint32_t bits, std::uint32_t format = 1, std::uint32_t photometric = 1)
{
  return { { 256, 4, { static_cast<std::uint32_t>(kSize.x()) } },
           { 257, 4, { static_cast<std::uint32_t>(kSize.y()) } },
           { 258, 2, { bits } },
           { 259, 2, { 1 } },
           { 262, 2, { photometric } },
           { 277, 2, { 1 } },
           { 278, 4, { static_cast<std::uint32_t>(kSize.y()) } },
           { 339, 2, { format } } };
}

std::string bytesOf(const cv::Mat& image, bool big_endian = false)
{
  std::string bytes(reinterpret_cast<const char*>(image.data), image.total() * image.elemSize());
  for (std::size_t n = 0; big_endian && n < bytes.size(); n += image.elemSize1())
  {
    std::reverse(bytes.begin() + static_cast<std::ptrdiff_t>(n),
                 bytes.begin() + static_cast<std::ptrdiff_t>(n + image.elemSize1()));
  }
  return bytes;
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
      expectSame(readXrayImage(folder.path(name), kDetector, kCounts), ramp(type));
    }
  }
  for (const int type : { CV_16UC1, CV_16SC1 })
  {
    folder.write("image.dcm", dicomImage(ramp(type)));
    expectSame(readXrayImage(folder.path("image.dcm"), kDetector, kCounts), ramp(type));
  }
}

TEST(XrayImage, RejectsOthers)
{
  const TemporaryFolder folder;
  const auto expectRejected = [&folder](const std::string& name, const std::vector<std::string>& parts)
  { expectError<std::runtime_error>([&] { readXrayImage(folder.path(name), kDetector, kCounts); }, parts); };
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
  folder.write("cut.dcm", dicom.substr(0, 250));  // within its header
  expectRejected("cut.dcm", { "cut.dcm", "truncated" });
  cv::Mat negative = ramp(CV_16SC1);
  negative.at<std::int16_t>(2, 2) = -7;
  folder.write("negative.dcm", dicomImage(negative));
  expectRejected("negative.dcm", { "negative.dcm", "-7", "65535" });

  cv::imwrite(folder.path("colour.png"), cv::Mat(4, 6, CV_8UC3, cv::Scalar(1, 2, 3)));
  expectRejected("colour.png", { "colour.png", "3 channels", "one channel" });
  cv::imwrite(folder.path("lossy.jpg"), ramp(CV_8UC1));
  expectRejected("lossy.jpg", { "lossy.jpg", "PNG, TIFF or DICOM" });
  folder.write("text.png", "not an image");
  expectRejected("text.png", { "text.png", "PNG, TIFF or DICOM" });
  folder.write("empty.png", "");
  expectRejected("empty.png", { "empty.png", "PNG, TIFF or DICOM" });
  cv::imwrite(folder.path("turned.png"), cv::Mat(6, 4, CV_16UC1, cv::Scalar(1)));
  expectRejected("turned.png", { "turned.png", "4 x 6", "6 x 4" });
  // What a header claims is judged before anything is allocated for it: decoded, they would be "truncated".
  std::string claim = content("turned.png");
  claim.replace(16, 8, std::string("\0\0\x4e\x20\0\0\x4e\x20", 8));
  folder.write("claim.png", claim);
  expectRejected("claim.png", { "claim.png", "20000 x 20000", "6 x 4" });
  folder.write("claim.png", claim.substr(0, 20));
  expectRejected("claim.png", { "claim.png", "truncated" });
  folder.write("claim.tif", tiffFile({ { { 256, 4, { 60000 } }, { 257, 4, { 60000 } }, { 258, 2, { 16 } } } }, "xx"));
  expectRejected("claim.tif", { "claim.tif", "60000 x 60000", "6 x 4" });
}

TEST(XrayImage, DicomAsTheStandardHasIt)
{
  const TemporaryFolder folder;
  const cv::Mat counts = cv::min(ramp(CV_16UC1) / 16, 4095);  // 12 bits
  cv::Mat shifted = 16 * counts + 7;
  const auto element = [](int group, int number, const std::string& vr, const std::string& value) {
    return [=](DicomElements& image) { image[{ group, number }] = { vr, value }; };
  };
  struct Case
  {
    const char* name;
    std::function<void(DicomElements&)> change;
    cv::Mat expected;
  };
  const std::vector<Case> cases{
    { "white on black, which is how it is displayed", element(0x28, 0x0004, "CS", "MONOCHROME1"), counts },
    { "12 bits in the upper ones",
      [&](DicomElements& image)
      {
        image[{ 0x28, 0x0101 }].second = us(12);
        image[{ 0x28, 0x0102 }].second = us(15);
        image[{ 0x7FE0, 0x0010 }].second = bytesOf(shifted);
      },
      counts },
    { "tiny slope", element(0x28, 0x1053, "DS", "2.1e-6"), counts },
    { "tiny slope, intercept of one step",
      [&](DicomElements& image)
      {
        image[{ 0x28, 0x1053 }] = { "DS", "2.0e-6" };
        image[{ 0x28, 0x1052 }] = { "DS", "2.0e-6" };
      },
      counts + 1 },
    { "slope and intercept",
      [&](DicomElements& image)
      {
        image[{ 0x28, 0x1053 }] = { "DS", "3" };
        image[{ 0x28, 0x1052 }] = { "DS", "50" };
      },
      3 * counts + 50 },
    { "turned round by its slope",
      [&](DicomElements& image)
      {
        image[{ 0x28, 0x1053 }] = { "DS", "-1" };
        image[{ 0x28, 0x1052 }] = { "DS", "4095" };
      },
      4095 - counts },
    { "linear in the counts", element(0x28, 0x1040, "CS", "LIN"), counts },
    { "the panel's pitch, and a patient's",
      [](DicomElements& image)
      {
        image[{ 0x18, 0x1164 }] = { "DS", "0.3\\0.4" };
        image[{ 0x28, 0x0030 }] = { "DS", "0.2\\0.27" };
      },
      counts },
    { "a window, which is for display", element(0x28, 0x1050, "DS", "100"), counts },
    { "one frame of one", element(0x28, 0x0008, "IS", "1"), counts },
  };
  for (const Case& one : cases)
  {
    SCOPED_TRACE(one.name);
    for (const bool big_endian : { false, true })
    {
      DicomElements image = dicomElements(counts);
      one.change(image);
      folder.write("image.dcm", dicomFile(image, big_endian));
      expectSame(readXrayImage(folder.path("image.dcm"), kDetector, kCounts), one.expected);
    }
  }
  folder.write("image.dcm", dicomImage(ramp(CV_8UC1)));
  expectSame(readXrayImage(folder.path("image.dcm"), kDetector, kCounts), ramp(CV_8UC1));
  DicomElements log = dicomElements(counts);
  log[{ 0x28, 0x1040 }] = { "CS", "LOG" };
  log[{ 0x28, 0x1041 }] = { "SS", us(-1) };
  folder.write("image.dcm", dicomFile(log));
  expectSame(readXrayImage(folder.path("image.dcm"), kDetector, kAttenuation), counts);

  struct Refused
  {
    std::function<void(DicomElements&)> change;
    IntensityModel intensity;
    std::vector<std::string> parts;
  };
  const std::vector<Refused> refused{
    { element(0x28, 0x1040, "CS", "LOG"), kCounts, { "PixelIntensityRelationship is LOG", "kind: counts" } },
    { element(0x28, 0x1040, "CS", "LIN"), kAttenuation, { "PixelIntensityRelationship is LIN", "kind: attenuation" } },
    { element(0x28, 0x1041, "SS", us(-1)), kCounts, { "PixelIntensityRelationshipSign is -1", "kind: counts" } },
    { element(0x28, 0x1041, "SS", us(1)), kAttenuation, { "PixelIntensityRelationshipSign is 1" } },
    { element(0x18, 0x1164, "DS", "0.6\\0.8"), kCounts, { "ImagerPixelSpacing is 0.6\\0.8", "detector_a is 0.4 0.3" } },
    { element(0x18, 0x1164, "DS", "0.4\\0.3"), kCounts, { "ImagerPixelSpacing is 0.4\\0.3" } },
    { element(0x28, 0x3000, "SQ", dicomItem({})), kCounts, { "ModalityLUTSequence" } },
    { element(0x28, 0x1053, "DS", "0"), kCounts, { "RescaleSlope is \"0\"" } },
    { element(0x28, 0x1053, "DS", "much"), kCounts, { "RescaleSlope is \"much\"" } },
    { element(0x28, 0x1052, "DS", "-70000"), kCounts, { "-70000", "expected 0 to 65535" } },
    { element(0x28, 0x0004, "CS", "PALETTE COLOR"), kCounts, { "PhotometricInterpretation is PALETTE COLOR" } },
    { [&](DicomElements& image)
      {
        image[{ 0x28, 0x0002 }].second = us(3);
        image[{ 0x28, 0x0004 }].second = "RGB";
        image[{ 0x7FE0, 0x0010 }].second = bytesOf(counts) + bytesOf(counts) + bytesOf(counts);
      },
      kCounts,
      { "PhotometricInterpretation is RGB", "SamplesPerPixel 3" } },
    { [&](DicomElements& image)
      {
        image[{ 0x28, 0x0008 }] = { "IS", "2" };
        image[{ 0x7FE0, 0x0010 }].second = bytesOf(counts) + bytesOf(counts);
      },
      kCounts,
      { "NumberOfFrames is 2" } },
    { [](DicomElements& image) {
       image.erase({ 0x7FE0, 0x0010 });
     },
      kCounts,
      { "no pixels" } },
  };
  for (const Refused& one : refused)
  {
    DicomElements image = dicomElements(counts);
    one.change(image);
    folder.write("image.dcm", dicomFile(image));
    std::vector<std::string> parts = one.parts;
    parts.push_back("image.dcm");
    expectError<std::runtime_error>([&] { readXrayImage(folder.path("image.dcm"), kDetector, one.intensity); }, parts);
  }
}

TEST(XrayImage, TiffAsItIsStored)
{
  const TemporaryFolder folder;
  const std::string path = folder.path("image.tif");
  for (const bool big_endian : { false, true })
  {
    for (const std::uint32_t photometric : { 0, 1 })
    {
      SCOPED_TRACE(testing::Message() << "big endian " << big_endian << ", photometric " << photometric);
      for (const int type : { CV_8UC1, CV_16UC1, CV_16SC1, CV_32SC1 })
      {
        const cv::Mat image = ramp(type);
        const auto bits = static_cast<std::uint32_t>(8 * image.elemSize());
        folder.write("image.tif",
                     tiffFile({ tiffPage(bits, type == CV_16SC1 || type == CV_32SC1 ? 2 : 1, photometric) },
                              bytesOf(image, big_endian), big_endian));
        expectSame(readXrayImage(path, kDetector, kCounts), image);
      }
    }
  }
  // 12 bits without gaps; 6 columns are 9 bytes.
  cv::Mat counts = cv::min(ramp(CV_16UC1) / 16, 4095);
  std::string packed;
  for (int n = 0; n < static_cast<int>(counts.total()); n += 2)
  {
    const int one = counts.ptr<std::uint16_t>()[n], other = counts.ptr<std::uint16_t>()[n + 1];
    packed += { static_cast<char>(one >> 4), static_cast<char>(one << 4 | other >> 8), static_cast<char>(other) };
  }
  folder.write("image.tif", tiffFile({ tiffPage(12) }, packed));
  expectSame(readXrayImage(path, kDetector, kCounts), counts);

  // Line integrals: noise below 0 behind air alone.
  cv::Mat integrals;
  counts.convertTo(integrals, CV_32F, 8.0 / 4096.0);
  integrals.at<float>(0, 0) = -0.02f;
  for (const int type : { CV_32FC1, CV_64FC1 })
  {
    cv::Mat image;
    integrals.convertTo(image, type);
    const std::string file =
        tiffFile({ tiffPage(static_cast<std::uint32_t>(8 * image.elemSize()), 3) }, bytesOf(image));
    folder.write("image.tif", file);
    expectSame(readXrayImage(path, kDetector, kAttenuation), 8 * counts);
    expectError<std::runtime_error>([&] { readXrayImage(path, kDetector, kCounts); }, { "image.tif", "counts" });
  }
  cv::Mat float_counts;
  counts.convertTo(float_counts, CV_32F);
  folder.write("image.tif", tiffFile({ tiffPage(32, 3) }, bytesOf(float_counts)));
  expectSame(readXrayImage(path, kDetector, kCounts), counts);
  expectError<std::runtime_error>([&] { readXrayImage(path, kDetector, kAttenuation); }, { "line integrals" });

  const auto expectRejected = [&](const std::string& file, const std::vector<std::string>& parts)
  {
    folder.write("image.tif", file);
    expectError<std::runtime_error>([&] { readXrayImage(path, kDetector, kAttenuation); }, parts);
  };
  integrals.at<float>(1, 1) = std::numeric_limits<float>::quiet_NaN();
  expectRejected(tiffFile({ tiffPage(32, 3) }, bytesOf(integrals)), { "image.tif", "not finite" });
  const std::string pixels = bytesOf(counts);
  expectRejected(tiffFile({ tiffPage(16), tiffPage(16), tiffPage(16) }, pixels),
                 { "image.tif", "3 pages, expected 1" });
  std::vector<TiffEntry> thumbnail = tiffPage(16);
  thumbnail.push_back({ 254, 4, { 1 } });
  folder.write("image.tif", tiffFile({ tiffPage(16), thumbnail }, pixels));
  expectSame(readXrayImage(path, kDetector, kCounts), counts);
  std::vector<TiffEntry> turned = tiffPage(16);
  turned.push_back({ 274, 2, { 3 } });
  expectRejected(tiffFile({ turned }, pixels), { "Orientation is 3" });
  std::vector<TiffEntry> palette = tiffPage(8, 1, 3);
  palette.push_back({ 320, 2, { 8 }, 3 * 256 });
  expectRejected(tiffFile({ palette }, std::string(2000, 'x')), { "PhotometricInterpretation is 3, a palette" });
  expectRejected(tiffFile({ tiffPage(64, 1) }, pixels), { "64 bit" });
  cv::Mat negative = ramp(CV_16SC1);
  negative.at<std::int16_t>(2, 2) = -7;
  expectRejected(tiffFile({ tiffPage(16, 2) }, bytesOf(negative)), { "-7", "0 to 65535" });
}

TEST(XrayImage, GreyValuesInColours)
{
  const TemporaryFolder folder;
  for (const int type : { CV_8UC1, CV_16UC1 })
  {
    const cv::Mat grey = ramp(type);
    const cv::Mat opaque(grey.size(), type, cv::Scalar(type == CV_8UC1 ? 255 : 65535));
    for (const std::vector<cv::Mat>& planes :
         { std::vector<cv::Mat>{ grey, grey, grey }, std::vector<cv::Mat>{ grey, grey, grey, opaque } })
    {
      cv::Mat image;
      cv::merge(planes, image);
      for (const char* name : { "image.png", "image.tif" })
      {
        cv::imwrite(folder.path(name), image);
        expectSame(readXrayImage(folder.path(name), kDetector, kCounts), grey);
      }
    }
    cv::Mat image;
    cv::merge(std::vector<cv::Mat>{ grey, grey, grey, opaque / 2 }, image);
    cv::imwrite(folder.path("image.png"), image);
    expectError<std::runtime_error>([&] { readXrayImage(folder.path("image.png"), kDetector, kCounts); }, { "alpha" });
  }
}
}  // namespace
}  // namespace xray_tracking
