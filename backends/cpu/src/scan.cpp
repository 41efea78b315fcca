#include "scan.h"

#include <algorithm>
#include <cstdlib>
#include <map>
#include <new>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "novaphy/cpu/float_mode.h"
#include "novaphy/program/scan.h"

namespace {

using nova::ir::Program;
using novaphy::cpu::ErrorSink;
using novaphy::cpu::NativeCode;

struct Interval {
  uint64_t begin, end;
  bool overlaps(const Interval& other) const { return begin < other.end && other.begin < end; }
};

// Returns the range of memory that a launch may read through a source.
Interval read_by(const Program& p, const uint64_t* arguments, int32_t source) {
  const auto s = static_cast<size_t>(source);
  const uint64_t begin = arguments[p.source_argument(s)];
  const uint64_t rows = arguments[p.source_argument(s) + 1];
  return {begin, begin + rows * static_cast<uint64_t>(p.sources[s].width) * 4};
}

// Returns the range of memory that an output writes. The output has as many rows as the source to
// which it is carried.
Interval written_by(const Program& p, const uint64_t* arguments, size_t output, int32_t carried) {
  const Interval like = read_by(p, arguments, carried);
  const uint64_t begin = arguments[p.output_argument(output)];
  return {begin, begin + (like.end - like.begin)};
}

// The number of later launches that are searched for a second write to the same array.
constexpr size_t kLookForward = 8;
// From this number of bytes on, stores of outputs bypass the caches, which could not hold the
// outputs until they are read.
constexpr uint64_t kStreamedBytes = 32 << 20;
constexpr int32_t kLine = 64;
// The size of a Scratch (below). Only the pages that launches use take memory.
constexpr int64_t kRoomBytes = 4 << 20;

}  // namespace

// Memory of a thread in which a scan passes data to the next scan: notes, followed by rows.
struct novaphy_scan::Scratch {
  char* bytes = nullptr;
  const novaphy_scan* from = nullptr;
  int64_t begin = 0, end = 0;

  ~Scratch() { std::free(bytes); }
  bool has(const novaphy_scan* scan, int64_t b, int64_t e) const {
    return from == scan && begin == b && end == e;
  }
  void hold(const novaphy_scan* scan, int64_t b, int64_t e) {
    from = scan;
    begin = b;
    end = e;
  }
  // Gives the memory to the scan that writes it, or to the scan that follows and reads it.
  void give(const novaphy_scan& writer, int64_t rows, novaphy_native_launches& all) {
    if (bytes == nullptr) [[unlikely]] {
      bytes = static_cast<char*>(std::aligned_alloc(4096, kRoomBytes));
      if (bytes == nullptr) throw std::bad_alloc();
    }
    const auto count = static_cast<int64_t>(writer.launches_.size());
    const int64_t noted = (rows * count + kLine - 1) / kLine * kLine;
    const int64_t row_bytes = writer.large_ ? writer.scratch_row_bytes_ : 0;
    if (noted + row_bytes * rows > kRoomBytes) return;
    all.notes = bytes;
    all.note_row_bytes = count;
    if (row_bytes == 0) return;
    all.scratch = bytes + noted;
    all.scratch_row_bytes = row_bytes;
  }
  static Scratch& of_thread() {
    thread_local Scratch scratch;
    return scratch;
  }
};

std::unique_ptr<novaphy_scan> novaphy_scan::make(const novaphy::cpu::Executable& executable,
                                                 std::span<const uint64_t* const> launches,
                                                 novaphy_scan* first) {
  if (executable.native.scan_rows == nullptr || executable.native.scan_scalar == nullptr)
    return nullptr;
  std::unique_ptr<novaphy_scan> made(new novaphy_scan(executable));
  made->launches_.assign(launches.begin(), launches.end());
  if (!made->same_but_for_arrays() || made->writes_what_all_read()) return nullptr;
  made->make_table();
  if (first != nullptr) made->follow(*first);
  return made;
}

std::span<const int32_t> novaphy_scan::carried() const {
  const novaphy_native_scan& form = *executable_->native.scan_rows;
  return {form.sources, static_cast<size_t>(form.outputs)};
}
std::span<const int32_t> novaphy_scan::varying() const {
  const novaphy_native_scan& form = *executable_->native.scan_rows;
  return {form.sources + form.outputs, static_cast<size_t>(form.varying)};
}

// Returns whether every launch reads the outputs of the previous launch, and otherwise has the
// argument words of the first launch.
bool novaphy_scan::same_but_for_arrays() const {
  const Program& p = executable_->program;
  std::vector<char> free(executable_->argument_count, 0);
  for (size_t o = 0; o < p.outputs.size(); ++o) free[p.output_argument(o)] = 1;
  for (const auto list : {carried(), varying()})
    for (const int32_t s : list) free[p.source_argument(static_cast<size_t>(s))] = 1;
  for (size_t k = 1; k < launches_.size(); ++k) {
    for (size_t o = 0; o < carried().size(); ++o)
      if (launches_[k][p.source_argument(static_cast<size_t>(carried()[o]))] !=
          launches_[k - 1][p.output_argument(o)])
        return false;
    for (uint32_t w = 0; w < executable_->argument_count; ++w)
      if (free[w] == 0 && launches_[k][w] != launches_[0][w]) return false;
  }
  return true;
}

// Returns whether a launch writes an array that the scan reads only once, before all launches.
bool novaphy_scan::writes_what_all_read() const {
  const Program& p = executable_->program;
  const auto once = [&](int32_t source) {
    const auto in = [source](std::span<const int32_t> list) {
      return std::find(list.begin(), list.end(), source) != list.end();
    };
    return !in(carried()) && !in(varying());
  };
  for (size_t s = 0; s < p.sources.size(); ++s) {
    const auto source = static_cast<int32_t>(s);
    if (!once(source)) continue;
    const Interval read = read_by(p, launches_[0], source);
    for (size_t k = 0; k < launches_.size(); ++k)
      for (size_t o = 0; o < carried().size(); ++o)
        if (read.overlaps(written_by(p, launches_[k], o, carried()[o]))) return true;
  }
  return false;
}

// Returns whether the output of a launch is read after the scan, or by a launch of the scan other
// than the next launch, which has the output in registers.
bool novaphy_scan::read_again(size_t k, size_t output) const {
  const Program& p = executable_->program;
  const Interval written = written_by(p, launches_[k], output, carried()[output]);
  for (size_t later = k + 1; later < std::min(launches_.size(), k + kLookForward); ++later) {
    for (const int32_t s : varying())
      if (written.overlaps(read_by(p, launches_[later], s))) return true;
    for (size_t o = 0; o < carried().size(); ++o) {
      const Interval next = written_by(p, launches_[later], o, carried()[o]);
      if (next.begin == written.begin && next.end == written.end) return false;
    }
  }
  return true;
}

void novaphy_scan::make_table() {
  const Program& p = executable_->program;
  for (size_t k = 0; k < launches_.size(); ++k) {
    for (const int32_t s : varying())
      table_.push_back(launches_[k][p.source_argument(static_cast<size_t>(s))]);
    for (size_t o = 0; o < carried().size(); ++o)
      table_.push_back(read_again(k, o) ? launches_[k][p.output_argument(o)] : 0);
    table_.push_back(k);
  }
  for (size_t k = 0; k < PREFETCH_LAUNCHES * launch_words(); ++k)
    table_.push_back(table_[table_.size() - launch_words()]);
  large_ = is_large();
}

// Returns whether the outputs exceed the caches and the compiled form can store them past the
// caches: rows of three numbers, where a group of rows fills whole cache lines.
bool novaphy_scan::is_large() const {
  const Program& p = executable_->program;
  if (executable_->native.lanes * 12 % kLine != 0) return false;
  uint64_t bytes = 0;
  for (size_t k = 0; k < launches_.size(); ++k)
    for (size_t o = 0; o < carried().size(); ++o) {
      if (table_[launch_words() * k + varying().size() + o] == 0) continue;
      const Interval written = written_by(p, launches_[k], o, carried()[o]);
      const nova::ir::Output& output = p.outputs[o];
      if (!nova::ir::handed_over(output.type, static_cast<int32_t>(output.values.size())) ||
          written.begin % kLine != 0)
        return false;
      bytes += written.end - written.begin;
    }
  return bytes >= kStreamedBytes;
}

void novaphy_scan::follow(novaphy_scan& first) {
  if (first.follows_ != nullptr || overwrites(first) || !asks_like(first)) return;
  follows_ = &first;
  first.notes_ = true;
  first.scratch_row_bytes_ = nova::ir::scratch_bytes(first.executable_->program, first.carried()) *
                             static_cast<int64_t>(first.launches_.size());
}

// Returns whether an array that a launch of `first` read or wrote as a carried array is written
// again, by `first` or by this scan. Its rows at a note would then differ from those in memory.
bool novaphy_scan::overwrites(const novaphy_scan& first) const {
  std::map<uint64_t, uint64_t> taken;
  const auto apart = [&](const Interval& i) {
    const auto next = taken.lower_bound(i.begin);
    return (next == taken.end() || next->first >= i.end) &&
           (next == taken.begin() || std::prev(next)->second <= i.begin);
  };
  const auto written = [](const novaphy_scan& scan, const auto& f) {
    for (const uint64_t* launch : scan.launches_)
      for (size_t o = 0; o < scan.carried().size(); ++o)
        if (!f(written_by(scan.executable_->program, launch, o, scan.carried()[o]))) return false;
    return true;
  };
  const auto take = [&](const Interval& i) {
    const bool fresh = apart(i);
    taken[i.begin] = i.end;
    return fresh;
  };
  for (const int32_t source : first.carried())
    if (!take(read_by(first.executable_->program, first.launches_[0], source))) return true;
  return !written(first, take) || !written(*this, apart);
}

// Returns whether every launch evaluates its conditions with the same values as a launch of
// `first`. Stores the numbers of the matching launches in the table.
bool novaphy_scan::asks_like(const novaphy_scan& first) {
  const Program &adjoint = executable_->program, &primal = first.executable_->program;
  const uint64_t hash = executable_->native.scan_rows->primal;
  if (hash == 0 || hash != nova::ir::hash(primal) || adjoint.param_count < primal.param_count ||
      adjoint.sources.size() < primal.sources.size())
    return false;
  struct Words {
    uint32_t here, there;
  };
  std::vector<Words> same;  // an adjoint begins with the sources of its primal
  for (size_t s = 0; s < primal.sources.size(); ++s)
    for (const uint32_t k : {0u, 1u})
      same.push_back({adjoint.source_argument(s) + k, primal.source_argument(s) + k});
  for (size_t l = 0; l < adjoint.loops.size(); ++l)
    for (const uint32_t k : {0u, 1u})
      same.push_back({adjoint.loop_argument(l) + k, primal.loop_argument(0) + k});
  for (size_t k = 0; k < static_cast<size_t>(primal.param_count); ++k)
    same.push_back({adjoint.param_argument(k), primal.param_argument(k)});

  const uint32_t state = primal.source_argument(static_cast<size_t>(first.carried()[0]));
  const auto words =
      std::find_if(same.begin(), same.end(), [&](const Words& w) { return w.there == state; });
  if (words == same.end()) return false;
  std::map<uint64_t, size_t> by_state;
  for (size_t k = 0; k < first.launches_.size(); ++k) by_state[first.launches_[k][state]] = k;
  for (size_t k = 0; k < launches_.size(); ++k) {
    const auto found = by_state.find(launches_[k][words->here]);
    if (found == by_state.end()) return false;
    for (const Words& w : same)
      if (launches_[k][w.here] != first.launches_[found->second][w.there]) return false;
    table_[launch_words() * k + launch_words() - 1] = found->second;
  }
  return true;
}

novaphy_status novaphy_scan::run(int64_t begin, int64_t end, novaphy_error* error) const {
  const novaphy::cpu::FloatMode mode;
  const NativeCode& code = executable_->native;
  novaphy_native_launches all = {};
  all.args = launches_[0];
  all.table = table_.data();
  all.count = static_cast<int64_t>(launches_.size());
  all.first = begin;
  Scratch& scratch = Scratch::of_thread();
  const bool writes = follows_ == nullptr;
  if (writes ? notes_ : scratch.has(follows_, begin, end))
    scratch.give((writes ? *this : *follows_), end - begin, all);
  all.streams = large_ && all.scratch != nullptr && begin * 12 % kLine == 0 ? 1 : 0;
  if (writes) scratch.from = nullptr;
  ErrorSink sink;
  bool whole = true;  // whether the compiled form ran all rows
  for (int64_t i = begin; i < end;) {
    const novaphy_native_scan& form = end - i >= code.lanes ? *code.scan_rows : *code.scan_scalar;
    const int64_t left = form.run(&all, i, end, &sink);
    if (left == end || left != i) {
      i = left;
      continue;
    }
    // Rows that the compiled form does not support run launch by launch.
    const int64_t stop = std::min(end, i + (end - i >= code.lanes ? code.lanes : 1));
    for (size_t k = 0; k < launches_.size(); ++k)
      run_native_rows(*executable_, launches_[k], i, stop, sink);
    i = stop;
    whole = false;
  }
#if defined(__x86_64__)
  if (all.streams != 0) _mm_sfence();  // makes streamed stores visible to other threads
#endif
  if (sink.index != INT64_MAX) [[unlikely]]
    return out_of_range(*executable_, sink, launches_[0], error);
  if (writes && whole) scratch.hold(this, begin, end);
  return NOVAPHY_OK;
}
