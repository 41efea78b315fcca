// Internal to core: freed blocks are kept per device and size class. A step of a simulation
// allocates the same sizes again and again, and a device allocation is slow.
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
  // At least `bytes` bytes, a multiple of 256, 256-byte aligned; not cleared. Throws when the
  // device has no more.
  void* allocate(const DeviceContext& context, size_t bytes);
  void release(const DeviceContext& context, void* block, size_t bytes) noexcept;
  void release_cached();
  // Multiples of 256 up to 4 KiB, then eight steps per power of two: at most an eighth is wasted.
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
