// Index tables that a list itself writes, such as contacts that each substep finds. Replays and
// gradients equal those of step-by-step execution.
#include <cmath>

#include "novaphy/nova/op_list.h"
#include "support.h"
#include "support/threads.h"

namespace novaphy::testing {
namespace {

using nova::Incidence;
using nova::make_kernel;
using nova::Operand;
using nova::ScopedCapture;

using Floats = std::vector<float>;

constexpr float kStep = 0.02f;

// Particles on a line. Each may touch one other, which its position decides; a touch pushes both.
class Touches {
 public:
  enum class Tables {
    Own,      // a table and an Incidence for each substep
    Rebuilt,  // one of each for all
    Stale,    // one of each, and the Incidence stays that of the first substep
  };
  struct How {
    Tables tables = Tables::Own;
    int per_checkpoint = 0;  // substeps between two; 0: there are none
    nova::KeepGradients keep = nova::KeepGradients::All;
    int per_table = 1;  // substeps that share the contacts of the first of them
  };

  explicit Touches(int32_t n) : Touches(n, How()) {}
  Touches(int32_t n, How how) : n_(n), how_(how) {
    Random random(7);
    x0 = random.leaf({n}, -3.0f, 3.0f);
    v0 = random.leaf({n}, -1.0f, 1.0f);
    stiffness = tensor({4.0f}, true);
    table_ = Tensor({n, 2});
    incidence_ = nova::make_incidence(slots(table_), n);
  }

  // Returns a loss of the state after `steps` steps.
  Tensor loss(int steps) const {
    Tensor x = x0, v = v0;
    const int together = how_.per_checkpoint > 0 ? how_.per_checkpoint : steps;
    for (int k = 0; k < steps; k += together) {
      const nova::RecomputedScope group(how_.per_checkpoint > 0);
      for (int j = k; j < std::min(k + together, steps); ++j) step(x, v, j % how_.per_table == 0);
    }
    return nova::sum(nova::mul(x, nova::sin(x)));
  }
  // One iteration of training.
  Tensor iterate(int steps) const {
    Tape tape(how_.keep);
    const TapeScope scope(tape);
    const Tensor value = loss(steps);
    tape.backward(value);
    return value;
  }
  std::vector<Floats> gradients() const {
    return {x0.grad().to_host(), v0.grad().to_host(), stiffness.grad().to_host()};
  }
  void zero() const {
    for (const Tensor& t : {x0, v0, stiffness}) t.zero_grad();
  }
  // Returns the result of the steps in double precision.
  double reference(int steps) const {
    const Floats host[] = {x0.to_host(), v0.to_host()};
    std::vector<double> x(host[0].begin(), host[0].end()), v(host[1].begin(), host[1].end());
    x[static_cast<size_t>(moved_)] += moved_by_;
    const double k = stiffness.to_host()[0];
    for (int s = 0; s < steps; ++s) {
      std::vector<double> f(x.size(), 0.0);
      for (size_t i = 0; i < x.size(); ++i) {
        const auto other = static_cast<int32_t>(std::floor(std::abs(x[i]) * 5.0));
        if (other % 3 == 0) continue;
        const auto j = static_cast<size_t>(other % n_);
        const double push = k * std::sin(x[i] - x[j]);
        f[i] -= push;
        f[j] += push;
      }
      for (size_t i = 0; i < x.size(); ++i) {
        v[i] += kStep * f[i];
        x[i] += kStep * v[i];
      }
    }
    double total = 0.0;
    for (const double value : x) total += value * std::sin(value);
    return total;
  }
  // d loss / d x0[i], by central differences in double precision.
  double difference(int32_t i, int steps) {
    constexpr double kEps = 1e-6;
    moved_ = i;
    moved_by_ = kEps;
    const double up = reference(steps);
    moved_by_ = -kEps;
    const double down = reference(steps);
    moved_by_ = 0.0;
    return (up - down) / (2.0 * kEps);
  }

  Tensor x0, v0, stiffness;

 private:
  // A kernel writes floats. The table is their bits as integers.
  static Tensor as_integers(const Tensor& t) { return {t.range(), t.shape(), DType::I32}; }
  static Operand slots(const Tensor& t) { return as_integers(t).flat_operand(); }

  void step(Tensor& x, Tensor& v, bool finds) const {
    const Tensor table = how_.tables == Tables::Own ? Tensor({n_, 2}) : table_;
    if (finds) launch(find(), {x.operand()}, table.operand());
    const Incidence incidence = finds ? rows_of(table) : incidence_;
    const Tensor f({n_, 2}), v_next({n_}), x_next({n_});
    launch(push(), {as_integers(table).operand(), x.operand(), stiffness.operand()}, f.operand());
    launch(add(), {v.operand(), f.flat_operand()}, v_next.operand(), &incidence);
    launch(move(), {x.operand(), v_next.operand()}, x_next.operand());
    x = x_next;
    v = v_next;
  }
  Incidence rows_of(const Tensor& table) const {
    if (how_.tables == Tables::Own) return nova::make_incidence(slots(table), n_);
    if (how_.tables == Tables::Rebuilt) nova::rebuild(incidence_);
    return incidence_;
  }
  void launch(const Kernel& kernel, std::vector<Operand> in, Operand out,
              const Incidence* csr = nullptr) const {
    kernel.launch(n_, in, out, {.csr = csr});
  }

  const Kernel& find() const {
    return find_ =
               find_.impl()
                   ? find_
                   : make_kernel("find", {{"x", DType::F32, 1, Access::Direct}}, {{"table", 2}},
                                 [n = n_](TraceContext& c) {
                                   const Int other =
                                       nova::to_int(nova::floor(nova::abs(c.f32(0)) * Real(5.0f)));
                                   const auto touches = [&](const Int& row) {
                                     return nova::bits_float(
                                         nova::select(other % Int(3) == Int(0), Int(-1), row));
                                   };
                                   return std::vector{touches(c.index()), touches(other % Int(n))};
                                 });
  }
  static const Kernel& push() {
    static const Kernel kernel =
        make_kernel("push",
                    {{"table", DType::I32, 2, Access::Direct},
                     {"x", DType::F32, 1, Access::Indexed},
                     {"k", DType::F32, 1, Access::Uniform}},
                    {{"f", 2}}, [](TraceContext& c) {
                      const Real apart = c.f32(1, c.i32(0, 0), 0) - c.f32(1, c.i32(0, 1), 0);
                      const Real push = c.f32(2) * nova::sin(apart) * Real(kStep);
                      return std::vector{-push, push};
                    });
    return kernel;
  }
  static const Kernel& add() {
    static const Kernel kernel = nova::make_reduce_kernel(
        "add", {{"v", DType::F32, 1, Access::Direct}, {"f", DType::F32, 1, Access::CsrRow}},
        {{"v", 1}},
        {.init = [](TraceContext& c) { return std::vector{c.f32(0)}; },
         .body = [](TraceContext& c) { return std::vector{c.f32(1)}; },
         .epilogue = {}});
    return kernel;
  }
  static const Kernel& move() {
    static const Kernel kernel = make_kernel(
        "move", {{"x", DType::F32, 1, Access::Direct}, {"v", DType::F32, 1, Access::Direct}},
        {{"x", 1}}, [](TraceContext& c) { return std::vector{c.f32(0) + c.f32(1) * Real(kStep)}; });
    return kernel;
  }

  const int32_t n_;
  const How how_;
  Tensor table_;
  Incidence incidence_;
  mutable Kernel find_;
  int32_t moved_ = 0;
  double moved_by_ = 0.0;
};

constexpr int kSteps = 6;
constexpr Touches::How kWays[] = {
    {Touches::Tables::Own, 0},  // every substep keeps its table
    {Touches::Tables::Own, 0, nova::KeepGradients::Leaves},
    {Touches::Tables::Own, 1},  // and is run once more
    {Touches::Tables::Own, 3, nova::KeepGradients::Leaves},
    {Touches::Tables::Rebuilt, 1},  // every substep finds its table again
    {Touches::Tables::Rebuilt, 1, nova::KeepGradients::Leaves},
};

TEST(ChangingTables, TheGradientIsThatOfTheTouchesOfEachSubstep) {
  for (const Touches::How& how : kWays) {
    Touches scene(40, how);
    EXPECT_NEAR(scene.iterate(kSteps).item(), scene.reference(kSteps), 1e-3);
    const Floats gradient = scene.gradients()[0];
    for (int32_t i = 0; i < 40; ++i)
      EXPECT_NEAR(gradient[static_cast<size_t>(i)], scene.difference(i, kSteps), 2e-3) << i;
  }
}

TEST(ChangingTables, CheckpointsGiveTheBitsOfKeptTables) {
  for (const int32_t n : {40, 3001}) {
    const Touches kept(n);
    const Floats loss = kept.iterate(kSteps).to_host();
    for (const Touches::How& how : kWays) {
      const Touches other(n, how);
      EXPECT_TRUE(same_bits<float>(other.iterate(kSteps).to_host(), loss));
      for (size_t k = 0; k < 3; ++k)
        EXPECT_TRUE(same_bits<float>(other.gradients()[k], kept.gradients()[k])) << k;
    }
  }
}

TEST(ChangingTables, AReplayHasTheBitsOfStepByStepWithGradients) {
  const bool on_host = device_context(default_device()).host_accessible;
  for (const int32_t n : {40, 3001})
    for (const Touches::How& how : kWays)
      for (const int threads : on_host ? std::vector{1, 2, 7} : std::vector{1}) {
        const Threads of(threads);
        const Touches direct(n, how), replayed(n, how);
        const Floats loss = direct.iterate(kSteps).to_host();
        Tensor value;
        std::shared_ptr<nova::OpList> graph;
        {
          const ScopedCapture capture;
          replayed.zero();
          value = replayed.iterate(kSteps);
          graph = capture.graph();
        }
        for (const bool planned : {false, true}) {
          if (planned) graph->prepare();
          replayed.zero();
          graph->launch();
          EXPECT_TRUE(same_bits<float>(value.to_host(), loss));
          for (size_t k = 0; k < 3; ++k)
            EXPECT_TRUE(same_bits<float>(replayed.gradients()[k], direct.gradients()[k])) << k;
        }
      }
}

TEST(ChangingTables, AReplayFindsTheTouchesOfTheStateThatItIsGiven) {
  const Touches direct(40), replayed(40, {Touches::Tables::Rebuilt});
  Tensor value;
  std::shared_ptr<nova::OpList> graph;
  {
    const ScopedCapture capture;
    value = replayed.loss(kSteps);
    graph = capture.graph();
  }
  for (const uint32_t seed : {1u, 2u, 3u}) {
    const Floats x = Random(seed).values(40, -4.0f, 4.0f);
    write(direct.x0, x);
    write(replayed.x0, x);
    graph->launch();
    EXPECT_TRUE(same_bits<float>(value.to_host(), direct.loss(kSteps).to_host()));
  }
}

// With the table of the plan's time, parts of the rows could compute the elements that their own
// sums need. The table may change, so the plan must not do so.
TEST(ChangingTables, APlanIsNotMadeOfWhatTheyHoldAtFirst) {
  const Threads of(7);
  constexpr int32_t kRows = 20001;
  constexpr int kSubsteps = 24;
  const Touches::How how{Touches::Tables::Rebuilt, 0, nova::KeepGradients::All, 8};
  const Touches direct(kRows, how), replayed(kRows, how);
  replayed.loss(kSubsteps);  // the tables hold touches
  Tensor value;
  std::shared_ptr<nova::OpList> graph;
  {
    const ScopedCapture capture;
    value = replayed.loss(kSubsteps);
    graph = capture.graph();
  }
  for (const uint32_t seed : {1u, 2u, 3u}) {
    const Floats x = Random(seed).values(kRows, -4.0f, 4.0f);
    write(direct.x0, x);
    write(replayed.x0, x);
    graph->prepare();
    graph->launch();
    EXPECT_TRUE(same_bits<float>(value.to_host(), direct.loss(kSubsteps).to_host()));
  }
}

TEST(ChangingTables, BackwardRefusesRowsThatWereRebuiltSince) {
  const Touches scene(40, {Touches::Tables::Rebuilt});
  EXPECT_NO_THROW(scene.loss(kSteps));
  EXPECT_ERROR(scene.iterate(kSteps), ErrorKind::Runtime, "modified after recording");
  EXPECT_EQ(scene.gradients()[0], Floats(40, 0.0f));
}

TEST(ChangingTables, TangentsAreThoseOfTheTouchesOfEachSubstepAndRefusedForRebuiltRows) {
  for (const Touches::Tables tables : {Touches::Tables::Own, Touches::Tables::Rebuilt}) {
    Touches scene(40, {tables});
    Tape tape;
    const TapeScope scope(tape);
    const Tensor loss = scene.loss(kSteps);
    Floats along(40, 0.0f);
    along[3] = 1.0f;
    const auto slope = [&] { return tape.jvp({loss}, {scene.x0}, {tensor(along)})[0].item(); };
    if (tables == Touches::Tables::Own) {
      EXPECT_NEAR(slope(), scene.difference(3, kSteps), 1e-3);
    } else {
      EXPECT_ERROR(slope(), ErrorKind::Runtime, "modified after recording");
    }
  }
}

TEST(ChangingTables, BackwardRefusesATableThatIsWrittenTwiceBetweenCheckpoints) {
  const Touches scene(40, {Touches::Tables::Rebuilt, 2});
  EXPECT_ERROR(scene.iterate(kSteps), ErrorKind::Runtime, "the index table of op 'add'");
}

TEST(Checkpoints, AValueThatIsWrittenTwiceBetweenTwoIsRefusedWhereItIsRead) {
  const Tensor x = tensor({2.0f}, true), same({1});
  const Kernel square =
      make_kernel("square", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0) * c.f32(0)}; });
  const auto launch = [&](const Tensor& from, const Tensor& to) {
    const Operand in = from.operand(), out = to.operand();
    square.launch(1, in, out);
  };
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y({1}), z({1});
  {
    const nova::RecomputedScope group(true);
    launch(x, same);
    launch(same, y);
    launch(y, same);
    launch(same, z);
  }
  EXPECT_ERROR(tape.backward(nova::add(y, z)), ErrorKind::Runtime,
               "input 'x' of op 'square' was overwritten before the next checkpoint");
}

TEST(ChangingTables, BackwardRefusesRowsThatAreNotOfTheTable) {
  for (const int per_checkpoint : {0, 1}) {
    const Touches scene(40, {Touches::Tables::Stale, per_checkpoint});
    EXPECT_ERROR(scene.iterate(1), ErrorKind::Runtime, "the index table of op 'add'");
  }
}

// Rows of the table {0, 1, 1}, whose values are squared and added up.
class Rebuilt : public ::testing::Test {
 protected:
  Tensor squares() const {
    static const Kernel kernel = nova::make_reduce_kernel(
        "squares", {{"e", DType::F32, 1, Access::CsrRow}}, {{"y", 1}},
        {.init = {},
         .body = [](TraceContext& c) { return std::vector{c.f32(0) * c.f32(0)}; },
         .epilogue = {}});
    return kernel(2, {e}, {.csr = &rows})[0];
  }
  static Tensor changed() { return table({1, -1, 0}); }
  const Tensor e = tensor({1.0f, 2.0f, 3.0f}, true), at = table({0, 1, 1});
  const Incidence rows = nova::make_incidence(at.operand(), 2);
};

TEST_F(Rebuilt, RowsAreThoseOfTheTableNow) {
  EXPECT_EQ(squares().to_host(), (Floats{1.0f, 13.0f}));
  at.copy_(changed());
  EXPECT_EQ(squares().to_host(), (Floats{1.0f, 13.0f}));
  nova::rebuild(rows);
  EXPECT_EQ(squares().to_host(), (Floats{9.0f, 1.0f}));
}

TEST_F(Rebuilt, GradientsAreOfTheNewRows) {
  at.copy_(changed());
  nova::rebuild(rows);
  Tape tape;
  const TapeScope scope(tape);
  tape.backward(squares(), tensor({10.0f, 1.0f}));
  EXPECT_EQ(e.grad().to_host(), (Floats{2.0f, 0.0f, 60.0f}));
}

TEST_F(Rebuilt, BackwardRefusesThoseOfBefore) {
  Tape tape;
  const TapeScope scope(tape);
  const Tensor loss = nova::sum(squares());
  nova::rebuild(rows);  // from the same table; the rows could have changed
  EXPECT_NO_THROW(
      tape.backward(loss));  // the items find their rows in the table, which is the same
  const Tensor again = nova::sum(squares());
  at.copy_(changed());
  nova::rebuild(rows);
  EXPECT_ERROR(tape.backward(again), ErrorKind::Runtime,
               "the index table of op 'squares' was modified after recording");
}

TEST_F(Rebuilt, AFailureLeavesTheRows) {
  if (!device_context(e.device()).host_accessible)
    GTEST_SKIP() << "a device reports failures when the host waits for it next";
  at.copy_(table({0, 2, 1}));
  EXPECT_ERROR(nova::rebuild(rows), ErrorKind::Index, "slot 1 holds row 2 of 2 rows");
  EXPECT_EQ(squares().to_host(), (Floats{1.0f, 13.0f}));
}

TEST_F(Rebuilt, ACaptureThatRebuildsFollowsTheTable) {
  Tensor y;
  std::shared_ptr<nova::OpList> graph;
  {
    const ScopedCapture capture;
    nova::rebuild(rows);
    y = squares();
    graph = capture.graph();
  }
  EXPECT_EQ(squares().to_host(), (Floats{1.0f, 13.0f}));
  at.copy_(changed());  // no table that the capture froze
  graph->launch();
  EXPECT_EQ(y.to_host(), (Floats{9.0f, 1.0f}));
}

TEST_F(Rebuilt, ACaptureThatWritesTheTableMustRebuild) {
  const Tensor source = changed();
  const ScopedCapture capture;
  at.copy_(source);
  EXPECT_ERROR(squares(), ErrorKind::Runtime, "must be rebuilt after that");
  nova::rebuild(rows);
  EXPECT_NO_THROW(squares());
}

TEST_F(Rebuilt, AfterACaptureGradientsNeedAnotherOne) {
  std::shared_ptr<nova::OpList> graph;
  {
    const ScopedCapture capture;
    at.copy_(changed());
    nova::rebuild(rows);
    graph = capture.graph();
  }
  const auto differentiate = [this] {
    Tape tape;
    const TapeScope scope(tape);
    tape.backward(nova::sum(squares()));
  };
  EXPECT_ERROR(differentiate(), ErrorKind::Runtime, "the index table");
  graph->launch();
  EXPECT_ERROR(differentiate(), ErrorKind::Runtime, "the index table");
  nova::rebuild(rows);
  differentiate();
  EXPECT_EQ(e.grad().to_host(), (Floats{2.0f, 0.0f, 6.0f}));
}

// A table that only a gradient needs sorted.
TEST(ChangingTables, SortedFormsOfACaptureAreNotThoseOfLater) {
  static const Kernel gather = make_kernel(
      "gather", {{"at", DType::I32, 1, Access::Direct}, {"x", DType::F32, 1, Access::Indexed}},
      {{"y", 1}}, [](TraceContext& c) { return std::vector{c.f32(1, c.i32(0), 0)}; });
  const Tensor x = tensor({1.0f, 2.0f, 3.0f}, true), at = table({0, 1, 2}), next = table({2, 2, 0});
  const Tensor weights = tensor({1.0f, 10.0f, 100.0f});
  const auto iterate = [&] {
    x.zero_grad();
    Tape tape;
    const TapeScope scope(tape);
    tape.backward(gather(3, {at, x})[0], weights);
  };
  std::shared_ptr<nova::OpList> graph;
  {
    const ScopedCapture capture;
    at.copy_(next);
    iterate();
    graph = capture.graph();
  }
  iterate();  // with the unchanged table
  EXPECT_EQ(x.grad().to_host(), (Floats{1.0f, 10.0f, 100.0f}));
  graph->launch();
  EXPECT_EQ(x.grad().to_host(), (Floats{100.0f, 0.0f, 11.0f}));
  iterate();
  EXPECT_EQ(x.grad().to_host(), (Floats{100.0f, 0.0f, 11.0f}));
}

}  // namespace
}  // namespace novaphy::testing
