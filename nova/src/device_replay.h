// Internal: launches of a recorded list on a device that captures streams. The first launches run
// the plain graph. Another thread makes the fused graph meanwhile, because compiling takes seconds.
// The fused graph runs from the first launch after it is ready, with the same results.
#pragma once

#include <future>
#include <memory>
#include <span>

#include "device_graph.h"

namespace nova::detail {

class DeviceReplay {
 public:
  // The arguments must outlive this object.
  DeviceReplay(const novaphy::DeviceContext& context, std::span<const OpList::Op> ops,
               std::span<const uint64_t> words, std::span<const MemoryAccess> accesses);
  // Launches the list. Throws an error of the compiling thread once, and runs the plain graph
  // afterwards.
  void launch();
  void prepare();  // waits for the other thread and throws its error

 private:
  void take();  // takes the fused graph if it is ready
  void have_graph();
  const novaphy::DeviceContext& context_;
  std::span<const OpList::Op> ops_;
  std::span<const uint64_t> words_;
  std::unique_ptr<DeviceGraph> graph_;
  std::future<std::unique_ptr<DeviceGraph>> fused_;  // its destructor waits for the thread
};

}  // namespace nova::detail
