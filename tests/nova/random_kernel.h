// Random kernels with every access kind and nested selects, for tests of all code that reads or
// transforms Programs.
#pragma once

#include <functional>
#include <vector>

#include "support.h"

namespace novaphy::testing {

enum class SumKind { None, Fixed, Csr };

class RandomKernel {
 public:
  explicit RandomKernel(uint32_t seed) : random_(seed) {}

  Kernel make(SumKind kind, int size = 25) {
    size_ = size;
    std::vector<nova::SourceSpec> sources = {{"x", DType::F32, 3, Access::Direct},
                                             {"u", DType::F32, 2, Access::Uniform},
                                             {"t", DType::I32, 2, Access::Direct},
                                             {"g", DType::F32, 2, Access::Indexed}};
    const std::vector<nova::OutputSpec> outputs = {{"a", 2}, {"b", 1}};
    if (kind == SumKind::None)
      return nova::make_kernel("random", sources, outputs, [this](TraceContext& c) {
        leaves(c);
        grow(size_);
        return results(3);
      });
    const Access items = kind == SumKind::Fixed ? Access::Reduced : Access::CsrRow;
    sources.push_back({"e", DType::F32, 2, items});
    sources.push_back({"et", DType::I32, 1, items});
    return nova::make_reduce_kernel("random_sum", sources, outputs,
                                    {.init =
                                         [this](TraceContext& c) {
                                           leaves(c);
                                           grow(6);
                                           return results(2);
                                         },
                                     .body =
                                         [this, kind](TraceContext& c) {
                                           leaves(c);
                                           keep(c.f32(4, 0));
                                           keep(c.f32(4, 1));
                                           if (kind == SumKind::Csr)
                                             keep(c.f32(3, c.i32(5), random_.below(2)));
                                           conditions_.push_back(c.i32(5) > Int(1));
                                           grow(size_);
                                           return results(2);
                                         },
                                     .epilogue =
                                         [this](TraceContext& c, std::span<const Real> sums) {
                                           leaves(c);
                                           for (const Real& s : sums) keep(s * Real(0.125f));
                                           grow(size_ / 2);
                                           return results(3);
                                         }});
  }

  // Inputs for `dim` rows; the float sources are leaves.
  Call call(SumKind kind, int64_t dim, int size = 25) {
    Call call{make(kind, size),
              dim,
              {random_.leaf({dim, 3}), random_.leaf({1, 2}), indices(2 * dim, 5, 2),
               random_.leaf({5, 2})}};
    if (kind == SumKind::Fixed) {
      call.extent = random_.below(4);
      const int64_t rows = call.extent + random_.below(3);
      call.inputs.push_back(random_.leaf({rows, 2}));
      call.inputs.push_back(indices(rows, 4, 1));
    }
    if (kind == SumKind::Csr) {
      const int64_t slots = 2 * dim + random_.below(4);
      call.csr = nova::make_incidence(indices(slots, static_cast<int32_t>(dim), 1).operand(), dim);
      call.inputs.push_back(random_.leaf({slots, 2}));
      call.inputs.push_back(indices(slots, 5, 1));
    }
    return call;
  }

  Random& random() { return random_; }

 private:
  Tensor indices(int64_t count, int32_t rows, int32_t width) {
    std::vector<int32_t> values(static_cast<size_t>(count));
    for (int32_t& v : values) v = random_.below(rows + 1) - 1;
    return table(values, width);
  }

  const Real& keep(const Real& x) {
    values_.push_back(x);
    return values_.back();
  }
  Real pick() {
    const auto n = static_cast<int32_t>(values_.size());
    const int32_t back = random_.chance(60) ? random_.below(std::min(n, 5)) : random_.below(n);
    return values_[static_cast<size_t>(n - 1 - back)];
  }
  nova::Bool condition() {
    if (random_.chance(30))
      return conditions_[static_cast<size_t>(
          random_.below(static_cast<int32_t>(conditions_.size())))];
    const nova::Bool c = random_.chance(50) ? pick() < pick() + Real(0.1f)
                                            : pick() > Real(random_.uniform(-0.5f, 0.5f));
    conditions_.push_back(random_.chance(30) ? both(c, conditions_.back()) : c);
    return conditions_.back();
  }

  void leaves(TraceContext& c) {
    values_.clear();
    conditions_.clear();
    for (int k = 0; k < 3; ++k) keep(c.f32(0, k));
    keep(c.f32(1, 0));
    keep(c.f32(1, 1));
    keep(c.f32(3, c.i32(2, 0), 0));
    keep(c.f32(3, c.i32(2, 1), 0));
    keep(c.f32(3, c.i32(2, 1), 1));
    keep(Real(random_.uniform(-1.0f, 1.0f)));
    conditions_.push_back(c.i32(2, 0) > Int(1));
  }

  // Values stay within a few units, so that float and double stay close.
  Real operation() {
    const Real a = pick(), b = pick(), half = 0.5f, one = 1.0f;
    switch (random_.below(13)) {
      case 0:
        return a + b;
      case 1:
        return a - b;
      case 2:
      case 3:
        return (a * half) * (b * half);
      case 4:
        return a / (abs(b) + one);
      case 5:
        return -a;
      case 6:
        return abs(a) - half;
      case 7:
        return min(a, b);
      case 8:
        return max(a, b);
      case 9:
        return sqrt(abs(a) + half);
      case 10:
        return fma(a * half, b * half, pick());
      case 11:
        return sign(a) * b + floor(a) * half;
      default:
        return detach(a) * half + b;
    }
  }

  // One side of a select: a separate chain, perhaps with another select in it. An operation may
  // give infinity or NaN where the side is not taken.
  Real side(int depth, const Real& divisor) {
    const size_t before = values_.size();
    const int length = 1 + random_.below(7);
    for (int k = 0; k < length; ++k) keep(operation());
    const bool unsafe = random_.chance(40);
    if (unsafe) keep(pick() / (divisor * Real(4.0f)));
    if (depth < 3 && random_.chance(50)) keep(choose(depth + 1));
    const Real result = random_.chance(30) ? values_.back() * pick() * Real(0.25f) : values_.back();
    // Usually the chain stays on this side. Sometimes later code uses it, unless its values may be
    // infinite or NaN.
    if (unsafe || random_.chance(80)) values_.resize(before);
    return result;
  }
  Real choose(int depth) {
    const Real divisor = pick();
    const nova::Bool safe = abs(divisor) > Real(0.25f);
    const nova::Bool c = random_.chance(60) ? safe : both(condition(), safe);
    const Real taken = side(depth, divisor);
    return select(
        c, taken,
        side(depth, Real(1.0f)));  // one after the other: the order must not be the compiler's
  }
  void grow(int count) {
    for (int k = 0; k < count; ++k) {
      Real x = random_.chance(20) ? choose(0) : operation();
      keep(max(min(x, Real(4.0f)), Real(-4.0f)));
    }
  }
  std::vector<Real> results(int count) {
    std::vector<Real> r;
    for (int k = 0; k < count; ++k) r.push_back(pick());
    return r;
  }

  Random random_;
  int size_ = 25;
  std::vector<Real> values_;
  std::vector<nova::Bool> conditions_;
};

}  // namespace novaphy::testing
