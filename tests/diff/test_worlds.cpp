// Models of several worlds: states and gradients of each world have the bits of that world alone.
#include <gtest/gtest.h>

#include <functional>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/dynamics/semi_implicit/diff_particles.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"
#include "support/threads.h"

namespace novaphy::testing {
namespace {

using diff::DiffSemiImplicitSolver;
using nova::Tensor;

constexpr int kSteps = 24;
constexpr float kDt = 0.005f;

// A ball that bounces on its own plane, beside a box.
ModelBuilder ball() {
  ModelBuilder builder(Axis::Z, Vec3f{0.3f, -0.1f, -9.0f});
  builder.add_particle({0.1f, 0.2f, 0.13f}, {0.7f, -0.4f, -2.0f}, 1.5f, 0.1f);
  const ShapeConfig cfg{.ke = 900.0f, .kd = 4.0f, .kf = 6.0f, .mu = 0.4f};
  builder.add_ground_plane({.cfg = cfg});
  Transformf wall;
  wall.p = {0.4f, 0.0f, 0.2f};
  builder.add_shape_box(-1, {.xform = wall, .hx = 0.2f, .hy = 0.5f, .hz = 0.5f, .cfg = cfg});
  return builder;
}
std::shared_ptr<Model> worlds(int count) {
  ModelBuilder builder;
  builder.replicate(ball(), count);
  return builder.finalize(Device::cpu());
}

enum class Path { Step, Rollout, StaticStep, StaticRollout, Captured };

struct Result {
  std::vector<float> q, grad_q, grad_qd, grad_gravity;
};

Result run(const std::shared_ptr<Model>& model, Path path) {
  const bool fixed = path == Path::Step || path == Path::Rollout;
  DiffSemiImplicitSolver solver(model,
                                {.enable_static_contacts = !fixed, .static_contact_margin = 0.05f});
  const bool steps = path == Path::Step || path == Path::StaticStep;
  diff::Trajectory trajectory(model, kSteps);
  std::vector<SimState> states;
  for (int t = 0; t <= kSteps; ++t) states.push_back(model->state());
  SimState& first = steps ? states[0] : trajectory.state(0);
  CollisionPipeline pipeline(model, {.soft_contact_margin = 10.0f});
  Contacts contacts = pipeline.contacts();
  pipeline.collide(model->state(), contacts);

  const Tensor q = diff::state_particle_q_tensor(first, true),
               qd = diff::state_particle_qd_tensor(first, true),
               gravity = diff::model_gravity_tensor(*model, true);
  SimState& last = steps ? states.back() : trajectory.state(kSteps);
  const auto iteration = [&] {
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    const Contacts* const given = fixed ? &contacts : nullptr;
    if (steps) {
      for (int t = 0; t < kSteps; ++t)
        solver.step(states[static_cast<size_t>(t)], states[static_cast<size_t>(t) + 1], nullptr,
                    given, kDt);
    } else {
      solver.rollout(trajectory, nullptr, given, kDt);
    }
    const Tensor end = diff::state_particle_q_tensor(last);
    tape.backward(nova::dot(end, end));
  };
  if (path == Path::Captured) {
    nova::ScopedCapture capture;
    iteration();
    const std::shared_ptr<nova::OpList> list = capture.graph();
    capture.end();
    list->launch();
  } else {
    iteration();
  }
  return {diff::state_particle_q_tensor(last).to_host(), q.grad().to_host(), qd.grad().to_host(),
          gravity.grad().to_host()};
}

void expect_each_world_alone(Path path, int count) {
  ModelBuilder alone = ball();
  const Result one = run(alone.finalize(Device::cpu()), path), many = run(worlds(count), path);
  const auto repeated = [count](const std::vector<float>& values) {
    std::vector<float> all;
    for (int k = 0; k < count; ++k) all.insert(all.end(), values.begin(), values.end());
    return all;
  };
  EXPECT_NE(one.grad_gravity[2], 0.0f);
  EXPECT_TRUE(same_bits<float>(many.q, repeated(one.q)));
  EXPECT_TRUE(same_bits<float>(many.grad_q, repeated(one.grad_q)));
  EXPECT_TRUE(same_bits<float>(many.grad_qd, repeated(one.grad_qd)));
  EXPECT_TRUE(same_bits<float>(many.grad_gravity, repeated(one.grad_gravity)));
}

TEST(Worlds, AThousandBallsEqualOneOnEveryPath) {
  for (const int threads : {1, 2, 7}) {
    const Threads use(threads);
    for (const Path path :
         {Path::Step, Path::Rollout, Path::StaticStep, Path::StaticRollout, Path::Captured}) {
      SCOPED_TRACE(::testing::Message()
                   << "path " << static_cast<int>(path) << ", threads " << threads);
      expect_each_world_alone(path, 1000);
    }
  }
}

TEST(Worlds, TheForwardSolverStepsEachWorldAsAlone) {
  const auto end = [](const std::shared_ptr<Model>& model) {
    SolverSemiImplicit solver(model);
    CollisionPipeline pipeline(model, {});
    Contacts contacts = pipeline.contacts();
    SimState now = model->state(), next = model->state();
    for (int t = 0; t < kSteps; ++t) {
      now.clear_forces();
      pipeline.collide(now, contacts);
      solver.step(now, next, nullptr, &contacts, kDt);
      std::swap(now, next);
    }
    return now.particle_q.to_host();
  };
  const std::vector<Vec3f> one = end(ball().finalize(Device::cpu())), many = end(worlds(50));
  EXPECT_TRUE(same_bits<Vec3f>(many, std::vector<Vec3f>(50, one[0])));
}

TEST(Worlds, GravityOfOneWorldMovesOnlyIt) {
  const auto model = worlds(3);
  model->set_gravity({0.0f, 0.0f, 5.0f}, 1);
  DiffSemiImplicitSolver solver(model, {.enable_particle_contacts = false});
  SimState from = model->state(), to = model->state();
  solver.step(from, to, nullptr, nullptr, kDt);
  const std::vector<Vec3f> qd = to.particle_qd.to_host();
  EXPECT_EQ(qd[0], qd[2]);
  EXPECT_FLOAT_EQ(qd[1].z, -2.0f + 5.0f * kDt);
  EXPECT_FLOAT_EQ(qd[0].z, -2.0f - 9.0f * kDt);
}

TEST(Worlds, AParticleOfAllWorldsIsRefusedByName) {
  const auto model = worlds(2);
  DiffSemiImplicitSolver solver(model, {.enable_particle_contacts = false});
  model->particle_world.fill(-1);
  SimState from = model->state(), to = model->state();
  EXPECT_ERROR(solver.step(from, to, nullptr, nullptr, kDt), ErrorKind::NotImplemented,
               "particle_world[0]");
  EXPECT_ERROR(DiffSemiImplicitSolver{model}, ErrorKind::NotImplemented, "particle_world[0]");
  model->particle_world.fill(2);
  EXPECT_ERROR(DiffSemiImplicitSolver{model}, ErrorKind::Index, "expected 0 to 1, got 2");
}

TEST(Worlds, ShapesThatChangeTheirWorldAreMetThere) {
  const auto model = worlds(2);
  DiffSemiImplicitSolver solver(model,
                                {.enable_static_contacts = true, .static_contact_margin = 0.05f});
  const auto velocities = [&] {
    SimState from = model->state(), to = model->state();
    const Vec3f inside[] = {{0.1f, 0.2f, 0.05f}, {0.1f, 0.2f, 0.05f}};
    from.particle_q.copy_from_host(std::span<const Vec3f>(inside));
    solver.step(from, to, nullptr, nullptr, kDt);
    return to.particle_qd.to_host();
  };
  std::vector<Vec3f> qd = velocities();
  EXPECT_EQ(qd[0], qd[1]);
  const int32_t all_in_one[] = {1, 1, 1, 1};
  model->shape_world.copy_from_host(std::span<const int32_t>(all_in_one));
  qd = velocities();
  EXPECT_FLOAT_EQ(qd[0].z, -2.0f - 9.0f * kDt);  // falls freely
  EXPECT_GT(qd[1].z, qd[0].z);
}

}  // namespace
}  // namespace novaphy::testing
