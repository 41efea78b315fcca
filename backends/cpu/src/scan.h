// A scan of launches of one compiled kernel: see <novaphy/program/scan.h>.
#pragma once

#include <stdint.h>

#include <memory>
#include <span>
#include <vector>

#include "module.h"

struct novaphy_scan {
 public:
  // Null when the kernel has no compiled form for a scan, or the launches differ in more than
  // that form allows. `first`: null, or a scan that always runs just before on the same rows and
  // thread, and nothing in between writes what it read or wrote. If the new one asks the same
  // questions, `first` notes for it which launches were quiet, and keeps near by what the others
  // read, so that large outputs may be written past the caches.
  static std::unique_ptr<novaphy_scan> make(const novaphy::cpu::Executable& executable,
                                            std::span<const uint64_t* const> launches,
                                            novaphy_scan* first);
  // The rows [begin, end) of all launches, on the calling thread.
  novaphy_status run(int64_t begin, int64_t end, novaphy_error* error) const;

 private:
  struct Room;
  explicit novaphy_scan(const novaphy::cpu::Executable& executable) : executable_(&executable) {}
  std::span<const int32_t> carried() const;  // per output: the source
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
  std::vector<const uint64_t*> launches_;  // the argument words of each
  std::vector<uint64_t> table_;            // what the compiled form reads of each launch
  bool large_ = false;                     // the outputs are worth streaming
  bool notes_ = false;                     // whether it writes notes for a scan that follows
  int64_t room_row_bytes_ = 0;             // what a row takes of the room for that
  const novaphy_scan* follows_ = nullptr;  // whose notes this one reads
};
