#include "run_pictures.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <stdexcept>

#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "xray_tracking_core/image/attenuation.h"

namespace xray_tracking
{
namespace
{
constexpr int kPictureSize = 420;           // columns, of what a page shows well
constexpr double kAround = 0.35;            // of the target's size, on every side
const cv::Scalar kEdge(30, 170, 255, 255);  // BGRA

/// Frames by what they are shown for.
std::map<std::size_t, std::string> chosenFrames(const ExposureSource& source, const MethodResult& method)
{
  std::map<std::size_t, std::string> chosen;
  const auto choose = [&chosen](std::size_t frame, const std::string& why)
  { chosen[frame] += (chosen[frame].empty() ? "" : ", ") + why; };
  const std::size_t last = source.stamps_ns.size() - 1;
  choose(0, "first");
  choose(last / 2, "middle");
  choose(last, "last");
  double largest = -1.0;
  std::size_t worst = 0;
  for (std::size_t k = 1; k < method.frames.size() && !source.gold_standard.empty(); ++k)
  {
    if (method.frames[k].status == FrameStatus::OK)
    {
      const double error =
          targetRegistrationError(method.frames[k].room_from_patient, source.gold_standard[k], source.setup.target_box);
      worst = error > largest ? k : worst;
      largest = std::max(largest, error);
    }
  }
  if (largest >= 0.0)
  {
    choose(worst, "worst");
  }
  return chosen;
}

/// What is seen of the target, and around it; of the whole image where the target is not seen.
cv::Rect cropAround(const TreatmentSetup& setup, const ProjectionGeometry& detector, const RigidTransform& pose)
{
  TreatmentSetup there = setup;
  there.room_from_patient = pose;
  const cv::Rect image(0, 0, detector.imageSize().x(), detector.imageSize().y());
  const cv::Rect seen = projectedTargetRegion(there, detector);
  if (seen.empty())
  {
    return image;
  }
  const int half = static_cast<int>(std::max(seen.width, seen.height) * (0.5 + kAround));
  const cv::Point centre = (seen.tl() + seen.br()) / 2;
  return cv::Rect(centre.x - half, centre.y - half, 2 * half, 2 * half) & image;
}

cv::Mat shrunk(const cv::Mat& image)
{
  const double scale = std::min(1.0, static_cast<double>(kPictureSize) / image.cols);
  cv::Mat small;
  cv::resize(image, small, {}, scale, scale, cv::INTER_AREA);
  return small;
}

/// Grey values of an image of attenuation, its darkest and brightest hundredth clipped.
cv::Mat tones(const cv::Mat& attenuation)
{
  cv::Mat sorted = attenuation.reshape(0, 1).clone();
  cv::patchNaNs(sorted);
  std::sort(sorted.begin<float>(), sorted.end<float>());
  const float low = sorted.at<float>(static_cast<int>(0.01 * (sorted.cols - 1)));
  const float high = sorted.at<float>(static_cast<int>(0.99 * (sorted.cols - 1)));
  cv::Mat grey;
  const double scale = 255.0 / std::max(1e-6F, high - low);
  attenuation.convertTo(grey, CV_8U, scale, -scale * low);
  return grey;
}

/// As tones(), with the contrast of each neighbourhood: a collimator or air beside the patient would take all of it.
cv::Mat localTones(const cv::Mat& attenuation)
{
  cv::Mat grey;
  cv::createCLAHE(3.0, { 6, 6 })->apply(tones(attenuation), grey);
  return grey;
}

/// Edges of a DRR, transparent elsewhere.
cv::Mat edgesOf(const cv::Mat& line_integrals)
{
  const cv::Mat grey = tones(line_integrals);
  cv::Mat smooth;
  cv::GaussianBlur(grey, smooth, {}, 1.2);
  cv::Mat edges;
  cv::Canny(smooth, edges, 20.0, 50.0);
  cv::Mat picture(edges.size(), CV_8UC4, cv::Scalar::all(0));
  picture.setTo(kEdge, edges);
  return picture;
}

void writePicture(const std::filesystem::path& path, const cv::Mat& picture, const std::vector<int>& parameters)
{
  if (!cv::imwrite(path.string(), picture, parameters))
  {
    throw std::runtime_error(path.string() + ": cannot be written");
  }
}
}  // namespace

nlohmann::json drawPictures(const ExposureSource& source, const MethodResult& method, const ShearWarpRenderer* target,
                            const std::string& folder)
{
  const std::filesystem::path root(folder);
  std::filesystem::remove_all(root / "pictures");  // of an earlier evaluation
  std::filesystem::create_directories(root / "pictures");
  nlohmann::json pictures = nlohmann::json::array();
  for (const auto& [k, why] : chosenFrames(source, method))
  {
    const FrameResult& frame = method.frames[k];
    const bool has_pose = frame.status == FrameStatus::OK;
    const RigidTransform pose = has_pose ? frame.room_from_patient : source.setup.room_from_patient;
    const std::vector<cv::Mat> images = source.images(k);
    for (std::size_t d = 0; d < images.size(); ++d)
    {
      const ProjectionGeometry& detector = source.setup.detectors[d];
      const cv::Rect crop = cropAround(source.setup, detector, pose);
      const std::string name = "pictures/" + std::to_string(k) + "_" + detector.name();
      nlohmann::json picture = { { "frame", k },
                                 { "why", why },
                                 { "detector", detector.name() },
                                 { "crop", { crop.x, crop.y, crop.width, crop.height } },
                                 { "radiograph", name + ".jpg" },
                                 { "edges", nullptr } };
      const cv::Mat radiograph = localTones(attenuationImage(images[d](crop), source.setup.intensity));
      writePicture(root / (name + ".jpg"), shrunk(radiograph), { cv::IMWRITE_JPEG_QUALITY, 80 });
      if (target != nullptr && has_pose)
      {
        cv::Mat drr;
        target->render(detector, pose, drr);
        writePicture(root / (name + "_edges.png"), edgesOf(shrunk(drr(crop))), { cv::IMWRITE_PNG_COMPRESSION, 9 });
        picture["edges"] = name + "_edges.png";
      }
      pictures.push_back(picture);
    }
  }
  return pictures;
}
}  // namespace xray_tracking
