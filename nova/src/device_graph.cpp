#include "device_graph.h"

#include <cstddef>
#include <cstdlib>
#include <cstring>

#include "fusion.h"

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

namespace {

// Fewer operations are not worth compiling a kernel for.
constexpr uint32_t kMinListOps = 8;

bool lists_wanted(const novaphy_backend_api& api) {
  constexpr size_t end = offsetof(novaphy_backend_api, list_destroy) + sizeof(api.list_destroy);
  if (api.struct_size < end || api.list_create == nullptr) return false;
  const char* wanted = std::getenv("NOVAPHY_DEVICE_LISTS");
  return wanted == nullptr || std::strcmp(wanted, "0") != 0;
}

novaphy_list_op list_op(const OpList::Op& op, std::span<const uint64_t> words, int64_t n) {
  novaphy_list_op out{};
  out.struct_size = sizeof(out);
  if (op.kind == OpList::Op::Kind::Launch) {
    out.kernel = op.kernel;
    out.arguments = words.data() + op.first_word;
    out.argument_count = op.word_count;
    return out;
  }
  out.target = op.target;
  out.source = op.source;
  out.pattern = op.pattern;
  out.row_bytes = static_cast<uint64_t>(op.n / n);
  return out;
}

}  // namespace

void DeviceGraph::make_lists(const RunPlan& plan, std::span<const uint64_t> words) {
  const novaphy_backend_api& api = *context_.api;
  if (!lists_wanted(api)) return;
  for (const Segment& segment : plan.segments) {
    if (segment.n < 1 || segment.last - segment.first < kMinListOps) continue;
    std::vector<novaphy_list_op> list_ops;
    for (uint32_t k = segment.first; k < segment.last; ++k)
      list_ops.push_back(list_op(plan.ops[k], words, segment.n));
    novaphy_list* list = nullptr;
    novaphy_error error = novaphy::make_error();
    const novaphy_status status =
        api.list_create(context_.device, segment.n, list_ops.data(),
                        static_cast<uint32_t>(list_ops.size()), &list, &error);
    if (status == NOVAPHY_NOT_SUPPORTED) continue;
    novaphy::check(status, error, "graph");
    lists_.push_back({segment.first, segment.last, list});
  }
}

novaphy_status DeviceGraph::issue_all(novaphy_stream* stream, std::span<const OpList::Op> ops,
                                      std::span<const uint64_t> words, novaphy_error& error,
                                      const char*& name) const {
  auto list = lists_.begin();
  for (uint32_t k = 0; k < ops.size();) {
    const bool whole = list != lists_.end() && list->first == k;
    const novaphy_status status = whole ? context_.api->list_launch(list->list, stream, &error)
                                        : issue(context_, stream, ops[k], words.data(), error);
    name = ops[k].name;
    if (status != NOVAPHY_OK) return status;
    k = whole ? (list++)->last : k + 1;
  }
  return NOVAPHY_OK;
}

std::unique_ptr<DeviceGraph> DeviceGraph::make(const DeviceContext& context,
                                               std::span<const OpList::Op> ops,
                                               std::span<const uint64_t> words,
                                               std::span<const MemoryAccess> accesses) {
  const novaphy_backend_api& api = *context.api;
  if (api.capture_begin == nullptr) return nullptr;
  std::unique_ptr<DeviceGraph> made(new DeviceGraph(context));
  const RunPlan plan = plan_run(ops, words, accesses, {.min_rows = 1, .multiples = false});
  made->make_lists(plan, words);
  novaphy_error error = novaphy::make_error();
  // A stream of its own: other threads may be using the device's.
  novaphy_stream* stream = nullptr;
  novaphy::check(api.stream_create(context.device, &stream, &error), error, "graph");
  const char* name = "graph";
  novaphy_status status = api.capture_begin(stream, &error);
  if (status == NOVAPHY_OK) {
    status = made->issue_all(stream, plan.ops, words, error, name);
    // Also after an error: the stream must leave the capture.
    novaphy_error end_error = novaphy::make_error();
    const novaphy_status ended = api.capture_end(stream, &made->graph_, &end_error);
    if (status == NOVAPHY_OK && ended != NOVAPHY_OK) {
      status = ended;
      error = end_error;
      name = "graph";
    }
  }
  api.stream_destroy(stream);
  novaphy::check(status, error, name);
  return made;
}

DeviceGraph::~DeviceGraph() {
  if (graph_ != nullptr) context_.api->graph_destroy(graph_);
  for (const List& list : lists_) context_.api->list_destroy(list.list);
}

void DeviceGraph::launch() const {
  novaphy_error error = novaphy::make_error();
  novaphy::check(context_.api->graph_launch(graph_, context_.stream, &error), error, "graph");
}

}  // namespace nova::detail
