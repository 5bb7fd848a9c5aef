#include <sys/resource.h>
#include <unistd.h>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <iostream>
#include <stdexcept>

#include <itkEuler3DTransform.h>
#include <itkImage.h>
#include <itkRayCastInterpolateImageFunction.h>
#include <tbb/parallel_for.h>

#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_core/projection/exact_projection.h"
#include "xray_tracking_core/projection/shear_warp_renderer.h"
#include "xray_tracking_core/sequence/treatment_setup.h"
#include "xray_tracking_core/volume/attenuation.h"
#include "xray_tracking_core/volume/neck_phantom.h"
#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/exposure_set.h"
#include "xray_tracking_tools/figure_table.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
struct Scene
{
  std::string name;
  CtVolume ct;
  ScalarVolume attenuation;
  TreatmentSetup setup;
};

/// Times of one piece of work [ms].
struct Times
{
  std::vector<double> wall;
  std::vector<double> cpu;  ///< of all threads
};

double cpuMilliseconds(int who)
{
  rusage usage;
  getrusage(who, &usage);
  const auto milliseconds = [](const timeval& time) { return 1e3 * time.tv_sec + 1e-3 * time.tv_usec; };
  return milliseconds(usage.ru_utime) + milliseconds(usage.ru_stime);
}

void measure(const std::function<void()>& work, int who, Times& times)
{
  const double cpu = cpuMilliseconds(who);
  const auto start = std::chrono::steady_clock::now();
  work();
  times.wall.push_back(std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count());
  times.cpu.push_back(cpuMilliseconds(who) - cpu);
}

Ray rayInPatient(const ProjectionGeometry& geometry, const Eigen::Vector2d& pixel, const RigidTransform& pose)
{
  const Ray ray = geometry.backProject(pixel);
  const RigidTransform patient_from_room = pose.inverse();
  return { patient_from_room * ray.source, patient_from_room.linear() * ray.direction };
}

/// Every pixel's line integral by `integrate(ray)`, on all cores.
template <typename Integrate>
cv::Mat castRays(const ProjectionGeometry& geometry, const PixelGrid& pixels, const RigidTransform& pose,
                 Integrate integrate)
{
  cv::Mat image(pixels.size.y(), pixels.size.x(), CV_32FC1);
  tbb::parallel_for(0, image.rows,
                    [&](int v)
                    {
                      for (int u = 0; u < image.cols; ++u)
                      {
                        const Eigen::Vector2d pixel = pixels.first + Eigen::Vector2d(u, v).cwiseProduct(pixels.step);
                        image.at<float>(v, u) = static_cast<float>(integrate(rayInPatient(geometry, pixel, pose)));
                      }
                    });
  return image;
}

/// ITK's ray casting, the peer in the same process.
class ItkRayCaster
{
public:
  explicit ItkRayCaster(const ScalarVolume& volume) : image_(Image::New()), caster_(Caster::New())
  {
    const VolumeGrid& grid = volume.grid;
    Image::SizeType size;
    Image::SpacingType spacing;
    Image::PointType origin;
    for (int axis = 0; axis < 3; ++axis)
    {
      size[axis] = grid.size[axis];
      spacing[axis] = grid.spacing()[axis];
      origin[axis] = grid.patient_from_index.translation()[axis];
    }
    image_->SetRegions(Image::RegionType(size));
    image_->SetSpacing(spacing);
    image_->SetOrigin(origin);
    image_->Allocate();
    std::copy(volume.values.begin(), volume.values.end(), image_->GetBufferPointer());
    caster_->SetInputImage(image_);
    caster_->SetTransform(itk::Euler3DTransform<double>::New());
  }

  cv::Mat render(const ProjectionGeometry& geometry, const PixelGrid& pixels, const RigidTransform& pose)
  {
    const Eigen::Vector3d source = pose.inverse() * geometry.source();
    caster_->SetFocalPoint(point(source));
    // It scales the sum by the ray's step and integrates from the focal spot to wherever the ray leaves the volume.
    return castRays(geometry, pixels, pose,
                    [&](const Ray& ray) { return caster_->Evaluate(point(ray.source + 4000.0 * ray.direction)); });
  }

private:
  using Image = itk::Image<float, 3>;
  using Caster = itk::RayCastInterpolateImageFunction<Image, double>;

  static Image::PointType point(const Eigen::Vector3d& p)
  {
    Image::PointType result;
    std::copy_n(p.data(), 3, result.Begin());
    return result;
  }

  Image::Pointer image_;
  Caster::Pointer caster_;
};

const char* name(SimdLevel level)
{
  return level == SimdLevel::GENERIC ? "generic" : level == SimdLevel::AVX2 ? "AVX2" : "AVX-512";
}

void addRow(FigureTable& table, const Scene& scene, const std::string& renderer, const std::string& work,
            const Times& times, double rms)
{
  table.beginRow();
  table.add("CT", scene.name);
  table.add("renderer", renderer);
  table.add("image", work);
  table.add("wall ms", quantile(times.wall, 0.5));
  table.add("CPU ms", quantile(times.cpu, 0.5));
  table.add("rel. RMS %", 100.0 * rms, 4);
}

/// The same work in every view in turn.
Times measureViews(const Scene& scene, int repeats, const std::function<void(const ProjectionGeometry&)>& work)
{
  Times times;
  for (int n = 0; n < repeats; ++n)
  {
    for (const ProjectionGeometry& view : scene.setup.detectors)
    {
      measure([&] { work(view); }, RUSAGE_SELF, times);
    }
  }
  return times;
}

/// Root mean square over all views of what rendering patches with every pixel differs by from exact integration.
double panelError(const Scene& scene, const std::function<cv::Mat(const ProjectionGeometry&, const PixelGrid&)>& render)
{
  // Grids of every pixel have the whole panel's resolution; some of them cost the reference less than the panel.
  constexpr int kPatches = 4;
  constexpr int kPatchSize = 24;
  double error = 0.0;
  double energy = 0.0;
  for (const ProjectionGeometry& view : scene.setup.detectors)
  {
    const Eigen::Vector2d step =
        (view.imageSize().cast<double>() - Eigen::Vector2d::Constant(kPatchSize)) / (kPatches - 1.0);
    for (int n = 0; n < kPatches * kPatches; ++n)
    {
      PixelGrid patch = PixelGrid::wholePanel(view);
      patch.first = (step.array() * Eigen::Array2d(n % kPatches, n / kPatches)).floor();
      patch.size = Eigen::Vector2i::Constant(kPatchSize);
      const cv::Mat exact = castRays(view, patch, scene.setup.room_from_patient,
                                     [&](const Ray& ray) { return integrateTrilinear(scene.attenuation, ray); });
      error += cv::norm(render(view, patch), exact, cv::NORM_L2SQR);
      energy += cv::norm(exact, cv::NORM_L2SQR);
    }
  }
  return std::sqrt(error / energy);
}

void measureShearWarp(const Scene& scene, SimdLevel level, int repeats, FigureTable& table)
{
  const ShearWarpRenderer renderer(scene.attenuation, level);
  const RigidTransform& pose = scene.setup.room_from_patient;
  const std::string label = std::string("shear-warp ") + name(level);
  const double unknown = std::numeric_limits<double>::quiet_NaN();
  cv::Mat image, derivatives;
  const double rms = panelError(scene,
                                [&](const ProjectionGeometry& view, const PixelGrid& patch)
                                {
                                  renderer.render(view, patch, pose, image);
                                  return image;
                                });
  addRow(table, scene, label, "whole panel",
         measureViews(scene, repeats, [&](const ProjectionGeometry& view) { renderer.render(view, pose, image); }),
         rms);
  const auto centred = [](const ProjectionGeometry& view, int edge, int binning)
  {
    const Eigen::Vector2i size = Eigen::Vector2i::Constant(edge);
    return PixelGrid::binnedRegion((view.imageSize() - size) / 2, size, binning);
  };
  addRow(
      table, scene, label, "150 x 150 px",
      measureViews(scene, 4 * repeats,
                   [&](const ProjectionGeometry& view) { renderer.render(view, centred(view, 150, 1), pose, image); }),
      unknown);
  addRow(table, scene, label, "60 x 60 bins of 4 px, 6 derivatives",
         measureViews(scene, 4 * repeats,
                      [&](const ProjectionGeometry& view) {
                        renderer.renderWithDerivatives(view, centred(view, 240, 4), pose, Eigen::Vector3d::Zero(),
                                                       image, derivatives);
                      }),
         unknown);
}

void measureItk(const Scene& scene, FigureTable& table)
{
  ItkRayCaster caster(scene.attenuation);
  const RigidTransform& pose = scene.setup.room_from_patient;
  const auto render = [&](const ProjectionGeometry& view, const PixelGrid& pixels)
  { return caster.render(view, pixels, pose); };
  addRow(table, scene, "ITK ray casting", "whole panel",
         measureViews(scene, 1, [&](const ProjectionGeometry& view) { render(view, PixelGrid::wholePanel(view)); }),
         panelError(scene, render));
}

/// The exact renderer of plastimatch, if it is installed: the difference of 9 angles and 1, so that reading the CT does
/// not count.
/// @return whether it ran
bool measurePlastimatch(const Scene& scene, FigureTable& table)
{
  if (std::system("plastimatch drr --help > /dev/null 2>&1") != 0)
  {
    return false;
  }
  std::string folder = (std::filesystem::temp_directory_path() / "benchmark_drr_XXXXXX").string();
  if (mkdtemp(folder.data()) == nullptr)
  {
    throw std::runtime_error("no temporary folder " + folder);
  }
  const std::string ct = folder + "/ct.mha";
  writeCtVolume(scene.ct, ct);
  const auto run = [&](int angles)
  {
    Times times;
    measure(
        [&]
        {
          const std::string command =
              "plastimatch drr --algorithm exact --threading cpu --sad 2600 --sid 3800 --dim "
              "'512 512' --detector-size '204.8 204.8' --gantry-angle 45 "
              "--gantry-angle-spacing 90 --output-format pfm --num-angles " +
              std::to_string(angles) + " --output " + folder + "/drr " + ct + " > /dev/null 2>&1";
          if (std::system(command.c_str()) != 0)
          {
            throw std::runtime_error("plastimatch failed: " + command);
          }
        },
        RUSAGE_CHILDREN, times);
    return times;
  };
  Times each;
  for (int n = 0; n < 3; ++n)
  {
    const Times one = run(1);
    const Times nine = run(9);
    each.wall.push_back((nine.wall[0] - one.wall[0]) / 8.0);
    each.cpu.push_back((nine.cpu[0] - one.cpu[0]) / 8.0);
  }
  std::filesystem::remove_all(folder);
  addRow(table, scene, "plastimatch drr, exact", "whole panel", each, std::numeric_limits<double>::quiet_NaN());
  return true;
}

Scene phantomScene(const std::string& name, const Eigen::Vector3i& size, double spacing)
{
  PhantomCtOptions options;
  options.size = size;
  options.spacing = { spacing, spacing, 1.0 };
  options.slice_thickness = 1.0;
  Scene scene;
  scene.name = name;
  scene.ct = NeckPhantom().sampleCt(options);
  scene.attenuation = attenuationVolume(scene.ct);
  scene.setup = loadTreatmentSetup(coreConfigPath("phantom_neck.yaml"));
  return scene;
}

int benchmarkDrr(const po::variables_map& arguments)
{
  const int repeats = arguments["repeats"].as<int>();
  requireAtLeast("repeats", repeats, 1);
  FigureTable table("DRR");
  bool plastimatch = true;
  const auto run = [&](const Scene& scene)
  {
    plastimatch = plastimatch && measurePlastimatch(scene, table);
    measureItk(scene, table);
    for (const SimdLevel level : { SimdLevel::GENERIC, SimdLevel::AVX2, SimdLevel::AVX512 })
    {
      if (level <= bestSimdLevel())
      {
        measureShearWarp(scene, level, repeats, table);
      }
    }
  };
  run(phantomScene("256 x 256 x 200", { 256, 256, 200 }, 1.0));
  run(phantomScene("512 x 512 x 200", { 512, 512, 200 }, 0.5));
  if (!plastimatch)
  {
    std::cerr << "plastimatch is not installed: left out" << std::endl;
  }
  report({ table }, arguments.count("json") != 0 ? arguments["json"].as<std::string>() : "");
  return 0;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  xray_tracking::CommandLine command_line;
  command_line.usage = "[--repeats 15] [--json FILE]";
  command_line.description =
      "Medians of the time of a DRR of 512 x 512 pixels, of a region and of a registration's image, from CTs of the "
      "neck\n"
      "phantom, on all cores, for every level of vector instructions that the processor has; error against exact\n"
      "integration of the trilinear volume. Peers in the same run: ITK's ray casting, and plastimatch where it is\n"
      "installed.";
  command_line.options.add_options()("repeats", po::value<int>()->default_value(15), "renderings of each view")(
      "json", po::value<std::string>(), "writes the figures to this file");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::benchmarkDrr);
}
