// A step allocates no heap memory, once the solver's own memory has grown to its final size.
#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/parallel.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/diff/diff_featherstone_solver.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/vbd/diff_vbd.h"
#include "novaphy/vbd/solver_vbd.h"
#include "support/allocations.h"
#include "vbd/everything_scene.h"

namespace novaphy::testing {
namespace {

constexpr float kDt = 1e-3f;
constexpr int kSteps = 40;  // some checks are of every 32nd step

TEST(StepAllocations, TheCounterSeesWhatASolverWouldTake) {
  EXPECT_EQ(allocations_of([] { std::vector<int32_t> memory(3); }, 5), 5);
  EXPECT_EQ(allocations_of([] {}), 0);
}

// Pendulums of two links with dry friction, each with a ball that rolls beside it: trees alone and
// in groups of lanes, contacts of one tree and of two.
ModelBuilder trees(int count, bool dry = true) {
  ModelBuilder b;
  const ShapeConfig cfg{.mu = 0.5f};
  for (int k = 0; k < count; ++k) {
    const float x = 2.0f * static_cast<float>(k);
    const BodyArgs link{.mass = 1.0f,
                        .inertia = Mat33f{{{0.01f, 0, 0}, {0, 0.01f, 0}, {0, 0, 0.01f}}},
                        .lock_inertia = true};
    const int32_t body[2] = {b.add_link(link), b.add_link(link)};
    b.add_shape_sphere(body[1], {.radius = 0.1f, .cfg = cfg});
    const JointDofConfig dof{.axis = {0, 1, 0}, .friction = dry ? 0.02f : 0.0f};
    const Transformf in_child = {{-0.25f, 0, 0}, Quatf::identity()};
    const int32_t joints[2] = {
        b.add_joint_revolute(-1, body[0],
                             {.parent_xform = {{x, 0, 0.09f}, Quatf::identity()},
                              .child_xform = in_child,
                              .dof = dof}),
        b.add_joint_revolute(body[0], body[1],
                             {.parent_xform = {{0.25f, 0, 0}, Quatf::identity()},
                              .child_xform = in_child,
                              .dof = dof})};
    b.add_articulation(joints);
    const int32_t ball = b.add_body({.xform = {{x, 0.19f, 0.1f}, Quatf::identity()}});
    b.add_shape_sphere(ball, {.radius = 0.1f, .cfg = cfg});
  }
  b.add_ground_plane({.cfg = cfg});
  return b;
}

struct Scene {
  std::shared_ptr<Model> model;
  std::unique_ptr<CollisionPipeline> pipeline;
  std::unique_ptr<Contacts> contacts;
  SimState a, b;

  explicit Scene(const ModelBuilder& builder)
      : model(builder.finalize()),
        pipeline(std::make_unique<CollisionPipeline>(model)),
        contacts(std::make_unique<Contacts>(pipeline->contacts())),
        a(model->state()),
        b(model->state()) {
    pipeline->collide(a, *contacts);
  }
  int32_t touching() const {
    return contacts->soft_contact_count.to_host()[0] + contacts->rigid_contact_count.to_host()[0];
  }
  // Returns the allocations of steps from the same state, with one thread and with two.
  int64_t of_steps(SolverBase& solver) {
    EXPECT_GT(touching(), 0);
    int64_t sum = 0;
    const int before = num_threads();
    for (const int threads : {1, 2}) {
      set_num_threads(threads);
      sum += allocations_of([&] { solver.step(a, b, nullptr, contacts.get(), kDt); }, kSteps);
    }
    set_num_threads(before);
    return sum;
  }
};

TEST(StepAllocations, SemiImplicitParticlesTakeNone) {
  Scene scene(EverythingScene::builder(0.0f, false));
  SolverSemiImplicit solver(scene.model);
  EXPECT_EQ(scene.of_steps(solver), 0);
}

TEST(StepAllocations, SemiImplicitBodiesTakeNone) {
  Scene scene(trees(3, false));
  SolverSemiImplicit solver(scene.model);
  EXPECT_EQ(scene.of_steps(solver), 0);
}

TEST(StepAllocations, FeatherstoneTakesNone) {
  for (const int count : {1, 40}) {
    Scene scene(trees(count));
    SolverFeatherstone solver(scene.model, {.contact = ArticulationContact::Pgs});
    EXPECT_EQ(scene.of_steps(solver), 0) << count;
  }
}

TEST(StepAllocations, VbdTakesNone) {
  for (const VbdOptions& options : {VbdOptions{}, VbdOptions{.acceleration = 0.9f},
                                    VbdOptions{.initial_guess = VbdInitialGuess::Adaptive},
                                    VbdOptions{.tolerance = 1e-3f}, VbdOptions{.coarse = true}}) {
    Scene scene(EverythingScene::builder());
    SolverVBD solver(scene.model, options);
    EXPECT_EQ(scene.of_steps(solver), 0);
  }
}

TEST(StepAllocations, VbdOfParticlesOnBodiesTakesNone) {
  ModelBuilder builder = trees(2);
  builder.add_cloth_grid({.placement = {.pos = {-0.3f, -0.1f, 0.2f}},
                          .dim_x = 6,
                          .dim_y = 6,
                          .cell_x = 0.05,
                          .cell_y = 0.05,
                          .mass = 2e-3f,
                          .tri = {.ke = 1e3f, .ka = 1e3f},
                          .particle_radius = 0.02f});
  builder.color();
  Scene scene(builder);
  SolverVBD solver(scene.model);
  EXPECT_GT(scene.contacts->soft_contact_count.to_host()[0], 0);
  EXPECT_EQ(scene.of_steps(solver), 0);
}

// A step that a tape may record takes memory still: for the handles of the tensors and the lists of
// operands of its launches, as many for any model. The numbers may only fall, to 0 where launches
// are made once.
int64_t of_a_step(Scene& scene, SolverBase& solver) {
  return scene.of_steps(solver) / (2 * kSteps);
}

TEST(StepAllocations, DifferentiableSemiImplicitTakesHandlesOnly) {
  Scene scene(EverythingScene::builder(0.0f, false));
  diff::DiffSemiImplicitSolver solver(scene.model, {.enable_tetrahedra = true,
                                                    .enable_triangles = true,
                                                    .enable_springs = true,
                                                    .enable_bending = true});
  EXPECT_LE(of_a_step(scene, solver), 18);
}

TEST(StepAllocations, DifferentiableFeatherstoneTakesHandlesOnly) {
  for (const int count : {3, 40}) {
    Scene scene(trees(count));
    diff::DiffFeatherstoneSolver solver(scene.model, {.contact = ArticulationContact::Pgs});
    EXPECT_LE(of_a_step(scene, solver), 105) << count;
  }
}

TEST(StepAllocations, DifferentiableVbdTakesHandlesOnly) {
  Scene scene(EverythingScene::builder());
  diff::DiffSolverVBD solver(scene.model);
  EXPECT_LE(of_a_step(scene, solver), 7);
}

// The broad phases are those without a sweep. A thread may allocate when it first gets work, which
// may happen after the warm calls.
TEST(StepAllocations, CollisionTakesNone) {
  for (const ModelBuilder& builder : {EverythingScene::builder(), trees(3), trees(40)}) {
    Scene scene(builder);
    constexpr int kCalls = 64;
    const auto collide = [&] { scene.pipeline->collide(scene.a, *scene.contacts); };
    EXPECT_LT(allocations_of(collide, kCalls), kCalls);
  }
}

TEST(StepAllocations, AVbdStepAndItsAdjointTakeNone) {
  Scene scene(EverythingScene::builder());
  DifferentiableVbd step(scene.model);
  const auto n = static_cast<size_t>(scene.model->particle_count());
  const auto q = zeros<Vec3f>(n), qd = zeros<Vec3f>(n), q_bar = zeros<Vec3f>(n),
             qd_bar = zeros<Vec3f>(n), gravity_bar = zeros<Vec3f>(1),
             bar = rows_of(std::vector<Vec3f>(n, Vec3f{1.0f, 0.5f, 0.25f}));
  const VbdStepInputs in = {.q = scene.a.particle_q,
                            .qd = scene.a.particle_qd,
                            .f = zeros<Vec3f>(n),
                            .contacts = scene.contacts.get(),
                            .dt = kDt};
  EXPECT_EQ(allocations_of([&] { step.forward(in, q, qd); }), 0);
  EXPECT_EQ(allocations_of([&] {
              step.backward(in, bar, bar,
                            {.particle_q = q_bar, .particle_qd = qd_bar, .gravity = gravity_bar});
            }),
            0);
  EXPECT_NE(q_bar.data()[20].x, 0.0f);
}

}  // namespace
}  // namespace novaphy::testing
