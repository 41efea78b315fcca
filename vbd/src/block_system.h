// BlockSystem: a sparse linear system of 6x6 blocks, solved by block elimination. The elimination
// takes the block with the fewest neighbors first, so a tree causes no fill. Blocks are inverted
// with partial pivoting. There is no pivoting between blocks.
//
// Source: George and Liu, Computer Solution of Large Sparse Positive Definite Systems (1981),
// chapter 5: minimum degree.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <set>
#include <utility>
#include <vector>

namespace novaphy::vbd {

using Row6 = std::array<double, 6>;
using Block6 = std::array<Row6, 6>;

// Adds scale times the product a x to y.
inline void add_product(const Block6& a, const Row6& x, double scale, Row6& y) {
  for (size_t i = 0; i < 6; ++i)
    for (size_t k = 0; k < 6; ++k) y[i] += scale * (a[i][k] * x[k]);
}

// As add_product, for the transpose of a.
inline void add_transposed(const Block6& a, const Row6& x, double scale, Row6& y) {
  for (size_t i = 0; i < 6; ++i)
    for (size_t k = 0; k < 6; ++k) y[i] += scale * (a[k][i] * x[k]);
}

// Returns the inverse of a block, by Gauss-Jordan elimination.
inline Block6 inverse(Block6 a) {
  Block6 b{};
  for (size_t i = 0; i < 6; ++i) b[i][i] = 1.0;
  for (size_t k = 0; k < 6; ++k) {
    size_t pivot = k;
    for (size_t i = k + 1; i < 6; ++i)
      if (std::abs(a[i][k]) > std::abs(a[pivot][k])) pivot = i;
    std::swap(a[k], a[pivot]);
    std::swap(b[k], b[pivot]);
    const double scale = 1.0 / a[k][k];
    for (size_t c = 0; c < 6; ++c) {
      a[k][c] *= scale;
      b[k][c] *= scale;
    }
    for (size_t i = 0; i < 6; ++i) {
      const double factor = a[i][k];
      if (i == k || factor == 0.0) continue;
      for (size_t c = 0; c < 6; ++c) {
        a[i][c] -= factor * a[k][c];
        b[i][c] -= factor * b[k][c];
      }
    }
  }
  return b;
}

class BlockSystem {
 public:
  explicit BlockSystem(size_t rows) : rows_(rows), inverse_(rows) {
    for (size_t i = 0; i < rows; ++i) rows_[i][i] = {};
  }
  // Returns the block at (i, j). The pattern stays symmetric.
  Block6& at(size_t i, size_t j) {
    rows_[j][i];
    return rows_[i][j];
  }

  void factor() {
    std::set<std::pair<size_t, size_t>> left;  // number of neighbors, block
    std::vector<std::set<size_t>> near(rows_.size());
    for (size_t i = 0; i < rows_.size(); ++i) {
      for (const auto& [j, block] : rows_[i])
        if (j != i) near[i].insert(j);
      left.insert({near[i].size(), i});
    }
    while (!left.empty()) {
      const size_t k = left.begin()->second;
      left.erase(left.begin());
      order_.push_back(k);
      inverse_[k] = inverse(rows_[k][k]);
      for (const size_t i : near[k]) {
        left.erase({near[i].size(), i});
        near[i].erase(k);
        for (const size_t j : near[k])
          if (j != i) near[i].insert(j);
        left.insert({near[i].size(), i});
      }
      eliminate(k, near[k]);
      after_.emplace_back(near[k].begin(), near[k].end());
    }
  }

  // Replaces b by the solution. Call factor() before.
  void solve(std::vector<Row6>& b) const {
    for (size_t n = 0; n < order_.size(); ++n)
      for (const size_t i : after_[n]) add_product(rows_[i].at(order_[n]), b[order_[n]], -1.0, b[i]);
    for (size_t n = order_.size(); n-- > 0;) {
      const size_t k = order_[n];
      for (const size_t j : after_[n]) add_product(rows_[k].at(j), b[j], -1.0, b[k]);
      Row6 x{};
      add_product(inverse_[k], b[k], 1.0, x);
      b[k] = x;
    }
  }
  // As solve(), for the transposed system.
  void solve_transposed(std::vector<Row6>& b) const {
    for (size_t n = 0; n < order_.size(); ++n) {
      const size_t k = order_[n];
      Row6 x{};
      add_transposed(inverse_[k], b[k], 1.0, x);
      b[k] = x;
      for (const size_t j : after_[n]) add_transposed(rows_[k].at(j), b[k], -1.0, b[j]);
    }
    for (size_t n = order_.size(); n-- > 0;)
      for (const size_t i : after_[n])
        add_transposed(rows_[i].at(order_[n]), b[i], -1.0, b[order_[n]]);
  }

 private:
  // Subtracts the products with the pivot k from the blocks of its neighbors. The block (i, k) then
  // holds the factor of row k in row i.
  void eliminate(size_t k, const std::set<size_t>& near) {
    for (const size_t i : near) {
      Block6& own = rows_[i][k];
      Block6 factor{};
      for (size_t r = 0; r < 6; ++r)
        for (size_t c = 0; c < 6; ++c)
          for (size_t m = 0; m < 6; ++m) factor[r][c] += own[r][m] * inverse_[k][m][c];
      own = factor;
      for (const size_t j : near) {
        Block6& to = rows_[i][j];
        const Block6& from = rows_[k][j];
        for (size_t r = 0; r < 6; ++r)
          for (size_t c = 0; c < 6; ++c)
            for (size_t m = 0; m < 6; ++m) to[r][c] -= factor[r][m] * from[m][c];
      }
    }
  }

  std::vector<std::map<size_t, Block6>> rows_;
  std::vector<Block6> inverse_;
  std::vector<size_t> order_;
  std::vector<std::vector<size_t>> after_;  // the neighbors of each pivot that follow it
};

}  // namespace novaphy::vbd
