#pragma once

#include <cstdlib>
#include <string>

#include <gtest/gtest.h>

namespace xray_tracking
{
/// Real scans and sequences: $XRAY_TRACKING_SHARED_DATA is the folder that holds them.
class SharedDataTest : public testing::Test
{
protected:
  void SetUp() override
  {
    const char* folder = std::getenv("XRAY_TRACKING_SHARED_DATA");
    if (!folder)
    {
      GTEST_SKIP() << "XRAY_TRACKING_SHARED_DATA is not set";
    }
    folder_ = folder;
  }

  std::string folder_;
};
}  // namespace xray_tracking
