// Properties of element forces that do not depend on the formula: conservation of momentum,
// invariance under rotations, energy loss by damping, and closed forms.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "novaphy/core/parallel.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "support/bits.h"

namespace novaphy {
namespace {

using Vec3d = Vec3<double>;
Vec3d exact(const Vec3f& a) {
  return {static_cast<double>(a.x), static_cast<double>(a.y), static_cast<double>(a.z)};
}
double norm(const Vec3d& a) { return std::sqrt(math::dot(a, a)); }

// One kind of element at a time, without external forces (drag, lift).
enum class Kind { Springs, Triangles, Edges, Tetrahedra };
std::shared_ptr<Model> make_model(Kind kind, float damping, float gravity = 0.0f) {
  ModelBuilder builder(Axis::Z, gravity);
  const bool is_tet = kind == Kind::Tetrahedra;
  if (is_tet) {
    builder.add_soft_grid({.dim_x = 2,
                           .dim_y = 2,
                           .dim_z = 1,
                           .cell_x = 0.5,
                           .cell_y = 0.4,
                           .cell_z = 0.6,
                           .density = 40.0,
                           .k_mu = 1e3f,
                           .k_lambda = 2e3f,
                           .k_damp = damping,
                           .add_surface_mesh_edges = false});
  } else {
    const auto only = [&](Kind k, float value) { return kind == k ? value : 0.0f; };
    builder.add_cloth_grid({.dim_x = 3,
                            .dim_y = 3,
                            .cell_x = 0.3,
                            .cell_y = 0.4,
                            .mass = 0.1f,
                            .tri = {only(Kind::Triangles, 1e2f), only(Kind::Triangles, 2e2f),
                                    only(Kind::Triangles, damping), 0.0f, 0.0f},
                            .edge = {only(Kind::Edges, 5.0f), only(Kind::Edges, damping)},
                            .add_springs = true,
                            .spring_ke = only(Kind::Springs, 50.0f),
                            .spring_kd = only(Kind::Springs, damping)});
  }
  return builder.finalize(Device::cpu());
}

std::vector<Vec3f> disturbed(const Model& model, float amount) {
  std::vector<Vec3f> q = model.particle_q.to_host();
  std::mt19937 random(5);
  std::uniform_real_distribution<float> u(-amount, amount);
  for (Vec3f& x : q) x = x + Vec3f{u(random), u(random), u(random)};
  return q;
}

std::vector<Vec3f> forces(const std::shared_ptr<Model>& model, const std::vector<Vec3f>& q,
                          const std::vector<Vec3f>& qd) {
  SimState state = model->state(), next = model->state();
  state.particle_q.copy_from_host(std::span<const Vec3f>(q));
  state.particle_qd.copy_from_host(std::span<const Vec3f>(qd));
  SolverSemiImplicit solver(model);
  solver.step(state, next, nullptr, nullptr, 1e-4f);
  return state.particle_f.to_host();
}

class EveryKind : public ::testing::TestWithParam<Kind> {};
INSTANTIATE_TEST_SUITE_P(Elements, EveryKind,
                         ::testing::Values(Kind::Springs, Kind::Triangles, Kind::Edges,
                                           Kind::Tetrahedra));

// Sums of forces and of moments, relative to the sums of their magnitudes.
TEST_P(EveryKind, InternalForcesConserveMomentum) {
  const auto model = make_model(GetParam(), 0.0f);
  const std::vector<Vec3f> q = disturbed(*model, 0.05f);
  const std::vector<Vec3f> f = forces(model, q, std::vector<Vec3f>(q.size()));
  Vec3d total{}, moment{};
  double size = 0.0, moments = 0.0;
  for (size_t p = 0; p < q.size(); ++p) {
    total = total + exact(f[p]);
    moment = moment + math::cross(exact(q[p]), exact(f[p]));
    size += norm(exact(f[p]));
    moments += norm(exact(q[p])) * norm(exact(f[p]));
  }
  EXPECT_GT(size, 0.1);
  EXPECT_LT(norm(total), 1e-6 * size);
  // The law of bending conserves the moment only where both triangles are of one height.
  if (GetParam() != Kind::Edges) {
    EXPECT_LT(norm(moment), 2e-6 * moments);
  }
}

TEST(Bending, AHingeOfEqualHeightsConservesTheMoment) {
  ModelBuilder builder(Axis::Z, 0.0f);
  for (const Vec3f& x : {Vec3f{-0.8f, 0.3f, 0.1f}, Vec3f{0.8f, 0.6f, 0.0f}, Vec3f{0.0f, 0.0f, 0.0f},
                         Vec3f{0.0f, 1.0f, 0.0f}})
    builder.add_particle(x, {}, 1.0f);
  builder.add_edge(0, 1, 2, 3, 0.0f, EdgeMaterial{4.0f, 0.0f});
  const auto model = builder.finalize(Device::cpu());
  std::vector<Vec3f> q = model->particle_q.to_host();
  q[0] = {-0.8f * std::cos(0.7f), 0.3f, 0.8f * std::sin(0.7f)};
  const std::vector<Vec3f> f = forces(model, q, std::vector<Vec3f>(4));
  Vec3d moment{};
  double size = 0.0;
  for (size_t p = 0; p < 4; ++p) {
    moment = moment + math::cross(exact(q[p]), exact(f[p]));
    size += norm(exact(q[p])) * norm(exact(f[p]));
  }
  EXPECT_GT(size, 0.1);
  EXPECT_LT(norm(moment), 1e-6 * size);
}

TEST_P(EveryKind, ForcesTurnWithTheBody) {
  const auto model = make_model(GetParam(), 0.0f);
  const std::vector<Vec3f> q = disturbed(*model, 0.05f), rest(q.size());
  const float s = std::sin(0.6f) / std::sqrt(3.0f);
  const Quatf turn = {s, -s, s, std::cos(0.6f)};
  std::vector<Vec3f> turned = q;
  for (Vec3f& x : turned) x = math::rotate(turn, x);
  const std::vector<Vec3f> f = forces(model, q, rest), g = forces(model, turned, rest);
  double error = 0.0, size = 0.0;
  for (size_t p = 0; p < q.size(); ++p) {
    error += norm(exact(math::rotate(turn, f[p])) - exact(g[p]));
    size += norm(exact(f[p]));
  }
  EXPECT_GT(size, 0.1);
  EXPECT_LT(error, 1e-4 * size);
}

TEST_P(EveryKind, AtRestThereIsNoForce) {
  const auto model = make_model(GetParam(), 0.3f);
  const std::vector<Vec3f> q = model->particle_q.to_host();
  const std::vector<Vec3f> f = forces(model, q, std::vector<Vec3f>(q.size()));
  const std::vector<Vec3f> strained = forces(model, disturbed(*model, 0.05f), q);
  double at_rest = 0.0, size = 0.0;
  for (size_t p = 0; p < q.size(); ++p) {
    at_rest += norm(exact(f[p]));
    size += norm(exact(strained[p]));
  }
  EXPECT_LT(at_rest, 1e-5 * size);
}

// Returns the kinetic energy of a disturbed body after some steps (J). Most of it remains without
// damping, little with damping.
double kinetic_energy_after(Kind kind, float damping, int steps) {
  const auto model = make_model(kind, damping);
  SimState a = model->state(), b = model->state();
  const std::vector<Vec3f> q = disturbed(*model, 0.02f);
  a.particle_q.copy_from_host(std::span<const Vec3f>(q));
  SolverSemiImplicit solver(model);
  const std::vector<float> mass = model->particle_mass.to_host();
  double sum = 0.0;  // mean over the last half, because the energy oscillates
  for (int t = 0; t < steps; ++t) {
    a.clear_forces();
    solver.step(a, b, nullptr, nullptr, 5e-4f);
    std::swap(a, b);
    if (t < steps / 2) continue;
    const std::vector<Vec3f> v = a.particle_qd.to_host();
    for (size_t p = 0; p < v.size(); ++p)
      sum += 0.5 * static_cast<double>(mass[p]) * math::dot(exact(v[p]), exact(v[p]));
  }
  return sum / (steps - steps / 2);
}
TEST_P(EveryKind, DampingTakesEnergyOutAndNothingElseDoes) {
  const double start = kinetic_energy_after(GetParam(), 0.0f, 400);
  EXPECT_GT(start, 1e-8);
  EXPECT_GT(kinetic_energy_after(GetParam(), 0.0f, 4000), 0.3 * start);
  EXPECT_LT(kinetic_energy_after(GetParam(), 0.0f, 4000), 3.0 * start);
  const float damping = GetParam() == Kind::Tetrahedra ? 20.0f : 2.0f;
  EXPECT_LT(kinetic_energy_after(GetParam(), damping, 4000), 0.2 * start);
}

// Spring k of a hanging chain carries the weights below it. Its extension is their sum over ke.
TEST(Springs, AHangingChainHasTheLengthOfTheClosedForm) {
  constexpr int kLinks = 5;
  constexpr float kKe = 400.0f, kMass = 0.2f, kRest = 0.3f;
  ModelBuilder builder;
  for (int k = 0; k <= kLinks; ++k)
    builder.add_particle({0.0f, 0.0f, -kRest * static_cast<float>(k)}, {}, k == 0 ? 0.0f : kMass);
  for (int k = 0; k < kLinks; ++k) builder.add_spring(k, k + 1, kKe, 4.0f);
  const auto model = builder.finalize(Device::cpu());
  SimState a = model->state(), b = model->state();
  SolverSemiImplicit solver(model);
  for (int t = 0; t < 20000; ++t) {
    a.clear_forces();
    solver.step(a, b, nullptr, nullptr, 1e-3f);
    std::swap(a, b);
  }
  const std::vector<Vec3f> q = a.particle_q.to_host();
  for (int k = 0; k < kLinks; ++k) {
    const float weight = static_cast<float>(kLinks - k) * kMass * 9.81f;
    const float length = q[static_cast<size_t>(k)].z - q[static_cast<size_t>(k) + 1].z;
    EXPECT_NEAR(length, kRest + weight / kKe, 1e-5f) << k;
  }
}

// A damped oscillator: x(t) = x0 exp(-c t/2m) cos(w t) for one mass on a spring.
TEST(Springs, ADampedOscillatorDecaysAsTheClosedForm) {
  ModelBuilder builder(Axis::Z, 0.0f);
  builder.add_particle({}, {}, 0.0f);
  builder.add_particle({1.0f, 0.0f, 0.0f}, {}, 2.0f);
  builder.add_spring(0, 1, 50.0f, 0.8f);
  const auto model = builder.finalize(Device::cpu());
  SimState a = model->state(), b = model->state();
  const Vec3f start[] = {{}, {1.1f, 0.0f, 0.0f}};
  a.particle_q.copy_from_host(std::span<const Vec3f>(start));
  SolverSemiImplicit solver(model);
  constexpr float kDt = 1e-4f;
  const double gamma = 0.8 / (2.0 * 2.0), omega = std::sqrt(50.0 / 2.0 - gamma * gamma);
  for (int t = 1; t <= 40000; ++t) {
    a.clear_forces();
    solver.step(a, b, nullptr, nullptr, kDt);
    std::swap(a, b);
    if (t % 10000 != 0) continue;
    const double time = t * static_cast<double>(kDt);
    const double expected = 0.1 * std::exp(-gamma * time) *
                            (std::cos(omega * time) + gamma / omega * std::sin(omega * time));
    EXPECT_NEAR(static_cast<double>(a.particle_q.to_host()[1].x) - 1.0, expected, 2e-4) << time;
  }
}

// First Piola stress of the law along x at F = diag(a, b, b), in double.
struct Stress {
  double along, across;
};
Stress stress(double mu, double lambda, double a, double b) {
  const double trace = a * a + 2.0 * b * b, factor = mu * (1.0 - 1.0 / (trace + 1.0));
  const double pressure = lambda * (a * b * b - (1.0 + mu / lambda - mu / (4.0 * lambda)));
  return {factor * a + pressure * b * b, factor * b + pressure * a * b};
}

// A bar that is stretched evenly, with free sides: particles inside feel nothing, and the end faces
// the stress times the area. For a small stretch that is Young's modulus of the linearized law.
TEST(Tetrahedra, AStretchedBarHasTheForceOfTheClosedForm) {
  constexpr double kMu = 2e3, kLambda = 5e3;
  ModelBuilder builder(Axis::Z, 0.0f);
  builder.add_soft_grid({.dim_x = 6,
                         .dim_y = 2,
                         .dim_z = 2,
                         .cell_x = 0.25,
                         .cell_y = 0.2,
                         .cell_z = 0.2,
                         .k_mu = static_cast<float>(kMu),
                         .k_lambda = static_cast<float>(kLambda)});
  const auto model = builder.finalize(Device::cpu());
  const std::vector<Vec3f> rest = model->particle_q.to_host();
  for (const double stretch : {1.01, 1.3, 0.8}) {
    double low = 0.5, high = 1.5;  // the width at which the sides are free
    for (int k = 0; k < 60; ++k) {
      const double middle = 0.5 * (low + high);
      (stress(kMu, kLambda, stretch, middle).across > 0.0 ? high : low) = middle;
    }
    const double force = stress(kMu, kLambda, stretch, low).along * 0.4 * 0.4;
    std::vector<Vec3f> q = rest;
    for (Vec3f& x : q)
      x = {x.x * static_cast<float>(stretch), x.y * static_cast<float>(low),
           x.z * static_cast<float>(low)};
    const std::vector<Vec3f> f = forces(model, q, std::vector<Vec3f>(q.size()));
    double left = 0.0, right = 0.0, inside = 0.0;
    for (size_t p = 0; p < q.size(); ++p) {
      if (rest[p].x == 0.0f) {
        left += static_cast<double>(f[p].x);
      } else if (rest[p].x == 1.5f) {
        right += static_cast<double>(f[p].x);
      } else {
        inside = std::max(inside, norm(exact(f[p])));
      }
    }
    EXPECT_NEAR(left, force, 1e-3 * std::fabs(force)) << stretch;
    EXPECT_NEAR(right, -force, 1e-3 * std::fabs(force)) << stretch;
    EXPECT_LT(inside, 1e-3 * std::fabs(force)) << stretch;
    if (stretch == 1.01) {
      const double mu = 0.75 * kMu, lambda = kLambda - 0.625 * kMu;
      const double young = mu * (3.0 * lambda + 2.0 * mu) / (lambda + mu);
      EXPECT_NEAR(force, young * 0.01 * 0.16, 0.03 * force);
    }
  }
}

// A positive activation of the cells of a block makes their rest volume smaller: the block
// contracts.
TEST(Tetrahedra, ActivationsComeFromTheControl) {
  const auto model = make_model(Kind::Tetrahedra, 5.0f);
  SolverSemiImplicit solver(model);
  const auto volume_after = [&](float activation) {
    SimState a = model->state(), b = model->state();
    Control control = model->control();
    control.particle_tet_activation.fill(activation);
    for (int t = 0; t < 4000; ++t) {
      a.clear_forces();
      solver.step(a, b, &control, nullptr, 5e-4f);
      std::swap(a, b);
    }
    const std::vector<Vec3f> q = a.particle_q.to_host();
    double volume = 0.0;
    for (const Vec4i& t : model->particle_tet_indices.to_host()) {
      const auto x = [&](int32_t p) { return exact(q[static_cast<size_t>(p)]); };
      volume += math::dot(x(t.y) - x(t.x), math::cross(x(t.z) - x(t.x), x(t.w) - x(t.x))) / 6.0;
    }
    return volume;
  };
  const double rest = volume_after(0.0f);
  EXPECT_NEAR(rest, 0.48, 1e-3);
  EXPECT_LT(volume_after(0.2f), 0.9 * rest);
  EXPECT_GT(volume_after(-0.2f), 1.1 * rest);
}

TEST(Elements, ThreadsChangeNoBitAndEditedIndicesAreChecked) {
  const auto model = make_model(Kind::Tetrahedra, 1.0f, -9.81f);
  const auto run = [&](int threads) {
    const int before = num_threads();
    set_num_threads(threads);
    SimState a = model->state(), b = model->state();
    SolverSemiImplicit solver(model);
    for (int t = 0; t < 50; ++t) {
      a.clear_forces();
      solver.step(a, b, nullptr, nullptr, 1e-3f);
      std::swap(a, b);
    }
    set_num_threads(before);
    return a.particle_q.to_host();
  };
  const std::vector<Vec3f> one = run(1);
  for (const int threads : {2, 7})
    EXPECT_TRUE(testing::same_bits<Vec3f>(run(threads), one)) << threads;

  SolverSemiImplicit solver(model);
  SimState a = model->state(), b = model->state();
  solver.step(a, b, nullptr, nullptr, 1e-3f);
  std::vector<Vec4i> indices = model->particle_tet_indices.to_host();
  indices[3].z = 1000;
  model->particle_tet_indices.copy_from_host(std::span<const Vec4i>(indices));
  EXPECT_ERROR(solver.step(a, b, nullptr, nullptr, 1e-3f), ErrorKind::Index,
               "particle_tet_indices: entry 14");
}

}  // namespace
}  // namespace novaphy
