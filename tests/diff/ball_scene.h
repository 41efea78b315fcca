// The ball: one particle thrown at a wall over a ground plane. Newton's diffsim_ball, for tests.
#pragma once

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy::testing {

inline constexpr int kBallSteps = 36 * 8;
inline constexpr float kBallDt = static_cast<float>(1.0 / 60.0 / 8.0);
inline constexpr Vec3f kBallTarget{0.0f, -2.0f, 1.5f};
inline constexpr float kBallRate = 0.02f;

inline std::shared_ptr<Model> make_ball_model(int balls = 1, Device device = Device::cpu()) {
  ModelBuilder builder;
  for (int k = 0; k < balls; ++k)
    builder.add_particle({balls == 1 ? 0.0f : static_cast<float>(k % 7 - 3) * 0.05f, -0.5f, 1.0f},
                         {0.0f, 5.0f, -5.0f}, 1.0f);
  ShapeConfig cfg;
  cfg.ke = 1.0e4f;
  cfg.kd = 10.0f;
  cfg.kf = 0.0f;
  cfg.mu = 0.2f;
  Transformf wall;
  wall.p = {0.0f, 2.0f, 1.0f};
  builder.add_shape_box(-1, {.xform = wall, .hx = 1.0f, .hy = 0.25f, .hz = 1.0f, .cfg = cfg});
  builder.add_ground_plane({.cfg = cfg});
  auto model = builder.finalize(device, {.requires_grad = true});
  model->soft_contact_ke = 1.0e4f;
  model->soft_contact_kd = 10.0f;
  model->soft_contact_kf = 0.0f;
  model->soft_contact_mu = 0.2f;
  return model;
}

inline Contacts make_ball_contacts(const std::shared_ptr<Model>& model, const SimState& state) {
  CollisionPipeline pipeline(model, {.soft_contact_margin = 10.0f});
  Contacts contacts = pipeline.contacts();
  pipeline.collide(state, contacts);
  return contacts;
}

}  // namespace novaphy::testing
