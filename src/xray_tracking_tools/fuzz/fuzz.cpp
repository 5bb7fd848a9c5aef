// The reader that `--reader=NAME` chooses, for libFuzzer: scripts/fuzz.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <string>

#include "readers.h"

namespace
{
const xray_tracking::Reader* chosen = nullptr;
}

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv)
{
  const std::string option = "--reader=";
  for (int n = 1; n < *argc; ++n)
  {
    const std::string argument = (*argv)[n];
    if (argument == "--list")
    {
      for (const auto& reader : xray_tracking::readers())
      {
        std::cout << reader.name << "\n";
      }
      std::exit(0);
    }
    for (const auto& reader : xray_tracking::readers())
    {
      if (argument == option + reader.name)
      {
        chosen = &reader;
      }
    }
  }
  if (chosen == nullptr)
  {
    std::cerr << "expected --reader=NAME, one of --list\n";
    std::exit(2);
  }
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
  // What it throws ends the fuzzer.
  xray_tracking::refusalOf(*chosen, std::string(reinterpret_cast<const char*>(data), size));
  return 0;
}
