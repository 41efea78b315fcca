#include "novaphy/program/series.h"

#include <algorithm>

namespace nova::ir {
namespace {

constexpr size_t kMinInstructions = 40;

// Whether every read is at the row of the launch.
bool read_at_own_row(const Program& p, int32_t source) {
  return std::all_of(p.instrs.begin(), p.instrs.end(), [&](const Instr& in) {
    const bool load = in.op == Op::LOAD_F || in.op == Op::LOAD_I;
    return !load || in.a != source || p.instrs[static_cast<size_t>(in.b)].op == Op::INDEX;
  });
}

int32_t source_of(const Program& p, const Output& output) {
  for (size_t s = 0; s < p.sources.size(); ++s) {
    const Source& source = p.sources[s];
    if (source.name == output.name && source.type == output.type &&
        static_cast<size_t>(source.width) == output.values.size() &&
        source.access == Access::Direct && read_at_own_row(p, static_cast<int32_t>(s)))
      return static_cast<int32_t>(s);
  }
  return -1;
}

}  // namespace

std::optional<Series> find_series(const Program& program) {
  if (program.instrs.size() < kMinInstructions) return std::nullopt;
  Series series;
  for (const Output& output : program.outputs) {
    const int32_t source = source_of(program, output);
    if (source < 0 || std::count(series.carried.begin(), series.carried.end(), source) != 0)
      return std::nullopt;
    series.carried.push_back(source);
  }
  // A gradient that comes from elsewhere in every launch.
  for (size_t s = 0; s < program.sources.size(); ++s)
    if (program.sources[s].name.starts_with("grad_") &&
        std::count(series.carried.begin(), series.carried.end(), static_cast<int32_t>(s)) == 0)
      return std::nullopt;
  const auto carries_gradient_of = [&](const Source& source) {
    return std::any_of(program.outputs.begin(), program.outputs.end(),
                       [&](const Output& o) { return o.name == "grad_" + source.name; });
  };
  for (size_t s = 0; s < program.sources.size(); ++s) {
    const auto source = static_cast<int32_t>(s);
    if (program.sources[s].access == Access::Direct && carries_gradient_of(program.sources[s]) &&
        read_at_own_row(program, source))
      series.varying.push_back(source);
  }
  return series;
}

int32_t room_bytes(const Program& program, std::span<const int32_t> carried) {
  int32_t bytes = 0;
  for (const int32_t source : carried)
    bytes += 4 * program.sources[static_cast<size_t>(source)].width;
  return bytes;
}

}  // namespace nova::ir
