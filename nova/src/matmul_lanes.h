// The matrix product on the CPU: every entry adds its products one after the other, each rounded
// before it is added, as the kernel that devices run.
#pragma once

#include <cstdint>

namespace nova {

// Entry (r, c) of a matrix: at r * row + c * column. Members of 8 bytes, the words of a launch.
struct ProductWords {
  const float *a, *b;
  float* out;  // rows by columns, one row after the other
  int64_t a_row, a_column, b_row, b_column;
  int64_t rows, columns, shared;
};

struct ProductLevel {
  const char* name;
  void (*multiply)(const ProductWords& product, int64_t begin, int64_t end);  // rows of the result
};

}  // namespace nova
