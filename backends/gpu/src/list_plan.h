// The structure of a list of operations as one kernel. Most lists are a few operations, then the
// same operations again and again (a rollout's substeps), then a few more. The middle becomes a
// loop, which keeps results for later operations in registers.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "module.h"

namespace novaphy::gpu {

struct ListPlan {
  struct Source {
    enum class From : uint8_t {
      Memory,    // as in a separate launch
      Constant,  // memory that no operation of the list writes
      Registers  // output `output` of operation `op` of the loop's body
    } from = From::Memory;
    uint32_t op = 0, output = 0;
    bool carried = false;  // from the previous iteration; the first iteration loads the row
  };
  struct Site {             // an operation in the text of the kernel
    uint32_t op = 0;        // index in the list: of the operation, or of its first iteration
    uint32_t function = 0;  // index of the Program, for kernels only
    std::vector<Source> sources;
  };
  std::vector<const nova::ir::Program*> programs;  // without duplicates
  uint32_t first = 0, period = 0, repeats = 0;     // the loop's body and its repetitions; period 0:
                                                   // no loop
  std::vector<Site> before, body, after;
  bool worth_it = false;
};
ListPlan plan_list(std::span<const novaphy_list_op> ops);

// The text and the words that it reads: `words` is an argument of the kernel, `table` is in memory
// with `table_width` words per iteration.
struct ListSource {
  std::string text;
  std::vector<uint64_t> words, table;
  uint32_t table_width = 0;
  bool fits = true;  // whether the words fit into an argument
};
ListSource list_source(const ListPlan& plan, std::span<const novaphy_list_op> ops, int64_t n);

}  // namespace novaphy::gpu
