#include "device_graph.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <map>

#include "fusion.h"
#include "novaphy/core/launch_trace.h"
#include "novaphy/core/parallel.h"
#include "optional_entry.h"
#include "phases.h"

namespace nova::detail {

using novaphy::DeviceContext;

int64_t active_rows(const OpList::Op& op, int64_t begin, int64_t rows) {
  return op.active ? std::clamp<int64_t>(*op.active - begin, 0, rows) : rows;
}

namespace {

novaphy_status enqueue(const DeviceContext& context, novaphy_stream* stream, const OpList::Op& op,
                       const uint64_t* words, novaphy_error& error) {
  const novaphy_backend_api& api = *context.api;
  const auto bytes = static_cast<uint64_t>(op.n);
  switch (op.kind) {
    case OpList::Op::Kind::Launch:
      if (op.active && !context.host_accessible)
        return api.launch_active(stream, op.kernel, op.n, op.active, words + op.first_word,
                                 op.word_count, &error);
      return api.launch(stream, op.kernel, active_rows(op, 0, op.n), words + op.first_word,
                        op.word_count, &error);
    case OpList::Op::Kind::Copy:
      return api.memory_copy(stream, NOVAPHY_COPY_DEVICE_TO_DEVICE, op.target, op.source, bytes,
                             &error);
    case OpList::Op::Kind::Fill:
      return api.memory_fill(stream, op.target, op.pattern, 4, bytes, &error);
  }
  return NOVAPHY_OK;
}

}  // namespace

novaphy_status issue(const DeviceContext& context, const OpList::Op& op, const uint64_t* words,
                     novaphy_error& error) {
  const auto run = [&] { return enqueue(context, context.stream, op, words, error); };
  return op.kind == OpList::Op::Kind::Launch ? novaphy::traced_launch(context, op.name, op.n, run)
                                             : run();
}

void issue_in_order(const DeviceContext& context, std::span<const OpList::Op> ops,
                    std::span<const uint64_t> words) {
  constexpr size_t kOpsPerInterruptCheck = 64;
  novaphy_error error = novaphy::make_error();
  for (size_t k = 0; k < ops.size(); ++k) {
    if (k % kOpsPerInterruptCheck == 0) novaphy::check_interrupt();
    const novaphy_status status = issue(context, ops[k], words.data(), error);
    if (status != NOVAPHY_OK) [[unlikely]]
      novaphy::check(status, error, ops[k].name);
  }
}

namespace {

// Lists with fewer operations are not worth compiling a kernel.
constexpr uint32_t kMinListOps = 8;

constexpr uint32_t kMinPersistentOps = 16;
// Compiling a kernel into a persistent kernel pays off only if the recording has this many launches
// of it.
constexpr uint32_t kMinOccurrences = 4;

bool switched_off(const char* value) { return value != nullptr && std::strcmp(value, "0") == 0; }
bool lists_wanted(const novaphy_backend_api& api) {
  return has_entry(api, &novaphy_backend_api::list_create) &&
         has_entry(api, &novaphy_backend_api::list_destroy) &&
         !switched_off(std::getenv("NOVAPHY_DEVICE_LISTS"));
}
bool persistent_wanted(const novaphy_backend_api& api) {
  constexpr uint32_t kOperationsHaveBytes = 9;  // ABI minor version from which operations have
                                                // sizes
  return has_entry(api, &novaphy_backend_api::persistent_create) &&
         api.abi_minor >= kOperationsHaveBytes &&
         !switched_off(std::getenv("NOVAPHY_DEVICE_PHASES"));
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

// Returns the bytes that a launch may read through its first argument.
uint64_t source_bytes(const OpList::Op& op, std::span<const uint64_t> words,
                      std::span<const MemoryAccess> accesses) {
  uint64_t bytes = 0;
  if (op.kind != OpList::Op::Kind::Launch) return bytes;
  for (const MemoryAccess& access : accesses.subspan(op.first_access, op.access_count))
    if (!access.write && access.begin == words[op.first_word])
      bytes = std::max(bytes, access.bytes);
  return bytes;
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

// Makes persistent kernels of the operations between lists, as far as the backend supports them.
void DeviceGraph::make_persistent_kernels(std::span<const OpList::Op> ops,
                                          std::span<const uint64_t> words,
                                          std::span<const MemoryAccess> accesses) {
  const novaphy_backend_api& api = *context_.api;
  if (!persistent_wanted(api)) return;
  std::map<const novaphy_kernel*, uint32_t> occurrences;
  for (const OpList::Op& op : ops) ++occurrences[op.kernel];
  const auto takes = [&](const OpList::Op& op) {
    if (op.kind != OpList::Op::Kind::Launch ? op.n % 4 != 0
                                            : occurrences[op.kernel] < kMinOccurrences)
      return false;
    const novaphy_list_op one = list_op(op, words, std::max<int64_t>(1, rows_of(op)));
    std::vector<MemoryAccess> touched;
    // The backend reads the tables of a persistent kernel when it makes the kernel, so the tables
    // must not change.
    return rows_of(op) > 0 && !op.tables_change && !op.active &&
           touched_by(op, words, accesses, touched) &&
           api.persistent_takes(context_.device, &one) != 0;
  };
  const std::vector<List> lists = lists_;
  auto list = lists.begin();
  for (uint32_t k = 0; k < ops.size();) {
    const bool before_list = list != lists.end();
    const uint32_t bound = before_list ? list->first : static_cast<uint32_t>(ops.size());
    uint32_t end = k;
    while (end < bound && takes(ops[end])) ++end;
    if (end - k >= kMinPersistentOps)
      if (novaphy_list* persistent = make_persistent(ops.subspan(k, end - k), words, accesses))
        lists_.push_back({k, end, persistent});
    k = end < bound ? end + 1 : before_list ? (list++)->last : bound;
  }
  std::sort(lists_.begin(), lists_.end(),
            [](const List& a, const List& b) { return a.first < b.first; });
}

novaphy_list* DeviceGraph::make_persistent(std::span<const OpList::Op> ops,
                                           std::span<const uint64_t> words,
                                           std::span<const MemoryAccess> accesses) const {
  std::vector<novaphy_persistent_op> persistent_ops;
  for (const Phased& p : plan_phases(ops, words, accesses)) {
    novaphy_persistent_op op{};
    op.struct_size = sizeof(op);
    op.n = rows_of(ops[p.op]);
    op.op = list_op(ops[p.op], words, op.n);
    op.rows = p.rows;
    op.phase = p.phase;
    op.chain = p.chain;
    op.source_bytes = source_bytes(ops[p.op], words, accesses);
    persistent_ops.push_back(op);
  }
  novaphy_list* persistent = nullptr;
  novaphy_error error = novaphy::make_error();
  const novaphy_status status = context_.api->persistent_create(
      context_.device, persistent_ops.data(), static_cast<uint32_t>(persistent_ops.size()),
      &persistent, &error);
  if (status != NOVAPHY_NOT_SUPPORTED) novaphy::check(status, error, "graph");
  return persistent;
}

novaphy_status DeviceGraph::issue_all(novaphy_stream* stream, std::span<const OpList::Op> ops,
                                      std::span<const uint64_t> words, novaphy_error& error,
                                      const char*& name) const {
  auto list = lists_.begin();
  for (uint32_t k = 0; k < ops.size();) {
    const bool whole = list != lists_.end() && list->first == k;
    const novaphy_status status = whole ? context_.api->list_launch(list->list, stream, &error)
                                        : enqueue(context_, stream, ops[k], words.data(), error);
    name = ops[k].name;
    if (status != NOVAPHY_OK) return status;
    k = whole ? (list++)->last : k + 1;
  }
  return NOVAPHY_OK;
}

void DeviceGraph::capture(std::span<const OpList::Op> ops, std::span<const uint64_t> words) {
  const novaphy_backend_api& api = *context_.api;
  novaphy_error error = novaphy::make_error();
  // A separate stream, because other threads may use the device's own stream.
  novaphy_stream* stream = nullptr;
  novaphy::check(api.stream_create(context_.device, &stream, &error), error, "graph");
  const char* name = "graph";
  novaphy_status status = api.capture_begin(stream, &error);
  if (status == NOVAPHY_OK) {
    status = issue_all(stream, ops, words, error, name);
    // The capture must end even after an error.
    novaphy_error end_error = novaphy::make_error();
    const novaphy_status ended = api.capture_end(stream, &graph_, &end_error);
    if (status == NOVAPHY_OK && ended != NOVAPHY_OK) {
      status = ended;
      error = end_error;
      name = "graph";
    }
  }
  api.stream_destroy(stream);
  novaphy::check(status, error, name);
}

std::unique_ptr<DeviceGraph> DeviceGraph::plain(const DeviceContext& context,
                                                std::span<const OpList::Op> ops,
                                                std::span<const uint64_t> words) {
  std::unique_ptr<DeviceGraph> made(new DeviceGraph(context));
  made->capture(ops, words);
  return made;
}

std::unique_ptr<DeviceGraph> DeviceGraph::fused(const DeviceContext& context,
                                                std::span<const OpList::Op> ops,
                                                std::span<const uint64_t> words,
                                                std::span<const MemoryAccess> accesses) {
  if (!lists_wanted(*context.api) && !persistent_wanted(*context.api)) return nullptr;
  std::unique_ptr<DeviceGraph> made(new DeviceGraph(context));
  RunPlan plan = plan_run(ops, words, accesses, {.min_rows = 1, .multiples = false});
  made->make_lists(plan, words);
  // The order of the plan groups operations into lists. Without lists that order would only move
  // single operations, such as the first fill of a gradient, between the substeps of a persistent
  // kernel. The recorded order is then used instead.
  if (made->lists_.empty()) plan.ops.assign(ops.begin(), ops.end());
  mark_changing_tables(plan.ops, words, accesses);
  made->make_persistent_kernels(plan.ops, words, accesses);
  if (made->lists_.empty()) return nullptr;
  made->capture(plan.ops, words);
  return made;
}

DeviceGraph::~DeviceGraph() {
  if (graph_ != nullptr) context_.api->graph_destroy(graph_);
  for (const List& list : lists_) context_.api->list_destroy(list.list);
}

void DeviceGraph::launch() const {
  novaphy_error error = novaphy::make_error();
  const novaphy_status status = novaphy::traced_launch(context_, "graph", 1, [&] {
    return context_.api->graph_launch(graph_, context_.stream, &error);
  });
  novaphy::check(status, error, "graph");
}

}  // namespace nova::detail
