// Tracing: constant folding has the bits of the run, and no operation is lost or invented. An
// operation that kernels do not support is rejected when the kernel is made.
#include <limits>
#include <type_traits>

#include "support.h"

namespace novaphy::testing {
namespace {

using nova::Bool;
using nova::make_kernel;
using nova::make_reduce_kernel;
using nova::SourceSpec;
using nova::Trace;
using nova::ir::Op;

static_assert(!std::is_convertible_v<Bool, bool> && !std::is_constructible_v<bool, Bool>);
static_assert(!std::is_convertible_v<Real, float> && !std::is_convertible_v<Int, int32_t>);

constexpr float kInf = std::numeric_limits<float>::infinity();
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
const std::vector<float> kFloats = {
    0.0f,   -0.0f,   1.0f,   -1.0f,          0.5f,          1.5f,           -2.5f, 3e9f,  -3e9f,
    1e-45f, -1e-45f, 1e-38f, 1.1754944e-38f, 3.4028235e38f, -3.4028235e38f, kInf,  -kInf, kNan};
const std::vector<int32_t> kInts = {0,  1,  -1,  2,         31,        32,
                                    33, -7, 100, INT32_MAX, INT32_MIN, 0x00FF00FF};

bool same_word(int32_t a, int32_t b, nova::ir::Type type) {
  if (type != nova::ir::Type::F32) return a == b;
  const float x = std::bit_cast<float>(a), y = std::bit_cast<float>(b);
  return a == b || (x != x && y != y);  // the bits of a NaN are not part of the contract
}

// Returns the result of the op on constants (folded), one word.
int32_t folded(const nova::ir::Instr& op, const std::vector<nova::ir::Instr>& operands) {
  Trace trace("fold");
  nova::ir::Instr in = op;
  int32_t* slots[] = {&in.a, &in.b, &in.c};
  for (size_t k = 0; k < operands.size(); ++k) *slots[k] = trace.emit(operands[k]);
  const nova::ir::Instr result = trace.program().instrs[static_cast<size_t>(trace.emit(in))];
  EXPECT_TRUE(result.op == Op::CONST_F || result.op == Op::CONST_I || result.op == Op::CONST_B)
      << nova::ir::kOpNames[static_cast<int>(op.op)] << " is not folded";
  return result.a;
}

// Runs the op in a kernel. The test compares results as bits of floats or of integers.
template <class Body>
std::vector<int32_t> run(const std::vector<Tensor>& in, Body body) {
  std::vector<SourceSpec> sources;
  for (const Tensor& t : in)
    sources.push_back({"s" + std::to_string(sources.size()), t.dtype(), 1, Access::Direct});
  const Kernel kernel = make_kernel("run", sources, {{"out", 1}},
                                    [&](TraceContext& c) { return std::vector<Real>{body(c)}; });
  const Tensor out = kernel(in[0].rows(), in)[0];
  return Tensor(out.range(), out.shape(), DType::I32).to_host_i32();
}

TEST(Trace, FoldsEveryFloatOpToTheBitsOfTheRun) {
  std::vector<float> a, b, c;
  for (const float x : kFloats)
    for (const float y : kFloats) {
      a.push_back(x);
      b.push_back(y);
      c.push_back(kFloats[(a.size() * 7) % kFloats.size()]);
    }
  const std::vector<Tensor> in = {tensor(a), tensor(b), tensor(c)};
  int ops = 0;
  for (int k = 0; k < nova::ir::kOpCount; ++k) {
    const auto op = static_cast<Op>(k);
    const std::string s = nova::ir::kOpSignatures[k];
    if (op == Op::PARTIAL || op == Op::DETACH || s[1] != 'f') continue;
    ++ops;
    const bool second = s[2] == 'f', third = s[3] == 'f';
    const auto result = run(in, [&](TraceContext& t) {
      const auto v =
          Trace::current().emit({op, t.f32(0).value(), second ? t.f32(1).value() : nova::ir::kNone,
                                 third ? t.f32(2).value() : nova::ir::kNone});
      if (s[0] == 'f') return Real::of(v);
      const Int as_int = s[0] == 'i' ? Int::of(v) : select(Bool::of(v), Int(1), Int(0));
      return bits_float(as_int);
    });
    for (size_t i = 0; i < a.size(); ++i) {
      std::vector<nova::ir::Instr> operands = {{Op::CONST_F, std::bit_cast<int32_t>(a[i])}};
      if (second) operands.push_back({Op::CONST_F, std::bit_cast<int32_t>(b[i])});
      if (third) operands.push_back({Op::CONST_F, std::bit_cast<int32_t>(c[i])});
      if (op == Op::F_BITS && a[i] != a[i]) continue;
      ASSERT_TRUE(same_word(folded({op}, operands), result[i], nova::ir::result_type(op)))
          << nova::ir::kOpNames[k] << '(' << a[i] << ", " << b[i] << ", " << c[i] << ')';
    }
  }
  EXPECT_GE(ops, 18);
}

TEST(Trace, FoldsEveryIntegerOpToTheBitsOfTheRun) {
  std::vector<int32_t> a, b;
  for (const int32_t x : kInts)
    for (const int32_t y : kInts) {
      a.push_back(x);
      b.push_back(y);
    }
  const std::vector<Tensor> in = {table(a), table(b)};
  int ops = 0;
  for (int k = 0; k < nova::ir::kOpCount; ++k) {
    const auto op = static_cast<Op>(k);
    const std::string s = nova::ir::kOpSignatures[k];
    if (s[1] != 'i') continue;
    ++ops;
    const bool second = s[2] == 'i';
    const auto result = run(in, [&](TraceContext& t) {
      const auto v = Trace::current().emit(
          {op, t.i32(0).value(), second ? t.i32(1).value() : nova::ir::kNone});
      if (s[0] == 'f') return Real::of(v);
      return bits_float(s[0] == 'i' ? Int::of(v) : select(Bool::of(v), Int(1), Int(0)));
    });
    for (size_t i = 0; i < a.size(); ++i) {
      std::vector<nova::ir::Instr> operands = {{Op::CONST_I, a[i]}};
      if (second) operands.push_back({Op::CONST_I, b[i]});
      ASSERT_TRUE(same_word(folded({op}, operands), result[i], nova::ir::result_type(op)))
          << nova::ir::kOpNames[k] << '(' << a[i] << ", " << b[i] << ')';
    }
  }
  EXPECT_GE(ops, 18);
}

TEST(Trace, UsesOnlyIdentitiesThatKeepEveryBit) {
  using Rewrite = Real (*)(const Real&);
  const Rewrite kept[] = {[](const Real& x) { return x + Real(0.0f); },
                          [](const Real& x) { return Real(0.0f) + x; },
                          [](const Real& x) { return x * Real(0.0f); },
                          [](const Real& x) { return x - Real(-0.0f); },
                          [](const Real& x) { return Real(0.0f) - x; },
                          [](const Real& x) { return x - x; },
                          [](const Real& x) { return x / x; },
                          [](const Real& x) { return min(x, Real(kInf)); },
                          [](const Real& x) { return fma(x, Real(1.0f), Real(-0.0f)); }};
  const Rewrite folded_away[] = {[](const Real& x) { return x + Real(-0.0f); },
                                 [](const Real& x) { return Real(-0.0f) + x; },
                                 [](const Real& x) { return x - Real(0.0f); },
                                 [](const Real& x) { return x * Real(1.0f); },
                                 [](const Real& x) { return Real(1.0f) * x; },
                                 [](const Real& x) { return x / Real(1.0f); },
                                 [](const Real& x) { return -(-x); },
                                 [](const Real& x) { return select(x < Real(1.0f), x, x); },
                                 [](const Real& x) { return select(Bool(true), x, -x); }};
  const auto program = [](Rewrite f) {
    return make_kernel("identity", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 1}},
                       [f](TraceContext& c) { return std::vector{f(c.f32(0))}; });
  };
  for (const Rewrite f : kept)
    EXPECT_GT(program(f).program().instrs.size(), 2u) << program(f).source();
  for (const Rewrite f : folded_away) {
    const Kernel kernel = program(f);
    EXPECT_EQ(kernel.program().instrs.size(), 2u) << kernel.source();
    const auto out = kernel(static_cast<int64_t>(kFloats.size()), {tensor(kFloats)})[0].to_host();
    for (size_t k = 0; k < out.size(); ++k) {
      if (std::isnan(kFloats[k])) continue;
      EXPECT_EQ(std::bit_cast<int32_t>(out[k]), std::bit_cast<int32_t>(kFloats[k]));
    }
  }
}

TEST(Trace, MakesOneValueOfEqualExpressions) {
  const Kernel kernel =
      make_kernel("twice", {{"x", DType::F32, 2, Access::Direct}}, {{"y", 2}}, [](TraceContext& c) {
        const Real a = sqrt(c.f32(0, 1)) * Real(3.0f);
        const Real b = sqrt(c.f32(c.source("x"), c.index(), 1)) * Real(3.0f);
        return std::vector{a, b};
      });
  EXPECT_EQ(kernel.program().outputs[0].values[0], kernel.program().outputs[0].values[1]);
  EXPECT_EQ(kernel.program().instrs.size(), 5u);
}

TEST(Trace, KeepsZerosAndNaNsOfConstantsApart) {
  const Kernel kernel =
      make_kernel("zeros", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 2}}, [](TraceContext& c) {
        return std::vector{c.f32(0) * Real(0.0f) + Real(0.0f), Real(-0.0f)};
      });
  const auto y = kernel(1, {tensor({1.0f})})[0].to_host();
  EXPECT_FALSE(std::signbit(y[0]));
  EXPECT_TRUE(std::signbit(y[1]));
}

TEST(Trace, NestsAndRefusesValuesWithoutATrace) {
  EXPECT_ERROR(Trace::current(), ErrorKind::Runtime, "outside of the function that makes a kernel");
  EXPECT_ERROR(Real(1.0f), ErrorKind::Runtime, "outside of the function");
  Trace outer("outer");
  const Real x = 1.0f;
  {
    const Kernel inner = make_kernel("inner", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 1}},
                                     [](TraceContext& c) { return std::vector{-c.f32(0)}; });
    EXPECT_EQ(inner(1, {tensor({2.0f})})[0].item(), -2.0f);
  }
  EXPECT_EQ(&Trace::current(), &outer);
  EXPECT_ERROR(x + Real(), ErrorKind::Runtime, "without a value");
}

TEST(Trace, RestoresTheOuterTraceWhenAFunctionThrows) {
  Trace outer("outer");
  EXPECT_THROW(
      make_kernel("bad", {}, {{"y", 1}},
                  [](TraceContext&) -> std::vector<Real> { throw std::runtime_error("mine"); }),
      std::runtime_error);
  EXPECT_EQ(&Trace::current(), &outer);
}

// A long chain, as an unrolled loop of a user makes one.
TEST(Trace, TakesALongChainOfOperations) {
  const Kernel kernel =
      make_kernel("chain", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 1}}, [](TraceContext& c) {
        Real y = c.f32(0);
        for (int k = 0; k < 5000; ++k) y = fma(y, Real(0.999f), c.f32(0));
        return std::vector{y};
      });
  const Tensor x = tensor({1.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = kernel(1, {x})[0];
  tape.backward(y);
  EXPECT_NEAR(x.grad().item(), y.item(), 1e-2f);  // linear in x
}

TEST(TraceRefuses, AChainThatIsTooLongForTheStack) {
  EXPECT_ERROR(make_kernel("endless", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 1}},
                           [](TraceContext& c) {
                             Real y = c.f32(0);
                             for (int k = 0; k < 300000; ++k) y = y * c.f32(0);
                             return std::vector{y};
                           }),
               ErrorKind::Value, "kernel 'endless': a chain of more than 10000 operations");
}

// ---- refusals when a kernel is made ----

Kernel one(const SourceSpec& source, const nova::TraceFn& f, int32_t width = 1) {
  return make_kernel("k", {source}, {{"out", width}}, f);
}
std::vector<Real> zeros(TraceContext&) { return {Real(0.0f)}; }

TEST(TraceRefuses, ARowThatTheDeclaredAccessDoesNotAllow) {
  EXPECT_ERROR(one({"x", DType::F32, 1, Access::Direct},
                   [](TraceContext& c) { return std::vector{c.f32(0, c.index() + Int(1), 0)}; }),
               ErrorKind::Value,
               "source 'x' is read at a row that its declared access does not allow");
  EXPECT_ERROR(one({"x", DType::F32, 1, Access::Uniform},
                   [](TraceContext& c) { return std::vector{c.f32(0, c.index(), 0)}; }),
               ErrorKind::Value, "'x'");
  EXPECT_ERROR(one({"x", DType::F32, 1, Access::Indexed},
                   [](TraceContext& c) { return std::vector{c.f32(0)}; }),
               ErrorKind::Value, "at which row");
  EXPECT_ERROR(one({"x", DType::F32, 1, Access::Reduced}, zeros), ErrorKind::Value,
               "only a kernel with a sum");
  EXPECT_ERROR(one({"x", DType::F32, 1, Access::CsrRow}, zeros), ErrorKind::Value,
               "only a kernel with a sum");
}

TEST(TraceRefuses, PositionsOutsideOfASum) {
  const SourceSpec direct = {"x", DType::F32, 1, Access::Direct};
  EXPECT_ERROR(one(direct, [](TraceContext& c) { return std::vector{to_real(c.reduce_index())}; }),
               ErrorKind::Value, "reduce_index");
  EXPECT_ERROR(one(direct, [](TraceContext& c) { return std::vector{to_real(c.slot())}; }),
               ErrorKind::Value, "slot");
  const auto sum = [](const SourceSpec& s, nova::ReduceFns fns) {
    return make_reduce_kernel("k", {s}, {{"out", 1}}, fns);
  };
  EXPECT_ERROR(sum({"r", DType::F32, 1, Access::Reduced},
                   {.init = {},
                    .body = [](TraceContext& c) { return std::vector{to_real(c.slot())}; },
                    .epilogue = {}}),
               ErrorKind::Value, "slot");
  EXPECT_ERROR(sum({"r", DType::F32, 1, Access::Reduced},
                   {.init = [](TraceContext& c) { return std::vector{c.f32(0)}; },
                    .body = [](TraceContext& c) { return std::vector{c.f32(0)}; },
                    .epilogue = {}}),
               ErrorKind::Value, "reduce_index");
}

TEST(TraceRefuses, AValueThatLeavesTheLoopThatMadeIt) {
  Real leaked;
  EXPECT_ERROR(
      make_reduce_kernel(
          "k", {{"r", DType::F32, 1, Access::Reduced}}, {{"out", 1}},
          {.init = {},
           .body = [&](TraceContext& c) { return std::vector{leaked = c.f32(0)}; },
           .epilogue = [&](TraceContext&,
                           std::span<const Real> s) { return std::vector{s[0] + leaked}; }}),
      ErrorKind::Value, "kernel 'k'");
  EXPECT_ERROR(
      make_reduce_kernel(
          "k", {{"r", DType::F32, 1, Access::Reduced}}, {{"out", 1}},
          {.init = {},
           .body = [&](TraceContext& c) { return std::vector{leaked = c.f32(0)}; },
           .epilogue = [&](TraceContext&, std::span<const Real>) { return std::vector{leaked}; }}),
      ErrorKind::Value, "kernel 'k'");
}

TEST(TraceRefuses, UnknownSourcesColumnsAndTypes) {
  const SourceSpec x = {"x", DType::F32, 2, Access::Direct};
  EXPECT_ERROR(one(x, [](TraceContext& c) { return std::vector{c.f32(c.source("y"))}; }),
               ErrorKind::Value, "no source 'y'");
  EXPECT_ERROR(one(x, [](TraceContext& c) { return std::vector{c.f32(1)}; }), ErrorKind::Index,
               "source 1 of 1");
  EXPECT_ERROR(one(x, [](TraceContext& c) { return std::vector{c.f32(0, 2)}; }), ErrorKind::Index,
               "column 2 of 2");
  EXPECT_ERROR(one(x, [](TraceContext& c) { return std::vector{c.f32(0, -1)}; }), ErrorKind::Index,
               "column -1");
  EXPECT_ERROR(one(x, [](TraceContext& c) { return std::vector{to_real(c.i32(0))}; }),
               ErrorKind::Type, "float32");
  EXPECT_ERROR(one({"x", DType::F32, 0, Access::Direct}, zeros), ErrorKind::Value, "width 0");
  EXPECT_ERROR(one({"x", DType::U8, 1, Access::Direct}, zeros), ErrorKind::Type, "uint8");
  EXPECT_ERROR(
      one(x, [](TraceContext& c) { return std::vector{c.param(0) + to_real(c.param_i32(0))}; }),
      ErrorKind::Type, "parameter 0");
  EXPECT_ERROR(one(x, [](TraceContext& c) { return std::vector{c.param(-1)}; }), ErrorKind::Index,
               "parameter -1");
}

TEST(TraceRefuses, AWrongNumberOfColumnsAndColumnsWithoutAValue) {
  const SourceSpec x = {"x", DType::F32, 1, Access::Direct};
  EXPECT_ERROR(one(x, zeros, 2), ErrorKind::Value, "returned fewer");
  EXPECT_ERROR(one(x, [](TraceContext&) { return std::vector<Real>(2, Real(0.0f)); }),
               ErrorKind::Value, "returned 2 values, expected 1");
  EXPECT_ERROR(one(x, [](TraceContext&) { return std::vector<Real>(1); }), ErrorKind::Value,
               "column 0: no value");
  EXPECT_ERROR(make_kernel("k", {x}, {}, [](TraceContext&) { return std::vector<Real>{}; }),
               ErrorKind::Value, "no outputs");
  const SourceSpec r = {"r", DType::F32, 1, Access::Reduced};
  EXPECT_ERROR(
      make_reduce_kernel(
          "k", {r}, {{"out", 1}},
          {.init = {}, .body = [](TraceContext&) { return std::vector<Real>(1); }, .epilogue = {}}),
      ErrorKind::Value, "term 0: no value");
  EXPECT_ERROR(make_reduce_kernel("k", {r}, {{"out", 1}},
                                  {.init = [](TraceContext&) { return std::vector<Real>(1); },
                                   .body = [](TraceContext& c) { return std::vector{c.f32(0)}; },
                                   .epilogue = {}}),
               ErrorKind::Value, "initial value 0: no value");
  EXPECT_ERROR(
      make_reduce_kernel("k", {r}, {{"out", 1}},
                         {.init = [](TraceContext&) { return std::vector<Real>(2, Real(0.0f)); },
                          .body = [](TraceContext& c) { return std::vector{c.f32(0)}; },
                          .epilogue = {}}),
      ErrorKind::Value, "1 terms but 2 initial values");
}

TEST(TraceRefuses, MissingFunctionsAndMoreThanItCanHold) {
  const SourceSpec x = {"x", DType::F32, 1, Access::Direct};
  EXPECT_ERROR(one(x, nova::TraceFn()), ErrorKind::Value, "expected a function");
  EXPECT_ERROR(make_reduce_kernel("k", {x}, {{"out", 1}}, {}), ErrorKind::Value,
               "expected a function");
  EXPECT_ERROR(make_kernel("k", std::vector<SourceSpec>(65, x), {{"out", 1}}, zeros),
               ErrorKind::Value, "64 sources");
  EXPECT_ERROR(make_kernel("k", {x}, std::vector<nova::OutputSpec>(33, {"out", 1}),
                           [](TraceContext& c) { return std::vector<Real>(33, c.f32(0)); }),
               ErrorKind::Value, "32 outputs");
  EXPECT_ERROR(
      make_reduce_kernel(
          "k", {{"r", DType::F32, 1, Access::Reduced}, {"e", DType::F32, 1, Access::CsrRow}},
          {{"out", 1}}, {.init = {}, .body = zeros, .epilogue = {}}),
      ErrorKind::Value, "not both");
}

// ---- refusals when a kernel is called ----

TEST(KernelRefuses, WrongInputs) {
  const Kernel kernel = make_kernel("k",
                                    {{"q", DType::F32, 3, Access::Direct},
                                     {"t", DType::I32, 1, Access::Direct},
                                     {"u", DType::F32, 1, Access::Uniform}},
                                    {{"out", 1}}, [](TraceContext& c) {
                                      return std::vector{c.f32(0) * c.f32(2) + to_real(c.i32(1))};
                                    });
  const Tensor q(Shape{4, 3}), u(Shape{1});
  const Tensor t = table({0, 1, 2, 3});
  EXPECT_EQ(kernel(4, {q, t, u})[0].shape(), (Shape{4}));
  EXPECT_ERROR(kernel(4, {q, t}), ErrorKind::Value, "expected 3 inputs, got 2");
  EXPECT_ERROR(kernel(4, {Tensor(Shape{4, 4}), t, u}), ErrorKind::Value,
               "q: expected {4, 3} tightly packed float32, got {4, 4}");
  EXPECT_ERROR(kernel(4, {Tensor(Shape{5, 3}), t, u}), ErrorKind::Value, "q: expected {4, 3}");
  EXPECT_ERROR(kernel(4, {Tensor(Shape{12}), t, u}), ErrorKind::Value, "q: expected {4, 3}");
  EXPECT_ERROR(kernel(4, {t, t, u}), ErrorKind::Type, "q: expected float32, got int32");
  EXPECT_ERROR(kernel(4, {q, q, u}), ErrorKind::Type, "t: expected int32, got float32");
  EXPECT_ERROR(kernel(4, {q, t, Tensor(Shape{0})}), ErrorKind::Value, "u: expected {1}");
  EXPECT_ERROR(kernel(4, {q, t, Tensor()}), ErrorKind::Value, "undefined");
  EXPECT_ERROR(kernel(-1, {q, t, u}), ErrorKind::Value, "dim");
  EXPECT_ERROR(kernel(4, {q, t, Tensor(Shape{4}, DType::U8)}), ErrorKind::Type, "uint8");
}

TEST(KernelRefuses, WrongParametersExtentAndIncidence) {
  const Kernel fixed =
      make_reduce_kernel("k", {{"r", DType::F32, 1, Access::Reduced}}, {{"out", 1}},
                         {.init = {},
                          .body =
                              [](TraceContext& c) {
                                return std::vector{c.f32(0) * c.param(0) * to_real(c.param_i32(1))};
                              },
                          .epilogue = {}});
  const Tensor r(Shape{3});
  const std::vector<Param> good = {1.0f, int32_t{2}}, few = {1.0f}, swapped = {int32_t{1}, 2.0f};
  EXPECT_NO_THROW(fixed(1, {r}, {.params = good, .extent = 3}));
  EXPECT_ERROR(fixed(1, {r}, {.params = few, .extent = 3}), ErrorKind::Value,
               "expected 2 parameters, got 1");
  EXPECT_ERROR(fixed(1, {r}, {.params = swapped, .extent = 3}), ErrorKind::Type,
               "parameter 0: expected float");
  EXPECT_ERROR(fixed(1, {r}, {.params = good, .extent = 4}), ErrorKind::Value, "r: expected {4}");
  EXPECT_ERROR(fixed(1, {r}, {.params = good, .extent = -1}), ErrorKind::Value,
               "extent: expected the number of items of the sum, >= 0");
  const Kernel csr = make_reduce_kernel(
      "k", {{"e", DType::F32, 1, Access::CsrRow}}, {{"out", 1}},
      {.init = {}, .body = [](TraceContext& c) { return std::vector{c.f32(0)}; }, .epilogue = {}});
  const nova::Incidence rows = nova::make_incidence(table({0, 1, 1}).operand(), 2), none;
  EXPECT_EQ(csr(2, {tensor({1.0f, 2.0f, 4.0f})}, {.csr = &rows})[0].to_host(),
            (std::vector<float>{1.0f, 6.0f}));
  EXPECT_ERROR(csr(2, {r}), ErrorKind::Value, "expected an Incidence of 2 rows, got none");
  EXPECT_ERROR(csr(2, {r}, {.csr = &none}), ErrorKind::Value, "expected an Incidence");
  EXPECT_ERROR(csr(3, {r}, {.csr = &rows}), ErrorKind::Value,
               "expected an Incidence of 3 rows, got 2");
  const auto past_the_end = [] {  // a device reports the error at the next wait
    nova::make_incidence(table({0, 2}).operand(), 2);
    novaphy::synchronize(novaphy::default_device());
  };
  EXPECT_ERROR(past_the_end(), ErrorKind::Index, "");
  EXPECT_ERROR(nova::make_incidence(tensor({0.0f}).operand(), 2), ErrorKind::Type, "int32");
}

TEST(KernelRefuses, AnIndexPastTheEndAndNamesTheKernel) {
  const Kernel kernel = make_kernel(
      "gather", {{"t", DType::I32, 1, Access::Direct}, {"x", DType::F32, 1, Access::Indexed}},
      {{"out", 1}}, [](TraceContext& c) { return std::vector{c.f32(1, c.i32(0), 0)}; });
  EXPECT_ERROR(kernel(2, {table({0, 3}), tensor({1.0f, 2.0f, 3.0f})})[0].to_host(),
               ErrorKind::Index, "gather");
  EXPECT_EQ(kernel(2, {table({2, -1}), tensor({1.0f, 2.0f, 3.0f})})[0].to_host(),
            (std::vector<float>{3.0f, 0.0f}));
}

TEST(KernelRefuses, OutputsThatOverlap) {
  const Kernel kernel = make_kernel(
      "two", {{"x", DType::F32, 1, Access::Direct}, {"u", DType::F32, 1, Access::Uniform}},
      {{"a", 1}, {"b", 1}}, [](TraceContext& c) {
        return std::vector{c.f32(0), c.f32(1)};
      });
  const auto storage = Storage::allocate(64, novaphy::default_device());
  const auto part = [&](size_t first, size_t count) {
    return Tensor(storage->range(4 * first, 4 * count), {static_cast<int64_t>(count)}, DType::F32);
  };
  const auto launch = [&](const Tensor& x, const Tensor& u, const Tensor& a, const Tensor& b) {
    const nova::Operand in[] = {x.operand(), u.operand()}, out[] = {a.operand(), b.operand()};
    kernel.launch(4, in, out);
  };
  const Tensor u(Shape{1});
  EXPECT_NO_THROW(launch(part(0, 4), u, part(4, 4), part(8, 4)));
  EXPECT_NO_THROW(
      launch(part(0, 4), u, part(0, 4), part(8, 4)));  // exactly the same rows, read direct
  EXPECT_ERROR(launch(part(0, 4), u, part(1, 4), part(8, 4)), ErrorKind::Value,
               "output 'a' overlaps input 'x'");
  EXPECT_ERROR(launch(part(0, 4), u, part(4, 4), part(7, 4)), ErrorKind::Value,
               "outputs 'a' and 'b' overlap");
  EXPECT_ERROR(launch(part(0, 4), part(4, 1), part(4, 4), part(8, 4)), ErrorKind::Value,
               "overlaps input 'u'");
  EXPECT_ERROR(launch(part(0, 4), u, part(4, 3), part(8, 4)), ErrorKind::Value,
               "output a: expected {4}");
}

}  // namespace
}  // namespace novaphy::testing
