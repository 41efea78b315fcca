// Counts the heap allocations of all threads of the process, in programs that link allocations.cpp.
// With glibc the count covers malloc and related functions. Without glibc and under sanitizers it
// covers operator new.
#pragma once

#include <algorithm>
#include <cstdint>

namespace novaphy::testing {

int64_t allocations();

// Those of `count` calls of step(), after `warm` calls, in which memory that is kept grows. The
// fewest of some rounds: a thread of the pool that a busy machine wakes late takes its memory then.
template <class Step>
int64_t allocations_of(Step&& step, int count = 8, int warm = 3) {
  for (int k = 0; k < warm; ++k) step();
  int64_t fewest = INT64_MAX;
  for (int round = 0; round < 4 && fewest != 0; ++round) {
    const int64_t before = allocations();
    for (int k = 0; k < count; ++k) step();
    fewest = std::min(fewest, allocations() - before);
  }
  return fewest;
}

}  // namespace novaphy::testing
