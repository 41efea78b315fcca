// Counts the contact rows that are filled, for the host.
#pragma once

#include <cstdint>

namespace novaphy {

// Returns the number of filled rows. `count` is the number of contacts found, and `most` the number
// of slots. A recorded search whose list of pairs is full counts pairs that have no rows, and
// leaves the last slots empty. `shape0` {most} is negative in an empty slot.
template <class Column>
int32_t filled_rows(int32_t count, int64_t most, const Column& shape0) {
  if (count <= most) return count < 0 ? 0 : count;
  int64_t filled = 0, end = most;
  while (filled < end) {
    const int64_t middle = (filled + end) / 2;
    if (shape0[middle] < 0)
      end = middle;
    else
      filled = middle + 1;
  }
  return static_cast<int32_t>(filled);
}

}  // namespace novaphy
