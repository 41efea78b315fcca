// Counts the heap allocations of all threads of the process, in programs that link allocations.cpp.
// With glibc the count covers malloc and related functions. Without glibc and under sanitizers it
// covers operator new.
#pragma once

#include <algorithm>
#include <cstdint>

namespace novaphy::testing {

int64_t allocations();

// Returns the allocations of `count` calls of step(). `warm` calls before let kept memory grow. The
// result is the minimum over some rounds, because a busy machine may wake a thread of the pool
// late.
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
