// The parts of persistent kernels for tests: kernels, and operations with their arguments.
#pragma once

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "module.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::gpu {

inline novaphy_kernel traced(const nova::Kernel& kernel) {
  novaphy_kernel made;
  made.program = kernel.program();
  made.argument_count = made.program.argument_count();
  return made;
}
// Adds rows of items to the own row.
inline novaphy_kernel collect_kernel() {
  using nova::Access;
  using nova::DType;
  using nova::TraceContext;
  return traced(nova::make_reduce_kernel(
      "collect", {{"own", DType::F32, 3, Access::Direct}, {"item", DType::F32, 3, Access::CsrRow}},
      {{"sum", 3}},
      {.init =
           [](TraceContext& t) {
             return std::vector{t.f32(0, 0), t.f32(0, 1), t.f32(0, 2)};
           },
       .body =
           [](TraceContext& t) {
             return std::vector{t.f32(1, 0), t.f32(1, 1), t.f32(1, 2)};
           },
       .epilogue = {}}));
}
inline novaphy_kernel row_sum_kernel() {
  novaphy_kernel sum;
  sum.name = "row_sum_f32";
  sum.argument_count = 7;
  sum.run = [](novaphy_stream*, const novaphy_kernel&, int64_t, const uint64_t*, novaphy_error*) {
    return NOVAPHY_OK;
  };
  return sum;
}

struct RecordedPersistent {
  std::vector<novaphy_persistent_op> ops;
  std::vector<std::unique_ptr<std::vector<uint64_t>>> words;  // by launch

  novaphy_persistent_op& add(uint32_t phase, uint32_t chain, int64_t n, int64_t rows) {
    novaphy_persistent_op o{};
    o.struct_size = sizeof(o);
    o.op.struct_size = sizeof(o.op);
    o.n = n;
    o.rows = rows;
    o.phase = phase;
    o.chain = chain;
    return ops.emplace_back(o);
  }
  void launch(novaphy_persistent_op& o, novaphy_kernel& kernel, std::vector<uint64_t> arguments) {
    words.push_back(std::make_unique<std::vector<uint64_t>>(std::move(arguments)));
    o.op.kernel = &kernel;
    o.op.arguments = words.back()->data();
    o.op.argument_count = kernel.argument_count;
  }
};

}  // namespace novaphy::gpu
