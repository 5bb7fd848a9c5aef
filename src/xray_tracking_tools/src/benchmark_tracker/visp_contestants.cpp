#include "contestant.h"

#ifdef XRAY_TRACKING_HAS_VISP

#include <visp3/core/vpException.h>
#include <visp3/core/vpImage.h>
#include <visp3/tt/vpTemplateTrackerSSDESM.h>
#include <visp3/tt/vpTemplateTrackerSSDInverseCompositional.h>
#include <visp3/tt/vpTemplateTrackerWarpAffine.h>
#include <visp3/tt/vpTemplateTrackerWarpHomographySL3.h>
#include <visp3/tt/vpTemplateTrackerWarpRT.h>
#include <visp3/tt/vpTemplateTrackerWarpSRT.h>
#include <visp3/tt/vpTemplateTrackerWarpTranslation.h>
#include <visp3/tt/vpTemplateTrackerZNCCInverseCompositional.h>
#include <visp3/tt_mi/vpTemplateTrackerMIInverseCompositional.h>

namespace xray_tracking
{
namespace
{
using Image = vpImage<unsigned char>;

/// A view of the pixels, which must outlive it.
Image viewOf(const cv::Mat& image)
{
  return Image(image.data, static_cast<unsigned int>(image.rows), static_cast<unsigned int>(image.cols), false);
}

/// Every third row and column: its time is that of tens of other trackers.
constexpr int kMutualInformationSampling = 3;

template <typename Tracker>
class VispContestant : public Contestant
{
public:
  VispContestant(const std::string& name, std::unique_ptr<vpTemplateTrackerWarp> warp)
    : Contestant(name), warp_(std::move(warp))
  {
  }

  void train(const BenchmarkFrame& frame, const BenchmarkView& view) override
  {
    tracker_ = std::make_unique<Tracker>(warp_.get());
    // All pixels, as long as it takes, and coarse levels, which widen the capture range.
    const int sampling = std::is_base_of_v<vpTemplateTrackerMI, Tracker> ? kMutualInformationSampling : 1;
    tracker_->setSampling(sampling, sampling);
    tracker_->setLambda(0.001);
    tracker_->setThresholdGradient(0.0);
    tracker_->setIterationMax(50);
    tracker_->setPyramidal(3, 0);

    const cv::Rect region = view.regionInWindow();
    const double left = region.x, top = region.y, right = region.br().x - 1, bottom = region.br().y - 1;
    const std::vector<vpImagePoint> corners = { { top, left }, { top, right },    { bottom, right },
                                                { top, left }, { bottom, right }, { bottom, left } };
    tracker_->initFromPoints(viewOf(frame.normalised.clone()), corners, false);
    centre_ = { 0.5 * (left + right), 0.5 * (top + bottom) };
    restart();
  }
  void restart() override
  {
    vpColVector zero(warp_->getNbParam());
    zero = 0.0;
    tracker_->setp(zero);
  }
  std::optional<Eigen::Vector2d> track(const BenchmarkFrame& frame) override
  {
    try
    {
      tracker_->track(viewOf(frame.normalised));
    }
    catch (const vpException&)  // the template has left the image, or a matrix is singular
    {
      return std::nullopt;
    }
    if (tracker_->getDiverge())
    {
      return std::nullopt;
    }
    vpColVector from(2), to(2);
    from[0] = centre_.x();
    from[1] = centre_.y();
    const vpColVector p = tracker_->getp();
    warp_->computeCoeff(p);
    warp_->computeDenom(from, p);
    warp_->warpX(from, to, p);
    return Eigen::Vector2d(to[0], to[1]) - centre_;
  }

private:
  std::unique_ptr<vpTemplateTrackerWarp> warp_;
  std::unique_ptr<Tracker> tracker_;
  Eigen::Vector2d centre_ = Eigen::Vector2d::Zero();
};

template <typename Tracker, typename Warp>
void add(const std::string& name, Contestants& contestants)
{
  contestants.push_back(std::make_unique<VispContestant<Tracker>>(name, std::make_unique<Warp>()));
}

template <typename Warp>
void addWithWarp(const std::string& model, Contestants& contestants)
{
  add<vpTemplateTrackerSSDInverseCompositional, Warp>("ViSP SSD inverse comp., " + model, contestants);
  add<vpTemplateTrackerZNCCInverseCompositional, Warp>("ViSP ZNCC, " + model, contestants);
  add<vpTemplateTrackerMIInverseCompositional, Warp>("ViSP MI, " + model, contestants);
}
}  // namespace

void addVisp(MotionModel model, Contestants& contestants)
{
  switch (model)
  {
    case MotionModel::TRANSLATION:
      addWithWarp<vpTemplateTrackerWarpTranslation>("translation", contestants);
      add<vpTemplateTrackerSSDESM, vpTemplateTrackerWarpTranslation>("ViSP ESM, translation", contestants);
      break;
    case MotionModel::EUCLIDEAN:
      addWithWarp<vpTemplateTrackerWarpRT>("Euclidean", contestants);
      break;
    case MotionModel::SIMILARITY:
      addWithWarp<vpTemplateTrackerWarpSRT>("similarity", contestants);
      break;
    case MotionModel::AFFINE:
      addWithWarp<vpTemplateTrackerWarpAffine>("affine", contestants);
      // ESM has no affine warp.
      add<vpTemplateTrackerSSDESM, vpTemplateTrackerWarpHomographySL3>("ViSP ESM, homography", contestants);
      break;
  }
}
}  // namespace xray_tracking

#else

namespace xray_tracking
{
void addVisp(MotionModel, Contestants&) {}
}  // namespace xray_tracking

#endif
