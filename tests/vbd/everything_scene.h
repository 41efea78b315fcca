// A scene for derivatives of a step of VBD.
#pragma once

#include <cmath>
#include <memory>
#include <span>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/vbd/differentiable_vbd.h"

namespace novaphy::testing {

// rows_of copies values to an array on the CPU. zeros makes an array of zeros on the CPU.
template <class T>
DeviceArray<T> rows_of(std::span<const T> values) {
  return DeviceArray<T>::from_host(values, Device::cpu());
}
template <class T>
DeviceArray<T> rows_of(const std::vector<T>& values) {
  return rows_of(std::span<const T>(values));
}
template <class T>
DeviceArray<T> zeros(size_t rows) {
  return DeviceArray<T>(rows, Device::cpu());
}

// A cloth, a block, a spring and two ropes with everything that has a derivative: damping,
// activations, bent edges, a contact with friction.
struct EverythingScene {
  std::shared_ptr<Model> model;
  std::unique_ptr<Contacts> contacts;
  std::vector<Vec3f> q, qd, f, w_q, w_qd, targets;  // empty targets: kinematic particles stay
  Control control;
  std::vector<Vec4f> last;  // none: there was no step before

  explicit EverythingScene(float kd = 0.0f) : model(make(kd)), control(model->control()) {
    CollisionPipeline pipeline(model, {.soft_contact_margin = 0.05f});
    contacts = std::make_unique<Contacts>(pipeline.contacts());
    pipeline.collide(model->state(), *contacts);
    q = model->particle_q.to_host();
    const size_t n = q.size();
    for (size_t p = 0; p < n; ++p) {
      const auto wave = [p](float a) { return std::sin(a * static_cast<float>(p + 1)); };
      qd.push_back({0.5f * wave(1.3f), 0.4f * wave(2.1f), -0.5f});
      f.push_back({0.01f * wave(0.7f), 0.0f, 0.02f * wave(1.9f)});
      w_q.push_back({wave(3.1f), wave(1.7f), wave(2.3f)});
      w_qd.push_back({0.01f * wave(0.9f), 0.01f * wave(4.1f), 0.01f * wave(5.3f)});
    }
    control.particle_tri_activation.fill(0.05f);
    control.particle_tet_activation.fill(-0.03f);
  }
  static ModelBuilder builder(float kd = 0.0f, bool ropes = true) {
    ModelBuilder b;
    b.add_cloth_grid({.placement = {.pos = {0.0f, 0.0f, 0.5f}},
                      .dim_x = 4,
                      .dim_y = 3,
                      .cell_x = 0.1,
                      .cell_y = 0.1,
                      .mass = 0.02f,
                      .fix_left = true,
                      .tri = {.ke = 20.0f, .ka = 30.0f, .kd = 0.05f},
                      .edge = {.ke = 0.5f, .kd = 0.01f}});
    b.add_soft_grid({.placement = {.pos = {0.0f, 0.0f, 0.12f}},
                     .dim_x = 2,
                     .dim_y = 2,
                     .dim_z = 2,
                     .density = 100.0,
                     .k_mu = 300.0f,
                     .k_lambda = 500.0f,
                     .k_damp = 2.0f,
                     .particle_radius = 0.1f});
    b.add_spring(7, 30, 40.0f, 0.5f);
    if (ropes) {
      b.add_spring(4, 40, 30.0f, 0.4f, 0.0f, true);  // taut
      b.add_spring(2, 26, 30.0f, 0.4f, 0.0f, true);  // slack
    }
    b.add_ground_plane({.cfg = ShapeConfig{.ke = 100.0f, .kd = kd, .mu = 0.5f}});
    for (size_t p = 0; p < b.particle_q.size(); ++p)
      b.particle_q[p].z += 0.02f * std::sin(2.0f * static_cast<float>(p));
    b.color();
    return b;
  }
  static std::shared_ptr<Model> make(float kd = 0.0f, Device device = Device::cpu()) {
    auto model = builder(kd).finalize(device);
    model->soft_contact_ke = 100.0f;
    model->soft_contact_kd = kd;
    return model;
  }
  VbdStepInputs inputs() const {
    return {.q = rows_of(q),
            .qd = rows_of(qd),
            .f = rows_of(f),
            .activations = {control.particle_tri_activation, control.particle_tet_activation},
            .contacts = contacts.get(),
            .targets = rows_of(targets),
            .dt = 1.0f / 60.0f,
            .last_velocity = rows_of(last)};
  }
  double loss(DifferentiableVbd& step) const {
    const auto q_rows = zeros<Vec3f>(q.size()), qd_rows = zeros<Vec3f>(q.size());
    step.forward(inputs(), q_rows, qd_rows);
    const std::vector<Vec3f> q_out = q_rows.to_host(), qd_out = qd_rows.to_host();
    double sum = 0.0;
    for (size_t p = 0; p < q.size(); ++p) {
      const Vec3f &a = q_out[p], &u = w_q[p], &b = qd_out[p], &v = w_qd[p];
      sum += static_cast<double>(a.x) * u.x + static_cast<double>(a.y) * u.y +
             static_cast<double>(a.z) * u.z + static_cast<double>(b.x) * v.x +
             static_cast<double>(b.y) * v.y + static_cast<double>(b.z) * v.z;
    }
    return sum;
  }
};

}  // namespace novaphy::testing
