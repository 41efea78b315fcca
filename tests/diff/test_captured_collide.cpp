// The contact search inside captures, between the kernels of a rollout.
#include <gtest/gtest.h>

#include <optional>

#include "ball_scene.h"
#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/parallel.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/dynamics/semi_implicit/diff_particles.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"
#include "support/threads.h"

namespace novaphy::testing {
namespace {

using diff::DiffSemiImplicitSolver;
using diff::Trajectory;
using nova::ScopedCapture;

// Balls that fall: the contacts before and after a rollout differ.
struct Falling {
  explicit Falling(int balls)
      : model(make_ball_model(balls)),
        pipeline(model, {.soft_contact_margin = 0.3f}),
        solver(model, {.enable_static_contacts = true}),
        trajectory(model, 40),
        before(pipeline.contacts()),
        after(pipeline.contacts()) {}
  void advance() {
    pipeline.collide(trajectory.state(0), before);
    solver.rollout(trajectory, nullptr, nullptr, kBallDt);
    pipeline.collide(trajectory.state(40), after);
  }
  std::shared_ptr<Model> model;
  CollisionPipeline pipeline;
  DiffSemiImplicitSolver solver;
  Trajectory trajectory;
  Contacts before, after;
};

void expect_same(const Contacts& actual, const Contacts& expected) {
  EXPECT_EQ(actual.soft_contacts(), expected.soft_contacts());
  EXPECT_EQ(actual.soft_contact_tids.to_host(), expected.soft_contact_tids.to_host());
  EXPECT_EQ(actual.soft_contact_count.to_host(), expected.soft_contact_count.to_host());
}

TEST(CapturedCollide, FindsTheContactsOfEveryReplay) {
  const int threads_before = num_threads();
  for (const int balls : {1, 3000}) {
    Falling direct(balls), captured(balls);
    std::optional<ScopedCapture> scope(std::in_place);
    captured.advance();
    scope->end();
    EXPECT_EQ(captured.before.contact_generation.to_host()[0], 0) << "nothing ran yet";
    for (const int threads : {1, 2, 7}) {
      set_num_threads(threads);
      for (const float height : {0.5f, 1.0f}) {
        std::vector<Vec3f> q(static_cast<size_t>(balls), {0.0f, 1.5f, height});
        for (size_t k = 0; k < q.size(); ++k) q[k].z += 0.001f * static_cast<float>(k % 900);
        for (Falling* scene : {&direct, &captured})
          scene->trajectory.state(0).particle_q.copy_from_host(q);
        direct.advance();
        const uint64_t version = captured.after.soft_contact_particle.version();
        scope->graph()->launch();
        EXPECT_GT(captured.after.soft_contact_particle.version(), version);
        expect_same(captured.before, direct.before);
        expect_same(captured.after, direct.after);
        EXPECT_NE(direct.before.soft_contacts(), direct.after.soft_contacts());
      }
    }
    EXPECT_EQ(captured.after.contact_generation.to_host()[0], 6);
    set_num_threads(threads_before);
  }
}

// The recording has counted the pairs.
TEST(CapturedCollide, RefusesAReplayAfterShapesChangedWhatTheyMeet) {
  Falling scene(2);
  ScopedCapture scope;
  scene.pipeline.collide(scene.trajectory.state(0), scene.before);
  scope.end();
  scope.graph()->launch();
  scene.model->shape_flags.copy_from_host(scene.model->shape_flags.to_host());
  EXPECT_ERROR(scope.graph()->launch(), ErrorKind::Runtime, "modified after the capture");
}

// The geometry of contacts is a constant of the tape, as documented.
TEST(CapturedCollide, StandsOnATapeBesideLeaves) {
  Falling scene(2);
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  EXPECT_NO_THROW(scene.advance());
}

// Training on a rollout that finds new contacts in each substep.
struct Training {
  static constexpr int kSteps = 60;

  explicit Training(int balls) : model(make_ball_model(balls)), pipeline(model) {
    for (int t = 0; t <= kSteps; ++t) states.push_back(model->state());
    for (int t = 0; t < kSteps; ++t) contacts.push_back(pipeline.contacts());
    std::vector<Vec3f> q = states[0].particle_q.to_host();
    // Some balls rest on the ground, some hit the ground, some the wall, some both at once.
    for (size_t k = 0; k < q.size(); ++k)
      q[k] = {0.01f * static_cast<float>(k % 50), 1.4f + 0.03f * static_cast<float>(k % 9),
              0.05f + 0.04f * static_cast<float>(k % 13)};
    states[0].particle_q.copy_from_host(q);
    for (const Array* leaf : {static_cast<const Array*>(&states[0].particle_q),
                              static_cast<const Array*>(&states[0].particle_qd)})
      nova::grad_info(*leaf->range()).requires_grad = true;
    diff::model_shape_material_ke_tensor(*model, true);
  }
  nova::Tensor iterate() {
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    const nova::Operand forces = nova::operand_of(states[0].particle_f);
    for (size_t t = 0; t < kSteps; ++t) {
      pipeline.collide(states[t], contacts[t]);
      const nova::Incidence of_particles = nova::make_incidence(
          nova::operand_of(contacts[t].soft_contact_particle), model->particle_count());
      diff::step_particles(
          *model, contacts[t], of_particles, nova::operand_of(states[t].particle_q),
          nova::operand_of(states[t].particle_qd), forces, kNoKfBound, kBallDt,
          nova::operand_of(states[t + 1].particle_q), nova::operand_of(states[t + 1].particle_qd));
    }
    const nova::Tensor centroid =
        diff::particle_centroid_generated(diff::state_particle_q_tensor(states.back()));
    const nova::Tensor loss = diff::vec3_point_loss_generated(centroid, 0.0f, -2.0f, 1.5f);
    tape.backward(loss);
    return loss;
  }
  std::vector<float> gradients() const {
    std::vector<float> all;
    for (const nova::Tensor& leaf :
         {diff::state_particle_q_tensor(states[0]), diff::state_particle_qd_tensor(states[0]),
          diff::model_shape_material_ke_tensor(*model)}) {
      const std::vector<float> g = leaf.grad().to_host();
      all.insert(all.end(), g.begin(), g.end());
    }
    return all;
  }
  void zero() const {
    diff::state_particle_q_tensor(states[0]).zero_grad();
    diff::state_particle_qd_tensor(states[0]).zero_grad();
    diff::model_shape_material_ke_tensor(*model).zero_grad();
  }

  std::shared_ptr<Model> model;
  CollisionPipeline pipeline;
  std::vector<SimState> states;
  std::vector<Contacts> contacts;
};

TEST(CapturedCollide, InEverySubstepOfTrainingGivesTheGradientsOfStepByStep) {
  for (const int balls : {1, 300}) {
    Training direct(balls), captured(balls);
    std::optional<ScopedCapture> scope(std::in_place);
    const nova::Tensor loss = captured.iterate();
    scope->end();
    for (const int threads : {1, 2, 7}) {
      const Threads guard(threads);
      // Other velocities give other contacts than those during the capture.
      const std::vector<Vec3f> qd(static_cast<size_t>(balls),
                                  {0.0f, 1.0f + static_cast<float>(threads), -2.0f});
      for (Training* scene : {&direct, &captured}) {
        scene->states[0].particle_qd.copy_from_host(qd);
        scene->zero();
      }
      const nova::Tensor expected = direct.iterate();
      scope->graph()->launch();
      EXPECT_NE(direct.contacts.front().soft_contacts(), direct.contacts.back().soft_contacts());
      EXPECT_EQ(loss.item(), expected.item());
      const std::vector<float> g = direct.gradients();
      EXPECT_TRUE(same_bits<float>(captured.gradients(), g)) << threads << " threads";
      EXPECT_NE(g.back(), 0.0f) << "the stiffness acts";
    }
  }
}

}  // namespace
}  // namespace novaphy::testing
