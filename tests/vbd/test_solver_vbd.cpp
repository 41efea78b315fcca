// The properties of SolverVBD besides agreement with Newton.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <utility>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/parallel.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/vbd/solver_vbd.h"
#include "support/bits.h"

namespace novaphy {
namespace {

using testing::same_bits;

constexpr float kDt = 1.0f / 120.0f;

struct EndState {
  std::vector<Vec3f> q, qd;
};

// Steps from the model's initial state. If the model has shapes, every step finds new contacts.
EndState end_of(const std::shared_ptr<Model>& model, int steps, const VbdOptions& options = {},
                float dt = kDt) {
  SolverVBD solver(model, options);
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  SimState a = model->state(), b = model->state();
  for (int i = 0; i < steps; ++i) {
    if (model->shape_count() > 0) pipeline.collide(a, contacts);
    solver.step(a, b, nullptr, model->shape_count() > 0 ? &contacts : nullptr, dt);
    std::swap(a, b);
  }
  return {a.particle_q.to_host(), a.particle_qd.to_host()};
}

ModelBuilder hanging_cloth(int size = 12) {
  ModelBuilder b;
  b.add_cloth_grid({.placement = {.pos = {0.0f, 0.0f, 1.0f}},
                    .dim_x = size,
                    .dim_y = size,
                    .cell_x = 0.05,
                    .cell_y = 0.05,
                    .mass = 0.002f,
                    .fix_left = true,
                    .tri = {.ke = 500.0f, .ka = 500.0f, .kd = 1e-3f},
                    .edge = {.ke = 1e-2f, .kd = 1e-4f},
                    .particle_radius = 0.01f});
  return b;
}

ModelBuilder block(int size, float k_damp = 0.0f) {
  ModelBuilder b;
  b.add_soft_grid({.placement = {.pos = {0.0f, 0.0f, 1.0f}},
                   .dim_x = size,
                   .dim_y = size,
                   .dim_z = size,
                   .density = 1000.0,
                   .k_mu = 2e4f,
                   .k_lambda = 5e4f,
                   .k_damp = k_damp});
  return b;
}

// Returns the energy that a step minimizes, in double precision, for undamped tetrahedra (J).
double step_energy(const Model& m, const SimState& from, std::span<const Vec3f> x, float dt) {
  const auto q = from.particle_q.to_host(), qd = from.particle_qd.to_host();
  const auto mass = m.particle_mass.to_host();
  const Vec3f g = m.gravity.to_host()[0];
  double energy = 0.0;
  const auto square = [](double a) { return a * a; };
  const double h = dt;
  const float* xs = &x[0].x;
  for (size_t i = 0; i < 3 * x.size(); ++i) {
    const double start = (&q[0].x)[i], v = (&qd[0].x)[i], a = (&g.x)[i % 3];
    if (mass[i / 3] > 0.0f)
      energy += mass[i / 3] / (2 * h * h) * square(xs[i] - (start + h * v + h * h * a));
  }
  const auto tets = m.particle_tet_indices.to_host();
  const auto pose = m.particle_tet_pose.to_host();
  const auto material = m.particle_tet_material.to_host();
  for (size_t e = 0; e < tets.size(); ++e) {
    const int32_t id[4] = {tets[e].x, tets[e].y, tets[e].z, tets[e].w};
    double f[3][3] = {}, det_pose = 0.0;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        for (int k = 0; k < 3; ++k)
          f[i][j] +=
              (static_cast<double>(xs[3 * id[k + 1] + i]) - xs[3 * id[0] + i]) * pose[e].m[k][j];
    const auto det = [](const auto& a) {
      return static_cast<double>(a[0][0]) *
                 (static_cast<double>(a[1][1]) * a[2][2] - a[1][2] * static_cast<double>(a[2][1])) -
             static_cast<double>(a[0][1]) *
                 (static_cast<double>(a[1][0]) * a[2][2] - a[1][2] * static_cast<double>(a[2][0])) +
             static_cast<double>(a[0][2]) *
                 (static_cast<double>(a[1][0]) * a[2][1] - a[1][1] * static_cast<double>(a[2][0]));
    };
    det_pose = det(pose[e].m);
    double trace = 0.0;
    for (const auto& row : f)
      for (const double value : row) trace += value * value;
    const double mu = material[3 * e], ln = mu + material[3 * e + 1];
    energy +=
        1.0 / (6.0 * det_pose) * (mu / 2 * (trace - 3) + ln / 2 * square(det(f) - (1 + mu / ln)));
  }
  return energy;
}

TEST(SolverVbd, WithoutForcesOfElementsAParticleFallsAndKeepsItsVelocity) {
  ModelBuilder b;
  b.add_particle({0.0f, 0.0f, 10.0f}, {1.0f, 0.0f, 0.0f}, 2.0f);
  b.color();
  const auto model = b.finalize(Device::cpu());
  SolverVBD solver(model);
  SimState in = model->state(), out = model->state();
  in.particle_f.fill({0.0f, 4.0f, 0.0f});
  solver.step(in, out, nullptr, nullptr, 0.1f);
  const Vec3f v = out.particle_qd.to_host()[0];
  EXPECT_NEAR(v.x, 1.0f, 1e-5f);
  EXPECT_NEAR(v.y, 0.2f, 1e-5f);
  EXPECT_NEAR(v.z, -0.981f, 2e-5f);
  EXPECT_EQ(in.particle_f.to_host()[0], (Vec3f{0.0f, 4.0f, 0.0f}));
  EXPECT_EQ(in.particle_q.to_host()[0], (Vec3f{0.0f, 0.0f, 10.0f}));
}

TEST(SolverVbd, AnyNumberOfThreadsGivesTheSameBits) {
  ModelBuilder b = hanging_cloth(24);
  b.add_shape_sphere(-1, {.xform = {{0.6f, 0.6f, 0.8f}, Quatf::identity()}, .radius = 0.25f});
  b.color();
  const auto model = b.finalize(Device::cpu());
  const int before = num_threads();
  set_num_threads(1);
  const EndState one = end_of(model, 40);
  for (const int threads : {2, 7}) {
    set_num_threads(threads);
    const EndState many = end_of(model, 40);
    EXPECT_TRUE(same_bits<Vec3f>(many.q, one.q)) << threads;
    EXPECT_TRUE(same_bits<Vec3f>(many.qd, one.qd)) << threads;
  }
  set_num_threads(before);
}

// Groups of 4, 8 and 16 particles, as this processor supports.
TEST(SolverVbd, AnyInstructionSetGivesTheSameBits) {
  ModelBuilder b = hanging_cloth(10);
  b.add_soft_grid({.placement = {.pos = {0.1f, 0.1f, 0.2f}},
                   .dim_x = 3,
                   .dim_y = 2,
                   .dim_z = 2,
                   .k_damp = 1.0f,
                   .particle_radius = 0.01f});
  b.add_spring(121, 130, 100.0f, 0.1f);
  b.add_ground_plane({.height = 0.19f});
  b.color();
  const auto model = b.finalize(Device::cpu());
  std::vector<EndState> runs;
  for (const char* level : {"baseline", "avx2", "avx512"}) {
    setenv("NOVAPHY_CPU_ISA", level, 1);
    try {
      runs.push_back(end_of(model, 20));
    } catch (const Error& error) {
      EXPECT_NE(std::string_view(error.what()).find("does not have it"), std::string_view::npos);
    }
  }
  setenv("NOVAPHY_CPU_ISA", "mmx", 1);
  EXPECT_ERROR(SolverVBD{model}, ErrorKind::Runtime, "got 'mmx'");
  unsetenv("NOVAPHY_CPU_ISA");
  if (runs.size() < 2) GTEST_SKIP() << "this processor has one instruction set only";
  for (const EndState& other : runs) {
    EXPECT_TRUE(same_bits<Vec3f>(other.q, runs[0].q));
    EXPECT_TRUE(same_bits<Vec3f>(other.qd, runs[0].qd));
  }
}

TEST(SolverVbd, TheEnergyOfUndampedTetrahedraFallsInEverySweep) {
  ModelBuilder b = block(4);
  for (Vec3f& q : b.particle_q) q = {q.x * 1.3f, q.y * 0.8f, q.z + 0.2f * q.x * q.x};
  b.color();
  const auto model = b.finalize(Device::cpu());
  SimState in = model->state(), out = model->state();
  double last = std::numeric_limits<double>::infinity();
  for (int k = 0; k <= 12; ++k) {
    SolverVBD(model, {.iterations = k}).step(in, out, nullptr, nullptr, kDt);
    const double energy = step_energy(*model, in, out.particle_q.to_host(), kDt);
    EXPECT_LT(energy, last + 1e-6 * std::abs(last)) << k;
    last = energy;
  }
}

// In a step of the files' soft scene the residual falls by a factor of about 0.3 per sweep.
TEST(SolverVbd, TheResidualFallsToItsFloor) {
  ModelBuilder b = block(4, 2.0f);
  for (Vec3f& q : b.particle_q) q = {q.x * 1.1f, q.y * 0.95f, q.z};
  b.color();
  const auto model = b.finalize(Device::cpu());
  SimState in = model->state(), out = model->state();
  std::vector<double> relative;
  for (const int k : {0, 5, 10, 20, 40}) {
    SolverVBD solver(model, {.iterations = k});
    EXPECT_ERROR(solver.residual(), ErrorKind::Runtime, "expected a step");
    solver.step(in, out, nullptr, nullptr, kDt);
    const VbdResidual r = solver.residual();
    EXPECT_EQ(r.iterations, k);
    EXPECT_GT(r.floor, 0.0);
    relative.push_back(r.relative);
    if (k == 40) {
      EXPECT_LT(r.relative, 10 * r.floor);
    }
  }
  for (size_t i = 1; i < 3; ++i) EXPECT_LT(relative[i], 0.2 * relative[i - 1]) << i;

  SolverVBD solver(model, {.iterations = 100, .tolerance = 1e-3f});
  solver.step(in, out, nullptr, nullptr, kDt);
  EXPECT_LE(solver.residual().relative, 1e-3);
  EXPECT_LT(solver.residual().iterations, 20);
}

// The end of a spring at its rest length moves sideways. The first sweep raises the energy, because
// a spring has no curvature across its line. The safeguard prevents the rise.
TEST(SolverVbd, TheSafeguardKeepsTheEnergyOfASpringFromRising) {
  ModelBuilder b(Axis::Z, Vec3f{});
  b.add_particle({}, {}, 0.0f);
  b.add_particle({1.0f, 0.0f, 0.0f}, {0.0f, 60.0f, 0.0f}, 1.0f);
  b.add_spring(0, 1, 1e6f, 0.0f);
  b.color();
  const auto model = b.finalize(Device::cpu());
  SimState in = model->state(), out = model->state();
  const auto energy = [&](int k, bool safeguard) {
    SolverVBD(model, {.iterations = k, .safeguard = safeguard})
        .step(in, out, nullptr, nullptr, 1.0f / 60.0f);
    const Vec3f x = out.particle_q.to_host()[1];
    const double stretch = static_cast<double>(math::length(x)) - 1.0;
    const Vec3f d = x - Vec3f{1.0f, 1.0f, 0.0f};
    return 0.5 * 3600.0 * static_cast<double>(math::dot(d, d)) + 0.5 * 1e6 * stretch * stretch;
  };
  double last = energy(0, true);
  for (int k = 1; k <= 20; ++k) {
    const double now = energy(k, true);
    EXPECT_LE(now, last * (1 + 1e-5)) << k;
    last = now;
  }
  EXPECT_LT(energy(10, false), energy(0, false));
  EXPECT_LT(energy(10, true), 0.1 * energy(0, true));
}

TEST(SolverVbd, InvertedAndFlatTetrahedraRecover) {
  for (const float z : {-0.5f, 0.0f}) {
    ModelBuilder b = block(3);
    b.gravity = {};
    for (Vec3f& q : b.particle_q) q = {q.x, q.y, 1.0f + z * (q.z - 1.0f)};
    b.color();
    const auto model = b.finalize(Device::cpu());
    const auto volume = [&](std::span<const Vec3f> q) {
      double least = 1e9;
      for (const Vec4i& t : model->particle_tet_indices.to_host()) {
        const auto at = [&](int32_t p) { return q[static_cast<size_t>(p)]; };
        least = std::min(
            least, static_cast<double>(math::dot(
                       at(t.y) - at(t.x), math::cross(at(t.z) - at(t.x), at(t.w) - at(t.x)))));
      }
      return least * 1e3;
    };
    EXPECT_LE(volume(model->particle_q.to_host()), 1e-6);
    const EndState after = end_of(model, 240, {.iterations = 20});
    EXPECT_GT(volume(after.q), 0.3) << "from " << z;
  }
}

// The bar is far stiffer than the step resolves, and its fixed ends twist it.
TEST(SolverVbd, AStiffBarIsTwistedByTheTargetsOfItsEnds) {
  ModelBuilder b;
  b.gravity = {};
  b.add_soft_grid({.placement = {},
                   .dim_x = 12,
                   .dim_y = 2,
                   .dim_z = 2,
                   .density = 1000.0,
                   .k_mu = 1e8f,
                   .k_lambda = 1e8f,
                   .fix_left = true,
                   .fix_right = true});
  b.color();
  const auto model = b.finalize(Device::cpu());
  SolverVBD solver(model, {.iterations = 20});
  ASSERT_EQ(solver.kinematic_count(), 18);
  const auto rest = model->particle_q.to_host();
  std::vector<size_t> held;
  for (size_t p = 0; p < rest.size(); ++p)
    if (model->particle_mass.to_host()[p] == 0.0f) held.push_back(p);
  SimState a = model->state(), c = model->state();
  DeviceArray<Vec3f> targets(held.size(), Device::cpu());
  for (int i = 1; i <= 60; ++i) {
    const float angle = 0.02f * static_cast<float>(i);
    std::vector<Vec3f> to;
    for (const size_t p : held) {
      const float turn = rest[p].x > 0.5f ? angle : -angle;
      const float y = rest[p].y - 0.1f, z = rest[p].z - 0.1f;
      to.push_back({rest[p].x, 0.1f + std::cos(turn) * y - std::sin(turn) * z,
                    0.1f + std::sin(turn) * y + std::cos(turn) * z});
    }
    targets.copy_from_host(std::span<const Vec3f>(to));
    solver.step(a, c, nullptr, nullptr, kDt, &targets);
    const auto q = c.particle_q.to_host(), qd = c.particle_qd.to_host();
    for (size_t k = 0; k < held.size(); ++k) EXPECT_EQ(q[held[k]], to[k]);
    if (i == 60) {
      // The middle does not rotate. A quarter of the length from an end rotates by half of the
      // end's angle.
      const Vec3f middle = q[6], quarter = q[9];
      EXPECT_NEAR(std::atan2(middle.z - 0.1f, middle.y - 0.1f), std::atan2(-0.1f, -0.1f), 0.05f);
      EXPECT_NEAR(std::atan2(quarter.z - 0.1f, quarter.y - 0.1f),
                  std::atan2(-0.1f, -0.1f) + 0.5f * angle, 0.1f);
      for (const Vec3f& v : qd) EXPECT_LT(math::length(v), 2.0f);
    }
    std::swap(a, c);
  }
  solver.step(a, c, nullptr, nullptr, kDt);
  EXPECT_EQ(c.particle_qd.to_host()[held[0]], Vec3f{});  // without targets they stay
  const DeviceArray<Vec3f> wrong(3, Device::cpu());
  EXPECT_ERROR(solver.step(a, c, nullptr, nullptr, kDt, &wrong), ErrorKind::Value, "targets");
}

// If the coloring leaves out a spring, each end moves as if the other end were fixed. With a
// stiffness above that of the inertia the step does not converge. The coloring here includes the
// spring.
TEST(SolverVbd, ASpringBetweenEqualColorsDoesNotConverge) {
  const auto residual = [](bool conflicts) {
    ModelBuilder b(Axis::Z, Vec3f{});
    b.add_particle({}, {}, 1.0f);
    b.add_particle({1.0f, 0.0f, 0.0f}, {1.0f, 0.0f, 0.0f}, 1.0f);
    b.add_spring(0, 1, 1e6f, 0.0f);
    if (conflicts) {
      b.set_coloring(std::vector<std::vector<int32_t>>{{0, 1}}, true);
    } else {
      b.color();
    }
    const auto model = b.finalize(Device::cpu());
    SolverVBD solver(model, {.iterations = 40});
    SimState in = model->state(), out = model->state();
    solver.step(in, out, nullptr, nullptr, kDt);
    return solver.residual().force;
  };
  EXPECT_GT(residual(true), 10 * residual(false));
}

TEST(SolverVbd, HingesThatAreLeftOutOfTheColoringConvergeWorse) {
  const auto residual = [](std::optional<bool> bending) {
    ModelBuilder b;
    b.add_cloth_grid({.dim_x = 12,
                      .dim_y = 12,
                      .cell_x = 0.05,
                      .cell_y = 0.05,
                      .mass = 0.002f,
                      .fix_left = true,
                      .tri = {.ke = 10.0f, .ka = 10.0f, .kd = 0.0f},
                      .edge = {.ke = 10.0f, .kd = 0.0f}});
    for (size_t p = 0; p < b.particle_q.size(); ++p)
      b.particle_q[p].z += 0.01f * static_cast<float>(p % 3);
    b.color({.include_bending = bending});
    const auto model = b.finalize(Device::cpu());
    SolverVBD solver(model, {.iterations = 20});
    SimState in = model->state(), out = model->state();
    solver.step(in, out, nullptr, nullptr, kDt);
    return solver.residual().relative;
  };
  EXPECT_GT(residual(false), 2 * residual({}));
}

TEST(SolverVbd, InitialGuessesAndAccelerationConvergeToOneSolution) {
  ModelBuilder b = block(3, 1.0f);
  for (Vec3f& q : b.particle_q) q = {q.x * 1.1f, q.y, q.z};
  b.color();
  const auto model = b.finalize(Device::cpu());
  const auto last = [&](const VbdOptions& options) { return end_of(model, 3, options).q; };
  const auto expected = last({.iterations = 80});
  for (const VbdOptions& options :
       {VbdOptions{.iterations = 80, .initial_guess = VbdInitialGuess::Previous},
        VbdOptions{.iterations = 80, .initial_guess = VbdInitialGuess::Adaptive},
        VbdOptions{.iterations = 60, .acceleration = 0.5f}}) {
    const auto q = last(options);
    for (size_t p = 0; p < q.size(); ++p) EXPECT_LT(math::length(q[p] - expected[p]), 2e-6f) << p;
  }
}

TEST(SolverVbd, ABlockComesToRestOnTheGround) {
  ModelBuilder b = block(3, 10.0f);
  for (Vec3f& q : b.particle_q) q.z -= 0.95f;
  b.add_ground_plane();
  b.color();
  const EndState after = end_of(b.finalize(Device::cpu()), 360, {.iterations = 30});
  for (const Vec3f& v : after.qd) EXPECT_LT(math::length(v), 0.02f);
  float lowest = 1.0f;
  for (const Vec3f& q : after.q) lowest = std::min(lowest, q.z);
  EXPECT_GT(lowest, 0.0f);
}

TEST(SolverVbd, ActivationsChangeTheRestVolumeAndArea) {
  ModelBuilder b = block(2);
  b.gravity = {};
  b.color();
  const auto model = b.finalize(Device::cpu());
  SolverVBD solver(model, {.iterations = 40});
  Control control = model->control();
  control.particle_tet_activation.fill(-0.3f);  // larger at rest
  SimState in = model->state(), out = model->state();
  solver.step(in, out, &control, nullptr, kDt);
  const auto wide = out.particle_q.to_host();
  EXPECT_GT(math::length(wide.back() - wide.front()),
            math::length(in.particle_q.to_host().back() - in.particle_q.to_host().front()) + 1e-4f);
  solver.step(in, out, nullptr, nullptr, kDt);  // the model's own: none
  EXPECT_NEAR(out.particle_q.to_host().back().x, in.particle_q.to_host().back().x, 1e-6f);
}

TEST(SolverVbd, EditedMaterialsActAndEditedMeshesAreRefused) {
  ModelBuilder b = hanging_cloth();
  b.color();
  const auto model = b.finalize(Device::cpu());
  SolverVBD solver(model);
  SimState in = model->state(), out = model->state();
  solver.step(in, out, nullptr, nullptr, kDt);
  const auto soft = out.particle_q.to_host();
  auto material = model->particle_edge_material.to_host();
  for (float& value : material) value *= 100.0f;
  model->particle_edge_material.copy_from_host(std::span<const float>(material));
  solver.step(in, out, nullptr, nullptr, kDt);
  SimState fresh = model->state();
  SolverVBD(model).step(in, fresh, nullptr, nullptr, kDt);
  EXPECT_TRUE(same_bits<Vec3f>(out.particle_q.to_host(), fresh.particle_q.to_host()));

  material[0] = -1.0f;
  model->particle_edge_material.copy_from_host(std::span<const float>(material));
  EXPECT_ERROR(solver.step(in, out, nullptr, nullptr, kDt), ErrorKind::Value,
               "particle_edge_material[0]");
  material[0] = std::numeric_limits<float>::quiet_NaN();
  model->particle_edge_material.copy_from_host(std::span<const float>(material));
  EXPECT_ERROR(SolverVBD{model}, ErrorKind::Value, "particle_edge_material[0]");
  material[0] = 1.0f;
  model->particle_edge_material.copy_from_host(std::span<const float>(material));
  auto indices = model->particle_tri_indices.to_host();
  std::swap(indices[0].x, indices[0].y);
  model->particle_tri_indices.copy_from_host(std::span<const Vec3i>(indices));
  EXPECT_ERROR(solver.step(in, out, nullptr, nullptr, kDt), ErrorKind::Value,
               "particle_tri_indices: it was edited");
}

TEST(SolverVbd, BadOptionsAndUncoveredPartsAreRefusedByName) {
  ModelBuilder b = hanging_cloth();
  b.color();
  const auto model = b.finalize(Device::cpu());
  EXPECT_ERROR(SolverVBD(nullptr), ErrorKind::Value, "model");
  EXPECT_ERROR(SolverVBD(model, {.iterations = -1}), ErrorKind::Value, "iterations");
  EXPECT_ERROR(SolverVBD(model, {.friction_epsilon = 0.0f}), ErrorKind::Value, "friction_epsilon");
  EXPECT_ERROR(SolverVBD(model, {.acceleration = 1.0f}), ErrorKind::Value, "acceleration");
  EXPECT_ERROR(SolverVBD(model, {.tolerance = 0.0f}), ErrorKind::Value, "tolerance");
  EXPECT_ERROR(SolverVBD(model, {.acceleration = 0.5f, .safeguard = true}), ErrorKind::Value,
               "safeguard");
  EXPECT_ERROR(SolverVBD(model, {.lhs_regularization = -1.0f}), ErrorKind::Value,
               "lhs_regularization");

  SolverVBD solver(model);
  SimState in = model->state(), out = model->state();
  EXPECT_ERROR(solver.step(in, out, nullptr, nullptr, 0.0f), ErrorKind::Value, "dt");
  model->particle_adhesion = 0.1f;
  EXPECT_ERROR(solver.step(in, out, nullptr, nullptr, kDt), ErrorKind::NotImplemented,
               "particle_adhesion");
  model->particle_adhesion = 0.0f;
  model->particle_max_velocity = 10.0f;
  EXPECT_ERROR(solver.step(in, out, nullptr, nullptr, kDt), ErrorKind::NotImplemented,
               "particle_max_velocity");

  ModelBuilder drag = hanging_cloth();
  drag.add_triangle(0, 1, 14, {.drag = 1.0f});
  drag.color();
  EXPECT_ERROR(SolverVBD(drag.finalize(Device::cpu())), ErrorKind::NotImplemented, "drag");
}

TEST(SolverVbd, ContactsOfOthersAndOverflowingOnesAreRefused) {
  ModelBuilder b = hanging_cloth();
  b.add_ground_plane({.height = 1.0f});
  b.color();
  const auto model = b.finalize(Device::cpu()), other = b.finalize(Device::cpu());
  SolverVBD solver(model);
  SimState in = model->state(), out = model->state();
  Contacts foreign = CollisionPipeline(other).contacts();
  EXPECT_ERROR(solver.step(in, out, nullptr, &foreign, kDt), ErrorKind::Value, "another model");
  CollisionPipeline pipeline(model, {.soft_contact_max = 3});
  Contacts contacts = pipeline.contacts();
  pipeline.collide(in, contacts);
  ASSERT_TRUE(contacts.overflowed());
  EXPECT_ERROR(solver.step(in, out, nullptr, &contacts, kDt), ErrorKind::Runtime, "slots for 3");
}

TEST(SolverVbd, BadMaterialsOfShapesAreRefusedByName) {
  for (const float bad : {-1.0f, std::numeric_limits<float>::quiet_NaN()})
    for (const char* name : {"shape_material_ke", "shape_material_kd", "shape_material_mu"}) {
      ModelBuilder b;
      b.add_particle({0.0f, 0.0f, 0.0f}, {}, 1.0f, 0.1f);
      b.add_ground_plane();
      b.color();
      const auto model = b.finalize(Device::cpu());
      CollisionPipeline pipeline(model);
      Contacts contacts = pipeline.contacts();
      SimState in = model->state(), out = model->state();
      pipeline.collide(in, contacts);
      DeviceArray<float> array = std::string_view(name).ends_with("ke") ? model->shape_material_ke
                                 : std::string_view(name).ends_with("kd")
                                     ? model->shape_material_kd
                                     : model->shape_material_mu;
      SolverVBD solver(model);
      array.fill(bad);
      EXPECT_ERROR(solver.step(in, out, nullptr, &contacts, kDt), ErrorKind::Value, name);
      EXPECT_ERROR(SolverVBD{model}, ErrorKind::Value, name);
    }
}

TEST(SolverVbd, ResetForgetsTheLastVelocity) {
  ModelBuilder b = hanging_cloth();
  b.color();
  const auto model = b.finalize(Device::cpu());
  const VbdOptions options{.iterations = 2, .initial_guess = VbdInitialGuess::Adaptive};
  SolverVBD solver(model, options);
  SimState start = model->state(), first = model->state(), second = model->state();
  solver.step(start, first, nullptr, nullptr, kDt);
  solver.step(first, second, nullptr, nullptr, kDt);
  SimState again = model->state();
  SolverVBD(model, options).step(first, again, nullptr, nullptr, kDt);
  EXPECT_FALSE(same_bits<Vec3f>(again.particle_q.to_host(), second.particle_q.to_host()));
  solver.reset();
  solver.step(first, second, nullptr, nullptr, kDt);
  EXPECT_TRUE(same_bits<Vec3f>(again.particle_q.to_host(), second.particle_q.to_host()));
}

}  // namespace
}  // namespace novaphy
