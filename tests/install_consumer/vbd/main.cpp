// Lets a cloth hang from one side. No other solver, no gradients: three libraries.
#include <iostream>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/vbd/solver_vbd.h"

int main() {
  novaphy::ModelBuilder builder;
  builder.add_cloth_grid({.dim_x = 8, .dim_y = 8, .mass = 0.01f, .fix_left = true});
  builder.color();
  const auto model = builder.finalize();

  novaphy::SolverVBD solver(model);
  novaphy::SimState a = model->state(), b = model->state();
  for (int i = 0; i < 60; ++i) {
    solver.step(a, b, nullptr, nullptr, 1.0f / 120.0f);
    std::swap(a, b);
  }
  const auto q = a.particle_q.to_host();
  std::cout << "the free corner is at z = " << q[8].z << "\n";
  return q[0].z == 0.0f && q[8].z < -0.5f && q[8].z > -1.5f ? 0 : 1;
}
