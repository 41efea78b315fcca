// Compiled kernels of the engine and random arguments for them, for tests that compare bits.
#pragma once

#include <dlfcn.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <random>
#include <string>
#include <vector>

#include "novaphy/abi/backend.h"
#include "novaphy/core/parallel.h"
#include "novaphy/diff/engine_kernels.h"
#include "novaphy/nova/registry.h"
#include "novaphy/program/ir.h"

namespace novaphy::testing {

namespace ir = nova::ir;
using ir::Access;
using ir::Op;

inline std::vector<ir::Program> engine_programs() {
  std::vector<nova::EngineKernel> kernels = nova::engine_kernels();
  for (nova::EngineKernel& k : diff::engine_kernels()) kernels.push_back(std::move(k));
  return nova::programs_of(kernels);
}

inline void host_parallel_for(int64_t chunks, void (*body)(void*, int64_t), void* context) {
  parallel_for(chunks, body, context);
}

// Arguments for a launch of n rows: random numbers, some of them edge values. Row indices are in
// range, except for negative ones.
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
    // Rows of one, two and mixed lengths, over consecutive items and not; several sums over the
    // same rows, as in an adjoint, and over others.
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
    for (const char f : is_float) arguments.push_back(f ? number() : next() % 8);
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

inline bool same(uint32_t a, uint32_t b, bool is_float) {
  float x, y;
  std::memcpy(&x, &a, 4);
  std::memcpy(&y, &b, 4);
  return a == b || (is_float && std::isnan(x) && std::isnan(y));
}

// The instruction sets that were built (NOVAPHY_CPU_LEVELS) and that this processor has.
inline std::vector<std::string> levels() {
  std::vector<std::string> list;
  const auto add = [&list](const std::string& name) {
    if (std::string(" " NOVAPHY_NATIVE_LEVELS " ").find(" " + name + " ") != std::string::npos)
      list.push_back(name);
  };
  add("baseline");
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
    add("avx2");
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl"))
      add("avx512");
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

inline const novaphy_host_api& host_api() {
  static const novaphy_host_api host = {sizeof(novaphy_host_api), NOVAPHY_ABI_MAJOR,
                                        NOVAPHY_ABI_MINOR, &host_parallel_for, nullptr};
  return host;
}

// Returns the table of the plugin with the compiled kernels. Without the plugin the test fails, and
// the result is null.
inline const novaphy_backend_api* plugin_api() {
  void* library = dlopen(NOVAPHY_CPU_PLUGIN, RTLD_NOW | RTLD_LOCAL);
  EXPECT_NE(library, nullptr) << dlerror();
  if (library == nullptr) return nullptr;
  const auto query =
      reinterpret_cast<novaphy_backend_query_fn>(dlsym(library, NOVAPHY_BACKEND_QUERY_SYMBOL));
  EXPECT_NE(query, nullptr);
  novaphy_error error{};
  const novaphy_backend_api* api =
      query != nullptr ? query(NOVAPHY_ABI_MAJOR, &host_api(), &error) : nullptr;
  EXPECT_NE(api, nullptr) << error.message;
  return api;
}

}  // namespace novaphy::testing
