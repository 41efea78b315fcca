// What list_create and sequence_create make: one kernel with its arguments.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "module.h"

struct novaphy_list {
  novaphy_device* device = nullptr;
  novaphy::gpu::Module module = nullptr;
  novaphy::gpu::Function function = nullptr;
  // The kernel's arguments: words by value, a table in memory, a number, and the sink of errors.
  std::vector<uint64_t> words;
  novaphy::gpu::DevicePointer table = 0;
  int64_t n = 0;
  int64_t blocks = 1;
  unsigned threads = 0;
  bool together = false;  // the blocks wait for one another
};

namespace novaphy::gpu {

struct DestroyList {
  void operator()(novaphy_list* list) const { list_destroy(list); }
};
using OwnList = std::unique_ptr<novaphy_list, DestroyList>;

// Compiles the text, and copies the table to the device.
novaphy_status load_list(novaphy_list& list, const std::string& text, bool contract,
                         const std::vector<uint64_t>& table, novaphy_error* error);

}  // namespace novaphy::gpu
