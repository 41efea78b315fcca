// The matrix product on the CPU. Each entry adds its products in order and rounds each product
// before the addition, like the kernel for devices.
#pragma once

#include <cstdint>

namespace nova {

// A matrix product as words of a launch (8 bytes per member). Entry (r, c) of a matrix is at r *
// row + c * column.
struct ProductWords {
  const float *a, *b;
  float* out;  // {rows, columns}, row-major
  int64_t a_row, a_column, b_row, b_column;
  int64_t rows, columns, shared;
};

struct ProductLevel {
  const char* name;
  // computes the rows [begin, end) of the result
  void (*multiply)(const ProductWords& product, int64_t begin, int64_t end);
};

}  // namespace nova
