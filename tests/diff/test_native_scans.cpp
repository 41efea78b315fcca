// Scans of launches of compiled kernels give the bits of single launches, on every instruction set
// of this processor. Launches that do not form a scan are rejected.
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <optional>

#include "native_kernels.h"
#include "novaphy/core/backend.h"
#include "novaphy/program/emit.h"
#include "novaphy/program/scan.h"

namespace novaphy::testing {
namespace {

// One compiled kernel on a device of its own, so that the instruction set can be forced.
class CompiledKernel {
 public:
  CompiledKernel(const novaphy_backend_api* api, const ir::Program& program)
      : api_(api), program_(program) {
    novaphy_error error = make_error();
    const std::vector<uint32_t> words = ir::serialize(program);
    EXPECT_EQ(api->device_open(0, &device_, &error), NOVAPHY_OK) << error.message;
    EXPECT_EQ(api->stream_create(device_, &stream_, &error), NOVAPHY_OK) << error.message;
    EXPECT_EQ(api->module_create(device_, NOVAPHY_CODE_PROGRAM, words.data(), words.size() * 4,
                                 &module_, &error),
              NOVAPHY_OK)
        << error.message;
    EXPECT_EQ(api->kernel_get(module_, "main", &kernel_, &error), NOVAPHY_OK) << error.message;
  }
  ~CompiledKernel() {
    api_->module_destroy(module_);
    api_->stream_destroy(stream_);
    api_->device_close(device_);
  }
  CompiledKernel(const CompiledKernel&) = delete;

  // The message of the first launch that fails, or none.
  std::string launch(const std::vector<std::vector<uint64_t>>& launches, int64_t n) const {
    for (const std::vector<uint64_t>& words : launches) {
      novaphy_error error = make_error();
      if (api_->launch(stream_, kernel_, n, words.data(), static_cast<uint32_t>(words.size()),
                       &error) != NOVAPHY_OK)
        return error.message;
    }
    return {};
  }
  // Null when the launches are no scan.
  novaphy_scan* scan(const std::vector<std::vector<uint64_t>>& launches,
                     novaphy_scan* first = nullptr) const {
    std::vector<const uint64_t*> all;
    for (const auto& words : launches) all.push_back(words.data());
    novaphy_error error = make_error();
    novaphy_scan* made = nullptr;
    const novaphy_status status =
        api_->scan_create(device_, kernel_, all.data(), program_.argument_count(),
                          static_cast<uint32_t>(launches.size()), first, &made, &error);
    EXPECT_TRUE(status == NOVAPHY_OK || status == NOVAPHY_NOT_SUPPORTED) << error.message;
    return status == NOVAPHY_OK ? made : nullptr;
  }
  // Runs a scan in two stretches of rows.
  std::string run(novaphy_scan* scan, int64_t n) const {
    novaphy_error error = make_error();
    const int64_t middle = n / 3;
    novaphy_status status = api_->scan_launch(scan, 0, middle, &error);
    if (status == NOVAPHY_OK) status = api_->scan_launch(scan, middle, n, &error);
    api_->scan_destroy(scan);
    return status == NOVAPHY_OK ? "" : error.message;
  }

 private:
  const novaphy_backend_api* api_;
  const ir::Program& program_;
  novaphy_device* device_ = nullptr;
  novaphy_stream* stream_ = nullptr;
  novaphy_module* module_ = nullptr;
  novaphy_kernel* kernel_ = nullptr;
};

constexpr int kLaunches = 11;

// The arguments of launches that pass their outputs on, and the arrays of these outputs. `buffers`:
// the number of arrays that each output uses in turns. `reads_back`: a varying source is the output
// of the launch before, if the shapes agree.
class Chain {
 public:
  Chain(const ir::Program& p, const ir::Scan& scan, int64_t n, uint32_t seed, int buffers,
        bool reads_back = false)
      : program_(p), scan_(scan), first_(p, n, seed) {
    for (int k = 0; k < kLaunches; ++k) {
      std::vector<uint64_t> words = first_.arguments;
      // Random words that are numbers of the right type: those of another draw.
      other_.push_back(
          std::make_unique<RandomArguments>(p, n, seed + 977u * static_cast<uint32_t>(k + 1)));
      for (const int32_t s : scan.varying)
        words[p.source_argument(static_cast<size_t>(s))] =
            other_.back()->arguments[p.source_argument(static_cast<size_t>(s))];
      for (const int32_t s : scan.varying)
        if (reads_back && k > 0 &&
            p.sources[static_cast<size_t>(s)].width ==
                static_cast<int32_t>(p.outputs[0].values.size()))
          words[p.source_argument(static_cast<size_t>(s))] = launches.back()[p.output_argument(0)];
      for (size_t o = 0; o < p.outputs.size(); ++o) {
        auto& array = arrays[{o, k % buffers}];
        array.resize(static_cast<size_t>(n) * p.outputs[o].values.size(), 0xDEADBEEFu);
        words[p.output_argument(o)] = reinterpret_cast<uint64_t>(array.data());
        if (k > 0) words[source(o)] = launches.back()[p.output_argument(o)];
      }
      launches.push_back(std::move(words));
    }
  }
  uint32_t source(size_t output) const {
    return program_.source_argument(static_cast<size_t>(scan_.carried[output]));
  }

  std::vector<std::vector<uint64_t>> launches;
  std::map<std::pair<size_t, int>, std::vector<uint32_t>> arrays;

 private:
  const ir::Program& program_;
  const ir::Scan& scan_;
  RandomArguments first_;
  std::vector<std::unique_ptr<RandomArguments>> other_;
};

// Gives the launch of an adjoint the sources, rows of items and parameters of its primal's; these
// perhaps negated.
void share(const ir::Program& q, const std::vector<uint64_t>& primal, const ir::Program& p,
           std::vector<uint64_t>& adjoint, bool negated) {
  for (size_t s = 0; s < q.sources.size(); ++s) {
    ASSERT_EQ(p.sources[s].name, q.sources[s].name);
    for (const uint32_t k : {0u, 1u})
      adjoint[p.source_argument(s) + k] = primal[q.source_argument(s) + k];
  }
  for (size_t l = 0; l < p.loops.size(); ++l)
    for (const uint32_t k : {0u, 1u})
      adjoint[p.loop_argument(l) + k] = primal[q.loop_argument(0) + k];
  for (size_t k = 0; k < static_cast<size_t>(q.param_count); ++k)
    adjoint[p.param_argument(k)] = primal[q.param_argument(k)] ^ (negated ? 0x80000000u : 0u);
}

TEST(NativeScans, EveryOneGivesTheBitsOfItsLaunches) {
  const novaphy_backend_api* api = plugin_api();
  ASSERT_NE(api, nullptr);
  int programs = 0, compared = 0;
  uint32_t seed = 1;
  for (const ir::Program& p : engine_programs()) {
    const auto scan = ir::find_scan(p);
    if (!scan) continue;
    ++programs;
    for (const std::string& level : levels()) {
      const ForcedIsa forced(level);
      const CompiledKernel kernel(api, p);
      for (const int64_t n : {1, 3, 19, 70})
        for (const int way : {0, 1, 2}) {
          const int buffers = way == 0 ? kLaunches : 3;
          const Chain one_by_one(p, *scan, n, ++seed, buffers, way == 2);
          const Chain together(p, *scan, n, seed, buffers, way == 2);
          novaphy_scan* made = kernel.scan(together.launches);
          ASSERT_NE(made, nullptr) << p.name;
          ASSERT_EQ(kernel.run(made, n), kernel.launch(one_by_one.launches, n)) << p.name;
          for (const auto& [key, expected] : one_by_one.arrays) {
            const std::vector<uint32_t>& got = together.arrays.at(key);
            for (size_t k = 0; k < got.size(); ++k)
              ASSERT_TRUE(same(expected[k], got[k], p.outputs[key.first].type == ir::Type::F32))
                  << p.name << " at " << level << ", n " << n << ", " << buffers
                  << " buffers, output " << key.first << " of launch " << key.second << ", word "
                  << k << std::hex << ": expected " << expected[k] << ", got " << got[k];
            ++compared;
          }
        }
    }
  }
  EXPECT_GE(programs, 5);
  EXPECT_GT(compared, 500);
}

// An adjoint takes the list of quiet launches from its primal. With other parameters, or a state
// that the primal wrote twice, the adjoint tests the launches itself.
TEST(NativeScans, AdjointsAfterTheirPrimalsGiveTheBitsOfTheirLaunches) {
  const novaphy_backend_api* api = plugin_api();
  ASSERT_NE(api, nullptr);
  const std::vector<ir::Program> programs = engine_programs();
  int pairs = 0, followed = 0;
  uint32_t seed = 1;
  for (const ir::Program& q : programs)
    for (const ir::Program& p : programs) {
      if (!ir::adjoint_of_scan(p, q)) continue;
      ++pairs;
      for (const std::string& level : levels()) {
        const ForcedIsa forced(level);
        const CompiledKernel primal(api, q), adjoint(api, p);
        for (const int64_t n : {1, 3, 19, 70})
          for (const bool negated : {false, true})
            for (const int buffers : {kLaunches, 3}) {
              ++seed;
              const auto run = [&](auto how) {
                Chain forward(q, *ir::find_scan(q), n, seed, buffers);
                Chain backward(p, *ir::find_scan(p), n, seed + 100000, kLaunches);
                for (int k = 0; k < kLaunches; ++k)
                  share(q, forward.launches[static_cast<size_t>(kLaunches - 1 - k)], p,
                        backward.launches[static_cast<size_t>(k)], negated);
                how(forward, backward);
                return std::make_pair(forward.arrays, backward.arrays);
              };
              const auto expected = run([&](Chain& forward, Chain& backward) {
                primal.launch(forward.launches, n);
                adjoint.launch(backward.launches, n);
              });
              const auto got = run([&](Chain& forward, Chain& backward) {
                novaphy_scan* first = primal.scan(forward.launches);
                novaphy_scan* then = adjoint.scan(backward.launches, first);
                ASSERT_NE(first, nullptr);
                if (then == nullptr) {  // the adjoint reads a state that does not vary in its scan
                  api->scan_destroy(first);
                  primal.launch(forward.launches, n);
                  adjoint.launch(backward.launches, n);
                  return;
                }
                ++followed;
                for (const auto& [begin, end] : {std::pair{int64_t{0}, n / 3}, {n / 3, n}})
                  for (novaphy_scan* scan : {first, then}) {
                    novaphy_error error = make_error();
                    api->scan_launch(scan, begin, end, &error);
                  }
                api->scan_destroy(then);
                api->scan_destroy(first);
              });
              const auto compare = [&](const auto& a, const auto& b) {
                for (const auto& [key, words] : a)
                  for (size_t w = 0; w < words.size(); ++w)
                    ASSERT_TRUE(same(words[w], b.at(key)[w], true))
                        << p.name << " at " << level << ", n " << n << ", negated parameters "
                        << negated << ", " << buffers << " buffers, word " << w;
              };
              compare(expected.first, got.first);
              compare(expected.second, got.second);
            }
      }
    }
  EXPECT_GE(pairs, 2);
  EXPECT_GE(followed, 32);
}

// The steps of the ball, which are the reason for all this, and their adjoints are scans.
TEST(NativeScans, StepsOfParticlesAreScans) {
  std::map<std::string, int> found;
  for (const ir::Program& p : engine_programs())
    if (ir::find_scan(p)) ++found[p.name];
  EXPECT_EQ(found["step_particles"], 1);
  EXPECT_GE(found["step_particles.adjoint"], 1);
  EXPECT_EQ(found["tetrahedron_forces"], 0);
}

// Names do not decide what a scan is, nor whose adjoint a Program is.
TEST(NativeScans, NamesDecideNothing) {
  const auto renamed = [](ir::Program p) {
    p.name = "p" + std::to_string(p.instrs.size());
    for (size_t s = 0; s < p.sources.size(); ++s) p.sources[s].name = "s" + std::to_string(s);
    for (size_t o = 0; o < p.outputs.size(); ++o) p.outputs[o].name = "o" + std::to_string(o);
    return p;
  };
  const std::vector<ir::Program> programs = engine_programs();
  int scan = 0, pairs = 0;
  for (const ir::Program& p : programs) {
    const auto found = ir::find_scan(p), again = ir::find_scan(renamed(p));
    ASSERT_EQ(found.has_value(), again.has_value()) << p.name;
    if (!found) continue;
    ++scan;
    EXPECT_EQ(found->carried, again->carried) << p.name;
    EXPECT_EQ(found->varying, again->varying) << p.name;
    for (const ir::Program& q : programs) {
      if (!ir::adjoint_of_scan(p, q)) continue;
      ++pairs;
      EXPECT_EQ(p.name, q.name + ".adjoint");
      EXPECT_TRUE(ir::adjoint_of_scan(renamed(p), renamed(q))) << p.name;
    }
  }
  EXPECT_GE(scan, 5);
  EXPECT_GE(pairs, 2);
}

class NativeScansOfSteps : public ::testing::Test {
 protected:
  void SetUp() override {
    const novaphy_backend_api* api = plugin_api();
    ASSERT_NE(api, nullptr);
    programs_ = engine_programs();
    step = std::find_if(programs_.begin(), programs_.end(),
                        [](const ir::Program& p) { return p.name == "step_particles"; });
    ASSERT_NE(step, programs_.end());
    scan = ir::find_scan(*step);
    ASSERT_TRUE(scan);
    kernel = std::make_unique<CompiledKernel>(api, *step);
  }

 private:
  std::vector<ir::Program> programs_;

 protected:
  std::vector<ir::Program>::const_iterator step;
  std::optional<ir::Scan> scan;
  std::unique_ptr<CompiledKernel> kernel;
};

TEST_F(NativeScansOfSteps, LaunchesThatAreNoneAreRefused) {
  const int64_t n = 5;
  const Chain chain(*step, *scan, n, 7, kLaunches);
  const auto refused = [&](auto change) {
    auto launches = chain.launches;
    change(launches);
    return kernel->scan(launches) == nullptr;
  };
  EXPECT_FALSE(refused([](auto&) {}));
  EXPECT_TRUE(refused([&](auto& l) { l[4][step->param_argument(1)] ^= 1; })) << "another time step";
  EXPECT_TRUE(refused([&](auto& l) { l[4][chain.source(0)] = l[0][chain.source(0)]; }))
      << "a state that no launch made";
  const auto read = [&](const char* name) {
    for (size_t s = 0; s < step->sources.size(); ++s)
      if (step->sources[s].name == name) return step->source_argument(s);
    ADD_FAILURE() << name;
    return 0u;
  };
  EXPECT_TRUE(refused([&](auto& l) { l[4][read("particle_f")] += 12; })) << "another force";
  EXPECT_TRUE(refused([&](auto& l) {
    for (auto& words : l) words[read("particle_f")] = l[6][step->output_argument(1)];
  })) << "a force that a launch writes";
  EXPECT_TRUE(refused([&](auto& l) { l[4][chain.source(0) + 1] -= 1; })) << "another row count";
}

// A row of a table that does not exist is reported as by the launches.
TEST_F(NativeScansOfSteps, AReadPastTheEndIsReported) {
  const int64_t n = 40;
  Chain one_by_one(*step, *scan, n, 3, kLaunches), together(*step, *scan, n, 3, kLaunches);
  std::vector<uint32_t> offsets, items;
  for (uint32_t i = 0; i <= n; ++i) {
    offsets.push_back(i);
    items.push_back(i == 29 ? 1u << 20 : 0);
  }
  for (Chain* chain : {&one_by_one, &together})
    for (auto& words : chain->launches) {
      words[step->loop_argument(0)] = reinterpret_cast<uint64_t>(offsets.data());
      words[step->loop_argument(0) + 1] = reinterpret_cast<uint64_t>(items.data());
    }
  novaphy_scan* made = kernel->scan(together.launches);
  ASSERT_NE(made, nullptr);
  const std::string message = kernel->run(made, n);
  EXPECT_EQ(message, kernel->launch(one_by_one.launches, n));
  EXPECT_NE(message.find("row i = 29 reads row 1048576"), std::string::npos) << message;
}

}  // namespace
}  // namespace novaphy::testing
