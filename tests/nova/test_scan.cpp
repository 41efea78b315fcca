// Scans: values, gradients and tangents of the loop without a scan, closed forms, captures, and
// bodies that are rejected by name.
#include <cmath>

#include "novaphy/core/parallel.h"
#include "novaphy/nova/gradcheck.h"
#include "novaphy/nova/networks.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/scan.h"
#include "support.h"

namespace novaphy::testing {
namespace {

using nova::scan;
using nova::ScanFn;
using nova::ScanResult;
using nova::ScopedCapture;
using Floats = std::vector<float>;
using Tensors = std::vector<Tensor>;

constexpr int64_t kSteps = 7;

// The loop that a scan replaces. Each step gets its own x, and copies its results.
ScanResult run_loop(const ScanFn& body, Tensors carry, const std::vector<Tensors>& x) {
  Tensors ys;
  for (const Tensors& of_step : x) {
    ScanResult step = body(carry, of_step);
    for (const Tensor& y : step.ys) ys.push_back(y.clone());
    carry = step.carry;
  }
  return {carry, ys};
}

Tensor copy_of_row(const Tensor& rows, int64_t k) {
  const Floats values = rows.to_host();
  const int64_t width = rows.size() / rows.dim(0);
  const auto from = values.begin() + static_cast<ptrdiff_t>(k * width);
  Shape shape(rows.shape().begin() + 1, rows.shape().end());
  return tensor(Floats(from, from + static_cast<ptrdiff_t>(width)), shape, rows.requires_grad());
}

Tensor weighted_sum(const Tensors& values, Random& random) {
  Tensor total = tensor({0.0f});
  for (const Tensor& t : values)
    total = nova::add(total, nova::dot(t, tensor(random.values(t.size()), t.shape())));
  return total;
}

void expect_same(const Floats& a, const Floats& b, const char* what) {
  EXPECT_TRUE(same_bits<float>(a, b)) << what;
}

// A recurrent network with two carries, weights from outside, and one of its carries as a result.
struct Recurrent {
  Random random{3};
  Tensor h = random.leaf({5, 4}), c = random.leaf({5, 4});
  Tensor leaf = random.leaf({4, 4}, -0.5f, 0.5f), bias = random.leaf({4}),
         xs = random.leaf({kSteps, 5, 4});
  Tensor weight = {};  // computed from the leaf on the tape

  void begin() { weight = nova::mul(leaf, 0.9f); }
  ScanResult step(const Tensors& carry, const Tensors& x) const {
    const Tensor next = nova::tanh(nova::add(
        nova::linear(nova::mul(carry[0], carry[0]), weight, bias), nova::add(x[0], carry[1])));
    const Tensor cell = nova::add(nova::mul(carry[1], 0.5f), nova::mul(next, x[0]));
    return {{next, cell}, {next, nova::sum(nova::mul(cell, bias), 1)}};
  }
  ScanFn body() const {
    return [this](const Tensors& carry, const Tensors& x) { return step(carry, x); };
  }
  Tensors leaves() const { return {h, c, leaf, bias, xs}; }
};

TEST(Scan, HasTheBitsOfTheLoopInValuesAndGradients) {
  Recurrent by_loop, by_scan;
  Tape loop_tape, scan_tape;
  ScanResult expected, found;
  std::vector<Tensors> x;
  for (int64_t k = 0; k < kSteps; ++k) x.push_back({copy_of_row(by_loop.xs, k)});
  {
    const TapeScope scope(loop_tape);
    by_loop.begin();
    expected = run_loop(by_loop.body(), {by_loop.h, by_loop.c}, x);
    Tensors results = expected.carry;
    for (size_t which : {0u, 1u})
      for (size_t k = 0; k < kSteps; ++k) results.push_back(expected.ys[2 * k + which]);
    Random random(9);
    const Tensor loss = nova::add(weighted_sum(results, random), nova::norm(by_loop.weight));
    loop_tape.backward(loss);
  }
  {
    const TapeScope scope(scan_tape);
    by_scan.begin();
    found = scan(by_scan.body(), {by_scan.h, by_scan.c}, {by_scan.xs});
    Random random(9);
    Tensors results = found.carry;
    for (const Tensor& ys : found.ys)
      for (int64_t k = 0; k < kSteps; ++k) results.push_back(nova::slice(ys, 0, k, 1));
    const Tensor loss = nova::add(weighted_sum(results, random), nova::norm(by_scan.weight));
    scan_tape.backward(loss);
  }
  EXPECT_EQ(std::ranges::count(scan_tape.op_names(), "scan"), 1);
  EXPECT_EQ(found.ys[0].shape(), (Shape{kSteps, 5, 4}));
  EXPECT_EQ(found.ys[1].shape(), (Shape{kSteps, 5}));
  for (size_t k : {0u, 1u})
    expect_same(found.carry[k].to_host(), expected.carry[k].to_host(), "carry");
  for (size_t which : {0u, 1u})
    for (int64_t k = 0; k < kSteps; ++k)
      expect_same(nova::slice(found.ys[which], 0, k, 1).to_host(),
                  expected.ys[2 * static_cast<size_t>(k) + which].to_host(), "ys");
  for (size_t k = 0; k < 4; ++k)
    expect_same(by_scan.leaves()[k].grad().to_host(), by_loop.leaves()[k].grad().to_host(),
                "gradient");
  const Tensor of_xs = by_scan.xs.grad();
  for (int64_t k = 0; k < kSteps; ++k)
    expect_same(nova::slice(of_xs, 0, k, 1).to_host(),
                x[static_cast<size_t>(k)][0].grad().to_host(), "gradient of x");
}

TEST(Scan, AddsToGradientsOfEarlierPasses) {
  Recurrent once, twice;
  const auto run = [](Recurrent& net, int passes) {
    Tape tape;
    const TapeScope scope(tape);
    net.begin();
    const ScanResult r = scan(net.body(), {net.h, net.c}, {net.xs});
    Random random(4);
    const Tensor loss = weighted_sum({r.carry[1], r.ys[0]}, random);
    for (int k = 0; k < passes; ++k) tape.backward(loss);
  };
  run(once, 1);
  run(twice, 2);
  for (size_t l = 0; l < 5; ++l) {
    const Floats one = once.leaves()[l].grad().to_host(), two = twice.leaves()[l].grad().to_host();
    double size = 0.0;
    for (const float g : one) size = std::max(size, std::fabs(static_cast<double>(g)));
    EXPECT_GT(size, 0.0);
    for (size_t k = 0; k < one.size(); ++k) EXPECT_NEAR(two[k], 2.0 * one[k], 2e-6 * size);
  }
}

TEST(Scan, TangentsAreTheTransposeOfTheGradients) {
  Recurrent net;
  Random random(5);
  Tensors directions;
  for (const Tensor& leaf : net.leaves())
    directions.push_back(tensor(random.values(leaf.size()), leaf.shape()));
  Tape tape;
  const TapeScope scope(tape);
  net.begin();
  const ScanResult r = scan(net.body(), {net.h, net.c}, {net.xs});
  const Tensor loss = weighted_sum({r.carry[0], r.carry[1], r.ys[0], r.ys[1]}, random);
  tape.backward(loss);
  const double forward = tape.jvp({loss}, net.leaves(), directions)[0].item();
  double reverse = 0.0, size = 0.0;
  for (size_t l = 0; l < directions.size(); ++l) {
    const Floats g = net.leaves()[l].grad().to_host(), u = directions[l].to_host();
    for (size_t k = 0; k < g.size(); ++k) {
      reverse += static_cast<double>(g[k]) * static_cast<double>(u[k]);
      size += std::fabs(static_cast<double>(g[k]) * static_cast<double>(u[k]));
    }
  }
  EXPECT_NEAR(forward, reverse, 1e-5 * size);
}

// c_{k+1} = r c_k + a gives c_n = r^n c_0 + a (1 - r^n) / (1 - r).
TEST(Scan, GeometricSeriesHasItsClosedForm) {
  const Tensor c = tensor({2.0f}, true), r = tensor({0.75f}, true), a = tensor({0.5f}, true);
  Tape tape;
  const TapeScope scope(tape);
  constexpr int n = 1000;
  const ScanResult result = scan(
      [&](const Tensors& carry, const Tensors&) {
        return ScanResult{{nova::add(nova::mul(carry[0], r), a)}, {}};
      },
      {c}, {}, n);
  EXPECT_EQ(tape.size(), 1u);
  tape.backward(result.carry[0]);
  EXPECT_NEAR(result.carry[0].item(), 0.5 / 0.25, 1e-6);
  EXPECT_NEAR(a.grad().item(), 1.0 / 0.25, 1e-5);
  EXPECT_NEAR(r.grad().item(), 0.5 / (0.25 * 0.25), 1e-5);
  EXPECT_NEAR(c.grad().item(), std::pow(0.75, n), 1e-6);
}

// Semi-implicit Euler steps of x'' = -x are a linear map of determinant 1, whose trace is 2 - h^2.
TEST(Scan, HarmonicOscillatorHasItsClosedForm) {
  constexpr int n = 400;
  constexpr double h = 0.03125;
  const Tensor x = tensor({1.0f}, true), v = tensor({0.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const ScanResult result = scan(
      [&](const Tensors& carry, const Tensors&) {
        const Tensor speed = nova::sub(carry[1], nova::mul(carry[0], static_cast<float>(h)));
        const Tensor at = nova::add(carry[0], nova::mul(speed, static_cast<float>(h)));
        return ScanResult{{at, speed}, {at}};
      },
      {x, v}, {}, n);
  tape.backward(result.carry[0]);
  // The powers of a matrix with determinant 1 and trace 2 cos(theta).
  const double theta = std::acos(1.0 - 0.5 * h * h), s = std::sin(theta);
  const double dx = (std::sin((n + 1) * theta) - std::sin(n * theta)) / s;
  const double dv = h * std::sin(n * theta) / s;
  EXPECT_NEAR(result.carry[0].item(), dx, 2e-5);
  EXPECT_NEAR(x.grad().item(), dx, 2e-5);
  EXPECT_NEAR(v.grad().item(), dv, 2e-5);
  EXPECT_EQ(result.ys[0].to_host().back(), result.carry[0].item());
}

TEST(Scan, AgreesWithDifferences) {
  Random random(6);
  const Tensors inputs = {random.leaf({1, 4}), random.leaf({1, 4}),
                          random.leaf({4, 4}, -0.5f, 0.5f), random.leaf({4}),
                          random.leaf({2, 1, 4})};
  const nova::GradcheckResult checked = nova::gradcheck(
      [&](const Tensors& in) {
        Recurrent at;
        at.leaf = in[2];
        at.bias = in[3];
        at.begin();
        const ScanResult r = scan(at.body(), {in[0], in[1]}, {in[4]});
        return nova::add(nova::sum(nova::mul(r.carry[1], r.carry[0])), nova::sum(r.ys[1]));
      },
      inputs);
  EXPECT_TRUE(checked.ok) << checked.worst;
  EXPECT_LT(checked.dot_product_error, 1e-5);
}

// The carries change places, so only every second step has a gradient of the first.
TEST(Scan, ExchangedAndUnchangedCarries) {
  const Tensor a = tensor({2.0f}, true), b = tensor({3.0f}, true), w = tensor({5.0f}, true);
  const ScanFn body = [](const Tensors& carry, const Tensors&) {
    return ScanResult{{nova::mul(carry[1], carry[2]), carry[0], carry[2]}, {}};
  };
  Tape tape;
  const TapeScope scope(tape);
  const ScanResult r = scan(body, {a, b, w}, {}, 3);
  tape.backward(r.carry[0]);  // w^2 b after three steps
  EXPECT_EQ(r.carry[0].item(), 75.0f);
  EXPECT_EQ(a.grad().item(), 0.0f);
  EXPECT_EQ(b.grad().item(), 25.0f);
  EXPECT_EQ(w.grad().item(), 30.0f);
}

TEST(Scan, NoStepsReturnTheCarry) {
  const Tensor c = tensor({2.0f, 3.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const ScanResult r = scan(
      [](const Tensors& carry, const Tensors&) {
        return ScanResult{{nova::mul(carry[0], 2.0f)}, {carry[0]}};
      },
      {c}, {}, 0);
  EXPECT_EQ(r.carry[0].to_host(), c.to_host());
  EXPECT_EQ(r.ys[0].shape(), (Shape{0, 2}));
  tape.backward(nova::sum(nova::mul(r.carry[0], 3.0f)));
  EXPECT_EQ(c.grad().to_host(), (Floats{3.0f, 3.0f}));
  EXPECT_EQ(tape.jvp({r.carry[0]}, {c}, {tensor({1.0f, 4.0f})})[0].to_host(), (Floats{1.0f, 4.0f}));
}

// c -> w c^2 in an inner scan of 2 steps, added up over 3 steps of the outer scan.
ScanResult run_nested(const Tensor& c, const Tensor& w, bool by_scan) {
  const ScanFn inner = [&](const Tensors& carry, const Tensors&) {
    return ScanResult{{nova::mul(nova::mul(carry[0], carry[0]), w)}, {}};
  };
  const ScanFn outer = [&](const Tensors& carry, const Tensors&) {
    const Tensor end = by_scan ? scan(inner, {carry[0]}, {}, 2).carry[0]
                               : run_loop(inner, {carry[0]}, {{}, {}}).carry[0];
    return ScanResult{{nova::add(nova::mul(end, 0.5f), carry[0])}, {}};
  };
  return by_scan ? scan(outer, {c}, {}, 3) : run_loop(outer, {c}, {{}, {}, {}});
}

TEST(Scan, MayContainAScan) {
  Floats gradients[2], values[2], tangents[2];
  for (const bool by_scan : {false, true}) {
    const Tensor c = tensor({0.9f, -0.8f}, true), w = tensor({1.1f, 0.7f}, true);
    Tape tape;
    const TapeScope scope(tape);
    const ScanResult r = run_nested(c, w, by_scan);
    tape.backward(nova::sum(r.carry[0]));
    values[by_scan] = r.carry[0].to_host();
    gradients[by_scan] = c.grad().to_host();
    for (const float g : w.grad().to_host()) gradients[by_scan].push_back(g);
    tangents[by_scan] =
        tape.jvp({r.carry[0]}, {c, w}, {tensor({1.0f, 2.0f}), tensor({3.0f, 4.0f})})[0].to_host();
  }
  expect_same(values[0], values[1], "values");
  expect_same(gradients[0], gradients[1], "gradients");
  expect_same(tangents[0], tangents[1], "tangents");
}

// A sum over the rows of a table, whose terms are read at computed rows too.
TEST(Scan, MayReadTables) {
  static const Kernel edges = nova::make_reduce_kernel(
      "scan_edges", {{"x", DType::F32, 1, Access::Direct}, {"e", DType::F32, 1, Access::CsrRow}},
      {{"y", 1}},
      {.init = [](TraceContext& c) { return std::vector{nova::sin(c.f32(0))}; },
       .body = [](TraceContext& c) { return std::vector{c.f32(1) * c.f32(1) * c.f32(0)}; },
       .epilogue = {}});
  const Tensor row_of = table({2, -1, 0, 2, 1, 0, 0}), index = table({1, 0, 2});
  const nova::Incidence rows = nova::make_incidence(row_of.operand(), 3);
  Floats results[2];
  for (const bool by_scan : {false, true}) {
    Random random(8);
    const Tensor c = random.leaf({3}), e = random.leaf({7}, -0.5f, 0.5f);
    const ScanFn body = [&](const Tensors& carry, const Tensors&) {
      const Tensor next = edges(3, {carry[0], e}, {.csr = &rows})[0];
      return ScanResult{{nova::gather(next, index)}, {}};
    };
    Tape tape;
    const TapeScope scope(tape);
    const Tensor last =
        by_scan ? scan(body, {c}, {}, 3).carry[0] : run_loop(body, {c}, {{}, {}, {}}).carry[0];
    tape.backward(last, tensor({1.0f, -2.0f, 3.0f}));
    for (const Tensor& t : {last, c.grad(), e.grad()})
      for (const float value : t.to_host()) results[by_scan].push_back(value);
  }
  expect_same(results[0], results[1], "value and gradients");
}

// The backward pass computes values again that no tape records: those of detach(), of slices of
// integers, and of operations without gradients.
TEST(Scan, ComputesUnrecordedValuesOfEachStep) {
  const Tensor numbers = tensor({5.0f, 3.0f, 2.0f, 7.0f});
  static const Kernel pick = nova::make_kernel(
      "scan_pick",
      {{"k", DType::I32, 1, Access::Uniform}, {"from", DType::F32, 1, Access::Indexed}}, {{"y", 1}},
      [](TraceContext& c) { return std::vector{c.f32(1, c.i32(0), 0)}; });
  Floats results[2];
  for (const bool by_scan : {false, true}) {
    const Tensor c = tensor({0.5f, -0.75f}, true);
    const ScanFn body = [&](const Tensors& carry, const Tensors& x) {
      Tensor without;
      {
        const NoGrad no_grad;
        without = nova::sin(carry[0]);
      }
      const Tensor number = pick(1, {nova::slice(x[0], 0, 1, 1), numbers})[0];
      const Tensor scale = nova::mul(nova::mul(carry[0].detach(), without), number);
      return ScanResult{{nova::sin(nova::mul(carry[0], scale))}, {}};
    };
    Tape tape;
    const TapeScope scope(tape);
    Tensor last;
    if (by_scan) {
      last = scan(body, {c}, {table({9, 1, 9, 3, 9, 0}, 2)}).carry[0];
    } else {
      last = run_loop(body, {c}, {{table({9, 1})}, {table({9, 3})}, {table({9, 0})}}).carry[0];
    }
    tape.backward(nova::sum(last));
    const Tensor tangent = tape.jvp({last}, {c}, {tensor({1.0f, 2.0f})})[0];
    for (const Tensor& t : {last, c.grad(), tangent})
      for (const float value : t.to_host()) results[by_scan].push_back(value);
  }
  expect_same(results[0], results[1], "value, gradient and tangent");
}

// Constants that the body makes are launches of the body, which its tape does not record.
TEST(Scan, MayMakeConstants) {
  const Tensor c = tensor({0.5f, 1.5f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const ScanResult r = scan(
      [](const Tensors& carry, const Tensors&) {
        return ScanResult{{nova::mul(carry[0], Tensor::full({2}, 3.0f))}, {}};
      },
      {c}, {}, 4);
  tape.backward(nova::sum(r.carry[0]));
  EXPECT_EQ(r.carry[0].to_host(), (Floats{40.5f, 121.5f}));
  EXPECT_EQ(c.grad().to_host(), (Floats{81.0f, 81.0f}));
}

TEST(Scan, RunsAgainBetweenCheckpoints) {
  Floats gradients[2];
  for (const bool group : {false, true}) {
    const Tensor c = tensor({0.9f, -0.8f}, true), w = tensor({1.1f, 0.7f}, true);
    Tape tape;
    const TapeScope scope(tape);
    Tensor at = c;
    for (int k = 0; k < 3; ++k) {
      const nova::RecomputedScope recomputed(group);
      at = nova::sin(run_nested(nova::mul(at, 0.5f), w, true).carry[0]);
    }
    tape.backward(nova::sum(at));
    gradients[group] = w.grad().to_host();
  }
  expect_same(gradients[0], gradients[1], "gradients");
}

TEST(Scan, CapturesReplayTheBits) {
  Recurrent direct, captured;
  const auto record = [](Recurrent& net) {
    Tape tape(nova::KeepGradients::Leaves);
    const TapeScope scope(tape);
    net.begin();
    const ScanResult r = scan(net.body(), {net.h, net.c}, {net.xs});
    tape.backward(nova::sum(nova::mul(r.carry[1], r.carry[0])));
    return r.carry[0];
  };
  ScopedCapture capture;
  const Tensor replayed = record(captured);
  capture.end();
  const Floats other(static_cast<size_t>(direct.h.size()), 0.25f);
  for (const bool changed : {false, true}) {
    if (changed)
      for (const Recurrent* net : {&direct, &captured}) write(net->h, other);
    for (const Tensor& leaf : captured.leaves()) leaf.zero_grad();
    for (const Tensor& leaf : direct.leaves()) leaf.zero_grad();
    const Tensor expected = record(direct);
    capture.graph()->launch();
    expect_same(replayed.to_host(), expected.to_host(), "carry");
    for (size_t l = 0; l < 5; ++l)
      expect_same(captured.leaves()[l].grad().to_host(), direct.leaves()[l].grad().to_host(),
                  "gradient");
  }
}

TEST(Scan, OutsideOfATapeNothingIsKept) {
  const Tensor w = tensor({0.5f}, true);
  const ScanFn body = [&](const Tensors& carry, const Tensors& x) {
    return ScanResult{{nova::add(nova::mul(carry[0], w), x[0])}, {}};
  };
  const Tensor xs = tensor({1.0f, 2.0f, 4.0f});
  EXPECT_EQ(scan(body, {tensor({8.0f})}, {xs}).carry[0].item(), 6.25f);
  Tape tape;
  const TapeScope scope(tape);
  {
    const NoGrad no_grad;
    EXPECT_EQ(scan(body, {tensor({8.0f})}, {xs}).carry[0].item(), 6.25f);
  }
  w.set_requires_grad(false);
  EXPECT_EQ(scan(body, {tensor({8.0f})}, {xs}).carry[0].item(), 6.25f);
  EXPECT_EQ(tape.size(), 0u);
}

TEST(Scan, RejectsArgumentsByName) {
  const Tensor c = tensor({1.0f, 2.0f}), three = tensor({1.0f, 2.0f, 3.0f});
  const ScanFn same = [](const Tensors& carry, const Tensors&) { return ScanResult{carry, {}}; };
  const auto has = [](const std::string& text, const char* part) {
    EXPECT_NE(text.find(part), std::string::npos) << text;
  };
  has(message_of([&] { scan(same, {c}, {}, -1); }), "length: expected >= 0, got -1");
  has(message_of([&] { scan(same, {c}); }), "length: expected the number of steps");
  has(message_of([&] { scan(same, {c}, {three}, 2); }), "xs 0: expected 2 rows");
  has(message_of([&] { scan(same, {c}, {three, c}); }), "xs 1: expected 3 rows");
  has(message_of([&] { scan(same, {table({1, 2})}, {}, 2); }), "carry 0: expected float32");
  const auto with = [&](const ScanFn& body) { return message_of([&] { scan(body, {c}, {}, 2); }); };
  has(with([&](const Tensors&, const Tensors&) {
        return ScanResult{{nova::mul(three, 2.0f)}, {}};
      }),
      "as before the step, got {3}");
  has(with([&](const Tensors&, const Tensors&) { return ScanResult{}; }), "expected 1 tensors");
  has(with([&](const Tensors& carry, const Tensors&) {
        return ScanResult{{nova::mul(carry[0], carry[0].to_host()[0])}, {}};
      }),
      "inside the body of a scan: it cannot be recorded");
  has(with([&](const Tensors& carry, const Tensors&) {
        carry[0].copy_(nova::mul(carry[0], 2.0f));
        return ScanResult{carry, {}};
      }),
      "carry 0: the body writes to it");
}

TEST(Scan, RejectsBodiesThatKeepOrOverwriteValues) {
  const Tensor c = tensor({1.0f, 2.0f}, true), sum = tensor({0.0f, 0.0f});
  Tensor kept;
  Tape tape;
  const TapeScope scope(tape);
  const auto run = [&](const ScanFn& body) { return scan(body, {c}, {}, 2); };
  const auto has = [](const std::string& text, const char* part) {
    EXPECT_NE(text.find(part), std::string::npos) << text;
  };
  const ScanResult r = run([&](const Tensors& carry, const Tensors&) {
    kept = nova::sin(carry[0]);
    return ScanResult{{nova::mul(kept, 2.0f)}, {}};
  });
  has(message_of([&] { nova::mul(kept, c); }), "belongs to the body of a scan");
  has(message_of([&] {
        run([&](const Tensors& carry, const Tensors&) {
          const Tensor next = nova::mul(carry[0], sum);
          sum.copy_(carry[0]);
          return ScanResult{{next}, {}};
        });
      }),
      "reads a tensor and then writes to it");
  has(message_of([&] {
        run([&](const Tensors& carry, const Tensors&) {
          Tape inside;
          const TapeScope second(inside);
          return ScanResult{carry, {}};
        });
      }),
      "another tape is active");
  EXPECT_EQ(Tape::active(), &tape);
  EXPECT_EQ(nova::current_capture(), nullptr);
  write(c, {3.0f, 4.0f});  // the scan keeps a copy of the carry
  tape.backward(nova::sum(r.carry[0]));
  const Floats g = c.grad().to_host();
  for (const size_t k : {0u, 1u}) {
    const double x = static_cast<double>(k) + 1.0, once = 2.0 * std::sin(x);
    EXPECT_NEAR(g[k], 2.0 * std::cos(once) * 2.0 * std::cos(x), 1e-6);
  }
}

TEST(Scan, BackwardRejectsValuesThatHaveChanged) {
  const Tensor c = tensor({1.0f}, true), w = tensor({2.0f});
  const Tensor xs = tensor({1.0f, 2.0f});
  for (const Tensor& changed : {w, xs}) {
    Tape tape;
    const TapeScope scope(tape);
    const ScanResult r = scan(
        [&](const Tensors& carry, const Tensors& x) {
          return ScanResult{{nova::mul(nova::mul(carry[0], w), x[0])}, {}};
        },
        {c}, {xs});
    changed.fill_(3.0f);
    const std::string text = message_of([&] { tape.backward(r.carry[0]); });
    EXPECT_NE(text.find("of op 'scan' was modified after recording"), std::string::npos) << text;
    c.zero_grad();
  }
}

}  // namespace
}  // namespace novaphy::testing
