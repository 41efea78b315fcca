// A double as a scalar of formulas, with the functions that formulas need.
#pragma once

#include <cmath>

namespace novaphy::testing {

struct Real64 {
  double v = 0.0;
  Real64() = default;
  explicit Real64(double value) : v(value) {}
  friend Real64 operator+(Real64 a, Real64 b) { return Real64(a.v + b.v); }
  friend Real64 operator-(Real64 a, Real64 b) { return Real64(a.v - b.v); }
  friend Real64 operator*(Real64 a, Real64 b) { return Real64(a.v * b.v); }
  friend Real64 operator/(Real64 a, Real64 b) { return Real64(a.v / b.v); }
  friend Real64 operator-(Real64 a) { return Real64(-a.v); }
  friend bool operator<(Real64 a, Real64 b) { return a.v < b.v; }
  friend bool operator>(Real64 a, Real64 b) { return a.v > b.v; }
  friend bool operator>=(Real64 a, Real64 b) { return a.v >= b.v; }
  friend Real64 select(bool c, Real64 a, Real64 b) { return c ? a : b; }
  friend Real64 min(Real64 a, Real64 b) { return a.v <= b.v ? a : b; }
  friend Real64 max(Real64 a, Real64 b) { return a.v >= b.v ? a : b; }
  friend Real64 sqrt(Real64 a) { return Real64(std::sqrt(a.v)); }
  friend Real64 atan2(Real64 y, Real64 x) { return Real64(std::atan2(y.v, x.v)); }
};

}  // namespace novaphy::testing
