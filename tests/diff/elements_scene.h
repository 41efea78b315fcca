// A small model with elements of all four kinds in a deformed, moving state; for tests.
#pragma once

#include <random>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::testing {

// A block of one cell, and beside it a cloth of two by two cells with springs and bending. All are
// so soft that differences of float32 forces are significant.
inline std::shared_ptr<Model> make_elements_model(Device device = Device::cpu()) {
  ModelBuilder builder(Axis::Z, 0.0f);
  builder.add_soft_grid({.cell_x = 0.8,
                         .cell_y = 0.9,
                         .cell_z = 1.0,
                         .density = 2.0,
                         .k_mu = 3.0f,
                         .k_lambda = 4.0f,
                         .k_damp = 0.7f,
                         .tri = {0.9f, 0.8f, 0.3f, 0.2f, 0.25f},
                         .edge = {0.4f, 0.15f}});
  builder.add_cloth_grid({.placement = {.pos = {1.5f, 0.0f, 0.5f}},
                          .dim_x = 2,
                          .dim_y = 2,
                          .cell_x = 0.7,
                          .cell_y = 0.6,
                          .mass = 0.5f,
                          .tri = {1.5f, 1.2f, 0.4f, 0.3f, 0.2f},
                          .edge = {0.6f, 0.2f},
                          .add_springs = true,
                          .spring_ke = 5.0f,
                          .spring_kd = 0.5f});
  auto model = builder.finalize(device);
  std::mt19937 random(11);
  std::uniform_real_distribution<float> u(-1.0f, 1.0f);
  std::vector<Vec3f> q = model->particle_q.to_host(), qd = q;
  for (Vec3f& x : q) x = x + Vec3f{0.15f * u(random), 0.15f * u(random), 0.15f * u(random)};
  for (Vec3f& v : qd) v = {u(random), u(random), u(random)};
  model->particle_q.copy_from_host(std::span<const Vec3f>(q));
  model->particle_qd.copy_from_host(std::span<const Vec3f>(qd));
  for (DeviceArray<float>* activation :
       {&model->particle_tri_activation, &model->particle_tet_activation}) {
    std::vector<float> values = activation->to_host();
    for (float& a : values) a = 0.1f * u(random);
    activation->copy_from_host(std::span<const float>(values));
  }
  return model;
}

inline nova::Tensor random_tensor(nova::Shape shape, uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> u(-1.0f, 1.0f);
  int64_t n = 1;
  for (int64_t d : shape) n *= d;
  std::vector<float> values(static_cast<size_t>(n));
  for (float& v : values) v = u(random);
  return nova::Tensor::from_host(std::span<const float>(values), std::move(shape));
}

}  // namespace novaphy::testing
