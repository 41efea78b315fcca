// Internal: launches of a recorded list on a device that captures streams. The first launches run
// the plain graph. Another thread makes the fused one meanwhile, because compiling takes seconds;
// it takes over at the first launch after that, with the same results.
#pragma once

#include <future>
#include <memory>
#include <span>

#include "device_graph.h"

namespace nova::detail {

class DeviceReplay {
 public:
  // What it is given must outlive it.
  DeviceReplay(const novaphy::DeviceContext& context, std::span<const OpList::Op> ops,
               std::span<const uint64_t> words, std::span<const MemoryAccess> accesses);
  // Throws, once, what went wrong on the other thread; the plain graph runs from then on.
  void launch();
  void prepare();  // waits for the other thread, and throws likewise

 private:
  void take();  // what the other thread has made, once it has
  void have_graph();
  const novaphy::DeviceContext& context_;
  std::span<const OpList::Op> ops_;
  std::span<const uint64_t> words_;
  std::unique_ptr<DeviceGraph> graph_;
  std::future<std::unique_ptr<DeviceGraph>> fused_;  // its destructor waits
};

}  // namespace nova::detail
