// The result of list_create and persistent_create: one kernel with its arguments.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "module.h"

struct novaphy_list {
  novaphy_device* device = nullptr;
  novaphy::gpu::Module module = nullptr;
  novaphy::gpu::Function function = nullptr;
  // The kernel's arguments: the words by value, the address of a table, a number, and the error
  // sink.
  std::vector<uint64_t> words;
  novaphy::gpu::DevicePointer table = 0;
  int64_t n = 0;
  int64_t blocks = 1;
  unsigned threads = 0;
  unsigned shared_bytes = 0;  // per block, in addition to the static shared memory of the text
  // A kernel that runs first and computes the early halves (persistent.cuh), with blocks of
  // kEarlyThreads, and the memory for its results.
  static constexpr unsigned kEarlyThreads = 128;
  novaphy::gpu::Function early = nullptr;
  novaphy::gpu::DevicePointer early_memory = 0, jobs = 0;
  uint32_t blocks_of_job = 0, job_count = 0;
  bool together = false;  // the blocks wait for one another and must run at the same time
};

namespace novaphy::gpu {

struct DestroyList {
  void operator()(novaphy_list* list) const { list_destroy(list); }
};
using OwnList = std::unique_ptr<novaphy_list, DestroyList>;

// Compiles the text, and copies the table to the device. The words of the table at the positions
// `relative` are offsets in bytes from its start and are replaced by addresses.
novaphy_status load_list(novaphy_list& list, const std::string& text, bool contract,
                         std::vector<uint64_t>& table, std::span<const uint64_t> relative,
                         novaphy_error* error);

}  // namespace novaphy::gpu
