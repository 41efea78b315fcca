// A tape never gives a wrong gradient silently: every misuse gives either the correct result or a
// clear error.
#include <optional>

#include "novaphy/nova/optim.h"
#include "support.h"

namespace novaphy::testing {
namespace {

using nova::BackwardFn;
using nova::make_kernel;
using Floats = std::vector<float>;

Floats grad(const Tensor& x) { return x.grad().to_host(); }
// x, which a kernel writes into given memory: out = a * x, and out = x * x.
const Kernel& scale_kernel() {
  static const Kernel kernel =
      make_kernel("scale", {{"x", DType::F32, 1, Access::Direct}}, {{"out", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0) * c.param(0)}; });
  return kernel;
}
const Kernel& square_kernel() {
  static const Kernel kernel =
      make_kernel("square", {{"x", DType::F32, 1, Access::Direct}}, {{"out", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0) * c.f32(0)}; });
  return kernel;
}
void scale_into(const Tensor& out, const Tensor& x, float a) {
  const nova::Operand in = x.operand(), to = out.operand();
  const Param params[] = {a};
  scale_kernel().launch(x.rows(), in, to, {.params = params});
}
void square_into(const Tensor& out, const Tensor& x) {
  const nova::Operand in = x.operand(), to = out.operand();
  square_kernel().launch(x.rows(), in, to);
}

class TapeTest : public ::testing::Test {
 protected:
  Tensor x = tensor({1.0f, -2.0f, 3.0f}, true);
  Tape tape;
  std::optional<TapeScope> scope{std::in_place, tape};
};

// ---- leaves ----

using TapeLeaves = TapeTest;

TEST_F(TapeLeaves, BackwardTwiceGivesExactlyTwice) {
  const Tensor loss = sum(nova::mul(nova::sin(x), x));
  tape.backward(loss);
  const Floats once = grad(x);
  tape.backward(loss);
  const Floats twice = grad(x);
  for (size_t k = 0; k < 3; ++k) EXPECT_EQ(twice[k], 2.0f * once[k]);
}

TEST_F(TapeLeaves, TwoLossesGiveTheSum) {
  const Tensor shared = nova::mul(x, x), a = sum(shared), b = sum(nova::mul(shared, x));
  tape.backward(a);
  tape.backward(b);
  EXPECT_EQ(grad(x), (Floats{2.0f + 3.0f, -4.0f + 12.0f, 6.0f + 27.0f}));
}

TEST_F(TapeLeaves, OnlyLeavesAccumulate) {
  const Tensor y = nova::mul(x, 2.0f), loss = sum(nova::mul(y, y));
  tape.backward(loss);
  const Floats once = grad(y);
  EXPECT_EQ(once, (Floats{4.0f, -8.0f, 12.0f}));
  tape.backward(loss);
  EXPECT_EQ(grad(y), once);
  EXPECT_EQ(grad(x), (Floats{16.0f, -32.0f, 48.0f}));
  EXPECT_EQ(grad(loss), (Floats{1.0f}));
}

TEST_F(TapeLeaves, AGradientFromBeforeTheTapeIsAddedTo) {
  const Tensor g = x.grad();
  g.fill_(100.0f);
  tape.backward(sum(x));
  EXPECT_EQ(grad(x), (Floats(3, 101.0f)));
}

TEST_F(TapeLeaves, AnInputThatTheLossDoesNotReachKeepsItsGradient) {
  const Tensor z = tensor({5.0f}, true), unused = nova::mul(z, 2.0f);
  tape.backward(sum(x));
  EXPECT_EQ(grad(z), (Floats{0.0f}));
  tape.backward(unused);
  tape.backward(sum(x));
  EXPECT_EQ(grad(z), (Floats{2.0f}));
}

TEST_F(TapeLeaves, AValueUsedByManyOperationsAddsUp) {
  Tensor total = nova::mul(x, x);
  for (int k = 0; k < 9; ++k) total = nova::add(total, nova::mul(x, static_cast<float>(k)));
  tape.backward(sum(total));
  EXPECT_EQ(grad(x), (Floats{2.0f + 36.0f, -4.0f + 36.0f, 6.0f + 36.0f}));
}

TEST_F(TapeLeaves, IsLeafUntilAnOperationOfALivingTapeWritesIt) {
  const Tensor y = nova::mul(x, 2.0f);
  EXPECT_TRUE(x.is_leaf());
  EXPECT_FALSE(y.is_leaf());
  tape.reset();
  EXPECT_TRUE(y.is_leaf());
  const Tensor z = nova::mul(tensor({1.0f}), 2.0f);  // nothing to record
  EXPECT_TRUE(z.is_leaf());
  EXPECT_EQ(tape.size(), 0u);
}

TEST_F(TapeLeaves, WithoutRequiresGradNothingIsRecorded) {
  x.set_requires_grad(false);
  const Tensor y = sum(nova::mul(x, 2.0f));
  EXPECT_EQ(tape.size(), 0u);
  EXPECT_ERROR(tape.backward(y), ErrorKind::Value,
               "no operation of this tape wrote it from an input with a gradient");
  EXPECT_ERROR(table({1}).set_requires_grad(true), ErrorKind::Value, "only float32");
}

// ---- what may be a loss ----

using TapeLoss = TapeTest;

TEST_F(TapeLoss, NotWrittenByThisTapeIsRefused) {
  EXPECT_ERROR(tape.backward(Tensor()), ErrorKind::Value, "undefined");
  EXPECT_ERROR(tape.backward(x), ErrorKind::Value, "no operation of this tape");
  const Tensor loss = sum(x);
  scope.reset();
  Tape other;
  EXPECT_ERROR(other.backward(loss), ErrorKind::Value, "no operation of this tape");
  EXPECT_NO_THROW(tape.backward(loss));  // also when it is no longer active
  tape.reset();
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Value, "no operation of this tape");
}

TEST_F(TapeLoss, OfSeveralValuesNeedsASeedOfItsSize) {
  const Tensor y = nova::mul(x, 2.0f);
  EXPECT_ERROR(tape.backward(y), ErrorKind::Value,
               "expected one value (or pass grad), got shape {3}");
  EXPECT_ERROR(tape.backward(y, tensor({1.0f, 1.0f})), ErrorKind::Value,
               "expected {3} float32, got {2}");
  EXPECT_ERROR(tape.backward(y, table({1, 1, 1})), ErrorKind::Value, "int32");
  EXPECT_FALSE(x.has_grad() && grad(x) != Floats(3, 0.0f));
  tape.backward(y, tensor({1.0f, 10.0f, 0.0f}));
  EXPECT_EQ(grad(x), (Floats{2.0f, 20.0f, 0.0f}));
  tape.backward(y, y.grad());  // the seed may be the gradient's own memory
  EXPECT_EQ(grad(x), (Floats{4.0f, 40.0f, 0.0f}));
}

TEST_F(TapeLoss, ASeedScalesAScalarLoss) {
  tape.backward(sum(x), tensor({-3.0f}));
  EXPECT_EQ(grad(x), Floats(3, -3.0f));
}

TEST_F(TapeLoss, OverwrittenAfterRecordingIsRefused) {
  const Tensor loss = sum(x);
  loss.fill_(0.0f);
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "loss: it was overwritten");
}

TEST_F(TapeLoss, AnIntermediateValueMayBeOne) {
  const Tensor y = nova::mul(x, 3.0f);
  sum(nova::mul(y, y));
  tape.backward(y, tensor({1.0f, 1.0f, 1.0f}));
  EXPECT_EQ(grad(x), Floats(3, 3.0f));
}

// ---- values that an adjoint reads ----

using TapeValues = TapeTest;

TEST_F(TapeValues, OverwrittenAfterRecordingAreRefusedAndTheOperationAndInputNamed) {
  const std::pair<const char*, std::function<void(const Tensor&)>> ways[] = {
      {"from the host",
       [](const Tensor& t) {
         write(t, {7.0f, 7.0f, 7.0f});
       }},
      {"by a fill", [](const Tensor& t) { t.fill_(7.0f); }},
      {"by a copy",
       [](const Tensor& t) {
         t.copy_(tensor({7.0f, 7.0f, 7.0f}));
       }},
      {"by a kernel that is not recorded",
       [](const Tensor& t) {
         const NoGrad no;
         scale_into(t, tensor({7.0f, 7.0f, 7.0f}), 1.0f);
       }},
      {"by an optimizer",
       [](const Tensor& t) {
         t.grad();
         nova::sgd_update_f32(t, 0.1f);
       }},
      {"through another view",
       [](const Tensor& t) {
         Tensor(t.range()->storage().range(4, 4), {1}, DType::F32).fill_(7.0f);
       }},
      {"through the engine's array",
       [](const Tensor& t) { Array(novaphy::DType::float32, 3, 1, t.range()).zero(); }}};
  for (const auto& [how, overwrite] : ways) {
    SCOPED_TRACE(how);
    const Tensor a = tensor({1.0f, 2.0f, 3.0f}, true);
    const Tensor out(Shape{3});
    square_into(out, a);
    const Tensor loss = sum(out);
    overwrite(a);
    EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime,
                 "input 'x' of op 'square' was modified after recording");
    EXPECT_EQ(grad(a), Floats(3, 0.0f));
  }
}

TEST_F(TapeValues, ThatNoAdjointReadsMayBeOverwritten) {
  const Tensor f = tensor({1.0f, 2.0f, 3.0f}, true);
  const Tensor y = nova::add(nova::mul(f, 2.0f), x);
  const Tensor loss = sum(nova::mul(y, y));
  const Floats values = y.to_host();
  f.fill_(0.0f);  // as clear_forces does
  x.fill_(0.0f);
  tape.backward(loss);
  for (size_t k = 0; k < 3; ++k) EXPECT_EQ(grad(f)[k], 4.0f * values[k]);
}

TEST_F(TapeValues, OnTheSideOfAProductThatHasNoGradientAreStillRead) {
  const Tensor constant = tensor({2.0f, 2.0f, 2.0f});
  const Tensor loss = sum(nova::mul(x, constant));
  constant.fill_(5.0f);
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "input 'b' of op 'mul'");
}

TEST_F(TapeValues, OfAnIndexTableOverwrittenAreRefused) {
  const Kernel gather = make_kernel(
      "gather", {{"at", DType::I32, 1, Access::Direct}, {"x", DType::F32, 1, Access::Indexed}},
      {{"out", 1}}, [](TraceContext& c) { return std::vector{c.f32(1, c.i32(0), 0)}; });
  const Tensor at = table({2, 0});
  const Tensor loss = sum(gather(2, {at, x})[0]);
  const std::vector<int32_t> other = {1, 1};
  at.copy_from_host(other.data(), 8);
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "input 'at' of op 'gather'");
}

TEST_F(TapeValues, OfTheTableOfACsrSumOverwrittenAreRefused) {
  const Kernel csr = nova::make_reduce_kernel(
      "rows", {{"e", DType::F32, 1, Access::CsrRow}}, {{"out", 1}},
      {.init = {}, .body = [](TraceContext& c) { return std::vector{c.f32(0)}; }, .epilogue = {}});
  const Tensor rows_of = table({0, 1, 1});
  const nova::Incidence rows = nova::make_incidence(rows_of.operand(), 2);
  const Tensor y = csr(2, {x}, {.csr = &rows})[0];
  const Tensor seed = tensor({1.0f, 10.0f});
  tape.backward(y, seed);
  EXPECT_EQ(grad(x), (Floats{1.0f, 10.0f, 10.0f}));
  const std::vector<int32_t> other = {1, 0, 0};
  rows_of.copy_from_host(other.data(), 12);
  EXPECT_ERROR(tape.backward(y, seed), ErrorKind::Runtime, "op 'rows'");
  EXPECT_EQ(grad(x), (Floats{1.0f, 10.0f, 10.0f}));
}

TEST_F(TapeValues, OfALeafThatChangedBetweenTwoUsesAreRefused) {
  // The operations are linear, so no adjoint reads the values. But one gradient cannot belong to
  // two values.
  const Tensor a = nova::mul(x, 2.0f);
  x.fill_(9.0f);
  const Tensor b = nova::mul(x, 3.0f);
  EXPECT_ERROR(tape.backward(sum(nova::add(a, b))), ErrorKind::Runtime,
               "input 'x' of op 'mul_scalar'");
  tape.backward(sum(b));  // each for itself is right
  EXPECT_EQ(grad(x), Floats(3, 3.0f));
}

TEST_F(TapeValues, ARefusedBackwardLeavesEveryGradientAsItWas) {
  const Tensor z = tensor({1.0f, 1.0f, 1.0f}, true), fresh = tensor({2.0f, 2.0f, 2.0f}, true);
  const Tensor y = nova::mul(z, 4.0f);
  tape.backward(sum(y));
  const Tensor bad = nova::mul(x, x);
  const Tensor loss = sum(nova::add(nova::add(bad, y), fresh));
  x.fill_(0.0f);
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "was modified");
  EXPECT_EQ(grad(z), Floats(3, 4.0f));
  EXPECT_EQ(grad(y), Floats(3, 1.0f));
  EXPECT_EQ(grad(fresh), Floats(3, 0.0f));
  EXPECT_EQ(grad(loss), Floats(1, 0.0f));
  EXPECT_NO_THROW(tape.backward(sum(y)));
  EXPECT_EQ(grad(z), Floats(3, 8.0f));
}

// ---- arrays used again ----

using TapeReuse = TapeTest;

TEST_F(TapeReuse, TwoArraysInTurnCarryTheGradientThroughEveryStep) {
  const Tensor other(Shape{3});
  for (int k = 0; k < 5; ++k) {
    scale_into(other, x, 2.0f);
    scale_into(x, other, 3.0f);
  }
  scale_into(other, x, 1.0f);
  tape.backward(sum(other));
  EXPECT_EQ(grad(x), Floats(3, 7776.0f));
  tape.backward(sum(other));  // x is no leaf now: its gradient is stored, not added to
  EXPECT_EQ(grad(x), Floats(3, 7776.0f));
}

TEST_F(TapeReuse, AnArrayWhoseValueIsNeededMustNotBeReused) {
  const Tensor a(Shape{3}), b(Shape{3});
  square_into(a, x);
  square_into(b, a);
  scale_into(a, b, 2.0f);
  EXPECT_ERROR(tape.backward(sum(a)), ErrorKind::Runtime,
               "input 'x' of op 'square' was modified after recording");
}

TEST_F(TapeReuse, ARecordedValueThatWasOverwrittenOutsideIsRefusedWhenItIsUsed) {
  const Tensor y(Shape{3});
  square_into(y, x);
  write(y, {1.0f, 1.0f, 1.0f});
  EXPECT_ERROR(scale_into(Tensor(Shape{3}), y, 2.0f), ErrorKind::Runtime,
               "input 'x' of op 'scale' was written by op 'square'");
}

TEST_F(TapeReuse, ALaunchWithoutGradientMakesItsOutputAConstantAgain) {
  const Tensor y(Shape{3});
  square_into(y, x);
  const Tensor before = nova::mul(y, 2.0f);
  scale_into(y, tensor({5.0f, 5.0f, 5.0f}), 1.0f);
  const Tensor loss = sum(nova::add(nova::mul(y, x), before));
  tape.backward(loss);
  EXPECT_EQ(grad(x), (Floats{5.0f + 4.0f, 5.0f - 8.0f, 5.0f + 12.0f}));
}

TEST_F(TapeReuse, TheNextIterationWithoutZeroAddsAndWithZeroStores) {
  for (int k = 1; k <= 3; ++k) {
    tape.backward(sum(nova::mul(x, 2.0f)));
    EXPECT_EQ(grad(x), Floats(3, 2.0f * static_cast<float>(k)));
  }
  tape.zero();
  EXPECT_EQ(grad(x), Floats(3, 0.0f));
  tape.backward(sum(nova::mul(x, 2.0f)));
  EXPECT_EQ(grad(x), Floats(3, 2.0f));
  tape.reset();
  EXPECT_EQ(tape.size(), 0u);
  tape.zero();  // changes nothing, because reset() forgot x
  EXPECT_EQ(grad(x), Floats(3, 2.0f));
}

TEST_F(TapeReuse, ZeroIsSeenByWhoHoldsTheGradient) {
  const Tensor y = nova::mul(x, 2.0f), loss = sum(y);
  tape.backward(loss);
  const Tensor held = x.grad();
  tape.zero();
  EXPECT_EQ(held.to_host(), Floats(3, 0.0f));
  EXPECT_EQ(grad(y), Floats(3, 0.0f));
  tape.backward(loss);
  EXPECT_EQ(held.to_host(), Floats(3, 2.0f));
}

TEST_F(TapeReuse, ZeroGradOfOneLeafLeavesTheOthers) {
  const Tensor z = tensor({1.0f, 1.0f, 1.0f}, true), loss = sum(nova::add(x, z));
  tape.backward(loss);
  x.zero_grad();
  tape.backward(loss);
  EXPECT_EQ(grad(x), Floats(3, 1.0f));
  EXPECT_EQ(grad(z), Floats(3, 2.0f));
}

TEST_F(TapeReuse, ATrainingLoopOnOneTapeWithReset) {
  for (int k = 0; k < 3; ++k) {
    const Tensor loss = sum(nova::mul(x, x));
    tape.backward(loss);
    nova::sgd_update_f32(x, 0.25f);
    tape.zero();
    tape.reset();
  }
  EXPECT_EQ(x.to_host(), (Floats{0.125f, -0.25f, 0.375f}));
}

// ---- aliasing ----

using TapeAlias = TapeTest;

TEST_F(TapeAlias, AnOutputThatIsTheInputIsRefusedBeforeAnythingIsWritten) {
  const Floats before = x.to_host();
  const uint64_t version = x.version();
  EXPECT_ERROR(scale_into(x, x, 2.0f), ErrorKind::Value,
               "output 'out' overlaps input 'x', which a tape records");
  EXPECT_EQ(x.to_host(), before);
  EXPECT_EQ(x.version(), version);
  EXPECT_EQ(tape.size(), 0u);
  const NoGrad no;
  scale_into(x, x, 2.0f);
  EXPECT_EQ(x.to_host(), (Floats{2.0f, -4.0f, 6.0f}));
}

TEST_F(TapeAlias, AnotherViewOfBytesThatCarryAGradientIsRefused) {
  const auto storage = Storage::allocate(24, novaphy::default_device());
  const Tensor whole(storage->range(), {6}, DType::F32),
      half(storage->range(0, 12), {3}, DType::F32);
  half.set_requires_grad(true);
  EXPECT_ERROR(nova::mul(whole, 2.0f), ErrorKind::Runtime, "gradient belongs to another view");
  half.set_requires_grad(false);
  square_into(half, x);  // now it carries one because the tape wrote it
  EXPECT_ERROR(nova::mul(whole, 2.0f), ErrorKind::Runtime, "gradient belongs to another view");
  EXPECT_NO_THROW(nova::mul(Tensor(storage->range(12, 12), {3}, DType::F32), 2.0f));
  const NoGrad no;
  EXPECT_NO_THROW(nova::mul(whole, 2.0f));
}

TEST_F(TapeAlias, AWriteThroughALargerViewIsSeen) {
  const auto storage = Storage::allocate(24, novaphy::default_device());
  const Tensor whole(storage->range(), {6}, DType::F32),
      half(storage->range(12, 12), {3}, DType::F32);
  square_into(half, x);
  whole.fill_(0.0f);
  EXPECT_ERROR(nova::mul(half, 2.0f), ErrorKind::Runtime, "overwritten outside");
}

TEST_F(TapeAlias, ViewsOfTheSameBytesShareOneGradient) {
  const Tensor row = x.reshape({1, 3});
  EXPECT_TRUE(row.requires_grad());
  tape.backward(sum(nova::mul(row, 2.0f)));
  EXPECT_EQ(grad(x), Floats(3, 2.0f));
  tape.backward(sum(nova::mul(x, 3.0f)));
  EXPECT_EQ(grad(row), Floats(3, 5.0f));
}

// ---- writable exports: somebody else writes the bytes without a word ----

class TapeExport : public TapeTest {
 protected:
  static void poke(const Tensor& t, float value) { poke(*t.range(), 1, value); }
  template <class T>
  static void poke(const Range& range, size_t at, T value) {
    const DeviceContext& c = device_context(range.storage().device());
    novaphy_error error = make_error();
    ASSERT_EQ(c.api->memory_copy(c.stream, NOVAPHY_COPY_HOST_TO_DEVICE,
                                 static_cast<char*>(range.data()) + at * sizeof(T), &value,
                                 sizeof(T), &error),
              NOVAPHY_OK)
        << error.message;
  }
};

TEST_F(TapeExport, AWriteBehindTheBackOfTheTapeIsCaught) {
  x.range()->mark_writable_export();
  const Tensor loss = sum(nova::mul(x, x));
  tape.backward(loss);
  EXPECT_EQ(grad(x), (Floats{2.0f, -4.0f, 6.0f}));
  poke(x, 5.0f);
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime,
               "input 'a' of op 'mul' was modified after recording");
  poke(x, -2.0f);  // as it was: nothing is wrong
  EXPECT_NO_THROW(tape.backward(loss));
}

TEST_F(TapeExport, AlsoWhenTheExportIsMadeAfterRecording) {
  const Tensor loss = sum(nova::mul(x, x));
  x.range()->mark_writable_export();
  tape.backward(loss);
  poke(x, 5.0f);
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "was modified after recording");
}

TEST_F(TapeExport, AlsoWhenASecondExportIsMadeAfterTheWrite) {
  const Tensor loss = sum(nova::mul(x, x));
  x.range()->mark_writable_export();
  poke(x, 5.0f);
  x.range()->mark_writable_export();
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "was modified after recording");
}

TEST_F(TapeExport, ARecordedValueThatWasWrittenBehindTheBackIsRefusedWhenItIsUsed) {
  const Tensor exported_before(Shape{3}), exported_after(Shape{3});
  exported_before.range()->mark_writable_export();
  square_into(exported_before, x);
  square_into(exported_after, x);
  exported_after.range()->mark_writable_export();
  EXPECT_NO_THROW(nova::mul(exported_before, 2.0f));
  EXPECT_NO_THROW(nova::mul(exported_after, 2.0f));
  poke(exported_before, 9.0f);
  poke(exported_after, 9.0f);
  EXPECT_ERROR(nova::mul(exported_before, 2.0f), ErrorKind::Runtime, "overwritten outside");
  EXPECT_ERROR(nova::mul(exported_after, 2.0f), ErrorKind::Runtime, "overwritten outside");
}

TEST_F(TapeExport, AWriteOfAnExportThatEndedIsCaughtToo) {
  std::shared_ptr<void> before = x.range()->writable_export_scope();
  const Tensor loss = sum(nova::mul(x, x));
  poke(x, 5.0f);
  before.reset();
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "was modified after recording");
  x.copy_from_host(Floats{1.0f, 2.0f, 3.0f}.data(), 12);
  const Tensor again = sum(nova::mul(x, x));
  std::shared_ptr<void> after = x.range()->writable_export_scope();
  poke(x, 5.0f);
  after.reset();
  EXPECT_ERROR(tape.backward(again), ErrorKind::Runtime, "was modified after recording");
}

TEST_F(TapeExport, ANewTapeReadsWhatAnExportHasWrittenMeanwhile) {
  const std::shared_ptr<void> living = x.range()->writable_export_scope();
  tape.backward(sum(nova::mul(x, x)));
  tape.reset();
  tape.zero();
  poke(x, 5.0f);  // an optimizer of somebody else
  const Tensor loss = sum(nova::mul(x, x));
  x.zero_grad();
  tape.backward(loss);
  EXPECT_EQ(grad(x), (Floats{2.0f, 10.0f, 6.0f}));
}

TEST_F(TapeExport, TheEndOfAnExportThatWroteNothingChangesNothing) {
  std::shared_ptr<void> living = x.range()->writable_export_scope();
  const Tensor y = nova::mul(x, x), loss = sum(nova::mul(y, y));
  std::shared_ptr<void> between = y.range()->writable_export_scope();
  living.reset();
  between.reset();
  EXPECT_NO_THROW(tape.backward(loss));
}

TEST_F(TapeTest, BackwardTakesTheMemoryOfWhatItRunsOnceMore) {
  const auto memory = std::make_shared<ExclusiveUse>();
  const Tensor y(Shape{3});
  {
    const nova::RecomputedScope once_more(true, memory);
    square_into(y, x);
  }
  const Tensor loss = sum(nova::mul(y, y));
  {
    const ExclusiveUse::Scope other(*memory, "step", "the solver");
    EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime,
                 "backward: the solver of the rollout is in use by another call");
  }
  EXPECT_NO_THROW(tape.backward(loss));
  EXPECT_NO_THROW(ExclusiveUse::Scope(*memory, "step", "the solver")) << "given back";
}

TEST_F(TapeExport, AnIndexTableWrittenBehindTheBackIsSortedAnew) {
  const Kernel gather = make_kernel(
      "gather", {{"at", DType::I32, 1, Access::Direct}, {"x", DType::F32, 1, Access::Indexed}},
      {{"out", 1}}, [](TraceContext& c) { return std::vector{c.f32(1, c.i32(0), 0)}; });
  const Tensor at = table({2, 0});
  at.range()->mark_writable_export();
  tape.backward(sum(gather(2, {at, x})[0]));
  EXPECT_EQ(grad(x), (Floats{1.0f, 0.0f, 1.0f}));
  poke(*at.range(), 0, int32_t{1});
  tape.zero();
  tape.backward(sum(gather(2, {at, x})[0]));
  EXPECT_EQ(grad(x), (Floats{1.0f, 1.0f, 0.0f}));
}

TEST_F(TapeExport, MemoryOfSomebodyElseIsGuardedFromTheStart) {
  Floats theirs = {1.0f, 2.0f, 3.0f};
  const Tensor outside = Tensor::external(theirs.data(), {3}, DType::F32, Device::cpu(), nullptr);
  outside.set_requires_grad(true);
  const Tensor loss = sum(nova::mul(outside, outside));
  tape.backward(loss);
  EXPECT_EQ(grad(outside), (Floats{2.0f, 4.0f, 6.0f}));
  theirs[0] = 8.0f;
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "was modified after recording");
}

TEST_F(TapeExport, APartOfAnExportedArrayIsGuardedToo) {
  const auto storage = Storage::allocate(24, novaphy::default_device());
  storage->range()->mark_writable_export();
  const Tensor part(storage->range(12, 12), {3}, DType::F32);
  part.set_requires_grad(true);
  const Tensor loss = sum(nova::mul(part, part));
  poke(*storage->range(), 4, 1.0f);
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "was modified after recording");
}

// ---- custom operations ----

using TapeCustom = TapeTest;

Tensor doubled(const Tensor& t) {
  const NoGrad no;
  return nova::mul(t, 2.0f);
}

TEST_F(TapeCustom, PullsGradientsThroughTheFunctionThatWasGiven) {
  const Tensor y = doubled(x);
  tape.record_custom("double", {x}, {y}, [](const std::vector<Tensor>& g) {
    return std::vector{nova::mul(g[0], 2.0f)};
  });
  EXPECT_EQ(tape.op_names(), std::vector<std::string>{"double"});
  const Tensor loss = sum(nova::mul(y, y));
  tape.backward(loss);
  EXPECT_EQ(grad(x), (Floats{8.0f, -16.0f, 24.0f}));
  tape.backward(loss);
  EXPECT_EQ(grad(x), (Floats{16.0f, -32.0f, 48.0f}));
  EXPECT_EQ(tape.size(), 3u);  // launches of the function are not recorded
}

TEST_F(TapeCustom, OneTensorAsTwoInputsGetsTheSum) {
  const Tensor y = doubled(x);
  tape.record_custom("sum of two", {x, x}, {y}, [](const std::vector<Tensor>& g) {
    return std::vector{g[0], nova::mul(g[0], 10.0f)};
  });
  const Tensor loss = sum(y);
  tape.backward(loss);
  EXPECT_EQ(grad(x), Floats(3, 11.0f));
  tape.backward(loss);
  EXPECT_EQ(grad(x), Floats(3, 22.0f));
}

TEST_F(TapeCustom, AnUndefinedGradientIsZero) {
  const Tensor z = tensor({1.0f, 1.0f, 1.0f}, true), constant = tensor({1.0f});
  const Tensor y = doubled(x);
  tape.record_custom("partial", {x, z, constant}, {y}, [](const std::vector<Tensor>& g) {
    return std::vector{g[0], Tensor(), Tensor()};
  });
  tape.backward(sum(nova::add(y, nova::mul(z, 4.0f))));
  EXPECT_EQ(grad(x), Floats(3, 1.0f));
  EXPECT_EQ(grad(z), Floats(3, 4.0f));
  EXPECT_FALSE(constant.has_grad());
}

TEST_F(TapeCustom, AnOutputThatTheLossDoesNotReachHasAnUndefinedGradient) {
  const Tensor a = doubled(x), b = doubled(x);
  bool first = true, second = true;
  tape.record_custom("two", {x}, {a, b}, [&](const std::vector<Tensor>& g) {
    first = g[0].defined();
    second = g[1].defined();
    return std::vector{g[1]};
  });
  tape.backward(sum(b));
  EXPECT_FALSE(first);
  EXPECT_TRUE(second);
}

TEST_F(TapeCustom, BadArgumentsAreRefused) {
  const BackwardFn nothing = [](const std::vector<Tensor>& g) { return g; };
  const Tensor y = doubled(x);
  EXPECT_ERROR(tape.record_custom("c", {x}, {y}, nullptr), ErrorKind::Value, "expected a function");
  EXPECT_ERROR(tape.record_custom("c", {x}, {}, nothing), ErrorKind::Value,
               "expected at least one");
  EXPECT_ERROR(tape.record_custom("c", {Tensor()}, {y}, nothing), ErrorKind::Type, "float32");
  EXPECT_ERROR(tape.record_custom("c", {table({1})}, {y}, nothing), ErrorKind::Type, "float32");
  EXPECT_ERROR(tape.record_custom("c", {x}, {x}, nothing), ErrorKind::Value,
               "an output overlaps an input");
  EXPECT_ERROR(tape.record_custom("c", std::vector<Tensor>(65, x), {y}, nothing), ErrorKind::Value,
               "at most 64");
  EXPECT_EQ(tape.size(), 0u);
}

TEST_F(TapeCustom, WhatItsFunctionGivesIsChecked) {
  const auto loss_of = [&](BackwardFn f) {
    const Tensor y = doubled(x);
    tape.record_custom("bad", {x}, {y}, std::move(f));
    return sum(y);
  };
  const Tensor fewer = loss_of([](const std::vector<Tensor>&) { return std::vector<Tensor>{}; });
  EXPECT_ERROR(tape.backward(fewer), ErrorKind::Value,
               "op 'bad': backward gave 0 gradients for 1 inputs");
  const Tensor short_one =
      loss_of([](const std::vector<Tensor>&) { return std::vector{tensor({1.0f})}; });
  EXPECT_ERROR(tape.backward(short_one), ErrorKind::Value,
               "op 'bad', gradient of input 0: expected {3} float32, got {1}");
}

TEST_F(TapeCustom, AnErrorInItsFunctionLeavesFreshGradientsZeroAndOthersWithoutHalves) {
  const Tensor z = tensor({1.0f, 1.0f, 1.0f}, true), y = doubled(x);
  tape.record_custom("throws", {x}, {y}, [](const std::vector<Tensor>&) -> std::vector<Tensor> {
    throw std::runtime_error("mine");
  });
  const Tensor w = nova::mul(z, 3.0f);  // runs after the one that throws
  const Tensor loss = sum(nova::add(y, nova::mul(w, x)));
  EXPECT_THROW(tape.backward(loss), std::runtime_error);
  EXPECT_EQ(grad(z), Floats(3, 0.0f));
  EXPECT_EQ(grad(x), Floats(3, 0.0f));
  EXPECT_EQ(grad(y), Floats(3, 0.0f));
  tape.backward(sum(w));
  EXPECT_EQ(grad(z), Floats(3, 3.0f));
  EXPECT_THROW(tape.backward(loss), std::runtime_error);
  EXPECT_EQ(grad(z), Floats(3, 3.0f));
}

TEST_F(TapeCustom, ItsInputsAreGuarded) {
  const Tensor y = doubled(x);
  tape.record_custom("double", {x}, {y}, [](const std::vector<Tensor>& g) { return g; });
  const Tensor loss = sum(y);
  x.fill_(1.0f);
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime,
               "input 'input 0' of op 'double' was modified");
}

TEST_F(TapeCustom, WithoutAnInputThatCarriesAGradientOrInNoGradItsOutputsAreConstants) {
  const BackwardFn same = [](const std::vector<Tensor>& g) { return g; };
  const Tensor constant = tensor({1.0f, 1.0f, 1.0f}), a = doubled(constant), b = doubled(x);
  tape.record_custom("c", {constant}, {a}, same);
  {
    const NoGrad no;
    tape.record_custom("c", {x}, {b}, same);
  }
  EXPECT_EQ(tape.size(), 0u);
  tape.backward(sum(nova::mul(nova::add(a, b), x)));
  EXPECT_EQ(grad(x), (Floats{4.0f, -2.0f, 8.0f}));
}

// ---- no_grad, nesting ----

using TapeScopes = TapeTest;

TEST_F(TapeScopes, NothingInsideNoGradIsRecordedAndItsResultsAreConstants) {
  Tensor y;
  {
    const NoGrad outer;
    const NoGrad inner;
    EXPECT_FALSE(nova::grad_enabled());
    EXPECT_EQ(Tape::active(), nullptr);
    y = nova::mul(x, 2.0f);
  }
  EXPECT_TRUE(nova::grad_enabled());
  EXPECT_EQ(Tape::active(), &tape);
  tape.backward(sum(nova::mul(y, x)));
  EXPECT_EQ(grad(x), (Floats{2.0f, -4.0f, 6.0f}));
}

TEST_F(TapeScopes, ARecordedArrayWrittenInNoGradIsRefusedWhenItIsUsed) {
  const Tensor y(Shape{3});
  square_into(y, x);
  {
    const NoGrad no;
    scale_into(y, x, 2.0f);
  }
  EXPECT_ERROR(nova::mul(y, 2.0f), ErrorKind::Runtime, "overwritten outside");
}

TEST_F(TapeScopes, DetachGivesACopyThatTheTapeDoesNotFollow) {
  const Tensor y = nova::mul(x, 2.0f), d = y.detach();
  EXPECT_EQ(d.to_host(), y.to_host());
  EXPECT_NE(d.range(), y.range());
  tape.backward(sum(nova::mul(d, x)));
  EXPECT_EQ(grad(x), y.to_host());
}

TEST_F(TapeScopes, AnotherTapeOnTheSameThreadIsRefused) {
  Tape other;
  EXPECT_ERROR(other.begin(), ErrorKind::Runtime, "another tape is active on this thread");
  EXPECT_ERROR(tape.begin(), ErrorKind::Runtime, "already active");
  EXPECT_ERROR(other.end(), ErrorKind::Runtime, "not active");
  EXPECT_EQ(Tape::active(), &tape);
  scope.reset();
  EXPECT_EQ(Tape::active(), nullptr);
  EXPECT_ERROR(tape.end(), ErrorKind::Runtime, "not active");
  const TapeScope now(other);
  EXPECT_EQ(Tape::active(), &other);
}

TEST_F(TapeScopes, ATapeMayBeResumed) {
  const Tensor y = nova::mul(x, 2.0f);
  scope.reset();
  EXPECT_EQ(nova::mul(x, 9.0f).to_host()[0], 9.0f);  // not recorded
  scope.emplace(tape);
  tape.backward(sum(nova::mul(y, 3.0f)));
  EXPECT_EQ(grad(x), Floats(3, 6.0f));
  EXPECT_EQ(tape.size(), 3u);
}

TEST_F(TapeScopes, AnExceptionEndsTheScope) {
  scope.reset();
  EXPECT_THROW(
      {
        const TapeScope now(tape);
        throw std::runtime_error("mine");
      },
      std::runtime_error);
  EXPECT_EQ(Tape::active(), nullptr);
}

// ---- copies ----

using TapeCopies = TapeTest;

TEST_F(TapeCopies, CloneAndCopyAndToCarryTheGradient) {
  const Tensor a = x.clone(), b(Shape{3}), c = x.to(Device::cpu());
  b.copy_(a);
  b.copy_(b);  // nothing
  tape.backward(sum(nova::add(nova::mul(b, 2.0f), c.to(x.device()))));
  EXPECT_EQ(grad(x), Floats(3, 3.0f));
  EXPECT_EQ(grad(b), Floats(3, 2.0f));
}

TEST_F(TapeCopies, CopiesOfEngineArraysCarryTheGradient) {
  DeviceArray<Vec3f> source(2), target(2);
  const Tensor s = Tensor::view(source, true);
  write(s, {1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f});
  target.assign(source);
  const DeviceArray<Vec3f> cloned = target.clone();
  tape.backward(sum(nova::mul(Tensor::view(cloned), Tensor::view(cloned))));
  EXPECT_EQ(grad(s), (Floats{2.0f, 4.0f, 6.0f, 8.0f, 10.0f, 12.0f}));
  EXPECT_EQ(s.shape(), (Shape{2, 3}));
}

TEST_F(TapeCopies, IntegersAreCopiedWithoutARecord) {
  DeviceArray<int32_t> source = DeviceArray<int32_t>::from_host(std::vector<int32_t>{1, 2}),
                       target(2);
  target.assign(source);
  EXPECT_EQ(target.to_host(), (std::vector<int32_t>{1, 2}));
  const Tensor t = table({3, 4}), u = t.clone();
  EXPECT_EQ(u.to_host_i32(), (std::vector<int32_t>{3, 4}));
  EXPECT_EQ(tape.size(), 0u);
}

TEST_F(TapeCopies, BadCopiesAreRefused) {
  const Tensor y(Shape{2});
  EXPECT_ERROR(y.copy_(x), ErrorKind::Value, "expected {2} float32, got {3} float32");
  EXPECT_ERROR(y.copy_(table({1, 2})), ErrorKind::Value, "int32");
  const auto storage = Storage::allocate(24, novaphy::default_device());
  const Tensor a(storage->range(0, 12), {3}, DType::F32), b(storage->range(4, 12), {3}, DType::F32);
  EXPECT_ERROR(a.copy_(b), ErrorKind::Value, "overlaps");
}

TEST_F(TapeCopies, AValueMarkedAsUntrackedIsRefusedUntilItIsWritten) {
  const Tensor y(Shape{3});
  y.fill_(1.0f);
  tape.mark_untracked(y.range(), "it stops here");
  EXPECT_ERROR(nova::mul(y, x), ErrorKind::Runtime, "it stops here");
  y.fill_(2.0f);
  tape.backward(sum(nova::mul(y, x)));
  EXPECT_EQ(grad(x), Floats(3, 2.0f));
}

// ---- lifetimes ----

TEST(TapeLifetime, TensorsOutliveTheTapeAndTheTapeItsTensors) {
  Tensor x = tensor({1.0f, 2.0f}, true), y;
  {
    Tape tape;
    const TapeScope scope(tape);
    y = nova::mul(x, 2.0f);
    Tensor loss = sum(nova::mul(y, x.clone()));
    tape.backward(loss);
  }
  EXPECT_EQ(grad(x), (Floats{4.0f, 8.0f}));
  EXPECT_TRUE(y.is_leaf());
  const Tensor g = x.grad();
  Tape tape;
  {
    const TapeScope scope(tape);
    const Tensor loss = sum(nova::mul(x, x));
    x = Tensor();
    y = Tensor();
    tape.backward(loss);
  }
  EXPECT_EQ(g.to_host(), (Floats{6.0f, 12.0f}));
}

TEST(TapeLifetime, AViewOutlivesTheArrayThatItShows) {
  Tensor view;
  {
    const DeviceArray<Vec3f> array(1);
    view = Tensor::view(array, true);
    EXPECT_EQ(Tensor::view(array).impl(), view.impl());
    EXPECT_TRUE(Tensor::view(array, false).requires_grad());
  }
  write(view, {1.0f, 2.0f, 3.0f});
  Tape tape;
  const TapeScope scope(tape);
  tape.backward(sum(nova::mul(view, view)));
  EXPECT_EQ(grad(view), (Floats{2.0f, 4.0f, 6.0f}));
}

TEST(TapeLifetime, ATapeThatTakesOverTheMemoryOfAnOtherKnowsNothingOfIt) {
  const Tensor x = tensor({3.0f}, true);
  Tensor y;
  for (int k = 0; k < 3; ++k) {
    Tape tape;
    EXPECT_EQ(tape.size(), 0u);
    EXPECT_TRUE(tape.op_names().empty());
    const TapeScope scope(tape);
    if (k > 0) {
      EXPECT_ERROR(tape.backward(y), ErrorKind::Value, "no operation of this tape");
    }
    y = nova::mul(x, x);
    tape.backward(y);
  }
  EXPECT_EQ(grad(x), (Floats{18.0f}));
}

TEST(TapeLifetime, TwoTapesOneAfterTheOtherAddToTheSameLeaf) {
  const Tensor x = tensor({3.0f}, true);
  Tape first, second;
  Tensor a, b;
  {
    const TapeScope scope(first);
    a = nova::mul(x, 2.0f);
  }
  {
    const TapeScope scope(second);
    b = nova::mul(x, 5.0f);
  }
  second.backward(b);
  first.backward(a);
  EXPECT_EQ(grad(x), (Floats{7.0f}));
}

TEST(TapeLifetime, AnActiveTapeThatIsDestroyedEnds) {
  {
    Tape tape;
    tape.begin();
    nova::mul(tensor({1.0f}, true), 2.0f);
  }
  EXPECT_EQ(Tape::active(), nullptr);
  EXPECT_EQ(array_observer(), nullptr);
}

// With many rows, backward collects its launches and runs them block by block.
TEST(TapeLarge, BlocksOfRowsGiveTheBitsOfAFewRows) {
  constexpr int64_t kRows = 5000;
  Random random(1);
  const Floats values = random.values(kRows);
  const auto gradient = [&](int64_t from, int64_t count) {
    const Tensor x = tensor(Floats(values.begin() + from, values.begin() + from + count), true);
    Tape tape;
    const TapeScope scope(tape);
    Tensor y = x;
    for (int k = 0; k < 12; ++k) y = nova::mul(nova::sin(y), nova::add(x, y));
    tape.backward(y, Tensor::full({count}, 1.0f));
    return grad(x);
  };
  const Floats all = gradient(0, kRows);
  for (const int64_t from : {int64_t{0}, int64_t{1000}, int64_t{1023}, int64_t{4990}}) {
    const Floats few = gradient(from, 10);
    EXPECT_TRUE(same_bits(std::span<const float>(few),
                          std::span<const float>(all).subspan(static_cast<size_t>(from), 10)))
        << from;
  }
}

}  // namespace
}  // namespace novaphy::testing
