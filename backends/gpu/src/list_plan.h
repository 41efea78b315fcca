// A list of operations as one kernel: its structure. Most lists are a few operations, then the same
// operations again and again (a rollout's substeps), then a few more. The middle becomes a loop
// that keeps in registers what one operation leaves for a later one.
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
      Memory,    // as a launch of its own would read it
      Constant,  // memory that no operation of the list writes
      Registers  // what output `output` of body operation `op` left
    } from = From::Memory;
    uint32_t op = 0, output = 0;
    bool carried = false;  // of the iteration before; the first one loads from memory
  };
  struct Site {             // an operation in the text
    uint32_t op = 0;        // of the list: itself, or of the first iteration
    uint32_t function = 0;  // which Program; of kernels only
    std::vector<Source> sources;
  };
  std::vector<const nova::ir::Program*> programs;  // each once
  uint32_t first = 0, period = 0, repeats = 0;     // of the body; period 0: there is none
  std::vector<Site> before, body, after;
  bool worth_it = false;
};
ListPlan plan_list(std::span<const novaphy_list_op> ops);

// The text, and the words that it reads: `words` as an argument of the kernel, `table` (per
// iteration `table_width` words) from memory.
struct ListSource {
  std::string text;
  std::vector<uint64_t> words, table;
  uint32_t table_width = 0;
  bool fits = true;  // the words are few enough for an argument
};
ListSource list_source(const ListPlan& plan, std::span<const novaphy_list_op> ops, int64_t n);

}  // namespace novaphy::gpu
