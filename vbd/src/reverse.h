// Reverse: lanes that record what they are computed from, for the gradient of one scalar. The
// formulas are instantiated with it as they stand.
#pragma once

#include "lanes.h"
#include "novaphy/math/functions.h"

namespace novaphy::vbd::NOVAPHY_VBD_LEVEL {

// The operations of one formula, each with the derivatives by its operands.
class Trace {
 public:
  static constexpr int32_t kMostNodes = 2048;

  void clear() { count_ = 0; }
  int32_t add(int32_t a, Lanes da, int32_t b, Lanes db) {
    da_[count_] = da.v;
    db_[count_] = db.v;
    operands_[count_] = {a, b};
    return count_++;
  }
  // Derivatives of node `root` by every node before it. A derivative of 0 passes nothing on, also
  // where the next one is not finite: it belongs to a branch that was not taken.
  void run(int32_t root) {
    for (int32_t k = 0; k < root; ++k) bars_[k] = VectorF{};
    bars_[root] = VectorF{} + 1.0f;
    for (int32_t k = root; k >= 0; --k) {
      const VectorF bar = bars_[k];
      const auto [a, b] = operands_[k];
      if (a >= 0) bars_[a] += bar == 0.0f ? VectorF{} : bar * da_[k];
      if (b >= 0) bars_[b] += bar == 0.0f ? VectorF{} : bar * db_[k];
    }
  }
  Lanes bar(int32_t node) const { return Lanes(bars_[node]); }

 private:
  struct Operands {
    int32_t a, b;
  };
  // Apart, so that no vector is padded. Without constructors: a trace is not cleared when it is
  // made.
  VectorF da_[kMostNodes], db_[kMostNodes], bars_[kMostNodes];
  Operands operands_[kMostNodes];
  int32_t count_;
};

struct Reverse {
  Lanes v{};
  Trace* trace = nullptr;  // null: a constant
  int32_t node = -1;

  Reverse() = default;
  explicit Reverse(float value) : v(value) {}
  explicit Reverse(Lanes value) : v(value) {}

  static Reverse input(Trace& trace, Lanes value) {
    Reverse r(value);
    r.trace = &trace;
    r.node = trace.add(-1, Lanes(), -1, Lanes());
    return r;
  }
  NOVAPHY_LANE_FN static Reverse of(Lanes value, const Reverse& a, Lanes da, const Reverse& b,
                                    Lanes db) {
    Reverse r(value);
    r.trace = a.trace != nullptr ? a.trace : b.trace;
    if (r.trace != nullptr) r.node = r.trace->add(a.node, da, b.node, db);
    return r;
  }
  Lanes bar() const { return trace->bar(node); }

  friend Reverse operator+(const Reverse& a, const Reverse& b) {
    return of(a.v + b.v, a, Lanes(1.0f), b, Lanes(1.0f));
  }
  friend Reverse operator-(const Reverse& a, const Reverse& b) {
    return of(a.v - b.v, a, Lanes(1.0f), b, Lanes(-1.0f));
  }
  friend Reverse operator*(const Reverse& a, const Reverse& b) {
    return of(a.v * b.v, a, b.v, b, a.v);
  }
  friend Reverse operator/(const Reverse& a, const Reverse& b) {
    const Lanes inverse = Lanes(1.0f) / b.v, quotient = a.v / b.v;
    return of(quotient, a, inverse, b, -(quotient * inverse));
  }
  friend Reverse operator-(const Reverse& a) {
    return of(-a.v, a, Lanes(-1.0f), Reverse(), Lanes());
  }
  friend Mask operator<(const Reverse& a, const Reverse& b) { return a.v < b.v; }
  friend Mask operator>(const Reverse& a, const Reverse& b) { return a.v > b.v; }
  friend Mask operator>=(const Reverse& a, const Reverse& b) { return a.v >= b.v; }

  friend Reverse select(Mask c, const Reverse& a, const Reverse& b) {
    const Lanes one(1.0f), zero;
    return of(select(c, a.v, b.v), a, select(c, one, zero), b, select(c, zero, one));
  }
  friend Reverse min(const Reverse& a, const Reverse& b) { return select(a.v <= b.v, a, b); }
  friend Reverse max(const Reverse& a, const Reverse& b) { return select(a.v >= b.v, a, b); }
  friend Reverse sqrt(const Reverse& a) {
    const Lanes root = sqrt(a.v), zero;
    return of(root, a, select(root > zero, Lanes(0.5f) / root, zero), Reverse(), zero);
  }
  friend Reverse atan2(const Reverse& y, const Reverse& x) {
    const auto angle = math::functions_detail::atan2_value(y.v, x.v);
    return of(angle.value, y, angle.dy, x, angle.dx);
  }
};

inline Vec3<Reverse> input(Trace& trace, const Vec3<Lanes>& value) {
  return {Reverse::input(trace, value.x), Reverse::input(trace, value.y),
          Reverse::input(trace, value.z)};
}
inline Vec3<Reverse> constant(const Vec3<Lanes>& value) {
  return {Reverse(value.x), Reverse(value.y), Reverse(value.z)};
}
inline Vec3<Lanes> bar(const Vec3<Reverse>& value) {
  return {value.x.bar(), value.y.bar(), value.z.bar()};
}

}  // namespace novaphy::vbd::NOVAPHY_VBD_LEVEL
