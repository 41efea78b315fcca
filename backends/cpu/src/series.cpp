#include "series.h"

#include <algorithm>

#include "novaphy/cpu/float_mode.h"

namespace {

using nova::ir::Program;
using novaphy::cpu::ErrorSink;
using novaphy::cpu::NativeCode;

struct Interval {
  uint64_t begin, end;
  bool overlaps(const Interval& other) const { return begin < other.end && other.begin < end; }
};

// What a launch may read through a source.
Interval read_by(const Program& p, const uint64_t* arguments, int32_t source) {
  const auto s = static_cast<size_t>(source);
  const uint64_t begin = arguments[p.source_argument(s)];
  const uint64_t rows = arguments[p.source_argument(s) + 1];
  return {begin, begin + rows * static_cast<uint64_t>(p.sources[s].width) * 4};
}

// An output has the rows of the source that it is carried to.
Interval written_by(const Program& p, const uint64_t* arguments, size_t output, int32_t carried) {
  const Interval like = read_by(p, arguments, carried);
  const uint64_t begin = arguments[p.output_argument(output)];
  return {begin, begin + (like.end - like.begin)};
}

// A write that follows another to the same array is looked for in so many launches.
constexpr size_t kLookAhead = 8;

}  // namespace

std::unique_ptr<novaphy_series> novaphy_series::make(const novaphy::cpu::Executable& executable,
                                                     std::span<const uint64_t* const> launches) {
  if (executable.native.series_rows == nullptr || executable.native.series_scalar == nullptr)
    return nullptr;
  std::unique_ptr<novaphy_series> made(new novaphy_series(executable));
  made->launches_.assign(launches.begin(), launches.end());
  if (!made->same_but_for_arrays() || made->writes_what_all_read()) return nullptr;
  made->make_table();
  return made;
}

std::span<const int32_t> novaphy_series::carried() const {
  const novaphy_native_series& form = *executable_->native.series_rows;
  return {form.sources, static_cast<size_t>(form.outputs)};
}
std::span<const int32_t> novaphy_series::varying() const {
  const novaphy_native_series& form = *executable_->native.series_rows;
  return {form.sources + form.outputs, static_cast<size_t>(form.varying)};
}

// Whether every launch reads what the one before wrote, and has the other words of the first.
bool novaphy_series::same_but_for_arrays() const {
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

// Whether a launch writes what is read once, before all of them.
bool novaphy_series::writes_what_all_read() const {
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

// Whether anything but the next launch, which has it in registers, reads what a launch writes:
// after the series, or in it.
bool novaphy_series::read_again(size_t k, size_t output) const {
  const Program& p = executable_->program;
  const Interval written = written_by(p, launches_[k], output, carried()[output]);
  for (size_t later = k + 1; later < std::min(launches_.size(), k + kLookAhead); ++later) {
    for (const int32_t s : varying())
      if (written.overlaps(read_by(p, launches_[later], s))) return true;
    for (size_t o = 0; o < carried().size(); ++o) {
      const Interval next = written_by(p, launches_[later], o, carried()[o]);
      if (next.begin == written.begin && next.end == written.end) return false;
    }
  }
  return true;
}

void novaphy_series::make_table() {
  const Program& p = executable_->program;
  for (size_t k = 0; k < launches_.size(); ++k) {
    for (const int32_t s : varying())
      table_.push_back(launches_[k][p.source_argument(static_cast<size_t>(s))]);
    for (size_t o = 0; o < carried().size(); ++o)
      table_.push_back(read_again(k, o) ? launches_[k][p.output_argument(o)] : 0);
  }
  const size_t width = varying().size() + carried().size();
  for (size_t k = 0; k < LAUNCHES_AHEAD * width; ++k)
    table_.push_back(table_[table_.size() - width]);
}

novaphy_status novaphy_series::run(int64_t begin, int64_t end, novaphy_error* error) const {
  const novaphy::cpu::FloatMode mode;
  const NativeCode& code = executable_->native;
  const auto count = static_cast<int64_t>(launches_.size());
  ErrorSink sink;
  for (int64_t i = begin; i < end;) {
    const novaphy_native_series& form =
        end - i >= code.lanes ? *code.series_rows : *code.series_scalar;
    const int64_t left = form.run(launches_[0], table_.data(), count, i, end, &sink);
    if (left == end || left != i) {
      i = left;
      continue;
    }
    // Rows that this form cannot do, launch by launch.
    const int64_t stop = std::min(end, i + (end - i >= code.lanes ? code.lanes : 1));
    for (size_t k = 0; k < launches_.size(); ++k)
      run_native_rows(*executable_, launches_[k], i, stop, sink);
    i = stop;
  }
  if (sink.index != INT64_MAX) [[unlikely]]
    return out_of_range(*executable_, sink, launches_[0], error);
  return NOVAPHY_OK;
}
