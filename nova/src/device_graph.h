// Internal: a recorded list as a graph of the device, so that a replay is one call. A plain graph
// has one launch per operation. A fused graph has fewer launches and the same results.
//
// Fusion makes one launch (a list) of consecutive operations that access written memory only at
// their own row, if the backend supports this (NOVAPHY_DEVICE_LISTS=0 switches it off). The
// operations between lists become one launch with barriers, a persistent kernel
// (NOVAPHY_DEVICE_PHASES=0 switches it off).
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "novaphy/core/backend.h"
#include "novaphy/nova/op_list.h"

namespace nova::detail {

// Issues one operation to the device's stream. Returns OK, or the status and message of the
// backend.
novaphy_status issue(const novaphy::DeviceContext& context, const OpList::Op& op,
                     const uint64_t* words, novaphy_error& error);

// Returns how many of the rows [begin, begin + rows) of a launch are active now, on a device whose
// memory the host can access.
int64_t active_rows(const OpList::Op& op, int64_t begin, int64_t rows);

// Issues operations to the device's stream in order. Throws like a launch.
void issue_in_order(const novaphy::DeviceContext& context, std::span<const OpList::Op> ops,
                    std::span<const uint64_t> words);

struct RunPlan;

class DeviceGraph {
 public:
  // Makes a plain graph. The backend must support the capture of streams.
  static std::unique_ptr<DeviceGraph> plain(const novaphy::DeviceContext& context,
                                            std::span<const OpList::Op> ops,
                                            std::span<const uint64_t> words);
  // Makes a fused graph, or returns null if nothing can be fused. Compiling takes seconds unless
  // the code is cached.
  static std::unique_ptr<DeviceGraph> fused(const novaphy::DeviceContext& context,
                                            std::span<const OpList::Op> ops,
                                            std::span<const uint64_t> words,
                                            std::span<const MemoryAccess> accesses);
  ~DeviceGraph();
  DeviceGraph(const DeviceGraph&) = delete;
  DeviceGraph& operator=(const DeviceGraph&) = delete;
  void launch() const;  // on the device's stream

 private:
  explicit DeviceGraph(const novaphy::DeviceContext& context) : context_(context) {}
  void make_lists(const RunPlan& plan, std::span<const uint64_t> words);
  void make_persistent_kernels(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                               std::span<const MemoryAccess> accesses);
  novaphy_list* make_persistent(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                                std::span<const MemoryAccess> accesses) const;
  void capture(std::span<const OpList::Op> ops, std::span<const uint64_t> words);
  novaphy_status issue_all(novaphy_stream* stream, std::span<const OpList::Op> ops,
                           std::span<const uint64_t> words, novaphy_error& error,
                           const char*& name) const;

  // Consecutive operations that the backend runs as one launch, each thread with its own rows.
  struct List {
    uint32_t first, last;
    novaphy_list* list;
  };
  const novaphy::DeviceContext& context_;
  std::vector<List> lists_;  // in order
  novaphy_graph* graph_ = nullptr;
};

}  // namespace nova::detail
