#include "novaphy/core/launch_list.h"

#include <algorithm>

#include "novaphy/core/error.h"
#include "novaphy/core/launch_trace.h"
#include "novaphy/core/parallel.h"

namespace novaphy {

LaunchList::LaunchList(Device device) : device_(device) {}

size_t LaunchList::append(const DeviceKernel& kernel, int64_t n,
                          std::span<const ArgumentInfo> infos, const ArgumentWord* values,
                          int64_t chunk) {
  const size_t number = ops_.size();
  require(kernel.function_ != nullptr, ErrorKind::NotImplemented, kernel.name(),
          ": a builtin is no launch of a list");
  ops_.push_back({&kernel, &kernel.get(device_), infos, n, words_.size(), ends_.size()});
  words_.resize(words_.size() + infos.size());
  ranges_.resize(words_.size());
  put(number, values);
  if (!device_.is_cpu() || n == 0) return number;
  for (int64_t begin = 0; begin < n; begin += chunk)
    chunks_.push_back({number, begin, std::min(begin + chunk, n)});
  ends_.push_back(static_cast<int64_t>(chunks_.size()));
  return number;
}

void LaunchList::put(size_t number, const ArgumentWord* values) {
  Op& op = ops_[number];
  op.writes_arrays = op.has_memory = false;
  for (size_t k = 0; k < op.infos.size(); ++k) {
    const ArgumentInfo& info = op.infos[k];
    uint64_t& word = words_[op.first_word + k];
    Range*& range = ranges_[op.first_word + k];
    word = values[k];
    range = nullptr;
    if (info.access == access::kNumber) continue;
    const bool is_memory = word != 0 && (word & kArrayBit) == 0;
    require(!is_memory || device_.is_cpu(), ErrorKind::Runtime, op.kernel->name(), ", ", info.name,
            ": expected an array, got memory");
    op.has_memory |= is_memory;
    if (is_memory) continue;
    range = range_of(word);
    word = range == nullptr ? 0 : reinterpret_cast<uint64_t>(range->data());
    if (range == nullptr && (info.access & access::kOptional) != 0) continue;
    op.writes_arrays |= range != nullptr && (info.access & access::kWrite) != 0;
    const size_t bytes = range == nullptr ? 0 : range->bytes();
    require(range == nullptr || range->device() == device_, ErrorKind::Value, op.kernel->name(),
            ", ", info.name, ": expected memory of ", device_.str(), ", got ",
            range == nullptr ? "" : range->device().str());
    require(bytes >= static_cast<uint64_t>(op.n) * info.row_bytes, ErrorKind::Value,
            op.kernel->name(), ", ", info.name, ": expected at least ", op.n, " rows, got ",
            info.row_bytes == 0 ? 0 : bytes / info.row_bytes);
  }
  has_memory_ = std::any_of(ops_.begin(), ops_.end(), [](const Op& o) { return o.has_memory; });
}

void LaunchList::record(const Op& op) const {
  std::vector<LaunchArgument> arguments(op.infos.size());
  for (size_t k = 0; k < arguments.size(); ++k) {
    const auto& [name, row_bytes, access] = op.infos[k];
    LaunchArgument& a = arguments[k];
    Range* const range = ranges_[op.first_word + k];
    a.word = words_[op.first_word + k];
    a.name = name;
    if (range == nullptr) continue;
    a.range = {range->storage().shared_from_this(), range};
    a.row_bytes = row_bytes;
    a.read = (access & access::kRead) != 0;
    a.write = (access & access::kWrite) != 0;
    a.differentiable = (access & access::kDifferentiable) != 0;
  }
  submit_launch(
      {*op.made->context, op.made->kernel, op.kernel->name(), op.n, words(op), arguments});
}

void LaunchList::run(size_t first, size_t last) const {
  const auto ops = std::span(ops_).subspan(first, last - first);
  if (launch_recorder() != nullptr && !has_memory_) {
    for (const Op& op : ops)
      if (op.n != 0) record(op);
    return;
  }
  if (device_.is_cpu() && !detail::launches_are_traced) {
    const auto phase_of = [&](size_t op) {
      return op == ops_.size() ? ends_.size() : ops_[op].first_phase;
    };
    const size_t phase = phase_of(first), end = phase_of(last);
    parallel_phases(
        phase == 0 ? 0 : ends_[phase - 1], std::span(ends_).subspan(phase, end - phase),
        [](void* self, int64_t number) {
          const LaunchList& list = *static_cast<const LaunchList*>(self);
          const Chunk& chunk = list.chunks_[static_cast<size_t>(number)];
          const Op& op = list.ops_[chunk.op];
          op.kernel->function_->rows(&list.words_[op.first_word], op.n, chunk.begin, chunk.end);
        },
        const_cast<LaunchList*>(this));
  } else {
    for (const Op& op : ops)
      if (op.n != 0)
        launch_now(*op.made->context, op.made->kernel, op.kernel->name(), op.n, words(op));
  }
  // Launches that follow each other often write the same arrays. One mark is enough for them.
  const Op* marked = nullptr;
  for (const Op& op : ops) {
    if (!op.writes_arrays || op.n == 0) continue;
    Range* const* const of = &ranges_[op.first_word];
    if (marked != nullptr && marked->infos.data() == op.infos.data() &&
        std::equal(of, of + op.infos.size(), &ranges_[marked->first_word]))
      continue;
    marked = &op;
    for (size_t k = 0; k < op.infos.size(); ++k)
      if (of[k] != nullptr && (op.infos[k].access & access::kWrite) != 0) of[k]->mark_written();
  }
}

}  // namespace novaphy
