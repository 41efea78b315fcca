// The checks that all solvers share, tested on a solver that uses only core.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/sim/solver_base.h"

namespace novaphy {
namespace {

// Moves every particle on with its velocity.
class Drift : public SolverBase {
 public:
  using SolverBase::SolverBase;
  void step(SimState& in, SimState& out, const Control* control, const Contacts* contacts,
            float dt) override {
    check_step("Drift.step", in, out, control, contacts, dt);
    out.particle_qd.assign(in.particle_qd);
    const Vec3f *q = in.particle_q.data(), *qd = in.particle_qd.data();
    Vec3f* const q_out = out.particle_q.mutable_data();
    for (size_t i = 0; i < in.particle_q.rows(); ++i) q_out[i] = q[i] + qd[i] * dt;
  }
};

std::shared_ptr<Model> particles(int count) {
  ModelBuilder builder;
  for (int i = 0; i < count; ++i)
    builder.add_particle({0.0f, 0.0f, 1.0f + static_cast<float>(i)}, {1.0f, 0.0f, 0.0f}, 1.0f);
  return builder.finalize();
}

TEST(SolverBase, SolverOfCoreAloneSteps) {
  const std::shared_ptr<Model> model = particles(2);
  Drift solver(model);
  SimState from = model->state(), to = model->state();
  solver.step(from, to, nullptr, nullptr, 0.5f);
  EXPECT_EQ(to.particle_q.to_host()[1], (Vec3f{0.5f, 0.0f, 2.0f}));
  EXPECT_FALSE(solver.supports_graph_capture());
}

TEST(SolverBase, RefusesWhatNoStepCanUse) {
  const std::shared_ptr<Model> model = particles(2), other = particles(2);
  EXPECT_THROW(Drift(nullptr), Error);
  Drift solver(model);
  SimState from = model->state(), to = model->state(), strange = other->state();
  EXPECT_THROW(solver.step(from, to, nullptr, nullptr, 0.0f), Error);
  EXPECT_THROW(solver.step(from, to, nullptr, nullptr, NAN), Error);
  EXPECT_THROW(solver.step(from, from, nullptr, nullptr, 0.5f), Error);
  EXPECT_THROW(solver.step(from, strange, nullptr, nullptr, 0.5f), Error);
  to.particle_q = from.particle_q;
  EXPECT_THROW(solver.step(from, to, nullptr, nullptr, 0.5f), Error);
}

}  // namespace
}  // namespace novaphy
