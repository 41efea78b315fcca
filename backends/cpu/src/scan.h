// A scan of launches of one compiled kernel: see <novaphy/program/scan.h>.
#pragma once

#include <stdint.h>

#include <memory>
#include <span>
#include <vector>

#include "module.h"

struct novaphy_scan {
 public:
  // Returns null if the kernel has no compiled form for a scan, or if the launches differ in more
  // than that form allows. `first` is null, or a scan that always runs just before this scan, on
  // the same rows and thread. No work in between writes the arrays that `first` read or wrote. If
  // both scans evaluate the same conditions, `first` records for this scan in which launches no
  // contact touched and no limit was reached. `first` also keeps the rows that the other launches
  // read, so that large outputs may bypass the caches.
  static std::unique_ptr<novaphy_scan> make(const novaphy::cpu::Executable& executable,
                                            std::span<const uint64_t* const> launches,
                                            novaphy_scan* first);
  // Runs the rows [begin, end) of all launches on the calling thread.
  novaphy_status run(int64_t begin, int64_t end, novaphy_error* error) const;

 private:
  struct Scratch;
  explicit novaphy_scan(const novaphy::cpu::Executable& executable) : executable_(&executable) {}
  std::span<const int32_t> carried() const;  // the source to which each output is carried
  std::span<const int32_t> varying() const;
  bool same_but_for_arrays() const;
  bool writes_what_all_read() const;
  bool read_again(size_t k, size_t output) const;
  bool is_large() const;
  void make_table();
  void follow(novaphy_scan& first);
  size_t launch_words() const { return varying().size() + carried().size() + 1; }
  bool asks_like(const novaphy_scan& first);
  bool overwrites(const novaphy_scan& first) const;

  const novaphy::cpu::Executable* executable_;
  std::vector<const uint64_t*> launches_;  // the argument words of each launch
  std::vector<uint64_t> table_;            // the table of launches that the compiled form reads
  bool large_ = false;                     // whether stores of outputs bypass the caches
  bool notes_ = false;                     // whether the scan writes notes for a following scan
  int64_t scratch_row_bytes_ = 0;          // bytes of the scratch per row
  const novaphy_scan* follows_ = nullptr;  // the scan whose notes this scan reads
};
