#pragma once

#include <cstddef>

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

namespace xray_tracking
{
/// Calls work(n) for n from 0 to count - 1, in parallel. Where each thread gets one, loops within them start no further
/// ones: all that these would do is wait for each other.
template <typename Work>
void forEachView(std::size_t count, const Work& work)
{
  const bool one_each = count >= static_cast<std::size_t>(tbb::this_task_arena::max_concurrency());
  tbb::parallel_for(std::size_t{ 0 }, count,
                    [&](std::size_t n)
                    {
                      if (one_each)
                      {
                        thread_local tbb::task_arena alone(1);
                        alone.execute([&] { work(n); });
                      }
                      else
                      {
                        work(n);
                      }
                    });
}
}  // namespace xray_tracking
