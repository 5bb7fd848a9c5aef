#pragma once

#include <malloc.h>

#include <cstdlib>
#include <new>

/// What the code between construction and destruction of a HeapWatch allocates. To be included by one source file of a
/// test only, as it replaces the global operator new.
class HeapWatch
{
public:
  HeapWatch() { active_ = true; }
  ~HeapWatch() { active_ = false; }
  HeapWatch(const HeapWatch&) = delete;
  HeapWatch& operator=(const HeapWatch&) = delete;

  inline static long allocations = 0;
  inline static long live_bytes = 0;

  static void* allocate(std::size_t size, std::size_t alignment)
  {
    void* memory = aligned_alloc(alignment, (size + alignment - 1) / alignment * alignment);
    if (memory == nullptr)
    {
      throw std::bad_alloc();
    }
    if (active_)
    {
      ++allocations;
      live_bytes += static_cast<long>(malloc_usable_size(memory));
    }
    return memory;
  }
  static void release(void* memory)
  {
    if (active_ && memory != nullptr)
    {
      live_bytes -= static_cast<long>(malloc_usable_size(memory));
    }
    std::free(memory);
  }

private:
  inline static bool active_ = false;
};

void* operator new(std::size_t size)
{
  return HeapWatch::allocate(size, alignof(std::max_align_t));
}
void* operator new(std::size_t size, const std::nothrow_t&) noexcept
{
  try
  {
    return operator new(size);
  }
  catch (const std::bad_alloc&)
  {
    return nullptr;
  }
}
void* operator new(std::size_t size, std::align_val_t alignment)
{
  return HeapWatch::allocate(size, static_cast<std::size_t>(alignment));
}
void operator delete(void* memory) noexcept
{
  HeapWatch::release(memory);
}
void operator delete(void* memory, std::size_t) noexcept
{
  HeapWatch::release(memory);
}
void operator delete(void* memory, std::align_val_t) noexcept
{
  HeapWatch::release(memory);
}
void operator delete(void* memory, std::size_t, std::align_val_t) noexcept
{
  HeapWatch::release(memory);
}
