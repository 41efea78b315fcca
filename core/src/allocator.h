// Internal to core: an allocator that caches freed blocks by device and size class. A simulation
// allocates the same sizes in every step, and a device allocation is slow.
#pragma once

#include <cstddef>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "novaphy/core/backend.h"

namespace novaphy {

class Allocator {
 public:
  static Allocator& get();
  // Returns a block of at least `bytes` bytes, rounded up to a multiple of 256 and aligned to 256
  // bytes. The block is not cleared. Throws if the device has no memory left.
  void* allocate(const DeviceContext& context, size_t bytes);
  void release(const DeviceContext& context, void* block, size_t bytes) noexcept;
  void release_cached();
  // Size classes: multiples of 256 up to 4 KiB, then eight classes per power of two. At most an
  // eighth of a block is unused.
  static size_t size_class(size_t bytes);

 private:
  struct Cache {
    std::unordered_map<size_t, std::vector<void*>> blocks;  // by size class
    size_t bytes = 0;
  };
  Allocator();
  static void free_all(const DeviceContext& context, Cache& cache) noexcept;

  std::mutex mutex_;
  std::unordered_map<const DeviceContext*, Cache> caches_;
};

}  // namespace novaphy
