// Internal: a recorded list as a graph of the device, so that a replay is one call. A plain graph
// has a launch for each operation. A fused graph has the same results.
//
// Fusion makes one launch of each stretch of operations that touch written memory at their own row
// only, where the backend can (NOVAPHY_DEVICE_LISTS=0 keeps the operations apart). The operations
// between become one launch with barriers (NOVAPHY_DEVICE_PHASES=0 keeps them apart).
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "novaphy/core/backend.h"
#include "novaphy/nova/op_list.h"

namespace nova::detail {

// Issues one operation to the device's stream. OK, or the backend's status and message.
novaphy_status issue(const novaphy::DeviceContext& context, const OpList::Op& op,
                     const uint64_t* words, novaphy_error& error);

// Of the rows [begin, begin + rows) of a launch, on a device whose memory the host may dereference,
// how many are to be computed now.
int64_t active_rows(const OpList::Op& op, int64_t begin, int64_t rows);

// Issues operations to the device's stream, one after the other. Throws like a launch.
void issue_in_order(const novaphy::DeviceContext& context, std::span<const OpList::Op> ops,
                    std::span<const uint64_t> words);

struct RunPlan;

class DeviceGraph {
 public:
  // The backend captures streams.
  static std::unique_ptr<DeviceGraph> plain(const novaphy::DeviceContext& context,
                                            std::span<const OpList::Op> ops,
                                            std::span<const uint64_t> words);
  // Null when nothing can be fused. Compiles, which takes seconds where the code is not at hand.
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

  // A stretch of the operations that the backend runs as one launch.
  struct List {
    uint32_t first, last;
    novaphy_list* list;
  };
  const novaphy::DeviceContext& context_;
  std::vector<List> lists_;  // in order
  novaphy_graph* graph_ = nullptr;
};

}  // namespace nova::detail
