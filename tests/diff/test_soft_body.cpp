// The soft body of Newton's example in the differentiable solver: the same bits in every way of
// running, its gradients, and independence of threads and replay.
#include <gtest/gtest.h>

#include <cmath>
#include <utility>

#include "elements_scene.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/optim.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"
#include "support/npz.h"
#include "support/soft_body_scene.h"
#include "support/threads.h"

namespace novaphy::testing {
namespace {

using diff::DiffSemiImplicitSolver;
using diff::DiffSolverConfig;
using diff::Trajectory;
using nova::Tensor;

const DiffSolverConfig kStatic = {.enable_tetrahedra = true,
                                  .enable_triangles = true,
                                  .enable_static_contacts = true,
                                  .static_contact_margin = kSoftBodyGap};
const DiffSolverConfig kAll = {.enable_tetrahedra = true,
                               .enable_triangles = true,
                               .enable_springs = true,
                               .enable_bending = true};

Npz golden() { return Npz(std::string(NOVAPHY_GOLDEN_DIR) + "/newton_soft_body_strict.npz"); }

// The optimization of the example: rollout, loss, gradients.
struct SoftBody {
  std::shared_ptr<Model> model;
  DiffSemiImplicitSolver solver{model, kStatic};
  Trajectory trajectory;
  Tensor materials = diff::model_tet_material_tensor(*model);
  Tensor base = materials.clone(), params;

  explicit SoftBody(int steps = kSoftBodySteps, int cells = 2)
      : model(make_soft_body_model(cells)),
        trajectory(model, steps, false) {  // the materials alone are leaves
    std::vector<float> values;
    const std::vector<float> table = materials.to_host();
    for (size_t t = 0; t < table.size(); t += 3)
      values.insert(values.end(), {table[t], table[t + 1]});
    params = Tensor::from_host(std::span<const float>(values), {model->tet_count() * 2});
    params.set_requires_grad(true);
  }
  Tensor forward() {
    materials.copy_(diff::assign_tet_materials_generated(params, base, model->tet_count()));
    solver.rollout(trajectory, nullptr, nullptr, kSoftBodyDt);
    const Tensor last = diff::state_particle_q_tensor(trajectory.state(trajectory.steps()));
    return diff::vec3_point_loss_generated(diff::particle_centroid_generated(last),
                                           kSoftBodyTarget.x, kSoftBodyTarget.y, kSoftBodyTarget.z);
  }
  Tensor iterate(nova::KeepGradients keep = nova::KeepGradients::All) {
    nova::Tape tape(keep);
    const nova::TapeScope scope(tape);
    const Tensor loss = forward();
    tape.backward(loss);
    return loss;
  }
};

double relative_error(std::span<const float> actual, std::span<const float> expected) {
  EXPECT_EQ(actual.size(), expected.size());
  double error = 0.0, norm = 0.0;
  for (size_t k = 0; k < expected.size(); ++k) {
    error += std::pow(static_cast<double>(actual[k]) - static_cast<double>(expected[k]), 2);
    norm += std::pow(static_cast<double>(expected[k]), 2);
  }
  return std::sqrt(error / norm);
}

TEST(SoftBodyDiff, TheRolloutAndTheGradientsAreNewtons) {
  const Npz file = golden();
  SoftBody body;
  const Tensor q0 = diff::state_particle_q_tensor(body.trajectory.state(0), true);
  const Tensor qd0 = diff::state_particle_qd_tensor(body.trajectory.state(0), true);
  const Tensor loss = body.iterate();
  const auto frames = file["particle_q_frames"].as<Vec3f>();
  const size_t n = 27;
  for (size_t frame = 0; frame <= 60; ++frame) {
    const std::vector<Vec3f> q =
        body.trajectory.state(static_cast<int32_t>(frame) * kSoftBodySubsteps).particle_q.to_host();
    EXPECT_TRUE(same_bits(std::span<const Vec3f>(q), frames.subspan(frame * n, n))) << frame;
  }
  EXPECT_NEAR(loss.item(), file["loss"].scalar<float>(), 1e-6f);
  EXPECT_LT(relative_error(body.params.grad().to_host(), file["grad_ad"].as<float>()), 1e-4);
  EXPECT_LT(relative_error(q0.grad().to_host(), file["grad_q0"].as<float>()), 1e-4);
  EXPECT_LT(relative_error(qd0.grad().to_host(), file["grad_qd0"].as<float>()), 1e-4);
}

TEST(SoftBodyDiff, TheGradientIsThatOfDifferences) {
  SoftBody body;
  body.iterate();
  const std::vector<float> gradient = body.params.grad().to_host();
  std::vector<float> start = body.params.to_host();
  const nova::NoGrad no_grad;
  for (const size_t k : {size_t{0}, size_t{1}, size_t{40}, size_t{41}}) {
    float loss[2];
    for (const int side : {0, 1}) {
      std::vector<float> moved = start;
      moved[k] *= side == 0 ? 1.02f : 0.98f;
      body.params.copy_from_host(moved.data(), moved.size() * sizeof(float));
      loss[side] = body.forward().item();
    }
    const float quotient = (loss[0] - loss[1]) / (0.04f * start[k]);
    EXPECT_NEAR(gradient[k], quotient, 2e-2f * std::fabs(quotient)) << k;
  }
}

// The tape leaves out the gradient of the damping, because no parameter sets the damping.
TEST(SoftBodyDiff, ATapeThatKeepsLeavesOnlyGivesTheSameGradient) {
  SoftBody all(60), leaves(60);
  all.iterate();
  leaves.iterate(nova::KeepGradients::Leaves);
  const std::vector<float> expected = all.params.grad().to_host();
  EXPECT_TRUE(same_bits<float>(leaves.params.grad().to_host(), expected));
  const std::vector<nova::KernelInfo> used = nova::kernel_info();
  const auto adjoints = std::count_if(used.begin(), used.end(), [](const nova::KernelInfo& info) {
    return info.name == "tetrahedron_forces.adjoint";
  });
  EXPECT_GE(adjoints, 2);  // with and without the damping
}

// The gradient and the final positions of a scene that so many threads make and run.
template <class Make>
std::vector<float> outcome(const Make& make, int threads, bool replay) {
  const Threads scope(threads);
  auto scene = make();
  if (replay) {
    std::shared_ptr<nova::OpList> graph;
    {
      nova::ScopedCapture capture;
      scene.iterate();
      graph = capture.graph();
    }
    graph->prepare();
    graph->launch();
  } else {
    scene.iterate();
  }
  std::vector<float> result = scene.params.grad().to_host();
  const std::vector<Vec3f> q =
      scene.trajectory.state(scene.trajectory.steps()).particle_q.to_host();
  const auto* values = reinterpret_cast<const float*>(q.data());
  result.insert(result.end(), values, values + q.size() * 3);
  return result;
}

TEST(SoftBodyDiff, ThreadsAndReplayChangeNoBit) {
  // The first block reaches the ground. The second has so many elements that threads share its
  // replay.
  for (const auto& [steps, cells] : {std::pair{200, 2}, std::pair{60, 4}}) {
    const auto make = [steps = steps, cells = cells] { return SoftBody(steps, cells); };
    const std::vector<float> one = outcome(make, 1, false);
    double norm = 0.0;
    for (size_t k = 0; k < 80; ++k) norm += std::fabs(static_cast<double>(one[k]));
    EXPECT_GT(norm, 0.0);
    for (const int threads : {1, 2, 7})
      for (const bool replay : {false, true})
        EXPECT_TRUE(same_bits<float>(outcome(make, threads, replay), one))
            << cells << " cells, " << threads << " " << replay;
  }
}

// A cloth that is thrown; its gradient is that of the first velocities.
struct Cloth {
  std::shared_ptr<Model> model = [] {
    ModelBuilder builder;
    builder.add_cloth_grid({.placement = {.vel = {0.0f, 0.4f, -1.5f}},
                            .dim_x = 14,
                            .dim_y = 13,
                            .cell_x = 0.07f,
                            .cell_y = 0.08f,
                            .mass = 1.0f,
                            .fix_left = true,
                            .tri = {1e3f, 1e3f, 10.0f, 10.0f, 5.0f},
                            .edge = {10.0f, 0.1f}});
    return builder.finalize(Device::cpu());
  }();
  DiffSemiImplicitSolver solver{model, kAll};
  Trajectory trajectory{model, 30};
  Tensor params = diff::state_particle_qd_tensor(trajectory.state(0), true);

  void iterate() {
    nova::Tape tape(nova::KeepGradients::Leaves);
    const nova::TapeScope scope(tape);
    solver.rollout(trajectory, nullptr, nullptr, 5e-4f);
    const Tensor last = diff::state_particle_q_tensor(trajectory.state(trajectory.steps()));
    tape.backward(
        diff::vec3_point_loss_generated(diff::particle_centroid_generated(last), 0.1f, 0.2f, 0.3f));
  }
};

// Threads share the phases of its replay, and compute the elements at their borders both.
TEST(ClothDiff, ThreadsAndReplayChangeNoBit) {
  const auto make = [] { return Cloth(); };
  const std::vector<float> one = outcome(make, 1, false);
  EXPECT_GT(std::count_if(one.begin(), one.end(), [](float v) { return v != 0.0f; }), 1000);
  EXPECT_TRUE(std::all_of(one.begin(), one.end(), [](float v) { return std::isfinite(v); }));
  for (const int threads : {1, 2, 7, 13})
    for (const bool replay : {false, true})
      EXPECT_TRUE(same_bits<float>(outcome(make, threads, replay), one))
          << threads << " " << replay;
}

// Every way through a step of a scene with elements of all kinds and recorded contacts.
TEST(SoftBodyDiff, StepAndRolloutHaveTheBitsOfTheForwardSolver) {
  ModelBuilder builder;
  builder.add_soft_grid({.placement = {.pos = {0.0f, 0.0f, 0.08f}, .vel = {0.5f, 0.2f, -1.0f}},
                         .density = 500.0,
                         .k_mu = 900.0f,
                         .k_lambda = 1200.0f,
                         .k_damp = 0.5f});
  builder.add_cloth_grid({.placement = {.pos = {0.3f, 0.0f, 0.1f}, .vel = {0.0f, 0.4f, -1.5f}},
                          .dim_x = 3,
                          .dim_y = 2,
                          .mass = 0.02f,
                          .fix_left = true,
                          .tri = {50.0f, 40.0f, 0.1f, 0.05f, 0.04f},
                          .edge = {0.02f, 0.001f},
                          .add_springs = true,
                          .spring_ke = 30.0f,
                          .spring_kd = 0.05f});
  builder.add_ground_plane({.cfg = ShapeConfig{.ke = 2e3f, .kd = 3.0f, .kf = 1.0f, .mu = 0.4f}});
  const auto model = builder.finalize(Device::cpu());
  constexpr int kSteps = 40;
  constexpr float kDt = 1e-3f;
  CollisionPipeline pipeline(model, {.soft_contact_margin = 1.0f});
  SimState start = model->state();
  Contacts contacts = pipeline.contacts();
  pipeline.collide(start, contacts);
  EXPECT_GT(contacts.active_soft_contact_count(), 0);
  const Control control = model->control();

  const auto loop = [&](SolverBase& solver, bool taped) {
    std::vector<SimState> states;
    for (int t = 0; t <= kSteps; ++t) states.push_back(model->state());
    diff::state_particle_qd_tensor(states[0], taped);
    nova::Tape tape;
    if (taped) tape.begin();
    for (size_t t = 0; t < kSteps; ++t) {
      states[t].clear_forces();
      solver.step(states[t], states[t + 1], &control, &contacts, kDt);
    }
    if (taped) tape.end();
    std::vector<Vec3f> result = states[kSteps].particle_q.to_host();
    for (const SimState* s : {&states[kSteps - 1], &states[kSteps / 2]}) {
      const std::vector<Vec3f> f = s->particle_f.to_host();
      result.insert(result.end(), f.begin(), f.end());
    }
    return result;
  };
  SolverSemiImplicit forward(model);
  DiffSemiImplicitSolver differentiable(model, kAll);
  const std::vector<Vec3f> expected = loop(forward, false);
  EXPECT_NE(expected[0], model->particle_q.to_host()[0]);
  EXPECT_TRUE(same_bits<Vec3f>(loop(differentiable, false), expected));
  EXPECT_TRUE(same_bits<Vec3f>(loop(differentiable, true), expected));
  for (const bool taped : {false, true}) {
    Trajectory trajectory(model, kSteps);
    diff::state_particle_qd_tensor(trajectory.state(0), taped);
    nova::Tape tape;
    if (taped) tape.begin();
    differentiable.rollout(trajectory, &control, &contacts, kDt);
    if (taped) tape.end();
    EXPECT_TRUE(same_bits<Vec3f>(trajectory.state(kSteps).particle_q.to_host(),
                                 std::span(expected).first(model->particle_q.rows())));
  }
}

// The gradient through a loop of step is that of the rollout.
TEST(SoftBodyDiff, StepAndRolloutHaveOneGradient) {
  constexpr int kSteps = 30;
  const auto model = make_elements_model();
  const Control control = model->control();
  const Tensor parameters[] = {diff::control_tet_activation_tensor(control, true),
                               diff::control_tri_activation_tensor(control, true),
                               diff::model_tet_material_tensor(*model, true),
                               diff::model_tri_material_tensor(*model, true),
                               diff::model_spring_rest_length_tensor(*model, true),
                               diff::model_edge_rest_angle_tensor(*model, true)};
  DiffSemiImplicitSolver solver(model, kAll);
  const auto gradients = [&](bool rollout) {
    for (const Tensor& p : parameters) p.zero_grad();
    Trajectory trajectory(model, kSteps);
    std::vector<SimState> states;
    for (int t = 0; t <= kSteps; ++t) states.push_back(model->state());
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    if (rollout) {
      solver.rollout(trajectory, &control, nullptr, 0.01f);
    } else {
      for (size_t t = 0; t < kSteps; ++t) {
        states[t].clear_forces();
        solver.step(states[t], states[t + 1], &control, nullptr, 0.01f);
      }
    }
    const SimState& last = rollout ? trajectory.state(kSteps) : states[kSteps];
    const Tensor q = diff::state_particle_q_tensor(last);
    tape.backward(nova::dot(q, q));
    std::vector<float> all;
    for (const Tensor& p : parameters) {
      const std::vector<float> g = p.grad().to_host();
      double norm = 0.0;
      for (const float v : g) norm += std::fabs(static_cast<double>(v));
      EXPECT_GT(norm, 0.0);
      all.insert(all.end(), g.begin(), g.end());
    }
    return all;
  };
  EXPECT_TRUE(same_bits<float>(gradients(false), gradients(true)));
}

TEST(SoftBodyDiff, WhatWouldBeLeftOutIsRefused) {
  const auto model = make_elements_model();
  const auto refuse = [&](const DiffSolverConfig& config, const char* option) {
    EXPECT_ERROR(DiffSemiImplicitSolver(model, config), ErrorKind::NotImplemented, option);
  };
  DiffSolverConfig config = kAll;
  config.enable_tetrahedra = false;
  refuse(config, "enable_tetrahedra");
  config = kAll;
  config.enable_triangles = false;
  refuse(config, "enable_triangles");
  config = kAll;
  config.enable_springs = false;
  refuse(config, "enable_springs");
  config = kAll;
  config.enable_bending = false;
  refuse(config, "enable_bending");
  config = {.strict = false};
  DiffSemiImplicitSolver permissive(model, config);
  config = kAll;
  config.static_contact_margin = -1.0f;
  EXPECT_ERROR(DiffSemiImplicitSolver(model, config), ErrorKind::Value, "static_contact_margin");

  const auto soft = make_soft_body_model();
  DiffSemiImplicitSolver solver(soft, kStatic);  // its edges exert nothing
  SimState a = soft->state(), b = soft->state();
  CollisionPipeline pipeline(soft);
  const Contacts contacts = pipeline.contacts();
  EXPECT_ERROR(solver.step(a, b, nullptr, &contacts, 0.01f), ErrorKind::Value,
               "enable_static_contacts");
}

TEST(SoftBodyDiff, ShapesThatNothingCoversAreRefused) {
  ModelBuilder builder;
  builder.add_particle({0.0f, 0.0f, 0.1f}, {}, 1.0f);
  builder.add_ground_plane();
  ShapeConfig ghost;
  ghost.has_particle_collision = false;
  builder.add_shape_box(-1, {.cfg = ghost});
  const auto model = builder.finalize(Device::cpu());
  SimState a = model->state(), b = model->state();
  Trajectory trajectory(model, 2);
  const char* message = "contacts: expected a Contacts, because particles collide with 1 shape";
  DiffSemiImplicitSolver strict(model);
  EXPECT_ERROR(strict.step(a, b, nullptr, nullptr, 0.01f), ErrorKind::Value, message);
  EXPECT_ERROR(strict.rollout(trajectory, nullptr, nullptr, 0.01f), ErrorKind::Value, message);
  for (const DiffSolverConfig& config :
       {DiffSolverConfig{.enable_static_contacts = true},
        DiffSolverConfig{.enable_particle_contacts = false}, DiffSolverConfig{.strict = false}}) {
    DiffSemiImplicitSolver solver(model, config);
    solver.step(a, b, nullptr, nullptr, 0.01f);
    solver.rollout(trajectory, nullptr, nullptr, 0.01f);
  }
  CollisionPipeline pipeline(model);
  const Contacts contacts = pipeline.contacts();
  strict.step(a, b, nullptr, &contacts, 0.01f);
}

}  // namespace
}  // namespace novaphy::testing
