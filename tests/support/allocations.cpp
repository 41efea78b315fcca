// In a separate file, because a compiler that sees new and delete at their use warns that delete
// calls free.
#include "support/allocations.h"

#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <new>

namespace {
std::atomic<int64_t> count{0};
void note() { count.fetch_add(1, std::memory_order_relaxed); }
}  // namespace

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)

// The program's definitions come before the C library's; operator new calls malloc. free() stays
// that of the C library, whose memory this is.
extern "C" {
void* __libc_malloc(size_t bytes);
void* __libc_calloc(size_t rows, size_t bytes);
void* __libc_realloc(void* p, size_t bytes);
void* __libc_memalign(size_t alignment, size_t bytes);

void* malloc(size_t bytes) {
  note();
  return __libc_malloc(bytes);
}
void* calloc(size_t rows, size_t bytes) {
  note();
  return __libc_calloc(rows, bytes);
}
void* realloc(void* p, size_t bytes) {
  note();
  return __libc_realloc(p, bytes);
}
void* memalign(size_t alignment, size_t bytes) {
  note();
  return __libc_memalign(alignment, bytes);
}
void* aligned_alloc(size_t alignment, size_t bytes) { return memalign(alignment, bytes); }
int posix_memalign(void** p, size_t alignment, size_t bytes) {
  *p = memalign(alignment, bytes);
  return *p == nullptr ? ENOMEM : 0;
}
}

#else

void* operator new(std::size_t bytes) {
  note();
  if (void* p = std::malloc(bytes == 0 ? 1 : bytes)) return p;
  throw std::bad_alloc();
}
void* operator new(std::size_t bytes, const std::nothrow_t&) noexcept {
  note();
  return std::malloc(bytes == 0 ? 1 : bytes);
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

#endif

namespace novaphy::testing {

int64_t allocations() { return count.load(std::memory_order_relaxed); }

}  // namespace novaphy::testing
