#include "allocator.h"

#include <pthread.h>

#include <bit>
#include <limits>

#include "novaphy/core/error.h"

namespace novaphy {
namespace {

constexpr size_t kMaxCachedBytes = size_t{1} << 30;  // per device

}  // namespace

Allocator& Allocator::get() {
  // Never destroyed, because arrays with static lifetime return their blocks at exit.
  static Allocator* allocator = new Allocator;
  return *allocator;
}

Allocator::Allocator() {
  // Another thread may hold the lock during a fork. The handlers take the lock around the fork, so
  // that the child finds it free.
  pthread_atfork([] { get().mutex_.lock(); }, [] { get().mutex_.unlock(); },
                 [] { get().mutex_.unlock(); });
}

size_t Allocator::size_class(size_t bytes) {
  if (bytes <= 256) return 256;
  // the allocation will fail and report this size
  if (bytes > std::numeric_limits<size_t>::max() / 2) return bytes;
  const size_t step = bytes <= 4096 ? 256 : size_t{1} << (std::bit_width(bytes - 1) - 4);
  return (bytes + step - 1) / step * step;
}

void* Allocator::allocate(const DeviceContext& context, size_t bytes) {
  const size_t size = size_class(bytes);
  const std::lock_guard lock(mutex_);
  Cache& cache = caches_[&context];
  if (const auto found = cache.blocks.find(size);
      found != cache.blocks.end() && !found->second.empty()) {
    void* block = found->second.back();
    found->second.pop_back();
    cache.bytes -= size;
    return block;
  }
  void* block = nullptr;
  novaphy_error error = make_error();
  novaphy_status status =
      context.api->memory_alloc(context.device, NOVAPHY_MEMORY_DEVICE, size, &block, &error);
  if (status == NOVAPHY_OUT_OF_MEMORY && cache.bytes != 0) {
    free_all(context, cache);
    status = context.api->memory_alloc(context.device, NOVAPHY_MEMORY_DEVICE, size, &block, &error);
  }
  check(status, error, "Storage.allocate");
  return block;
}

void Allocator::release(const DeviceContext& context, void* block, size_t bytes) noexcept {
  const size_t size = size_class(bytes);
  const std::lock_guard lock(mutex_);
  try {
    Cache& cache = caches_[&context];
    if (cache.bytes + size <= kMaxCachedBytes) {
      cache.blocks[size].push_back(block);
      cache.bytes += size;
      return;
    }
  } catch (...) {  // no memory to cache the block: free it instead
  }
  context.api->memory_free(context.device, NOVAPHY_MEMORY_DEVICE, block);
}

void Allocator::free_all(const DeviceContext& context, Cache& cache) noexcept {
  novaphy_error error = make_error();
  context.api->stream_synchronize(context.stream, &error);  // queued work may still use the blocks
  for (auto& [size, blocks] : cache.blocks) {
    for (void* block : blocks)
      context.api->memory_free(context.device, NOVAPHY_MEMORY_DEVICE, block);
    blocks.clear();
  }
  cache.bytes = 0;
}

void Allocator::release_cached() {
  const std::lock_guard lock(mutex_);
  for (auto& [context, cache] : caches_) free_all(*context, cache);
}

}  // namespace novaphy
