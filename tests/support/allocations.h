// How often memory was taken from the heap, by all threads of the process: malloc and its kin where
// the C library is glibc, else and under sanitizers operator new. A program that links
// allocations.cpp counts.
#pragma once

#include <cstdint>

namespace novaphy::testing {

int64_t allocations();

// Those of `count` calls of step(), after `warm` calls, in which memory that is kept grows.
template <class Step>
int64_t allocations_of(Step&& step, int count = 8, int warm = 3) {
  for (int k = 0; k < warm; ++k) step();
  const int64_t before = allocations();
  for (int k = 0; k < count; ++k) step();
  return allocations() - before;
}

}  // namespace novaphy::testing
