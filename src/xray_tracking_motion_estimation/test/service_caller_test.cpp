#include "xray_tracking_conversions/service_caller.h"

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <ros/ros.h>
#include <std_srvs/Trigger.h>

namespace xray_tracking
{
namespace
{
using Trigger = std_srvs::Trigger;

/// A service in threads of its own that hangs while it is told to, and a caller whose answers come in this thread.
class ServiceCallerTest : public testing::Test
{
protected:
  ServiceCallerTest()
  {
    ros::NodeHandle server;
    server.setCallbackQueue(&server_queue_);
    const boost::function<bool(Trigger::Request&, Trigger::Response&)> serve =
        [this](Trigger::Request&, Trigger::Response& response)
    {
      ++served_;
      while (hangs_)
      {
        ros::WallDuration(0.001).sleep();
      }
      response.success = 1;
      return true;
    };
    service_ = server.advertiseService("trigger", serve);
    spinner_.start();
    nh_.setCallbackQueue(&queue_);
  }

  ~ServiceCallerTest() override { hangs_ = false; }

  std::unique_ptr<ServiceCaller<Trigger>> caller(const std::string& name)
  {
    return std::make_unique<ServiceCaller<Trigger>>(
        nh_, name,
        [this](const std::optional<Trigger::Response>& response, const std::string& why)
        { answers_.push_back(response ? "answered" : why); });
  }

  /// Calls back until there are so many answers.
  bool waitFor(
      std::size_t answers, const std::function<void()>& meanwhile = [] {})
  {
    for (const ros::SteadyTime begin = ros::SteadyTime::now();
         answers_.size() < answers && (ros::SteadyTime::now() - begin).toSec() < 10.0;)
    {
      meanwhile();
      queue_.callAvailable(ros::WallDuration(0.005));
    }
    return answers_.size() >= answers;
  }

  ros::NodeHandle nh_;
  ros::CallbackQueue queue_, server_queue_;
  ros::AsyncSpinner spinner_{ 4, &server_queue_ };
  std::atomic<bool> hangs_{ false };
  std::atomic<int> served_{ 0 };
  ros::ServiceServer service_;
  std::vector<std::string> answers_;
};

TEST_F(ServiceCallerTest, CallsOneAtATime)
{
  const auto caller = this->caller("trigger");
  for (std::size_t i = 1; i <= 20; ++i)
  {
    ASSERT_TRUE(caller->call({}));
    EXPECT_FALSE(caller->call({}));
    ASSERT_TRUE(waitFor(i));
    EXPECT_EQ(answers_.back(), "answered");
  }
  EXPECT_EQ(served_, 20);
}

TEST_F(ServiceCallerTest, SaysWhereThereIsNoService)
{
  const auto caller = this->caller("nothing");
  ASSERT_TRUE(caller->call({}));
  ASSERT_TRUE(waitFor(1));
  EXPECT_NE(answers_.back().find("there is no service"), std::string::npos) << answers_.back();
}

// What hangs is given up, and lets the next call through.
TEST_F(ServiceCallerTest, GivesUpWhatTakesTooLong)
{
  const auto caller = this->caller("trigger");
  for (std::size_t i = 1; i <= 3; ++i)
  {
    hangs_ = true;
    ASSERT_TRUE(caller->call({}));
    const ros::SteadyTime begin = ros::SteadyTime::now();
    ASSERT_TRUE(waitFor(2 * i - 1, [&] { caller->cancelAfter(ros::WallDuration(0.5)); }));
    const double took = (ros::SteadyTime::now() - begin).toSec();
    EXPECT_NE(answers_.back().find("broken off"), std::string::npos) << answers_.back();
    EXPECT_GE(took, 0.5);
    EXPECT_LT(took, 2.0);
    hangs_ = false;
    ASSERT_TRUE(caller->call({}));
    ASSERT_TRUE(waitFor(2 * i));
    EXPECT_EQ(answers_.back(), "answered");
  }
}

// From another thread, at any time of a call: at its beginning, while it hangs, as it ends.
TEST_F(ServiceCallerTest, EndsAtAnyTime)
{
  for (int i = 0; i < 40; ++i)
  {
    hangs_ = i % 2 == 1;
    auto caller = this->caller("trigger");
    ASSERT_TRUE(caller->call({}));
    ros::WallDuration(0.0005 * (i / 2)).sleep();
    caller->cancelAfter(ros::WallDuration(0.0));
    const ros::SteadyTime begin = ros::SteadyTime::now();
    caller.reset();
    EXPECT_LT((ros::SteadyTime::now() - begin).toSec(), 2.0) << i;
    hangs_ = false;
  }
  const std::size_t answers = answers_.size();
  queue_.callAvailable();
  EXPECT_EQ(answers_.size(), answers) << "of a caller that is no more";
}
}  // namespace
}  // namespace xray_tracking

int main(int argc, char** argv)
{
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "service_caller_test");
  const ros::NodeHandle keeps_ros_up;
  return RUN_ALL_TESTS();
}
