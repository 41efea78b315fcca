// The search for contacts inside captures, between the kernels of a rollout.
#include <gtest/gtest.h>

#include <optional>

#include "ball_scene.h"
#include "novaphy/core/parallel.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"

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

// The pairs were counted when it was recorded.
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

}  // namespace
}  // namespace novaphy::testing
