// Newton's diffsim_soft_body: a block of tetrahedra thrown at a wall over a ground plane, for
// tests.
#pragma once

#include "novaphy/core/sim/model_builder.h"

namespace novaphy::testing {

inline constexpr int kSoftBodySteps = 60 * 16;
inline constexpr int kSoftBodySubsteps = 16;
inline constexpr float kSoftBodyDt = static_cast<float>(1.0 / 60.0 / 16.0);
inline constexpr float kSoftBodyGap = 0.001f;
inline constexpr Vec3f kSoftBodyTarget{0.0f, -1.0f, 1.5f};

inline std::shared_ptr<Model> make_soft_body_model(int cells = 2, Device device = Device::cpu()) {
  ModelBuilder builder;
  builder.default_particle_radius = 0.0005f;
  const double cell = 0.1, particles = (cells + 1.0) * (cells + 1.0) * (cells + 1.0);
  const double young = 1.5e4, poisson = 0.3;
  const double density = 0.2 / particles / (cell * cell * cell);
  builder.add_soft_grid(
      {.placement = {.pos = {static_cast<float>(-0.5 * cell * cells), -0.5f, 1.0f},
                     .vel = {0.0f, 6.0f, -6.0f}},
       .dim_x = cells,
       .dim_y = cells,
       .dim_z = cells,
       .cell_x = cell,
       .cell_y = cell,
       .cell_z = cell,
       .density = density,
       .k_mu = static_cast<float>(0.5 * young / (1.0 + poisson)),
       .k_lambda = static_cast<float>(young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))),
       .k_damp = 0.0f,
       .tri = {1e-4f, 1e-4f, 1e-4f, 0.0f, 0.0f}});
  // In Newton each particle has the mass of a cell.
  for (float& mass : builder.particle_mass) mass = static_cast<float>(cell * cell * cell * density);
  const ShapeConfig cfg = {.ke = 1e3f, .kd = 1.0f, .kf = 0.0f, .mu = 0.2f};
  builder.add_shape_box(-1, {.xform = {{0.0f, 2.0f, 1.0f}, Quatf::identity()},
                             .hx = 1.0f,
                             .hy = 0.25f,
                             .hz = 1.0f,
                             .cfg = cfg});
  builder.add_ground_plane({.cfg = cfg});
  auto model = builder.finalize(device, {.requires_grad = true});
  model->soft_contact_ke = 1e3f;
  model->soft_contact_kd = 1.0f;
  model->soft_contact_kf = 0.0f;
  model->soft_contact_mu = 0.2f;
  model->soft_contact_restitution = 1.0f;
  return model;
}

// The mean as in the golden file: summed in order, then divided by the count.
inline Vec3f centroid(std::span<const Vec3f> q) {
  Vec3f sum{};
  for (const Vec3f& x : q) sum = sum + x;
  return sum / static_cast<float>(q.size());
}

}  // namespace novaphy::testing
