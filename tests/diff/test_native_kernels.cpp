// Kernels compiled ahead of time. None is missing, and the kernels of users' solvers run natively.
// Each gives the bits of the interpreter, for few and many rows, on every instruction set of this
// processor.
#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "ball_scene.h"
#include "engine_calls.h"
#include "native_kernels.h"
#include "novaphy/core/backend.h"
#include "novaphy/cpu/query.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/nova/optim.h"
#include "novaphy/nova/tape.h"

#if defined(__x86_64__)
#include <cpuid.h>
#endif

namespace novaphy::testing {
namespace {

TEST(NativeKernels, NoneOfTheEngineIsMissing) {
  const std::vector<ir::Program> programs = engine_programs();
  // Bounds the number of Programs that are compiled ahead: 140 for the first kernels, and at most 5
  // for each later kernel. Later kernels: push box, relu, softplus, two of random numbers, held
  // rigid rows, acos, atan2, cross, four of quaternions.
  constexpr size_t kNewKernels = 13;
  EXPECT_LT(programs.size(), 140 + 5 * kNewKernels);
  const std::vector<std::string> built = levels();
  const int32_t baseline = !built.empty() && built.front() == "baseline" ? 4 : 1;
  std::set<std::string> names;
  for (const ir::Program& p : programs) {
    const nova::KernelInfo info = nova::kernel_info(p);
    ASSERT_EQ(info.how, "native") << p.name << "\n" << ir::to_string(p);
    EXPECT_EQ(info.hash, ir::hash(p));
    EXPECT_EQ(info.lanes, info.isa == "baseline" ? baseline : info.isa == "avx2" ? 8 : 16) << info.isa;
    names.insert(p.name);
  }
  for (const char* name : {"step_particles", "step_particles.adjoint", "sgd_update_f32", "mul",
                           "particle_point_loss.adjoint", "accumulate_gradient", "copy"})
    EXPECT_TRUE(names.count(name)) << name;
}

TEST(NativeKernels, TwoSetsOfGradientsServeAKernelAndOneServesATensorFunction) {
  for (const nova::EngineKernel& k : all_kernels())
    EXPECT_LE(k.gradients.size(), 2u) << k.kernel.name();
  for (const nova::EngineKernel& k : nova::engine_kernels())
    EXPECT_LE(k.gradients.size(), 1u) << k.kernel.name();
  for (const nova::EngineKernel& k : diff::engine_kernels()) {
    if (k.gradients.empty()) continue;
    const nova::AdjointMask& all = k.gradients.back();
    EXPECT_TRUE(all.gated) << k.kernel.name();
    for (size_t s = 0; s < all.wrt.size(); ++s)
      EXPECT_EQ(all.wrt[s], k.kernel.sources()[s].dtype == nova::DType::F32) << k.kernel.name();
  }
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
  std::set<uint64_t> before;  // made by other tests of this process
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

// The test tries parts of the declared gradients, and parts of the outputs with a gradient.
TEST(NativeKernels, NoPartOfTheGradientsOfAnOperatorIsInterpreted) {
  std::set<uint64_t> before;
  for (const nova::KernelInfo& info : nova::kernel_info()) before.insert(info.hash);
  Random random(5);
  int asked = 0;
  for (const nova::EngineKernel& k : diff::engine_kernels()) {
    if (k.gradients.empty()) continue;
    const Call call = random_call(k.kernel, 3);
    const bool adds = std::any_of(k.gradients.begin(), k.gradients.end(),
                                  [](const nova::AdjointMask& mask) { return mask.gated; });
    for (const nova::AdjointMask& mask : k.gradients)
      for (int time = 0; time < 4; ++time) {
        std::vector<bool> some = mask.wrt;
        for (size_t s = 0; s < some.size(); ++s) some[s] = some[s] && random.chance(50);
        const auto outputs = static_cast<int32_t>(k.kernel.outputs().size());
        const auto seeded = static_cast<uint32_t>(1 + random.below((1 << outputs) - 1));
        // Elements are read through their table only where a sum follows.
        if (std::count(some.begin(), some.end(), true) == 0 || mask.table >= 0) continue;
        gradients(call, some, seeded, nova::KeepGradients::Leaves, adds ? 2 : 1);
        ++asked;
      }
  }
  EXPECT_GT(asked, 50);
  for (const nova::KernelInfo& info : nova::kernel_info())
    if (!before.contains(info.hash)) {
      EXPECT_EQ(info.how, "native") << info.name;
    }
}

// A device of a backend's table, and the record of its launches.
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

  // Returns the status and the message of a launch, and writes its outputs. `in_place`: for each
  // output the source that shares its memory, or -1.
  std::string run(const ir::Program& p, int64_t n, std::vector<uint64_t> arguments,
                  std::vector<std::vector<uint32_t>>& outputs, bool native,
                  const std::vector<int32_t>& in_place = {}) const {
    novaphy_error error = make_error();
    novaphy_module* module = nullptr;
    novaphy_kernel* kernel = nullptr;
    const std::vector<uint32_t> words = ir::serialize(p);
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
      if (in_place.empty() || in_place[o] < 0) continue;
      uint64_t& source = arguments[p.source_argument(static_cast<size_t>(in_place[o]))];
      std::memcpy(outputs.back().data(), reinterpret_cast<const void*>(source),
                  outputs.back().size() * sizeof(uint32_t));
      source = arguments[p.output_argument(o)];
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

#if defined(__x86_64__)
// Returns whether the upper parts of vector registers are in use. False where the processor does
// not tell.
bool uses_upper_parts() {
  uint32_t a = 0, b = 0, c = 0, d = 0;
  constexpr uint32_t kOsxsave = 1u << 27, kXgetbv1 = 1u << 2, kUpper = 1u << 2;
  if (__get_cpuid(1, &a, &b, &c, &d) == 0 || (c & kOsxsave) == 0) return false;
  if (__get_cpuid_count(0xd, 1, &a, &b, &c, &d) == 0 || (a & kXgetbv1) == 0) return false;
  __asm__ volatile("xgetbv" : "=a"(a), "=d"(d) : "c"(1));
  return (a & kUpper) != 0;
}

TEST(NativeKernels, NoneLeavesTheUpperPartsOfVectorRegistersInUse) {
  const novaphy_backend_api* api = plugin_api();
  ASSERT_NE(api, nullptr);
  const Machine machine(api);
  uint32_t seed = 1;
  for (const ir::Program& p : engine_programs()) {
    const RandomArguments in(p, 32, seed++);
    std::vector<std::vector<uint32_t>> outputs;
    machine.run(p, 32, in.arguments, outputs, true);
    EXPECT_FALSE(uses_upper_parts()) << p.name;
  }
}
#endif

// Returns for every output a source of the same shape that is read at the own row, or -1.
std::vector<int32_t> sources_in_place(const ir::Program& p) {
  std::vector<int32_t> found(p.outputs.size(), -1);
  for (size_t s = 0; s < p.sources.size(); ++s) {
    const ir::Source& source = p.sources[s];
    for (size_t o = 0; o < found.size() && source.access == Access::Direct; ++o) {
      const ir::Output& output = p.outputs[o];
      if (found[o] >= 0 || output.type != source.type ||
          static_cast<int32_t>(output.values.size()) != source.width)
        continue;
      found[o] = static_cast<int32_t>(s);
      break;
    }
  }
  return found;
}

TEST(NativeKernels, EveryOneGivesTheBitsOfTheInterpreterOnEveryInstructionSet) {
  novaphy_error error = make_error();
  // Linked into this test, the backend has no compiled kernels.
  const Machine interpreter(novaphy_cpu_backend_query(NOVAPHY_ABI_MAJOR, &host_api(), &error));
  const novaphy_backend_api* api = plugin_api();
  ASSERT_NE(api, nullptr);
  std::vector<std::unique_ptr<Machine>> machines;
  for (const std::string& level : levels()) {
    const ForcedIsa forced(level);
    machines.push_back(std::make_unique<Machine>(api));
  }
  const std::vector<std::string> names = levels();
  uint32_t seed = 1;
  int64_t in_place_runs = 0;
  for (const ir::Program& p : engine_programs()) {
    const std::vector<int32_t> in_place = sources_in_place(p);
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
        // The rows of the last group that are computed once more must not be written once more.
        if (std::count(in_place.begin(), in_place.end(), -1) == std::ssize(in_place)) continue;
        std::vector<std::vector<uint32_t>> again;
        ASSERT_EQ(machines[m]->run(p, n, in.arguments, again, true, in_place), "") << p.name;
        ++in_place_runs;
        for (size_t o = 0; o < again.size(); ++o)
          for (size_t k = 0; k < again[o].size(); ++k)
            ASSERT_TRUE(same(expected[o][k], again[o][k], p.outputs[o].type == ir::Type::F32))
                << p.name << " in place at " << names[m] << ", n " << n << ", word " << k;
      }
    }
  }
  EXPECT_GT(in_place_runs, 500);
}

}  // namespace
}  // namespace novaphy::testing
