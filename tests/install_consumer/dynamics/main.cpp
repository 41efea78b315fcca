// Drops a ball and lets it come to rest: the forward engine.
#include <cmath>
#include <iostream>
#include <utility>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"

int main() {
  novaphy::ModelBuilder builder;
  builder.add_particle({0.0f, 0.0f, 1.0f}, {0.0f, 0.0f, 0.0f}, 1.0f, 0.1f);
  builder.add_ground_plane();
  const auto model = builder.finalize();

  novaphy::SolverSemiImplicit solver(model);
  novaphy::CollisionPipeline pipeline(model);
  novaphy::Contacts contacts = pipeline.contacts();
  novaphy::SimState now = model->state(), next = model->state();
  for (int step = 0; step < 4000; ++step) {
    pipeline.collide(now, contacts);
    now.clear_forces();
    solver.step(now, next, nullptr, &contacts, 1e-3f);
    std::swap(now, next);
  }
  const float height = now.particle_q.to_host()[0].z;
  std::cout << "at rest at z = " << height << " m\n";
  return std::fabs(height - 0.1f) < 0.02f ? 0 : 1;
}
