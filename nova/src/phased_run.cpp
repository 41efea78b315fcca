#include "phased_run.h"

#include <algorithm>
#include <atomic>
#include <mutex>

#include "fusion.h"
#include "novaphy/core/assert.h"
#include "novaphy/core/parallel.h"
#include "phases.h"

namespace nova::detail {

namespace {

// Largest number of bytes that an operation may access if its rows cannot be split.
constexpr uint64_t kSmallBytes = 1 << 15;
// A phase with fewer operations (rows times operations per row) is faster on one thread. Compiled
// code runs this many in about three microseconds.
constexpr int64_t kWorthSharing = 1 << 17;
// Limits of the parts of a chain. Every thread has the same part of each chain in every phase, so
// that it reads mostly data that it wrote. Chains with many rows are split further, so that threads
// can take over parts from each other. Smaller parts cost more, because compiled code has a
// start-up cost: a quarter of these rows per call costs up to 10 %.
constexpr int64_t kRowsPerPart = 1024, kMostEach = 32;
constexpr int64_t kGroupRows = 16;  // largest number of rows that compiled code computes together
// Number of phases between two checks for an interrupt.
constexpr size_t kPhasesPerRound = 64;
bool can_be_cut(const OpList::Op& op) {
  return op.kind == OpList::Op::Kind::Launch ? op.layout != nullptr && op.layout->row_local
                                             : op.n % 4 == 0;
}

// Returns the number of threads that can share the work of these phases.
int64_t threads_for(std::span<const Phased> placed, std::span<const OpList::Op> ops) {
  int64_t operations = 0;
  for (const Phased& p : placed) {
    const OpList::Op& op = ops[p.op];
    operations += rows_of(op) * (op.layout != nullptr ? op.layout->operations : 1);
  }
  const int64_t phases = placed.back().phase + 1;
  return operations / phases < kWorthSharing ? 1 : novaphy::num_threads();
}

}  // namespace

bool fits_phases(const OpList::Op& op, std::span<const uint64_t> words,
                 std::span<const MemoryAccess> accesses) {
  std::vector<MemoryAccess> touched;
  if (rows_of(op) < 1 || !touched_by(op, words, accesses, touched)) return false;
  if (can_be_cut(op)) return true;
  uint64_t bytes = 0;
  for (const MemoryAccess& access : touched) bytes += access.bytes;
  return bytes <= kSmallBytes;
}

PhasedRun::PhasedRun(const novaphy::DeviceContext& context, std::span<OpList::Op> ops,
                     std::span<const uint64_t> words, std::span<const MemoryAccess> accesses)
    : context_(context), words_(words), ops_(ops) {
  const std::vector<Phased> placed = plan_phases(ops, words, accesses);
  threads_ = threads_for(placed, ops);
  const std::vector<OpList::Op> recorded(ops.begin(), ops.end());
  const auto count = static_cast<uint32_t>(placed.size());
  for (uint32_t k = 0; k < count; ++k) {
    ops[k] = recorded[placed[k].op];
    order_.push_back(placed[k].op);
  }
  for (uint32_t k = 0; k < count;) {
    const Phased& p = placed[k];
    const uint32_t first = k;
    while (k < count && placed[k].phase == p.phase && placed[k].chain == p.chain) ++k;
    chains_.push_back(
        {first, k, p.phase, p.rows, parts_of(ops_.subspan(first, k - first), p.rows)});
  }
  make_chunks();
  for (const Chain& chain : chains_)  // the parts cover all rows
    NOVAPHY_ASSERT(chain.begin(0) == 0 && chain.begin(chain.parts) == chain.rows);
}

// Parts begin at whole groups of rows.
int64_t PhasedRun::Chain::begin(uint32_t part) const {
  return part == parts ? rows : rows * part / parts / kGroupRows * kGroupRows;
}

uint32_t PhasedRun::parts_of(std::span<const OpList::Op> chain, int64_t rows) const {
  if (!std::all_of(chain.begin(), chain.end(), can_be_cut)) return 1;
  const int64_t each = std::clamp<int64_t>(rows / (threads_ * kRowsPerPart), 1, kMostEach);
  return static_cast<uint32_t>(std::min(threads_ * each, (rows + kGroupRows - 1) / kGroupRows));
}

void PhasedRun::make_chunks() {
  const auto count = static_cast<uint32_t>(chains_.size());
  for (uint32_t c = 0; c < count;) {
    const uint32_t phase = chains_[c].phase;
    uint32_t end = c;
    while (end < count && chains_[end].phase == phase) ++end;
    const auto begin = static_cast<ptrdiff_t>(chunks_.size());
    for (; c < end; ++c)
      for (uint32_t part = 0; part < chains_[c].parts; ++part) chunks_.push_back({c, part});
    // Sorts the same parts of all chains together. A thread then gets a part of each chain, and in
    // VBD the elements near the particles that it moves.
    const auto place = [this](const Chunk& chunk) {
      return static_cast<double>(chunk.part) / static_cast<double>(chains_[chunk.chain].parts);
    };
    std::stable_sort(chunks_.begin() + begin, chunks_.end(),
                     [&](const Chunk& a, const Chunk& b) { return place(a) < place(b); });
    ends_.push_back(static_cast<int64_t>(chunks_.size()));
  }
  NOVAPHY_ASSERT(std::is_sorted(ends_.begin(), ends_.end()));
}

struct PhasedRun::Failure {
  std::atomic<bool> any{false};
  std::mutex mutex = {};
  uint32_t phase = 0, op = 0;
  novaphy_status status = NOVAPHY_OK;
  novaphy_error error = novaphy::make_error();
};

void PhasedRun::run_chunk(int64_t number, Failure& failure) const {
  const Chunk& chunk = chunks_[static_cast<size_t>(number)];
  const Chain& chain = chains_[chunk.chain];
  if (failure.any && failure.phase < chain.phase) [[unlikely]]
    return;
  const int64_t begin = chain.begin(chunk.part), end = chain.begin(chunk.part + 1);
  novaphy_error error = novaphy::make_error();
  for (uint32_t k = chain.first; k < chain.last; ++k) {
    const novaphy_status status =
        run_rows(context_, ops_[k], words_.data(), chain.rows, begin, end - begin, error);
    if (status == NOVAPHY_OK) [[likely]]
      continue;
    const std::lock_guard lock(failure.mutex);
    // The phase is written once, before `any`. Other threads read `phase` without the lock.
    if (!failure.any) failure.phase = chain.phase;
    if (!failure.any || order_[k] < order_[failure.op]) {
      failure.op = k;
      failure.status = status;
      failure.error = error;
    }
    failure.any = true;
    return;
  }
}

void PhasedRun::run() const {
  struct Work {
    const PhasedRun& run;
    Failure failure = {};
  } work{*this};
  const auto body = [](void* self, int64_t chunk) {
    Work& w = *static_cast<Work*>(self);
    w.run.run_chunk(chunk, w.failure);
  };
  int64_t first = 0;
  for (size_t p = 0; p < ends_.size(); p += kPhasesPerRound) {
    novaphy::check_interrupt();
    const auto ends = std::span(ends_).subspan(p, std::min(kPhasesPerRound, ends_.size() - p));
    if (threads_ > 1) {
      novaphy::parallel_phases(first, ends, body, &work);
    } else {
      for (int64_t chunk = first; chunk < ends.back(); ++chunk) body(&work, chunk);
    }
    first = ends.back();
    if (work.failure.any)
      fail_as_a_whole(context_, ops_[work.failure.op], words_.data(), work.failure.status,
                      work.failure.error);
  }
}

}  // namespace nova::detail
