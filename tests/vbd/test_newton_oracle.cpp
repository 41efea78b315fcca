// The oracle has the bits of Newton 1.8.0: units, sweeps and the whole rollouts of both files. The
// solver is compared with the oracle in every substep, restarted from the oracle's state.
#include <gtest/gtest.h>

#include "newton_oracle.h"
#include "support/bits.h"

namespace novaphy {
namespace {

using testing::largest_distance;
using testing::NewtonVbdScene;
using testing::Npz;
using testing::same_bits;
namespace newton = testing::newton;
using newton::M;
using newton::Unit;
using newton::V;

// 0 and -0 count as equal, because Newton's unit kernels start their sums at 0.
bool equal(const V& a, const V& b) { return a.x == b.x && a.y == b.y && a.z == b.z; }
bool equal(const M& a, const M& b) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      if (a.m[i][j] != b.m[i][j]) return false;
  return true;
}

// The units of one kind that are not Newton's.
template <class Evaluate>
size_t differing_units(const Npz& file, const char* kind, const Evaluate& evaluate) {
  const auto f = file["unit_" + std::string(kind) + "_f"].as<V>();
  const auto h = file["unit_" + std::string(kind) + "_h"].as<M>();
  size_t differ = 0;
  for (size_t k = 0; k < f.size(); ++k) {
    const Unit unit = evaluate(k);
    differ += !equal(unit.f, f[k]) || !equal(unit.h, h[k]);
  }
  EXPECT_GT(f.size(), 60u);
  return differ;
}

template <size_t n>
void pick(std::span<const V> from, size_t element, V (&to)[n]) {
  for (size_t c = 0; c < n; ++c) to[c] = from[n * element + c];
}

TEST(NewtonOracle, UnitsHaveNewtonsBits) {
  const Npz cloth = testing::golden("newton_vbd_cloth.npz");
  const Npz soft = testing::golden("newton_vbd_soft.npz");
  const float dt = cloth["unit_dt"].scalar<float>();
  EXPECT_EQ(dt, soft["unit_dt"].scalar<float>());
  EXPECT_EQ(differing_units(cloth, "tri",
                            [&](size_t k) {
                              V x[3], xn[3];
                              pick(cloth["unit_tri_x"].as<V>(), k / 3, x);
                              pick(cloth["unit_tri_xprev"].as<V>(), k / 3, xn);
                              const V c = cloth["unit_tri_mat"].as<V>()[k / 3];
                              return newton::triangle(static_cast<int>(k % 3), x, xn,
                                                      cloth["unit_tri_pose"].as<Mat22f>()[k / 3],
                                                      cloth["unit_tri_area"].as<float>()[k / 3],
                                                      c.x, c.y, c.z, dt);
                            }),
            0u);
  EXPECT_EQ(
      differing_units(cloth, "edge",
                      [&](size_t k) {
                        const size_t e = k / 4;
                        const Vec4i id = cloth["unit_edge_idx"].as<Vec4i>()[e];
                        if (id.x < 0 || id.y < 0) return Unit{};
                        V x[4], xn[4];
                        const int32_t ids[4] = {id.x, id.y, id.z, id.w};
                        for (size_t c = 0; c < 4; ++c) {
                          x[c] = cloth["unit_edge_x"].as<V>()[static_cast<size_t>(ids[c])];
                          xn[c] = cloth["unit_edge_xprev"].as<V>()[static_cast<size_t>(ids[c])];
                        }
                        const Vec2f c = cloth["unit_edge_mat"].as<Vec2f>()[e];
                        return newton::hinge(static_cast<int>(k % 4), x, xn,
                                             cloth["unit_edge_ang"].as<float>()[e],
                                             cloth["unit_edge_len"].as<float>()[e], c.x, c.y, dt);
                      }),
      0u);
  EXPECT_EQ(differing_units(soft, "tet",
                            [&](size_t k) {
                              V x[4], xn[4];
                              pick(soft["unit_tet_x"].as<V>(), k / 4, x);
                              pick(soft["unit_tet_xprev"].as<V>(), k / 4, xn);
                              const V c = soft["unit_tet_mat"].as<V>()[k / 4];
                              return newton::tetrahedron(static_cast<int>(k % 4), x, xn,
                                                         soft["unit_tet_pose"].as<M>()[k / 4], c.x,
                                                         c.y, c.z, dt);
                            }),
            0u);
  EXPECT_EQ(differing_units(soft, "spring",
                            [&](size_t k) {
                              V x[2], xn[2];
                              pick(soft["unit_spring_x"].as<V>(), k / 2, x);
                              pick(soft["unit_spring_xprev"].as<V>(), k / 2, xn);
                              Unit unit =
                                  newton::spring(x[0], x[1], xn[0], xn[1],
                                                 soft["unit_spring_rest"].as<float>()[k / 2],
                                                 soft["unit_spring_ke"].as<float>()[k / 2],
                                                 soft["unit_spring_kd"].as<float>()[k / 2], dt);
                              if (k % 2 == 1) unit.f = -unit.f;
                              return unit;
                            }),
            0u);
  EXPECT_EQ(differing_units(soft, "contact",
                            [&](size_t k) {
                              const V c = soft["unit_contact_mat"].as<V>()[k];
                              return newton::contact(soft["unit_contact_dist"].as<float>()[k],
                                                     soft["unit_contact_rad"].as<float>()[k],
                                                     soft["unit_contact_n"].as<V>()[k],
                                                     soft["unit_contact_u"].as<V>()[k], c.x, c.y,
                                                     c.z, soft["unit_contact_eps"].scalar<float>(),
                                                     dt);
                            }),
            0u);
}

class NewtonOracleRun : public ::testing::TestWithParam<const char*> {};

TEST_P(NewtonOracleRun, RolloutAndSweepsHaveNewtonsBitsAndTheProductFollows) {
  const NewtonVbdScene scene(GetParam());
  newton::Oracle oracle(scene);
  const auto first_q = scene.file["model_particle_q"].as<V>();
  const auto first_qd = scene.file["model_particle_qd"].as<V>();
  std::vector<V> q(first_q.begin(), first_q.end()), qd(first_qd.begin(), first_qd.end());
  SolverVBD solver(scene.model, {.iterations = scene.iterations()});
  SimState in = scene.model->state(), out = scene.model->state();
  const auto substeps = static_cast<size_t>(scene.file["T"].scalar<int32_t>());
  size_t compared = 0, swept = 0;
  for (size_t t = 0; t < substeps; ++t) {
    const std::string sweeps = "sweep" + std::to_string(t) + "_q";
    std::vector<std::vector<V>> iterates;
    std::vector<V> next, next_qd;
    oracle.step(t, q, qd, next, next_qd, &iterates);
    if (scene.file.contains(sweeps)) {
      const auto expected = scene.file[sweeps].as<V>();
      for (size_t k = 0; k < iterates.size(); ++k)
        EXPECT_TRUE(same_bits<V>(iterates[k], expected.subspan(k * q.size(), q.size())))
            << sweeps << ", iteration " << k;
      ++swept;
    }
    if (const auto expected = scene.q(t + 1); !expected.empty()) {
      EXPECT_TRUE(same_bits<V>(next, expected)) << "substep " << t;
      ++compared;
    }
    if (const std::string name = "qd_" + std::to_string(t + 1); scene.file.contains(name)) {
      EXPECT_TRUE(same_bits<V>(next_qd, scene.file[name].as<V>())) << name;
    }

    in.particle_q.copy_from_host(std::span<const V>(q));
    in.particle_qd.copy_from_host(std::span<const V>(qd));
    const Contacts contacts = scene.contacts(t);
    solver.step(in, out, nullptr, &contacts, scene.dt());
    EXPECT_LE(largest_distance(out.particle_q.to_host(), next), 1e-6f) << "substep " << t;
    EXPECT_LE(largest_distance(out.particle_qd.to_host(), next_qd), 1e-3f) << "substep " << t;
    if (HasFailure()) return;
    q = next;
    qd = next_qd;
  }
  EXPECT_EQ(swept, 3u);
  EXPECT_GT(compared, 75u);
}

INSTANTIATE_TEST_SUITE_P(Scenes, NewtonOracleRun,
                         ::testing::Values("newton_vbd_cloth.npz", "newton_vbd_soft.npz"));

}  // namespace
}  // namespace novaphy
