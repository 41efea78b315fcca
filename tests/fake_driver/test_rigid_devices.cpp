// Rigid bodies on a CUDA device: rows, steps, rollouts and gradients have the bits of the CPU. The
// device is a GPU or the fake driver (CMakeLists.txt).
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "dynamics/newton_rigid_scene.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/warning.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/rigid_losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "novaphy/dynamics/semi_implicit/contact_gradients.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"
#include "support/convex_shapes.h"
#include "support/cuda_device.h"
#include "support/device_bits.h"
#include "support/pair_scenes.h"
#include "support/triangles.h"

namespace novaphy {
namespace {

constexpr float kDt = 1.0f / 960.0f;

class RigidDevices : public testing::OnCuda {};

using testing::bytes;
using testing::expect_same_bits;
using testing::Result;

void add_rows(Result& result, const Contacts& c, const std::string& when) {
  result.emplace_back(when + " count", bytes(c.rigid_contact_count.to_host()));
#define NOVAPHY_ADD_ROWS(field) \
  result.emplace_back(when + " " #field, bytes(c.rigid_contact_##field.to_host()));
  NOVAPHY_ADD_ROWS(shape0)
  NOVAPHY_ADD_ROWS(shape1)
  NOVAPHY_ADD_ROWS(point0)
  NOVAPHY_ADD_ROWS(point1)
  NOVAPHY_ADD_ROWS(offset0)
  NOVAPHY_ADD_ROWS(offset1)
  NOVAPHY_ADD_ROWS(normal)
  NOVAPHY_ADD_ROWS(margin0)
  NOVAPHY_ADD_ROWS(margin1)
  NOVAPHY_ADD_ROWS(point_id)
  NOVAPHY_ADD_ROWS(force)
#undef NOVAPHY_ADD_ROWS
}
void add_bodies(Result& result, const SimState& s, const std::string& when) {
  result.emplace_back(when + " body_q", bytes(s.body_q.to_host()));
  result.emplace_back(when + " body_qd", bytes(s.body_qd.to_host()));
}

const ShapeConfig kSurface{.ke = 1e4f, .kd = 100.0f, .kf = 200.0f, .mu = 0.5f};

// Overlapping bodies of all types in random poses, on a tilted and a level plane. `groups`: some
// shapes meet only shapes of another group.
ModelBuilder heap(int bodies, float size, uint32_t seed = 5, bool groups = false) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
  ModelBuilder builder;
  builder.add_ground_plane({.cfg = kSurface});
  for (int b = 0; b < bodies; ++b) {
    const Vec3f p = {size * unit(random), size * unit(random), 0.1f + 0.4f * (1.0f + unit(random))};
    const Quatf any = {unit(random), unit(random), unit(random), 1.1f + unit(random)};
    const float l = std::sqrt(any.x * any.x + any.y * any.y + any.z * any.z + any.w * any.w);
    const Quatf q = {any.x / l, any.y / l, any.z / l, any.w / l};
    const int32_t body = builder.add_body({.xform = {p, q}});
    ShapeConfig surface = kSurface;
    if (groups && b < 6) surface.collision_group = b % 2 == 0 ? 2 : -2;
    novaphy::testing::add_convex_shape(builder, body, b, surface);
    builder.body_qd[static_cast<size_t>(body)] = {{unit(random), unit(random), unit(random)},
                                                  {unit(random), unit(random), unit(random)}};
  }
  builder.add_shape_box(-1, {.xform = {{0.0f, size, 0.2f}, Quatf::identity()},
                             .hx = size,
                             .hy = 0.1f,
                             .hz = 0.2f,
                             .cfg = kSurface});
  return builder;
}

// Poses that the next search finds.
void shake(const Model& model, SimState& state) {
  std::vector<Transformf> q = state.body_q.to_host();
  for (size_t b = 0; b < q.size(); ++b) q[b].p.x += 0.01f * static_cast<float>(b % 5);
  q[0].p.y += 0.3f;
  state.body_q.copy_from_host(q);
  ASSERT_EQ(model.body_count(), static_cast<int32_t>(q.size()));
}

Result found_rows(const ModelBuilder& builder, Device device, const CollisionOptions& options,
                  bool capture) {
  const auto model = builder.finalize(device);
  CollisionPipeline pipeline(model, options);
  Contacts contacts = pipeline.contacts();
  SimState state = model->state();
  Result result;
  nova::ScopedCapture scope;
  if (!capture) scope.end();
  pipeline.collide(state, contacts);
  scope.end();
  for (const char* when : {"first", "second"}) {
    if (capture)
      scope.graph()->launch();
    else
      pipeline.collide(state, contacts);
    add_rows(result, contacts, when);
    shake(*model, state);
  }
  return result;
}

int32_t count_of(const Result& rows) {
  int32_t count = 0;
  std::memcpy(&count, rows[0].second.data(), sizeof(count));
  return count;
}

constexpr BroadPhase kPhases[] = {BroadPhase::Explicit, BroadPhase::NxN, BroadPhase::Sap};

// Three worlds, shapes that belong to all worlds, groups and filters.
ModelBuilder worlds() {
  ModelBuilder all;
  all.add_ground_plane({.cfg = kSurface});
  for (uint32_t w = 0; w < 3; ++w) {
    ModelBuilder one = heap(14, 0.3f, w, true);
    one.add_shape_collision_filter_pair(3, 9);
    one.add_shape_collision_filter_pair(7, 8);
    all.add_world(one);
  }
  const int32_t body = all.add_body({.xform = {{0.1f, 0.0f, 0.3f}, Quatf::identity()}});
  novaphy::testing::add_convex_shape(all, body, 0, kSurface);
  return all;
}

void expect_the_rows_of_the_cpu(const ModelBuilder& builder, std::span<const BroadPhase> phases,
                                int32_t least, int64_t most) {
  const Result expected = found_rows(builder, Device::cpu(), {.rigid_contact_max = most}, false);
  EXPECT_GT(count_of(expected), least);
  for (const BroadPhase phase : phases)
    for (const bool capture : {false, true}) {
      const Result rows = found_rows(builder, Device::cuda(),
                                     {.broad_phase = phase, .rigid_contact_max = most}, capture);
      for (size_t k = 0; k < rows.size(); ++k)
        EXPECT_TRUE(rows[k].second == expected[k].second)
            << rows[k].first << ", " << broad_phase_name(phase) << ", captured " << capture;
    }
}

TEST_F(RigidDevices, FindTheRowsOfTheCpuWithEveryBroadPhaseDirectAndReplayed) {
  for (const ModelBuilder& builder : {heap(60, 0.5f), worlds()})
    expect_the_rows_of_the_cpu(builder, kPhases, 200, 4000);
}

// Hills of triangles under bodies of all types, with more contacts of a pair than are kept.
ModelBuilder hills() {
  std::vector<Vec3f> vertices;
  std::vector<int32_t> triangles;
  constexpr int kSide = 17;
  for (int k = 0; k < kSide * kSide; ++k) {
    const float x = 0.1f * static_cast<float>(k % kSide - kSide / 2),
                y = 0.1f * static_cast<float>(k / kSide - kSide / 2);
    vertices.push_back({x, y, 0.15f * x * x - 0.1f * y * y + 0.03f * static_cast<float>(k % 3)});
  }
  for (int k = 0; k < kSide * (kSide - 1); ++k) {
    if (k % kSide == kSide - 1) continue;
    triangles.insert(triangles.end(), {k, k + 1, k + kSide + 1, k, k + kSide + 1, k + kSide});
  }
  ModelBuilder builder = heap(14, 0.5f);
  builder.add_shape_mesh(-1, {.vertices = vertices, .indices = triangles, .cfg = kSurface});
  const int32_t slab = builder.add_body({.xform = {{0.0f, 0.0f, 0.0f}, Quatf::identity()}});
  builder.add_shape_box(slab, {.hx = 0.7f, .hy = 0.7f, .hz = 0.05f, .cfg = kSurface});
  return builder;
}

TEST_F(RigidDevices, FindTheRowsOfTheCpuOnTriangles) {
  const ModelBuilder builder = hills();
  const std::span<const BroadPhase> phases(kPhases, 2);  // Sap refuses meshes on devices
  expect_the_rows_of_the_cpu(builder, phases, 80, 4000);
  expect_the_rows_of_the_cpu(builder, phases, 80, 60);  // more rows than fit
}

// A cube of triangles that falls on a cube of triangles, and on the hills.
TEST_F(RigidDevices, StepsOnTrianglesHaveTheBitsOfTheCpu) {
  const testing::Triangles cube = testing::cube(0.1f);
  ModelBuilder builder = hills();
  for (int k = 0; k < 2; ++k) {
    const int32_t body = builder.add_body(
        {.xform = {{0.02f, 0.0f, 0.6f + 0.21f * static_cast<float>(k)}, Quatf::identity()}});
    builder.add_shape_mesh(body,
                           {.vertices = cube.vertices, .indices = cube.indices, .cfg = kSurface});
  }
  Result results[2];
  for (const bool on_device : {false, true}) {
    const auto model = builder.finalize(on_device ? Device::cuda() : Device::cpu());
    CollisionPipeline pipeline(model, {.rigid_contact_max = 4000});
    Contacts contacts = pipeline.contacts();
    SolverFeatherstone articulated(model);
    SolverSemiImplicit penalty(model);
    for (SolverBase* const solver :
         {static_cast<SolverBase*>(&articulated), static_cast<SolverBase*>(&penalty)}) {
      SimState now = model->state(), next = model->state();
      for (int step = 0; step < 20; ++step) {
        pipeline.collide(now, contacts);
        solver->step(now, next, nullptr, &contacts, kDt);
        std::swap(now, next);
      }
      add_rows(results[on_device], contacts, "after 20 steps");
      add_bodies(results[on_device], now, "after 20 steps");
    }
  }
  for (size_t k = 0; k < results[0].size(); ++k)
    EXPECT_TRUE(results[0][k].second == results[1][k].second) << results[0][k].first;
}

Result rows_of_poses(const novaphy::testing::PairScene& scene, Device device, BroadPhase phase,
                     bool capture) {
  const auto model = scene.builder.finalize(device);
  CollisionPipeline pipeline(model, {.broad_phase = phase, .rigid_contact_max = 9000});
  Contacts contacts = pipeline.contacts();
  SimState state = model->state();
  Result result;
  nova::ScopedCapture scope;
  if (!capture) scope.end();
  pipeline.collide(state, contacts, {}, 0.01f);
  scope.end();
  for (const std::vector<Transformf>& poses : poses_of(scene, state)) {
    state.body_q.copy_from_host(poses);
    if (capture)
      scope.graph()->launch();
    else
      pipeline.collide(state, contacts, {}, 0.01f);
    add_rows(result, contacts, scene.name);
  }
  return result;
}

TEST_F(RigidDevices, LoseNoRowOfHardScenes) {
  for (const novaphy::testing::PairScene& scene : novaphy::testing::hard_pair_scenes()) {
    const Result expected = rows_of_poses(scene, Device::cpu(), BroadPhase::NxN, false);
    EXPECT_GT(count_of(expected), 90) << scene.name;
    for (const bool capture : {false, true}) {
      const Result rows = rows_of_poses(scene, Device::cuda(), BroadPhase::Sap, capture);
      for (size_t k = 0; k < rows.size(); ++k)
        EXPECT_TRUE(rows[k].second == expected[k].second)
            << rows[k].first << ", captured " << capture;
    }
  }
}

TEST_F(RigidDevices, KeepTheFirstRowsAndTheTrueCountOfAnOverflow) {
  const ModelBuilder builder = heap(40, 0.4f);
  const Result expected = found_rows(builder, Device::cpu(), {.rigid_contact_max = 30}, false);
  EXPECT_GT(count_of(expected), 100);
  for (const BroadPhase phase : kPhases) {
    const Result rows =
        found_rows(builder, Device::cuda(), {.broad_phase = phase, .rigid_contact_max = 30}, true);
    for (size_t k = 0; k < rows.size(); ++k)
      EXPECT_TRUE(rows[k].second == expected[k].second)
          << rows[k].first << ", " << broad_phase_name(phase);
  }
}

// 4950 pairs, where a capture that was recorded first has room for 1600.
TEST_F(RigidDevices, PairsForWhichACaptureHasNoRoomAreAnOverflow) {
  ModelBuilder builder;
  for (int b = 0; b < 100; ++b) {
    builder.add_body({.xform = {{0.001f * static_cast<float>(b), 0.0f, 0.0f}, Quatf::identity()}});
    builder.add_shape_sphere(b, {.radius = 0.1f});
  }
  const auto model = builder.finalize(Device::cuda());
  for (const bool collides_before : {false, true}) {
    CollisionPipeline pipeline(model, {.broad_phase = BroadPhase::Sap, .rigid_contact_max = 5000});
    Contacts contacts = pipeline.contacts();
    SimState state = model->state();
    if (collides_before) {
      pipeline.collide(state, contacts);
      EXPECT_EQ(contacts.rigid_contact_count.to_host()[0], 4950);
    }
    nova::ScopedCapture scope;
    pipeline.collide(state, contacts);
    scope.end();
    scope.graph()->launch();
    EXPECT_EQ(contacts.overflowed(), !collides_before);
    EXPECT_EQ(contacts.rigid_contact_count.to_host()[0],
              collides_before ? 4950 : 5000 + (4950 - 1600));
    EXPECT_EQ(contacts.rigid_contact_shape0.to_host()[1599], 17) << "the first pairs are there";
    EXPECT_EQ(contacts.rigid_contact_shape1.to_host()[1599], 70);
    EXPECT_EQ(contacts.active_rigid_contact_count(), collides_before ? 4950 : 1600);
    SolverFeatherstone solver(model);
    SimState next = model->state();
    solver.step(state, next, nullptr, &contacts, 1e-5f);
    EXPECT_NO_THROW(solver.check_last_step()) << "an empty row is no contact";
  }
}

TEST_F(RigidDevices, StepsOfAHeapHaveTheBitsOfTheCpu) {
  const ModelBuilder builder = heap(30, 0.4f);
  for (const FrictionLaw law :
       {FrictionLaw::Viscous, FrictionLaw::Huber, FrictionLaw::Newton17, FrictionLaw::Newton18})
    expect_same_bits([&](Device device) {
      const auto model = builder.finalize(device);
      CollisionPipeline pipeline(model);
      SemiImplicitOptions options{.angular_damping = 0.1f, .friction_law = law};
      if (law == FrictionLaw::Huber || law == FrictionLaw::Newton17)
        options.friction_smoothing = 0.2f;
      SolverSemiImplicit solver(model, options);
      Contacts contacts = pipeline.contacts();
      SimState now = model->state(), next = model->state();
      now.body_f.fill({{0.3f, 0.0f, 0.1f}, {0.0f, 0.05f, 0.0f}});
      next.body_f.fill({{0.3f, 0.0f, 0.1f}, {0.0f, 0.05f, 0.0f}});
      Result result;
      for (int t = 0; t < 12; ++t) {
        pipeline.collide(now, contacts);
        solver.step(now, next, nullptr, &contacts, kDt);
        std::swap(now, next);
      }
      add_rows(result, contacts, "last");
      add_bodies(result, now, "last");
      return result;
    });
}

// A rollout of the forward solver, which finds contacts in every step.
TEST_F(RigidDevices, ARolloutHasTheBitsOfTheSteps) {
  const ModelBuilder builder = heap(20, 0.3f);
  expect_same_bits([&](Device device) {
    const auto model = builder.finalize(device);
    CollisionPipeline pipeline(model);
    SolverSemiImplicit solver(model);
    Trajectory trajectory(model, 10);
    solver.rollout(trajectory, nullptr, nullptr, kDt, {.pipeline = &pipeline});
    Result result;
    add_bodies(result, trajectory.state(10), "end");
    return result;
  });
}

TEST_F(RigidDevices, ClothOnAFallingBoxHasTheBitsOfTheCpu) {
  expect_same_bits([](Device device) {
    ModelBuilder builder;
    builder.add_ground_plane({.cfg = kSurface});
    const int32_t box = builder.add_body({.xform = {{0.0f, 0.0f, 0.25f}, Quatf::identity()}});
    builder.add_shape_box(box, {.hx = 0.2f, .hy = 0.2f, .hz = 0.2f, .cfg = kSurface});
    for (int k = 0; k < 64; ++k)
      builder.add_particle({0.05f * static_cast<float>(k % 8) - 0.17f,
                            0.05f * static_cast<float>(k / 8) - 0.17f, 0.471f},
                           {}, 0.1f, 0.02f);
    for (int k = 0; k < 63; ++k)
      if (k % 8 != 7) builder.add_spring(k, k + 1, 50.0f, 0.1f);
    const auto model = builder.finalize(device);
    CollisionPipeline pipeline(model, {.soft_contact_margin = 0.05f});
    SolverSemiImplicit solver(model);
    Contacts contacts = pipeline.contacts();
    SimState now = model->state(), next = model->state();
    for (int t = 0; t < 20; ++t) {
      now.clear_forces();
      pipeline.collide(now, contacts);
      solver.step(now, next, nullptr, &contacts, kDt);
      std::swap(now, next);
    }
    Result result;
    add_bodies(result, now, "end");
    result.emplace_back("particle_q", bytes(now.particle_q.to_host()));
    EXPECT_GT(contacts.active_soft_contact_count(), 30);
    return result;
  });
}

// A chain of all types of joints, with limits, drives and a force, which falls on the ground.
ModelBuilder chain() {
  ModelBuilder b;
  b.add_ground_plane({.cfg = kSurface});
  const Mat33f inertia = {{{0.05f, 0.0f, 0.0f}, {0.0f, 0.05f, 0.0f}, {0.0f, 0.0f, 0.05f}}};
  for (int k = 0; k < 7; ++k) {
    b.add_link({.xform = {{0.4f * static_cast<float>(k), 0.0f, 0.4f}, Quatf::identity()},
                .mass = 1.0f,
                .inertia = inertia,
                .lock_inertia = true});
    b.add_shape_sphere(k, {.radius = 0.1f, .cfg = kSurface});
    b.body_qd[static_cast<size_t>(k)] = {{0.1f * static_cast<float>(k % 3), 0.2f, -0.3f},
                                         {0.4f, -0.3f * static_cast<float>(k % 2), 0.6f}};
  }
  const Transformf front = {{0.2f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.1f, 0.995f}},
                   back = {{-0.2f, 0.0f, 0.0f}, Quatf::identity()};
  const JointDofConfig drive{.axis = {0.0f, 1.0f, 0.0f},
                             .limit_lower = -0.1f,
                             .limit_upper = 0.1f,
                             .limit_ke = 50.0f,
                             .limit_kd = 1.0f,
                             .target_q = 0.15f,
                             .target_ke = 5.0f,
                             .target_kd = 0.5f};
  JointDofConfig other = drive;
  other.axis = {1.0f, 0.0f, 0.0f};
  const JointArgs frames{.parent_xform = front, .child_xform = back};
  b.add_joint_free(0);
  JointArgs args = frames;
  args.angular_axes = {drive};
  b.add_joint(JointType::REVOLUTE, 0, 1, args);
  args = frames;
  args.linear_axes = {drive};
  b.add_joint(JointType::PRISMATIC, 1, 2, args);
  b.add_joint(JointType::BALL, 2, 3, frames);
  b.add_joint(JointType::FIXED, 3, 4, frames);
  args.linear_axes = {other};
  args.angular_axes = {drive, other};
  b.add_joint(JointType::D6, 4, 5, args);
  b.add_joint_distance(5, 6, {.min_distance = 0.39f, .max_distance = 0.41f});
  return b;
}

TEST_F(RigidDevices, JointsHaveTheBitsOfTheCpu) {
  expect_same_bits([](Device device) {
    const auto model = chain().finalize(device);
    CollisionPipeline pipeline(model);
    SolverSemiImplicit solver(model, {.joint_attach_ke = 1e3f, .joint_attach_kd = 10.0f});
    Control control = model->control();
    std::vector<float> force = control.joint_f.to_host();
    for (size_t k = 0; k < force.size(); ++k) force[k] = 0.1f * static_cast<float>(k % 4);
    control.joint_f.copy_from_host(force);
    Contacts contacts = pipeline.contacts();
    SimState now = model->state(), next = model->state();
    for (int t = 0; t < 30; ++t) {
      pipeline.collide(now, contacts);
      solver.step(now, next, &control, &contacts, kDt);
      std::swap(now, next);
    }
    Result result;
    add_bodies(result, now, "end");
    return result;
  });
}

TEST_F(RigidDevices, AStepAboveTheStableOneOfAJointIsRefusedThereToo) {
  const auto model = chain().finalize(Device::cuda());
  SolverSemiImplicit solver(model, {.joint_attach_ke = 1e6f, .joint_attach_kd = 10.0f});
  SimState now = model->state(), next = model->state();
  try {
    solver.step(now, next, nullptr, nullptr, 0.1f);
    FAIL() << "nothing was thrown";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Value);
    EXPECT_NE(std::string(error.what()).find("diverges with joint_attach_ke"), std::string::npos);
  }
}

// Returns the collected warnings.
std::vector<std::string>& warnings() {
  static std::vector<std::string> said;
  return said;
}

TEST_F(RigidDevices, AStepThatIsTooLongForItsContactsWarnsThereToo) {
  set_warning_handler([](const std::string& text) { warnings().push_back(text); });
  float limit[2] = {};
  for (const bool on_device : {false, true}) {
    ModelBuilder builder = heap(20, 0.3f);
    const auto model = builder.finalize(on_device ? Device::cuda() : Device::cpu());
    CollisionPipeline pipeline(model);
    Contacts contacts = pipeline.contacts();
    SimState state = model->state(), after = model->state();
    pipeline.collide(state, contacts);
    SolverSemiImplicit solver(model);
    diff::DiffSemiImplicitSolver recorded(model);
    limit[on_device] = solver.stable_dt(state, contacts);
    EXPECT_EQ(recorded.stable_dt(state, contacts), limit[on_device]);
    for (SolverBase* one :
         {static_cast<SolverBase*>(&solver), static_cast<SolverBase*>(&recorded)}) {
      warnings().clear();
      one->step(state, after, nullptr, &contacts, 0.5f * limit[on_device]);
      EXPECT_EQ(warnings().size(), 0u);
      for (int k = 0; k < 3; ++k) one->step(state, after, nullptr, &contacts, 0.1f);
      ASSERT_EQ(warnings().size(), 2u);  // one for springs and dampers, one for friction
      for (const std::string& said : warnings())
        EXPECT_NE(said.find("dt: 0.1 s is longer than the "), std::string::npos);
    }
  }
  set_warning_handler(nullptr);
  EXPECT_GT(limit[0], 0.0f);
  EXPECT_LT(limit[0], 0.1f);
  EXPECT_EQ(limit[1], limit[0]);
}

TEST_F(RigidDevices, WhatIsNotThereIsRefusedByName) {
  const auto refusal = [](const auto& call) {
    try {
      call();
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::NotImplemented);
      return std::string(error.what());
    }
    return std::string("nothing was thrown");
  };
  const auto model = hills().finalize(Device::cuda());
  EXPECT_NE(refusal([&] {
              CollisionPipeline(model, {.broad_phase = BroadPhase::Sap});
            }).find("the broad phase \"sap\" finds pairs of meshes on the cpu only"),
            std::string::npos);
  EXPECT_NE(refusal([&] {
              CollisionPipeline(model, {.narrow_phase = NarrowPhase::Fcl});
            }).find("narrow_phase"),
            std::string::npos);
}

class NewtonScenes : public RigidDevices, public ::testing::WithParamInterface<const char*> {};

TEST_P(NewtonScenes, AreNewtonsInAllBits) {
  const testing::NewtonRigidScene scene(GetParam());
  const auto model = scene.model(Device::cuda());
  CollisionPipeline pipeline(model);
  SolverSemiImplicit solver(model, {.friction_law = FrictionLaw::Newton18});
  Contacts contacts = pipeline.contacts();
  SimState now = model->state(), next = model->state();
  scene.load(0, now);
  const auto counts = scene["contact_count"].as<int32_t>();
  // The fake driver interprets, which takes long.
  const size_t steps = device_info(Device::cuda()).name == "Fake GPU" ? 60 : 480;
  for (size_t t = 0; t < steps; ++t) {
    pipeline.collide(now, contacts);
    ASSERT_EQ(contacts.rigid_contact_count.to_host()[0], counts[t]) << t;
    solver.step(now, next, nullptr, &contacts, scene.dt());
    if (t % 20 == 19) {  // the bits of each follow from those of the one before
      ASSERT_TRUE(scene.is_at(t + 1, next));
    }
    std::swap(now, next);
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, NewtonScenes,
                         ::testing::Values("box_drop", "box_slope", "sphere_roll",
                                           "capsule_tumble"),
                         [](const auto& scene) { return std::string(scene.param); });

// A die with a ball on it is thrown.
ModelBuilder die(const Vec3f& spin) {
  ModelBuilder builder;
  builder.add_ground_plane({.cfg = kSurface});
  const int32_t body =
      builder.add_body({.xform = {{0.0f, 0.0f, 0.14f}, Quatf::identity()}, .mass = 4.0f});
  builder.add_shape_box(body, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f, .cfg = kSurface});
  builder.body_qd[0] = {{1.0f, 0.0f, -2.0f}, spin};
  return builder;
}

TEST_F(RigidDevices, AThousandWorldsAreOneThousandTimes) {
  ModelBuilder one = die({1.0f, 5.0f, 2.0f});
  const int32_t ball = one.add_body({.xform = {{0.02f, 0.0f, 0.33f}, Quatf::identity()}});
  one.add_shape_sphere(ball, {.radius = 0.1f, .cfg = kSurface});
  ModelBuilder all;
  all.replicate(one, 1000);
  const auto end = [](const ModelBuilder& builder, Device device) {
    const auto model = builder.finalize(device);
    CollisionPipeline pipeline(model);
    SolverSemiImplicit solver(model);
    Contacts contacts = pipeline.contacts();
    SimState now = model->state(), next = model->state();
    for (int t = 0; t < 10; ++t) {
      pipeline.collide(now, contacts);
      solver.step(now, next, nullptr, &contacts, kDt);
      std::swap(now, next);
    }
    return now.body_qd.to_host();
  };
  const std::vector<SpatialVectorf> alone = end(one, Device::cpu()),
                                    together = end(all, Device::cuda());
  ASSERT_EQ(together.size(), 2000u);
  int different = 0;
  for (size_t b = 0; b < together.size(); ++b)
    different += std::memcmp(&together[b], &alone[b % 2], sizeof(alone[0])) != 0 ? 1 : 0;
  EXPECT_EQ(different, 0);
}

// Rollouts on a tape: a direct run, and a replay of a capture.
Result trained(Device device, const ModelBuilder& builder, bool captured, bool fused,
               BroadPhase phase) {
  const auto model = builder.finalize(device, {.requires_grad = true});
  // On a device the default is the derivative of the code.
  const auto derivative = device.is_cpu() ? diff::DerivativeOf::Code : diff::DerivativeOf::Auto;
  diff::DiffSemiImplicitSolver solver(model, {.enable_static_contacts = fused,
                                              .friction_law = FrictionLaw::Huber,
                                              .friction_smoothing = 0.1f,
                                              .joint_attach_ke = 1e3f,
                                              .joint_attach_kd = 10.0f,
                                              .contact_gradient = derivative});
  std::optional<CollisionPipeline> pipeline;
  if (!fused)
    pipeline.emplace(model, CollisionOptions{.broad_phase = phase, .rigid_contact_max = 200});
  constexpr int32_t kSteps = 16;
  Trajectory trajectory(model, kSteps);
  const nova::Tensor qd = diff::state_body_qd_tensor(trajectory.state(0), true),
                     ke = diff::model_shape_material_ke_tensor(*model, true),
                     mass = diff::model_body_mass_tensor(*model, true);
  const auto iterate = [&] {
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    RolloutOptions options;
    if (pipeline) options.pipeline = &*pipeline;
    solver.rollout(trajectory, nullptr, nullptr, kDt, options);
    const SimState& end = trajectory.state(kSteps);
    const nova::Tensor loss = diff::rigid_orientation_velocity_loss_generated(
        diff::state_body_q_tensor(end), diff::state_body_qd_tensor(end), 0, {1.0f, 0.0f, 0.0f},
        {0.0f, 0.0f, 1.0f}, {0.0f, 1.0f, 0.0f}, {0.0f, 1.0f, 0.0f},
        {.height_weight = 1.0f,
         .linear_velocity_weight = 0.01f,
         .angular_velocity_weight = 0.001f});
    tape.backward(loss);
    return loss;
  };
  nova::Tensor loss;
  if (captured) {
    nova::ScopedCapture scope;
    loss = iterate();
    scope.end();
    for (const nova::Tensor& leaf : {qd, ke, mass}) leaf.zero_grad();
    scope.graph()->launch();
  } else {
    loss = iterate();
  }
  Result result;
  result.emplace_back("loss", bytes(loss.to_host()));
  add_bodies(result, trajectory.state(kSteps), "end");
  result.emplace_back("gradient of body_qd", bytes(qd.grad().to_host()));
  result.emplace_back("gradient of ke", bytes(ke.grad().to_host()));
  result.emplace_back("gradient of mass", bytes(mass.grad().to_host()));
  return result;
}

void expect_trained(const ModelBuilder& builder, bool fused, BroadPhase phase) {
  const Result expected = trained(Device::cpu(), builder, false, fused, BroadPhase::Explicit);
  bool any = false;
  for (const std::byte b : expected[4].second) any = any || b != std::byte{0};
  EXPECT_TRUE(any) << "no contact has acted";
  for (const bool captured : {false, true}) {
    const Result actual = trained(Device::cuda(), builder, captured, fused, phase);
    for (size_t k = 0; k < actual.size(); ++k)
      EXPECT_TRUE(actual[k].second == expected[k].second)
          << actual[k].first << ", captured " << captured;
  }
}

// The fused operator.
TEST_F(RigidDevices, TheGradientOfAThrownDieHasTheBitsOfTheCpu) {
  expect_trained(die({1.0f, 5.0f, 2.0f}), true, BroadPhase::Explicit);
}

TEST_F(RigidDevices, TheGradientOfBodiesThatMeetHasTheBitsOfTheCpu) {
  ModelBuilder builder = die({1.0f, 5.0f, 2.0f});
  const int32_t ball = builder.add_body({.xform = {{0.02f, 0.0f, 0.33f}, Quatf::identity()}});
  builder.add_shape_sphere(ball, {.radius = 0.1f, .cfg = kSurface});
  for (const BroadPhase phase : {BroadPhase::Explicit, BroadPhase::Sap})
    expect_trained(builder, false, phase);
}

TEST_F(RigidDevices, TheGradientThroughJointsHasTheBitsOfTheCpu) {
  ModelBuilder builder = chain();
  for (int k = 0; k < 7; ++k) builder.body_q[static_cast<size_t>(k)].p.z = 0.095f;
  expect_trained(builder, false, BroadPhase::Explicit);
}

TEST_F(RigidDevices, AModelWithoutBodiesHasNoRows) {
  ModelBuilder still;
  still.add_ground_plane();
  still.add_shape_box(-1, {});
  const auto world = still.finalize(Device::cuda());
  EXPECT_EQ(CollisionPipeline(world).contacts().rigid_contact_max(), 0);
  EXPECT_NO_THROW(CollisionPipeline(world, {.broad_phase = BroadPhase::Sap}));
}

// Boxes on boxes, turned so that faces meet in eight corners, of which four stay.
TEST_F(RigidDevices, FourRowsOfAPairAreThoseOfTheCpu) {
  ModelBuilder builder;
  builder.add_ground_plane({.cfg = kSurface});
  for (int k = 0; k < 6; ++k) {
    const float half = 0.15f * static_cast<float>(k);
    const int32_t body =
        builder.add_body({.xform = {{0.0f, 0.0f, 0.099f + 0.198f * static_cast<float>(k)},
                                    {0.0f, 0.0f, std::sin(half), std::cos(half)}}});
    builder.add_shape_box(body, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f, .cfg = kSurface});
  }
  const auto rows = [&](Device device, int32_t per_pair) {
    return found_rows(builder, device, {.rigid_contact_max = 100, .contacts_per_pair = per_pair},
                      false);
  };
  const Result expected = rows(Device::cpu(), 4), actual = rows(Device::cuda(), 4);
  EXPECT_GT(count_of(rows(Device::cpu(), 8)), count_of(expected)) << "some were dropped";
  ASSERT_EQ(actual.size(), expected.size());
  for (size_t k = 0; k < actual.size(); ++k)
    EXPECT_TRUE(actual[k].second == expected[k].second) << actual[k].first;
}

// Four rows of a box on a plane, one of a ball on the box, and one of the ball above the plane.
TEST_F(RigidDevices, LabelsOfTheGradientsOfRowsAreThoseOfTheCpu) {
  ModelBuilder builder;
  builder.add_ground_plane({.cfg = kSurface});
  const int32_t box = builder.add_body({.xform = {{0.0f, 0.0f, 0.099f}, Quatf::identity()}});
  builder.add_shape_box(box, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f, .cfg = kSurface});
  const int32_t ball = builder.add_body({.xform = {{0.02f, 0.0f, 0.297f}, Quatf::identity()}});
  builder.add_shape_sphere(ball, {.radius = 0.1f, .cfg = kSurface});
  const auto labels = [&](Device device) {
    const auto model = builder.finalize(device);
    CollisionPipeline pipeline(model);
    Contacts contacts = pipeline.contacts();
    const SimState state = model->state();
    pipeline.collide(state, contacts);
    return exact_contact_gradients(*model, state, contacts);
  };
  const std::vector<bool> expected = labels(Device::cpu());
  EXPECT_EQ(expected.size(), 6u);
  EXPECT_EQ(std::count(expected.begin(), expected.end(), true), 6);
  EXPECT_EQ(labels(Device::cuda()), expected);
}

TEST_F(RigidDevices, StickingSpringsAreRefusedByName) {
  const auto model = die({}).finalize(Device::cuda());
  EXPECT_ERROR(SolverSemiImplicit(model, {.stick_ke = 1.0f}), ErrorKind::NotImplemented,
               "stick_ke: expected 0 for a model on cuda:0, got 1");
}

}  // namespace
}  // namespace novaphy
