// Counts the contact rows that are filled, for the host.
#pragma once

#include <cstdint>

namespace novaphy {

// Returns the number of filled rows of contacts. `count` is the number of contacts that the search
// found, and `most` the number of rows. `shape0` {most} is negative in an empty row. If count
// exceeds most, the first row with a negative shape0 ends the filled rows: a recorded search also
// counts pairs that did not fit into its list and fills no rows for them.
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
