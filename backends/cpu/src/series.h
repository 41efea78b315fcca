// A series of launches of one compiled kernel: see <novaphy/program/series.h>.
#pragma once

#include <stdint.h>

#include <memory>
#include <span>
#include <vector>

#include "module.h"

struct novaphy_series {
 public:
  // Null when the kernel has no compiled form for a series, or the launches differ in more than
  // that form allows.
  static std::unique_ptr<novaphy_series> make(const novaphy::cpu::Executable& executable,
                                              std::span<const uint64_t* const> launches);
  // The rows [begin, end) of all launches, on the calling thread.
  novaphy_status run(int64_t begin, int64_t end, novaphy_error* error) const;

 private:
  explicit novaphy_series(const novaphy::cpu::Executable& executable) : executable_(&executable) {}
  std::span<const int32_t> carried() const;  // per output: the source
  std::span<const int32_t> varying() const;
  bool same_but_for_arrays() const;
  bool writes_what_all_read() const;
  bool read_again(size_t k, size_t output) const;
  void make_table();

  const novaphy::cpu::Executable* executable_;
  std::vector<const uint64_t*> launches_;  // the argument words of each
  std::vector<uint64_t> table_;            // what the compiled form reads of each launch
};
