// In a file of its own: where the compiler sees new and delete at their use, it warns that delete
// calls free.
#include "allocations.h"

#include <cstdlib>
#include <new>

namespace {
thread_local int64_t count = 0;
}

void* operator new(std::size_t bytes) {
  ++count;
  if (void* p = std::malloc(bytes == 0 ? 1 : bytes)) return p;
  throw std::bad_alloc();
}
void* operator new(std::size_t bytes, const std::nothrow_t&) noexcept {
  ++count;
  return std::malloc(bytes == 0 ? 1 : bytes);
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

namespace novaphy::testing {

int64_t allocations() { return count; }

}  // namespace novaphy::testing
