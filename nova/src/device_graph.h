// Internal: a recorded list as a graph of the device, so that a replay is one call.
#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "novaphy/core/backend.h"
#include "novaphy/nova/op_list.h"

namespace nova::detail {

// Issues one operation to a stream. OK, or the backend's status and message.
novaphy_status issue(const novaphy::DeviceContext& context, novaphy_stream* stream,
                     const OpList::Op& op, const uint64_t* words, novaphy_error& error);

class DeviceGraph {
 public:
  // Null when the backend captures no streams.
  static std::unique_ptr<DeviceGraph> make(const novaphy::DeviceContext& context,
                                           std::span<const OpList::Op> ops,
                                           std::span<const uint64_t> words);
  ~DeviceGraph();
  DeviceGraph(const DeviceGraph&) = delete;
  DeviceGraph& operator=(const DeviceGraph&) = delete;
  void launch() const;  // on the device's stream

 private:
  DeviceGraph(const novaphy::DeviceContext& context, novaphy_graph* graph)
      : context_(context), graph_(graph) {}
  const novaphy::DeviceContext& context_;
  novaphy_graph* graph_;
};

}  // namespace nova::detail
