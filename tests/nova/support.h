// Helpers shared by the tests of the tensor runtime: random tensors, and the comparison of
// gradients with the oracle.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>
#include <string>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/nova/functions.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "oracle.h"
#include "support/bits.h"

namespace novaphy::testing {

using nova::Access;
using nova::DType;
using nova::Int;
using nova::Kernel;
using nova::NoGrad;
using nova::Param;
using nova::Real;
using nova::Shape;
using nova::Tape;
using nova::TapeScope;
using nova::Tensor;
using nova::TraceContext;

inline Tensor tensor(const std::vector<float>& values, bool requires_grad = false) {
  const Tensor t = Tensor::from_host(values, {static_cast<int64_t>(values.size())});
  if (requires_grad) t.set_requires_grad(true);
  return t;
}
inline Tensor tensor(const std::vector<float>& values, const Shape& shape,
                     bool requires_grad = false) {
  const Tensor t = Tensor::from_host(values, shape);
  if (requires_grad) t.set_requires_grad(true);
  return t;
}
inline Tensor table(const std::vector<int32_t>& values, int32_t width = 1) {
  const auto rows = static_cast<int64_t>(values.size()) / width;
  return Tensor::from_host(values, width == 1 ? Shape{rows} : Shape{rows, width});
}
inline void write(const Tensor& t, const std::vector<float>& values) {
  t.copy_from_host(values.data(), values.size() * sizeof(float));
}

// Returns the message of the error that a call throws.
template <class F>
std::string message_of(F&& call) {
  try {
    call();
  } catch (const Error& error) {
    return error.what();
  }
  return "nothing was thrown";
}

class Random {
 public:
  explicit Random(uint32_t seed) : engine_(seed) {}
  int32_t below(int32_t n) { return static_cast<int32_t>(engine_() % static_cast<uint32_t>(n)); }
  bool chance(int percent) { return below(100) < percent; }
  float uniform(float lo, float hi) {  // not std's, whose values depend on the library
    return lo + (hi - lo) * static_cast<float>(engine_() >> 8) * 0x1p-24f;
  }
  std::vector<float> values(int64_t n, float lo = -2.0f, float hi = 2.0f) {
    std::vector<float> v(static_cast<size_t>(n));
    for (float& x : v) x = uniform(lo, hi);
    return v;
  }
  Tensor leaf(const Shape& shape, float lo = -2.0f, float hi = 2.0f) {
    int64_t n = 1;
    for (const int64_t d : shape) n *= d;
    return tensor(values(n, lo, hi), shape, true);
  }

 private:
  std::mt19937 engine_;
};

// One kernel and its arguments.
struct Call {
  Kernel kernel;
  int64_t dim = 0;
  std::vector<Tensor> inputs;
  std::vector<Param> params = {};
  int32_t extent = 0;
  nova::Incidence csr = {};

  std::vector<Tensor> operator()() const {
    return kernel(dim, inputs, {.params = params, .extent = extent, .csr = csr ? &csr : nullptr});
  }
};

inline OracleInputs oracle_inputs(const Call& call) {
  OracleInputs in;
  in.dim = call.dim;
  in.extent = call.extent;
  for (const Param& p : call.params) in.params.push_back(p.bits);
  for (const Tensor& t : call.inputs) {
    in.f32.emplace_back();
    in.i32.emplace_back();
    if (t.dtype() == DType::I32) {
      in.i32.back() = t.to_host_i32();
    } else {
      for (const float x : t.to_host()) in.f32.back().push_back({static_cast<double>(x), 0.0});
    }
  }
  if (call.csr) {
    const auto host = [](const std::shared_ptr<Range>& range) {
      const Tensor view(range, {static_cast<int64_t>(range->bytes() / 4)}, DType::I32);
      return view.to_host_i32();
    };
    in.offsets = host(call.csr->offsets);
    in.items = host(call.csr->items);
  }
  return in;
}

// Weights of the outputs; an empty list leaves an output without a gradient.
using Seeds = std::vector<std::vector<float>>;
// Per range that carries a gradient.
using Gradients = std::map<const Range*, std::vector<double>>;

inline double weighted(const std::vector<std::vector<Dual>>& outputs, const Seeds& seeds,
                       bool tangent) {
  double total = 0.0;
  for (size_t o = 0; o < outputs.size(); ++o)
    for (size_t k = 0; k < seeds[o].size(); ++k)
      total += static_cast<double>(seeds[o][k]) * (tangent ? outputs[o][k].t : outputs[o][k].v);
  return total;
}

// Returns the derivative of sum(seeds * outputs) with respect to each input value, in double. step
// 0: forward mode. step > 0: central differences.
inline Gradients oracle_gradients(const Call& call, const Seeds& seeds, double step = 0.0) {
  OracleInputs in = oracle_inputs(call);
  Gradients gradients;
  for (size_t s = 0; s < call.inputs.size(); ++s) {
    if (!call.inputs[s].requires_grad()) continue;
    auto& gradient = gradients[call.inputs[s].range().get()];
    gradient.resize(in.f32[s].size());
    for (size_t k = 0; k < gradient.size(); ++k) {
      Dual& x = in.f32[s][k];
      if (step == 0.0) {
        x.t = 1.0;
        gradient[k] += weighted(oracle(call.kernel.traced(), in), seeds, true);
        x.t = 0.0;
      } else {
        const double before = x.v;
        x.v = before + step;
        const double up = weighted(oracle(call.kernel.traced(), in), seeds, false);
        x.v = before - step;
        const double down = weighted(oracle(call.kernel.traced(), in), seeds, false);
        x.v = before;
        gradient[k] += (up - down) / (2.0 * step);
      }
    }
  }
  return gradients;
}

enum class Backward {
  Each,
  Together
};  // one call per output, or one for the sum of seeds * outputs

inline Gradients tape_gradients(const Call& call, const Seeds& seeds, Backward how) {
  for (const Tensor& t : call.inputs)
    if (t.requires_grad()) t.zero_grad();
  Tape tape;
  {
    const TapeScope scope(tape);
    const std::vector<Tensor> outputs = call();
    Tensor total;
    for (size_t o = 0; o < outputs.size(); ++o) {
      if (seeds[o].empty()) continue;
      const Tensor seed = tensor(seeds[o], outputs[o].shape());
      if (how == Backward::Each) {
        tape.backward(outputs[o], seed);
      } else {
        const Tensor part = nova::dot(outputs[o], seed);
        total = total.defined() ? nova::add(total, part) : part;
      }
    }
    if (how == Backward::Together) tape.backward(total);
  }
  Gradients gradients;
  for (const Tensor& t : call.inputs) {
    if (!t.requires_grad()) continue;
    const std::vector<float> g = t.grad().to_host();
    gradients[t.range().get()].assign(g.begin(), g.end());
  }
  return gradients;
}

inline ::testing::AssertionResult close(const Gradients& actual, const Gradients& expected,
                                        double rtol) {
  for (const auto& [range, e] : expected) {
    const auto& a = actual.at(range);
    double scale = 1e-3;
    for (const double x : e) scale = std::max(scale, std::fabs(x));
    for (size_t k = 0; k < e.size(); ++k) {
      if (!(std::fabs(a[k] - e[k]) <= rtol * scale))
        return ::testing::AssertionFailure() << "value " << k << ": got " << a[k] << ", expected "
                                             << e[k] << " (largest " << scale << ")";
    }
  }
  return ::testing::AssertionSuccess();
}

inline Seeds random_seeds(const Call& call, Random& random) {
  Seeds seeds;
  for (const nova::OutputSpec& o : call.kernel.outputs())
    seeds.push_back(random.values(call.dim * o.width, 0.5f, 2.0f));
  return seeds;
}

// The dot-product identity <J u, w> = <u, J^T w> of a tape's two directions at random u and w, and
// J u against the oracle's. Sums of products are compared with the sum of their absolute values.
inline ::testing::AssertionResult directions_agree(const Call& call, Random& random, double rtol) {
  std::vector<Tensor> leaves, directions;
  OracleInputs in = oracle_inputs(call);
  for (size_t s = 0; s < call.inputs.size(); ++s) {
    const Tensor& t = call.inputs[s];
    if (!t.requires_grad()) continue;
    const auto same_range = [&](const Tensor& leaf) { return leaf.range() == t.range(); };
    auto known = std::find_if(leaves.begin(), leaves.end(), same_range);
    if (known == leaves.end()) {
      leaves.push_back(t);
      t.zero_grad();
      directions.push_back(tensor(random.values(t.size(), -1.0f, 1.0f), t.shape()));
      known = leaves.end() - 1;
    }
    const auto u = directions[static_cast<size_t>(known - leaves.begin())].to_host();
    for (size_t k = 0; k < u.size(); ++k) in.f32[s][k].t = static_cast<double>(u[k]);
  }
  const Seeds seeds = random_seeds(call, random);
  Tape tape;
  std::vector<Tensor> outputs, tangents;
  {
    const TapeScope scope(tape);
    outputs = call();
    tangents = tape.jvp(outputs, leaves, directions);
    for (size_t o = 0; o < outputs.size(); ++o)
      tape.backward(outputs[o], tensor(seeds[o], outputs[o].shape()));
  }
  const auto expected = oracle(call.kernel.traced(), in);
  double forward = 0.0, reverse = 0.0, size = 1e-6;
  const auto add = [&size](double& sum, double term) {
    sum += term;
    size += std::fabs(term);
  };
  for (size_t o = 0; o < outputs.size(); ++o) {
    const std::vector<float> t = tangents[o].to_host();
    double scale = 1e-3;
    for (const Dual& d : expected[o]) scale = std::max(scale, std::fabs(d.t));
    for (size_t k = 0; k < t.size(); ++k) {
      if (!(std::fabs(static_cast<double>(t[k]) - expected[o][k].t) <= rtol * scale))
        return ::testing::AssertionFailure()
               << "tangent of output " << o << ", value " << k << ": got " << t[k] << ", expected "
               << expected[o][k].t << " (largest " << scale << ")";
      add(forward, static_cast<double>(t[k]) * static_cast<double>(seeds[o][k]));
    }
  }
  for (size_t s = 0; s < leaves.size(); ++s) {
    const std::vector<float> g = leaves[s].grad().to_host(), u = directions[s].to_host();
    for (size_t k = 0; k < g.size(); ++k)
      add(reverse, static_cast<double>(g[k]) * static_cast<double>(u[k]));
  }
  if (std::fabs(forward - reverse) <= rtol * size) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << "<J u, w> is " << forward << ", <u, J^T w> is " << reverse
                                       << " (sum of sizes " << size << ")";
}

// Expects <J u, w> = <u, J^T w> for every unit vector u and random seeds w. J comes from forward
// mode, and with `fd` also from differences. For a random u, J u comes from the tape's forward
// mode.
inline void expect_gradients(const Call& call, Random& random, double rtol = 2e-5, bool fd = true) {
  EXPECT_TRUE(directions_agree(call, random, rtol));
  const Seeds seeds = random_seeds(call, random);
  const Gradients expected = oracle_gradients(call, seeds);
  for (const Backward how : {Backward::Each, Backward::Together}) {
    const Gradients actual = tape_gradients(call, seeds, how);
    EXPECT_TRUE(close(actual, expected, rtol))
        << (how == Backward::Each ? "output by output" : "all outputs together");
    if (fd) {
      EXPECT_TRUE(close(actual, oracle_gradients(call, seeds, 1e-5), std::max(rtol, 1e-5)));
    }
  }
}

}  // namespace novaphy::testing
