// The kernels that were compiled ahead: none is missing, what a user runs is native, and every one
// gives the bits of the interpreter, for few rows and many, on every instruction set that this
// processor has.
#include <dlfcn.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <map>
#include <random>
#include <set>

#include "ball_scene.h"
#include "novaphy/core/backend.h"
#include "novaphy/core/parallel.h"
#include "novaphy/cpu/query.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/engine_kernels.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/nova/optim.h"
#include "novaphy/nova/registry.h"
#include "novaphy/nova/tape.h"

namespace novaphy::testing {
namespace {

namespace ir = nova::ir;
using ir::Access;
using ir::Op;

std::vector<ir::Program> engine_programs() {
  std::vector<nova::EngineKernel> kernels = nova::engine_kernels();
  for (nova::EngineKernel& k : diff::engine_kernels()) kernels.push_back(std::move(k));
  return nova::programs_of(kernels);
}

TEST(NativeKernels, NoneOfTheEngineIsMissing) {
  const std::vector<ir::Program> programs = engine_programs();
  EXPECT_GT(programs.size(), 200u);
  std::set<std::string> names;
  for (const ir::Program& p : programs) {
    const nova::KernelInfo info = nova::kernel_info(p);
    ASSERT_EQ(info.how, "native") << p.name << "\n" << ir::to_string(p);
    EXPECT_EQ(info.hash, ir::hash(p));
    EXPECT_EQ(info.lanes, info.isa == "baseline" ? 4 : info.isa == "avx2" ? 8 : 16) << info.isa;
    names.insert(p.name);
  }
  for (const char* name : {"step_particles", "step_particles.adjoint", "sgd_update_f32", "mul",
                           "particle_point_loss.adjoint", "accumulate_gradient", "copy"})
    EXPECT_TRUE(names.count(name)) << name;
}

TEST(NativeKernels, AUsersKernelIsInterpretedAndListed) {
  const nova::Kernel kernel = nova::make_kernel(
      "a_users_own", {{"x", nova::DType::F32, 1, Access::Direct}}, {{"out", 1}},
      [](nova::TraceContext& c) { return std::vector{c.f32(0) * nova::Real(0.3f) + c.f32(0)}; });
  const auto count = [] {
    const std::vector<nova::KernelInfo> list = nova::kernel_info();
    return std::count_if(list.begin(), list.end(), [](const nova::KernelInfo& i) {
      return i.name == "a_users_own" && i.how == "interpreter";
    });
  };
  EXPECT_EQ(count(), 0) << "before its first launch";
  const nova::Tensor x = nova::Tensor::from_host(std::vector{1.0f, 2.0f}, {2});
  kernel(2, {x});
  EXPECT_EQ(count(), 1);
  EXPECT_NE(kernel.source().find("// a_users_own\n"), std::string::npos);
  EXPECT_NE(kernel.source().find("0  x: f32{1}, own row; 1  its rows"), std::string::npos);
  EXPECT_NE(kernel.source("program").find("program a_users_own"), std::string::npos);
  EXPECT_THROW(kernel.source("assembly"), Error);
}

TEST(NativeKernels, ATrainingIterationOfBallsRunsNothingElse) {
  std::set<uint64_t> before;  // of other tests in this process
  for (const nova::KernelInfo& info : nova::kernel_info()) before.insert(info.hash);
  for (const int balls : {1, 3000}) {
    auto model = make_ball_model(balls);
    diff::Trajectory trajectory(model, 8);
    const Contacts contacts = make_ball_contacts(model, trajectory.state(0));
    diff::DiffSemiImplicitSolver solver(model, {});
    const nova::Tensor velocity = diff::state_particle_qd_tensor(trajectory.state(0), true);
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    solver.rollout(trajectory, nullptr, &contacts, kBallDt);
    const nova::Tensor last = diff::state_particle_q_tensor(trajectory.state(8));
    tape.backward(diff::particle_point_loss_generated(last, 0, 0.0f, -2.0f, 1.5f));
    nova::sgd_update_f32(velocity, kBallRate);
  }
  int seen = 0;
  for (const nova::KernelInfo& info : nova::kernel_info()) {
    if (!before.contains(info.hash)) {
      EXPECT_EQ(info.how, "native") << info.name;
    }
    seen += info.how == "native" ? 1 : 0;
  }
  EXPECT_GE(seen, 5);
}

// A device of a backend's table, and what ran on it.
class Machine {
 public:
  explicit Machine(const novaphy_backend_api* api) : api_(api) {
    novaphy_error error = make_error();
    EXPECT_EQ(api_->device_open(0, &device_, &error), NOVAPHY_OK) << error.message;
    EXPECT_EQ(api_->stream_create(device_, &stream_, &error), NOVAPHY_OK) << error.message;
  }
  ~Machine() {
    api_->stream_destroy(stream_);
    api_->device_close(device_);
  }
  Machine(const Machine&) = delete;

  // The status and message, and the outputs behind them.
  std::string run(const ir::Program& p, int64_t n, std::vector<uint64_t> arguments,
                  std::vector<std::vector<uint32_t>>& outputs, bool native) const {
    novaphy_error error = make_error();
    novaphy_module* module = nullptr;
    novaphy_kernel* kernel = nullptr;
    const std::vector<uint32_t> words = ir::serialise(p);
    EXPECT_EQ(api_->module_create(device_, NOVAPHY_CODE_PROGRAM, words.data(), words.size() * 4,
                                  &module, &error),
              NOVAPHY_OK)
        << error.message;
    EXPECT_EQ(api_->kernel_get(module, "main", &kernel, &error), NOVAPHY_OK);
    novaphy_kernel_info info{};
    info.struct_size = sizeof(info);
    EXPECT_EQ(api_->kernel_info(kernel, &info, &error), NOVAPHY_OK);
    EXPECT_EQ(info.native, native ? 1 : 0) << p.name;
    for (size_t o = 0; o < p.outputs.size(); ++o) {
      outputs.emplace_back(static_cast<size_t>(n) * p.outputs[o].values.size(), 0xDEADBEEFu);
      arguments[p.output_argument(o)] = reinterpret_cast<uint64_t>(outputs.back().data());
    }
    const novaphy_status status = api_->launch(stream_, kernel, n, arguments.data(),
                                               static_cast<uint32_t>(arguments.size()), &error);
    api_->module_destroy(module);
    return status == NOVAPHY_OK ? "" : error.message;
  }

 private:
  const novaphy_backend_api* api_;
  novaphy_device* device_ = nullptr;
  novaphy_stream* stream_ = nullptr;
};

void host_parallel_for(int64_t chunks, void (*body)(void*, int64_t), void* context) {
  parallel_for(chunks, body, context);
}

// Arguments for a launch of n rows: random numbers with edge values among them, rows in range but
// for negative ones.
class RandomArguments {
 public:
  RandomArguments(const ir::Program& p, int64_t n, uint32_t seed) : random_(seed) {
    const int64_t items = 3 * n + 2;
    for (const ir::Source& s : p.sources) {
      const int64_t rows = s.access == Access::Direct    ? n
                           : s.access == Access::Uniform ? 1
                           : s.access == Access::CsrRow  ? items
                                                         : std::max<int64_t>(n, 7);
      std::vector<uint32_t> words;
      for (int64_t k = 0; k < rows * s.width; ++k)
        words.push_back(s.type == ir::Type::F32 ? number() : row());
      add(std::move(words));
      arguments.push_back(static_cast<uint64_t>(rows));
    }
    arguments.resize(arguments.size() + p.outputs.size());
    // Rows of one, two and mixed lengths, over consecutive items and not; several sums over the same
    // rows, as in an adjoint, and over others.
    const int kind = static_cast<int>(next() % 4);
    const bool same_rows = next() % 2 == 0;
    size_t first_rows = 0;
    for (const ir::Loop& l : p.loops) {
      if (l.kind != ir::LoopKind::Csr) continue;
      if (first_rows != 0 && same_rows) {
        for (size_t k = 0; k < 2; ++k) arguments.push_back(arguments[first_rows + k]);
        continue;
      }
      first_rows = arguments.size();
      std::vector<uint32_t> offsets = {0}, list;
      for (int64_t i = 0; i < n; ++i) {
        const uint32_t length = kind < 3 ? static_cast<uint32_t>(kind) : next() % 7;
        for (uint32_t k = 0; k < length; ++k)
          list.push_back(next() % 5 == 0
                             ? next() % static_cast<uint32_t>(items)
                             : static_cast<uint32_t>(list.size()) % static_cast<uint32_t>(items));
        offsets.push_back(static_cast<uint32_t>(list.size()));
      }
      add(std::move(offsets));
      add(std::move(list));
    }
    std::vector<char> is_float(static_cast<size_t>(p.param_count), 0);
    for (const ir::Instr& in : p.instrs)
      if (in.op == Op::PARAM_F) is_float[static_cast<size_t>(in.a)] = 1;
    for (const char f : is_float) arguments.push_back(f ? number() : next() % 5);
  }

  std::vector<uint64_t> arguments;

 private:
  void add(std::vector<uint32_t> words) {
    memory_.push_back(std::move(words));
    arguments.push_back(reinterpret_cast<uint64_t>(memory_.back().data()));
  }
  uint32_t next() { return static_cast<uint32_t>(random_()); }
  uint32_t number() {
    static const float edges[] = {0.0f,  -0.0f,    1.0f,      -1.0f, 1e-40f,
                                  3e38f, INFINITY, -INFINITY, NAN};
    const float value = next() % 25 == 0
                            ? edges[next() % 9]
                            : std::uniform_real_distribution<float>(-2.0f, 2.0f)(random_);
    uint32_t word;
    std::memcpy(&word, &value, 4);
    return word;
  }
  uint32_t row() { return next() % 6 == 0 ? 0xFFFFFFFFu : next() % 7; }

  std::mt19937 random_;
  std::vector<std::vector<uint32_t>> memory_;
};

bool same(uint32_t a, uint32_t b, bool is_float) {
  float x, y;
  std::memcpy(&x, &a, 4);
  std::memcpy(&y, &b, 4);
  return a == b || (is_float && std::isnan(x) && std::isnan(y));
}

std::vector<std::string> levels() {
  std::vector<std::string> list = {"baseline"};
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
    list.push_back("avx2");
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl"))
      list.push_back("avx512");
  }
#endif
  return list;
}

// The environment variable decides when a device is opened.
class ForcedIsa {
 public:
  explicit ForcedIsa(const std::string& level) {
    if (const char* now = std::getenv("NOVAPHY_CPU_ISA")) before_ = now;
    setenv("NOVAPHY_CPU_ISA", level.c_str(), 1);
  }
  ~ForcedIsa() { setenv("NOVAPHY_CPU_ISA", before_.c_str(), 1); }

 private:
  std::string before_;
};

TEST(NativeKernels, EveryOneGivesTheBitsOfTheInterpreterOnEveryInstructionSet) {
  static const novaphy_host_api host = {sizeof(novaphy_host_api), NOVAPHY_ABI_MAJOR,
                                        NOVAPHY_ABI_MINOR, &host_parallel_for};
  novaphy_error error = make_error();
  // Linked into this test, the backend has no compiled kernels.
  const Machine interpreter(novaphy_cpu_backend_query(NOVAPHY_ABI_MAJOR, &host, &error));
  void* library = dlopen(NOVAPHY_CPU_PLUGIN, RTLD_NOW | RTLD_LOCAL);
  ASSERT_NE(library, nullptr) << dlerror();
  const auto query =
      reinterpret_cast<novaphy_backend_query_fn>(dlsym(library, NOVAPHY_BACKEND_QUERY_SYMBOL));
  ASSERT_NE(query, nullptr);
  const novaphy_backend_api* api = query(NOVAPHY_ABI_MAJOR, &host, &error);
  ASSERT_NE(api, nullptr) << error.message;
  std::vector<std::unique_ptr<Machine>> machines;
  for (const std::string& level : levels()) {
    const ForcedIsa forced(level);
    machines.push_back(std::make_unique<Machine>(api));
  }
  const std::vector<std::string> names = levels();
  uint32_t seed = 1;
  for (const ir::Program& p : engine_programs()) {
    for (const int64_t n : {1, 2, 5, 8, 19, 70, 2500}) {
      if (n == 2500 && seed % 5 != 0) continue;
      const RandomArguments in(p, n, seed++);
      std::vector<std::vector<uint32_t>> expected;
      const std::string message = interpreter.run(p, n, in.arguments, expected, false);
      for (size_t m = 0; m < machines.size(); ++m) {
        std::vector<std::vector<uint32_t>> got;
        ASSERT_EQ(machines[m]->run(p, n, in.arguments, got, true), message) << p.name;
        if (!message.empty()) continue;
        for (size_t o = 0; o < got.size(); ++o)
          for (size_t k = 0; k < got[o].size(); ++k)
            ASSERT_TRUE(same(expected[o][k], got[o][k], p.outputs[o].type == ir::Type::F32))
                << p.name << " at " << names[m] << ", n " << n << ", output " << o << ", word " << k
                << std::hex << ": expected " << expected[o][k] << ", got " << got[o][k];
      }
    }
  }
}

}  // namespace
}  // namespace novaphy::testing
