#include "device_graph.h"

namespace nova::detail {

using novaphy::DeviceContext;

novaphy_status issue(const DeviceContext& context, novaphy_stream* stream, const OpList::Op& op,
                     const uint64_t* words, novaphy_error& error) {
  const novaphy_backend_api& api = *context.api;
  const auto bytes = static_cast<uint64_t>(op.n);
  switch (op.kind) {
    case OpList::Op::Kind::Launch:
      return api.launch(stream, op.kernel, op.n, words + op.first_word, op.word_count, &error);
    case OpList::Op::Kind::Copy:
      return api.memory_copy(stream, NOVAPHY_COPY_DEVICE_TO_DEVICE, op.target, op.source, bytes,
                             &error);
    case OpList::Op::Kind::Fill:
      return api.memory_fill(stream, op.target, op.pattern, 4, bytes, &error);
  }
  return NOVAPHY_OK;
}

std::unique_ptr<DeviceGraph> DeviceGraph::make(const DeviceContext& context,
                                               std::span<const OpList::Op> ops,
                                               std::span<const uint64_t> words) {
  const novaphy_backend_api& api = *context.api;
  if (api.capture_begin == nullptr) return nullptr;
  novaphy_error error = novaphy::make_error();
  // A stream of its own: other threads may be using the device's.
  novaphy_stream* stream = nullptr;
  novaphy::check(api.stream_create(context.device, &stream, &error), error, "graph");
  novaphy_status status = api.capture_begin(stream, &error);
  const char* name = "graph";
  novaphy_graph* graph = nullptr;
  if (status == NOVAPHY_OK) {
    for (const OpList::Op& op : ops) {
      status = issue(context, stream, op, words.data(), error);
      name = op.name;
      if (status != NOVAPHY_OK) break;
    }
    // Also after an error: the stream must leave the capture.
    novaphy_error end_error = novaphy::make_error();
    const novaphy_status ended = api.capture_end(stream, &graph, &end_error);
    if (status == NOVAPHY_OK && ended != NOVAPHY_OK) {
      status = ended;
      error = end_error;
      name = "graph";
    }
  }
  api.stream_destroy(stream);
  if (status != NOVAPHY_OK && graph != nullptr) api.graph_destroy(graph);
  novaphy::check(status, error, name);
  return std::unique_ptr<DeviceGraph>(new DeviceGraph(context, graph));
}

DeviceGraph::~DeviceGraph() { context_.api->graph_destroy(graph_); }

void DeviceGraph::launch() const {
  novaphy_error error = novaphy::make_error();
  novaphy::check(context_.api->graph_launch(graph_, context_.stream, &error), error, "graph");
}

}  // namespace nova::detail
