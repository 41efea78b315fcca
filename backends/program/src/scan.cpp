#include "novaphy/program/scan.h"

#include <algorithm>

namespace nova::ir {
namespace {

constexpr size_t kMinInstructions = 40;

// Returns whether every read of the source is at the row of the launch.
bool read_at_own_row(const Program& p, int32_t source) {
  return std::all_of(p.instrs.begin(), p.instrs.end(), [&](const Instr& in) {
    const bool load = in.op == Op::LOAD_F || in.op == Op::LOAD_I;
    return !load || in.a != source || p.instrs[static_cast<size_t>(in.b)].op == Op::INDEX;
  });
}

}  // namespace

std::optional<Scan> find_scan(const Program& program) {
  if (program.instrs.size() < kMinInstructions) return std::nullopt;
  const auto at_own_row = [&](int32_t source) {
    return program.sources[static_cast<size_t>(source)].access == Access::Direct &&
           read_at_own_row(program, source);
  };
  Scan scan;
  for (const Output& output : program.outputs) {
    if (output.carried == kNone || !at_own_row(output.carried)) return std::nullopt;
    scan.carried.push_back(output.carried);
  }
  for (int32_t s = 0; s < static_cast<int32_t>(program.sources.size()); ++s)
    if (program.sources[static_cast<size_t>(s)].varies && at_own_row(s)) scan.varying.push_back(s);
  return scan;
}

int32_t scratch_bytes(const Program& program, std::span<const int32_t> carried) {
  int32_t bytes = 0;
  for (const int32_t source : carried)
    bytes += 4 * program.sources[static_cast<size_t>(source)].width;
  return bytes;
}

}  // namespace nova::ir
