#include "native_tables.h"

#include <algorithm>
#include <string_view>

namespace novaphy::cpu {
namespace {

std::span<const NativeLevel> g_levels;

const novaphy_native_kernel* find_in(const novaphy_native_table& table, uint64_t hash) {
  const novaphy_native_kernel* const end = table.kernels + table.count;
  const novaphy_native_kernel* const found = std::lower_bound(
      table.kernels, end, hash,
      [](const novaphy_native_kernel& kernel, uint64_t wanted) { return kernel.hash < wanted; });
  return found != end && found->hash == hash ? found : nullptr;
}

const novaphy_native_kernel* find_level(std::string_view level, const nova::ir::Program& program,
                                        uint64_t hash, int32_t& lanes) {
  for (const NativeLevel& candidate : g_levels) {
    if (level != candidate.name) continue;
    for (const novaphy_native_table* part : candidate.parts) {
      const novaphy_native_kernel* kernel = find_in(*part, hash);
      if (kernel == nullptr || kernel->instructions != program.instrs.size() ||
          kernel->arguments != program.argument_count())
        continue;
      lanes = part->lanes;
      return kernel;
    }
  }
  return nullptr;
}

}  // namespace

void set_native_levels(std::span<const NativeLevel> levels) { g_levels = levels; }

NativeCode find_native(const nova::ir::Program& program, const char* isa) {
  if (g_levels.empty()) return {};
  const uint64_t hash = nova::ir::hash(program);
  int32_t one = 1, lanes = 1;
  const novaphy_native_kernel* const scalar = find_level("scalar", program, hash, one);
  if (scalar == nullptr) return {};
  const novaphy_native_kernel* rows = find_level(isa, program, hash, lanes);
  if (rows == nullptr) rows = scalar;  // no code was compiled for this instruction set
  return {rows->run, scalar->run, lanes, rows->scan, scalar->scan};
}

}  // namespace novaphy::cpu
