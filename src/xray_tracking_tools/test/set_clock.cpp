// Preloaded into a program under test: the system's clock, set by as many seconds as the file $SET_CLOCK_BY holds.
#include <sys/syscall.h>
#include <unistd.h>

#include <cstdlib>
#include <ctime>
#include <fstream>

extern "C" int clock_gettime(clockid_t clock, timespec* now) noexcept
{
  const long result = syscall(SYS_clock_gettime, clock, now);
  const char* const path = std::getenv("SET_CLOCK_BY");
  time_t seconds = 0;
  if (clock == CLOCK_REALTIME && path != nullptr && std::ifstream(path) >> seconds)
  {
    now->tv_sec += seconds;
  }
  return static_cast<int>(result);
}
