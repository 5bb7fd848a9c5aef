#include <algorithm>
#include <cstdint>
#include <cstring>
#include <iostream>
#include <map>
#include <mutex>
#include <random>

#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <tf2_msgs/TFMessage.h>
#include <nlohmann/json.hpp>

#include "xray_tracking_conversions/conversions.h"
#include "xray_tracking_core/evaluation/evaluation.h"
#include "xray_tracking_tools/command_line.h"
#include "xray_tracking_tools/exposure_set.h"
#include "xray_tracking_tools/graph_connections.h"
#include "xray_tracking_tools/image_message.h"
#include "xray_tracking_tools/json_file.h"

namespace po = boost::program_options;

namespace xray_tracking
{
namespace
{
/// Publishes exposures stamped now and notes when their transform treatment_room -> patient comes back.
class LatencyBenchmark
{
public:
  /// @param registers whether a registration has to listen, too
  LatencyBenchmark(const ExposureSet& exposures, bool registers)
    : count_(exposures.images.size()), registers_(registers)
  {
    for (std::size_t d = 0; d < exposures.setup.detectors.size(); ++d)
    {
      const ProjectionGeometry& geometry = exposures.setup.detectors[d];
      Detector detector;
      detector.info = cameraInfoFromGeometry(geometry);
      detector.info_publisher = nh_.advertise<sensor_msgs::CameraInfo>(geometry.name() + "/camera_info", 10);
      detector.image_publisher = nh_.advertise<sensor_msgs::Image>(geometry.name() + "/image_raw", 10);
      detector.region_topic = nh_.resolveName(geometry.name() + "/tracked_region");
      for (const std::vector<cv::Mat>& images : exposures.images)
      {
        detector.images.push_back(imageMessage(images[d], geometry.name(), ros::Time()));
      }
      detectors_.push_back(detector);
    }
    tf_subscriber_ =
        nh_.subscribe("/tf", 1000, &LatencyBenchmark::tfCallback, this, ros::TransportHints().tcpNoDelay());
  }

  /// Waits until trackers and motion estimation listen. @throws std::runtime_error naming what is missing
  void waitForGraph() const
  {
    constexpr double kTimeout = 60.0;  // [s]
    const ros::WallTime deadline = ros::WallTime::now() + ros::WallDuration(kTimeout);
    for (std::string missing = missingListener(); !missing.empty(); missing = missingListener())
    {
      if (!ros::ok() || ros::WallTime::now() > deadline)
      {
        throw std::runtime_error("the graph is not complete after " + std::to_string(kTimeout) + " s: " + missing);
      }
      ros::WallDuration(0.1).sleep();
    }
  }

  /// Publishes the k-th exposure of the way back and forth through the sequence, so that motion is continuous.
  /// @return its stamp
  ros::Time expose(std::size_t k)
  {
    const std::size_t index = backAndForth(k, count_);
    for (Detector& detector : detectors_)
    {
      renewLastBits(detector.images[index]);
    }
    const ros::Time stamp = ros::Time::now();
    for (Detector& detector : detectors_)
    {
      detector.info.header.stamp = detector.images[index].header.stamp = stamp;
      detector.info_publisher.publish(detector.info);
      detector.image_publisher.publish(detector.images[index]);
    }
    return stamp;
  }

  /// Waits at most `timeout` [s] for an exposure's transform. @return latency [s], negative if there is none
  double latency(const ros::Time& stamp, double timeout)
  {
    const ros::WallTime deadline = ros::WallTime::now() + ros::WallDuration(timeout);
    do
    {
      {
        const std::lock_guard<std::mutex> lock(mutex_);
        const auto arrival = arrivals_.find(stamp);
        if (arrival != arrivals_.end())
        {
          return (arrival->second - stamp).toSec();
        }
      }
      ros::WallDuration(0.001).sleep();
    } while (ros::ok() && ros::WallTime::now() < deadline);
    return -1.0;
  }

private:
  struct Detector
  {
    sensor_msgs::CameraInfo info;
    std::vector<sensor_msgs::Image> images;
    ros::Publisher info_publisher;
    ros::Publisher image_publisher;
    std::string region_topic;
  };

  /// As a detector's noise does: an image that comes again bit for bit is taken for that of a panel that stands still.
  void renewLastBits(sensor_msgs::Image& image)
  {
    for (std::size_t i = 0; i + sizeof(std::uint64_t) <= image.data.size(); i += sizeof(std::uint64_t))
    {
      constexpr std::uint64_t kLastBits = 0x0001000100010001;  // of four little-endian pixels
      std::uint64_t pixels = 0;
      std::memcpy(&pixels, &image.data[i], sizeof(pixels));
      pixels ^= random_() & kLastBits;
      std::memcpy(&image.data[i], &pixels, sizeof(pixels));
    }
  }

  std::string missingListener() const
  {
    if (tf_subscriber_.getNumPublishers() == 0)
    {
      return "nobody publishes /tf";
    }
    RequiredSubscribers listeners;
    for (const Detector& detector : detectors_)
    {
      for (const ros::Publisher* publisher : { &detector.image_publisher, &detector.info_publisher })
      {
        if (publisher->getNumSubscribers() == 0)
        {
          return "nobody subscribes to " + publisher->getTopic();
        }
      }
      auto& of_infos = listeners[detector.info_publisher.getTopic()];
      of_infos = listeners[detector.region_topic] = { nh_.resolveName("motion_estimation") };
      if (registers_)
      {
        of_infos.push_back(nh_.resolveName("registration"));
        listeners[detector.image_publisher.getTopic()] = { nh_.resolveName("registration") };
      }
    }
    const std::vector<std::string> missing = missingConnections(listeners);
    return missing.empty() ? "" : missing.front();
  }

  void tfCallback(const tf2_msgs::TFMessage& message)
  {
    const ros::Time now = ros::Time::now();
    const std::lock_guard<std::mutex> lock(mutex_);
    for (const geometry_msgs::TransformStamped& transform : message.transforms)
    {
      if (transform.child_frame_id == kPatientFrame)
      {
        arrivals_.emplace(transform.header.stamp, now);
      }
    }
  }

  ros::NodeHandle nh_;
  std::size_t count_;
  bool registers_;
  std::mt19937_64 random_{ 1 };
  std::vector<Detector> detectors_;
  ros::Subscriber tf_subscriber_;
  std::mutex mutex_;
  std::map<ros::Time, ros::Time> arrivals_;  // by exposure
};

struct LatencyReport
{
  double rate_hz = 0.0;
  double first_s = 0.0;             ///< of the exposure that the trackers are trained on
  std::vector<double> latencies_s;  ///< of the other answered exposures
  int lost = 0;
};

LatencyReport measure(LatencyBenchmark& benchmark, double rate_hz, int exposures)
{
  constexpr double kTrainingTimeout = 20.0;  // [s]
  constexpr double kAgain = 5.0;             // [s]
  constexpr double kTimeout = 2.0;           // [s]
  LatencyReport report;
  report.rate_hz = rate_hz;
  // Others than trackers listen to images as well, so that one may have missed an exposure.
  report.first_s = -1.0;
  for (double waited = 0.0; report.first_s < 0.0 && waited < kTrainingTimeout; waited += kAgain)
  {
    report.first_s = benchmark.latency(benchmark.expose(0), kAgain);
  }
  if (report.first_s < 0.0)
  {
    throw std::runtime_error("no transform treatment_room -> patient for the first exposure within 20 s");
  }
  std::vector<ros::Time> stamps;
  ros::WallRate rate(rate_hz);
  Progress progress("exposure");
  for (int k = 1; k < exposures && ros::ok(); ++k)
  {
    rate.sleep();
    stamps.push_back(benchmark.expose(k));
    progress(k + 1, exposures);
  }
  ros::WallDuration(kTimeout).sleep();
  for (const ros::Time& stamp : stamps)
  {
    const double latency_s = benchmark.latency(stamp, 0.0);
    if (latency_s < 0.0)
    {
      ++report.lost;
    }
    else
    {
      report.latencies_s.push_back(latency_s);
    }
  }
  if (report.latencies_s.empty())
  {
    throw std::runtime_error("no exposure after the first was answered");
  }
  return report;
}

/// The figures by name, for the table and for JSON.
std::vector<std::pair<std::string, double>> figures(const LatencyReport& report)
{
  const auto quantile_ms = [&report](double q) { return 1e3 * quantile(report.latencies_s, q); };
  return { { "rate_hz", report.rate_hz },
           { "answered", static_cast<double>(report.latencies_s.size()) },
           { "lost", static_cast<double>(report.lost) },
           { "first_ms", 1e3 * report.first_s },
           { "median_ms", quantile_ms(0.5) },
           { "p95_ms", quantile_ms(0.95) },
           { "p99_ms", quantile_ms(0.99) },
           { "max_ms", quantile_ms(1.0) } };
}

int benchmarkLatency(const po::variables_map& arguments)
{
  const double rate_hz = arguments["rate"].as<double>();
  const int exposures = arguments["exposures"].as<int>();
  requireAtLeast("--rate", rate_hz, 0.01);
  requireAtLeast("--exposures", exposures, 2);
  const std::string method = arguments["method"].as<std::string>();
  if (method != "tracking" && method != "registration" && method != "tracking_and_registration")
  {
    throw std::invalid_argument("--method is " + method +
                                ", expected tracking, registration or tracking_and_registration");
  }
  LatencyBenchmark benchmark(loadExposureSet(arguments["SETUP_OR_SEQUENCE_DIR"].as<std::string>()),
                             method != "tracking");
  ros::AsyncSpinner spinner(1);
  spinner.start();
  benchmark.waitForGraph();
  const LatencyReport report = measure(benchmark, rate_hz, exposures);

  nlohmann::json json;
  for (const auto& [name, value] : figures(report))
  {
    std::cout << "exposure to tf: " << name << " " << value << "\n";
    json[name] = value;
  }
  std::cout << std::flush;
  if (arguments.count("json") != 0)
  {
    writeJsonFile(arguments["json"].as<std::string>(), json);
  }
  return report.lost == 0 ? 0 : 1;
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  ros::init(argc, argv, "benchmark_latency");  // takes ROS's own arguments out
  xray_tracking::CommandLine command_line;
  command_line.usage = "SETUP_OR_SEQUENCE_DIR [--method NAME] [--rate 10] [--exposures 200] [--json FILE]";
  command_line.description =
      "Time from an exposure's publication to its transform treatment_room -> patient in a running graph without a\n"
      "simulator (latency.launch): the images of a sequence, or of the phantom for another setup file, back and "
      "forth.\n"
      "Exit status 0 only if every exposure was answered.";
  command_line.arguments = { "SETUP_OR_SEQUENCE_DIR" };
  command_line.options.add_options()(
      "method", po::value<std::string>()->default_value("tracking"),
      "of the graph: tracking, registration or tracking_and_registration; a registration is waited for")(
      "rate", po::value<double>()->default_value(10.0), "exposures a second [Hz]")(
      "exposures", po::value<int>()->default_value(200), "number of exposures")("json", po::value<std::string>(),
                                                                                "writes the figures to this file");
  return xray_tracking::runCommand(argc, argv, command_line, xray_tracking::benchmarkLatency);
}
