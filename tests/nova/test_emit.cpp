// The text of the C emitter. With NOVAPHY_UPDATE_GOLDEN=1 the golden files are written instead of
// compared.
#include <cstdlib>
#include <fstream>
#include <set>
#include <sstream>

#include "novaphy/nova/registry.h"
#include "novaphy/program/emit.h"
#include "random_kernel.h"

namespace novaphy::testing {
namespace {

std::string read(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::stringstream text;
  text << file.rdbuf();
  return file ? text.str() : std::string();
}

void expect_golden(const std::string& name, const std::string& text) {
  const std::string path = std::string(NOVAPHY_GOLDEN_DIR) + "/emit/" + name + ".c";
  if (const char* update = std::getenv("NOVAPHY_UPDATE_GOLDEN"); update && *update) {
    std::ofstream(path, std::ios::binary) << text;
    return;
  }
  const std::string golden = read(path);
  ASSERT_FALSE(golden.empty()) << path << " is missing; NOVAPHY_UPDATE_GOLDEN=1 writes it";
  EXPECT_EQ(text, golden) << "a wanted change: NOVAPHY_UPDATE_GOLDEN=1 writes " << path;
}

void expect_golden(const std::string& name, const nova::ir::Program& program) {
  expect_golden(name, nova::ir::emit_c(program));
}

nova::Kernel engine_kernel(const std::string& name) {
  for (const nova::EngineKernel& k : nova::engine_kernels())
    if (k.kernel.name() == name) return k.kernel;
  ADD_FAILURE() << "no kernel " << name;
  return {};
}

TEST(Emit, SaysWhatTheArgumentsAreAndComputesRowByRow) {
  expect_golden("sgd_update_f32", engine_kernel("sgd_update_f32").program());
}
TEST(Emit, TakesPackedRowsApartAndSkipsWhatNoLaneNeeds) {
  expect_golden("sgd_update_vec3_clipped_f32",
                engine_kernel("sgd_update_vec3_clipped_f32").program());
}
TEST(Emit, SkipsNothingWhereProductsAndSumsMayBeContracted) {
  nova::ir::Program program = engine_kernel("sgd_update_vec3_clipped_f32").program();
  const auto asks = [&] {
    return nova::ir::emit_device(program, "row").find("if (any(") != std::string::npos;
  };
  EXPECT_TRUE(asks());
  program.contract = true;
  EXPECT_FALSE(asks());
}
// The two halves from the adjoint of a select become one, and no part of them stays outside.
TEST(Emit, SkipsWhatTheHalvesOfASelectNeedToo) {
  const nova::Kernel kernel = nova::make_kernel(
      "halves", {{"x", DType::F32, 4, Access::Direct}}, {{"y", 1}}, [](TraceContext& c) {
        Real h = c.f32(0, 0);
        for (int k = 0; k < 4; ++k) h = nova::sqrt(h * h + Real(1.0f));
        const nova::Bool d = c.f32(0, 1) < c.f32(0, 2);
        const Real halves = nova::select(d, Real(0.0f), h * Real(2.0f)) +
                            nova::select(d, h * Real(3.0f), Real(0.0f));
        return std::vector{nova::select(c.f32(0, 3) < Real(0.0f), halves, Real(0.0f))};
      });
  const std::string text = nova::ir::emit_c(kernel.program());
  ASSERT_NE(text.find("if (any("), std::string::npos) << text;
  EXPECT_LT(text.find("if (any("), text.find("vsqrt(")) << text;
}
TEST(Emit, ComputesWhatIsTheSameForAllRowsOnce) {
  const nova::Kernel kernel = nova::make_kernel(
      "uniform", {{"x", DType::F32, 2, Access::Direct}, {"u", DType::F32, 3, Access::Uniform}},
      {{"y", 2}}, [](nova::TraceContext& c) {
        const nova::Real u = c.f32(1, 0) * c.param(0) - c.f32(1, 2);
        return std::vector{c.f32(0, 0) * u, c.f32(0, 1) + sqrt(u)};
      });
  expect_golden("uniform", kernel.program());
}
TEST(Emit, SumsOverACsrRowInOrder) {
  const nova::Kernel kernel =
      nova::make_reduce_kernel("neighbors",
                               {{"x", DType::F32, 3, Access::Direct},
                                {"other", DType::I32, 1, Access::CsrRow},
                                {"position", DType::F32, 3, Access::Indexed}},
                               {{"sum", 1}},
                               {.init = {},
                                .body =
                                    [](nova::TraceContext& c) {
                                      const nova::Int row = c.i32(1);
                                      nova::Real d = c.f32(2, row, 0) - c.f32(0, 0);
                                      for (int32_t k = 1; k < 3; ++k)
                                        d = d + (c.f32(2, row, k) - c.f32(0, k));
                                      return std::vector{d};
                                    },
                                .epilogue = {}});
  expect_golden("neighbors", kernel.program());
}
TEST(Emit, AddsPlainRowsOfACsrRowRowByRow) {
  const nova::Kernel kernel = nova::make_reduce_kernel(
      "forces", {{"x", DType::F32, 3, Access::Direct}, {"f", DType::F32, 3, Access::CsrRow}},
      {{"sum", 3}},
      {.init =
           [](nova::TraceContext& c) {
             return std::vector{c.f32(0, 0), c.f32(0, 1), c.f32(0, 2)};
           },
       .body =
           [](nova::TraceContext& c) {
             return std::vector{c.f32(1, 0), c.f32(1, 1), c.f32(1, 2)};
           },
       .epilogue = {}});
  expect_golden("forces", kernel.program());
}
TEST(Emit, TakesFourColumnsOfAWideRowAtATime) {
  const nova::Kernel kernel = nova::make_kernel(
      "wide", {{"x", DType::F32, 9, Access::Direct}, {"y", DType::F32, 7, Access::Direct}},
      {{"z", 6}}, [](nova::TraceContext& c) {
        std::vector<nova::Real> z;  // all of x, and of y the columns 0, 4, 5, 6
        for (const int32_t k : {0, 4, 5, 6, 0, 4})
          z.push_back(c.f32(1, k) * c.f32(0, static_cast<int32_t>(z.size()) + 3) +
                      c.f32(0, static_cast<int32_t>(z.size()) % 3));
        return z;
      });
  expect_golden("wide", kernel.program());
}
// A force that acts within a distance, and its adjoint: the items that did not act in the first sum
// add nothing to the second.
TEST(Emit, LeavesOutItemsOfASecondSumThatDidNotActInTheFirst) {
  const nova::Kernel kernel = nova::make_reduce_kernel(
      "springs_to_points",
      {{"x", DType::F32, 3, Access::Direct}, {"point", DType::F32, 3, Access::Reduced}}, {{"f", 1}},
      {.init = [](TraceContext&) { return std::vector{Real(0.0f)}; },
       .body =
           [](TraceContext& c) {
             Real d = Real(0.0f);
             for (int32_t k = 0; k < 3; ++k) {
               const Real e = c.f32(1, k) - c.f32(0, k);
               d = d + e * e;
             }
             Real force = d;
             for (int k = 0; k < 12; ++k) force = nova::sqrt(force * d + Real(1.0f));
             return std::vector{nova::select(d < Real(0.25f), force, Real(0.0f))};
           },
       .epilogue = [](TraceContext&,
                      std::span<const Real> sums) { return std::vector{sums[0] * sums[0]}; }});
  const nova::AdjointPlan& plan = kernel.adjoint(nova::gradient_mask(kernel, {"x"}, {}, {"f"}));
  const std::string text = nova::ir::emit_c(plan.rows[0].program);
  EXPECT_NE(text.find("acting1 |= 1u << r0;"), std::string::npos) << text;
  EXPECT_NE(text.find("(acting1 >> r1 & 1u) == 0) continue;"), std::string::npos) << text;
}
TEST(Emit, GathersTheRowsOfElementsOneGroupAhead) {
  const nova::Kernel kernel =
      nova::make_kernel("spring",
                        {{"indices", DType::I32, 2, Access::Direct},
                         {"q", DType::F32, 3, Access::Indexed},
                         {"stiffness", DType::F32, 1, Access::Direct}},
                        {{"f", 6}}, [](nova::TraceContext& c) {
                          std::vector<nova::Real> f;
                          const nova::Real k = c.f32(2);
                          for (int32_t d = 0; d < 3; ++d)
                            f.push_back(k * (c.f32(1, c.i32(0, 1), d) - c.f32(1, c.i32(0, 0), d)));
                          for (int32_t d = 0; d < 3; ++d) f.push_back(-f[static_cast<size_t>(d)]);
                          return f;
                        });
  expect_golden("spring", kernel.program());
}
// Rows with a condition are prefetched where the group before needs its rows, else where the
// condition holds.
TEST(Emit, GathersAheadWhatTheGroupBeforeNeeded) {
  const nova::Kernel kernel = nova::make_kernel(
      "damper",
      {{"indices", DType::I32, 2, Access::Direct},
       {"q", DType::F32, 3, Access::Indexed},
       {"qd", DType::F32, 3, Access::Indexed},
       {"damping", DType::F32, 1, Access::Direct}},
      {{"f", 3}}, [](nova::TraceContext& c) {
        std::vector<nova::Real> f;
        for (int32_t d = 0; d < 3; ++d)
          f.push_back(c.f32(1, c.i32(0, 1), d) - c.f32(1, c.i32(0, 0), d) +
                      novaphy::math::optional_product(
                          c.f32(3), c.f32(2, c.i32(0, 1), d) - c.f32(2, c.i32(0, 0), d)));
        return f;
      });
  expect_golden("damper", kernel.program());
}
TEST(Emit, SumsOverAFixedNumberOfUniformRows) {
  const nova::Kernel kernel = nova::make_reduce_kernel(
      "weights", {{"x", DType::F32, 1, Access::Direct}, {"w", DType::F32, 1, Access::Reduced}},
      {{"sum", 1}},
      {.init = {},
       .body =
           [](nova::TraceContext& c) {
             return std::vector{c.f32(0) * (c.f32(1) * nova::Real(2.0f))};
           },
       .epilogue = {}});
  expect_golden("weights", kernel.program());
}

// The state stays in registers. The parameters of the walls are loaded once. A wall that no row
// touches costs one comparison.
TEST(Emit, RunsManyLaunchesOfARowInOne) {
  const nova::Kernel kernel = nova::make_reduce_kernel(
      "bounce", {{"x", DType::F32, 1, Access::Direct}, {"wall", DType::F32, 1, Access::CsrRow}},
      {{"x", 1}},
      {.init = [](nova::TraceContext& c) { return std::vector{c.f32(0)}; },
       .body =
           [](nova::TraceContext& c) {
             const nova::Real d = c.f32(0) - c.f32(1);
             const nova::Real push = c.param(0) / d / sqrt(nova::Real(1.0f) + d * d);
             return std::vector{select(d > nova::Real(0.0f), nova::Real(-0.0f), push)};
           },
       .epilogue = {}});
  const nova::ir::Scan scan{.carried = {0}, .varying = {}};
  expect_golden("bounce_scan", nova::ir::emit_c_scan(kernel.program(), scan, "k_bounce_scan"));
}

// Every name that the text uses is declared before: an undeclared one would break a build far from
// here.
TEST(Emit, DeclaresEveryValueBeforeItsUse) {
  for (const SumKind kind : {SumKind::None, SumKind::Fixed, SumKind::Csr})
    for (uint32_t seed = 1; seed < 60; ++seed) {
      const Kernel kernel = RandomKernel(seed).make(kind);
      std::stringstream text(nova::ir::emit_c(kernel.program()));
      std::set<std::string> declared;
      std::string word;
      const auto is_value = [](const std::string& w) {
        return w.size() > 1 && (w[0] == 'v' || w[0] == 'u') &&
               w.find_first_not_of("0123456789", 1) == std::string::npos;
      };
      for (std::string line; std::getline(text, line);) {
        if (line.rfind("//", 0) == 0) continue;
        const size_t equals = line.find('=');
        const bool declares =
            line.find("const v") != std::string::npos ||
            line.find("const float u") != std::string::npos ||
            line.find("const int") != std::string::npos || line.find(" vf ") != std::string::npos ||
            line.find(" vi ") != std::string::npos || line.find(" vb ") != std::string::npos ||
            line.find(" float u") != std::string::npos ||
            line.find(" int32_t u") != std::string::npos ||
            line.find(" int u") != std::string::npos;
        std::string name;
        for (size_t k = 0; k <= line.size(); ++k) {
          const char c = k < line.size() ? line[k] : ' ';
          if (std::isalnum(static_cast<unsigned char>(c)) || c == '_') {
            name += c;
            continue;
          }
          if (is_value(name)) {
            if (declares && (equals == std::string::npos || k <= equals)) {
              declared.insert(name);
            } else {
              ASSERT_TRUE(declared.count(name)) << name << " in: " << line << "\n"
                                                << kernel.source();
            }
          }
          name.clear();
        }
      }
      EXPECT_GT(declared.size(), 3u);
    }
}

TEST(Emit, GivesEqualTextsForEqualPrograms) {
  for (uint32_t seed = 1; seed < 10; ++seed)
    EXPECT_EQ(nova::ir::emit_c(RandomKernel(seed).make(SumKind::Csr).program()),
              nova::ir::emit_c(RandomKernel(seed).make(SumKind::Csr).program()));
}

TEST(Emit, MakesACFunctionNameOfAnyName) {
  nova::ir::Program p = RandomKernel(1).make(SumKind::None).program();
  p.name = "a b*/c\n" + std::string(500, 'x');
  const std::string name = nova::ir::c_function_name(p);
  EXPECT_EQ(name.find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789_"), std::string::npos)
      << name;
  EXPECT_LT(name.size(), 90u);
  EXPECT_EQ(nova::ir::emit_c(p).rfind("// a b*/c ", 0), 0u);
}

}  // namespace
}  // namespace novaphy::testing
