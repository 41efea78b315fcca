// The first gradient from C++: how the place where a thrown ball is after half a second depends on the throw.
#include <cmath>
#include <iostream>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/nova/tape.h"

int main() {
  namespace diff = novaphy::diff;
  novaphy::ModelBuilder builder;
  builder.add_particle({0.0f, 0.0f, 1.0f}, {0.0f, 5.0f, 0.0f}, 1.0f);
  const auto model = builder.finalize(novaphy::default_device(), {.requires_grad = true});

  diff::DiffSemiImplicitSolver solver(model);
  diff::Trajectory trajectory(model, 500);
  const nova::Tensor velocity = diff::state_particle_qd_tensor(trajectory.state(0), true);

  nova::Tape tape;
  const nova::TapeScope scope(tape);
  solver.rollout(trajectory, nullptr, nullptr, 1e-3f);
  const nova::Tensor end = diff::state_particle_q_tensor(trajectory.state(500));
  const nova::Tensor loss = diff::particle_point_loss_generated(end, 0, 0.0f, 3.0f, 0.0f);
  tape.backward(loss);

  // Free flight: d(loss)/d(vy) = 2 (y - 3) t.
  const std::vector<float> gradient = velocity.grad().to_host();
  const float expected = 2.0f * (end.to_host()[1] - 3.0f) * 0.5f;
  std::cout << "loss " << loss.item() << ", d(loss)/d(vy) = " << gradient[1] << ", by hand " << expected << "\n";
  return std::fabs(gradient[1] - expected) < 1e-3f ? 0 : 1;
}
