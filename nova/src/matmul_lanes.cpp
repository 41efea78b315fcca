#include "matmul_lanes.h"

#include <algorithm>
#include <cstring>
#include <vector>

#define NOVAPHY_LANES nova::NOVAPHY_LEVEL
#include "novaphy/core/lanes.h"

namespace nova::NOVAPHY_LEVEL {

namespace {

constexpr int64_t kWidth = 2 * LANES;  // columns of a tile in registers
constexpr int64_t kHeight = 6;         // rows of a tile: 12 sums use 12 of 16 registers

VectorF load(const float* at) {
  VectorF v;
  std::memcpy(&v, at, sizeof(v));
  return v;
}

// Computes a tile of `height` rows and kWidth columns. `b_row`: floats from one row of b to the
// next.
template <int64_t height>
void tile(const ProductWords& p, const float* a, const float* b, int64_t b_row, float* out,
          int64_t columns) {
  VectorF sums[height][2] = {};
  for (int64_t k = 0; k < p.shared; ++k) {
    const VectorF left = load(b), right = load(b + LANES);
    for (int64_t r = 0; r < height; ++r) {
      const float factor = a[r * p.a_row];
      sums[r][0] += left * factor;
      sums[r][1] += right * factor;
    }
    a += p.a_column;
    b += b_row;
  }
  for (int64_t r = 0; r < height; ++r)
    std::memcpy(out + r * p.columns, sums[r], static_cast<size_t>(columns) * sizeof(float));
}

using Tile = void (*)(const ProductWords&, const float*, const float*, int64_t, float*, int64_t);
constexpr Tile kTiles[kHeight] = {tile<1>, tile<2>, tile<3>, tile<4>, tile<5>, tile<6>};

void multiply(const ProductWords& p, int64_t begin, int64_t end) {
  thread_local std::vector<float> packed;
  for (int64_t j = 0; j < p.columns; j += kWidth) {
    const int64_t columns = std::min(kWidth, p.columns - j);
    const float* b = p.b + j * p.b_column;
    int64_t b_row = p.b_row;
    if (columns < kWidth || p.b_column != 1) {
      packed.assign(static_cast<size_t>(p.shared * kWidth), 0.0f);
      for (int64_t c = 0; c < columns; ++c)
        for (int64_t k = 0; k < p.shared; ++k)
          packed[static_cast<size_t>(k * kWidth + c)] = b[k * p.b_row + c * p.b_column];
      b = packed.data();
      b_row = kWidth;
    }
    for (int64_t i = begin; i < end; i += kHeight) {
      const int64_t height = std::min(kHeight, end - i);
      kTiles[height - 1](p, p.a + i * p.a_row, b, b_row, p.out + i * p.columns + j, columns);
    }
  }
}

}  // namespace

extern const ProductLevel kLevel;
const ProductLevel kLevel = {NOVAPHY_LEVEL_NAME, multiply};

}  // namespace nova::NOVAPHY_LEVEL
