// A scene from a golden file of Newton: its model, and the run stored in the file.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "support/bits.h"
#include "support/npz.h"

namespace novaphy::testing {

// Builds the scene with ModelBuilder from the file's description of Newton's model.
inline std::shared_ptr<Model> golden_model(const Npz& file) {
  ModelBuilder builder(Axis::Z, file["model_gravity"].as<Vec3f>()[0]);
  builder.add_particles(file["model_particle_q"].as<Vec3f>(), file["model_particle_qd"].as<Vec3f>(),
                        file["model_particle_mass"].as<float>(),
                        file["model_particle_radius"].as<float>(),
                        file["model_particle_flags"].as<int32_t>());
  const auto shape = [&](const char* name) -> const NpyArray& {
    return file[std::string("model_shape_") + name];
  };
  for (size_t s = 0; s < shape("type").size(); ++s) {
    const ShapeConfig cfg = {.ke = shape("material_ke").as<float>()[s],
                             .kd = shape("material_kd").as<float>()[s],
                             .kf = shape("material_kf").as<float>()[s],
                             .mu = shape("material_mu").as<float>()[s],
                             .margin = shape("margin").as<float>()[s],
                             .has_particle_collision = has_flag(shape("flags").as<int32_t>()[s],
                                                                ShapeFlags::COLLIDE_PARTICLES)};
    builder.add_shape({.body = shape("body").as<int32_t>()[s],
                       .type = static_cast<GeoType>(shape("type").as<int32_t>()[s]),
                       .xform = shape("transform").as<Transformf>()[s],
                       .scale = shape("scale").as<Vec3f>()[s],
                       .cfg = cfg});
  }
  auto model = builder.finalize(Device::cpu());
  model->particle_max_velocity = file["model_particle_max_velocity"].scalar<float>();
  model->soft_contact_ke = file["model_soft_contact_ke"].scalar<float>();
  model->soft_contact_kd = file["model_soft_contact_kd"].scalar<float>();
  model->soft_contact_kf = file["model_soft_contact_kf"].scalar<float>();
  model->soft_contact_mu = file["model_soft_contact_mu"].scalar<float>();
  return model;
}

// Every array "model_<name>" of the file that the model has too is equal in all bits.
inline void expect_model_arrays_equal(const Npz& file, const Model& model, size_t at_least) {
  size_t compared = 0;
  for_each_field(model, [&](const FieldInfo& info, const Array& array) {
    const std::string name = "model_" + std::string(info.name);
    if (!file.contains(name) || array.rows() == 0) return;
    std::vector<unsigned char> bytes(array.bytes());
    array.copy_to_host(bytes.data(), bytes.size());
    EXPECT_EQ(bytes, file[name].bytes) << name;
    ++compared;
  });
  EXPECT_GE(compared, at_least);
}

struct GoldenRun {
  std::vector<Vec3f> q, qd, f;          // {steps + 1, n}
  std::vector<SoftContact> contacts;    // made from state 0
  std::vector<int32_t> contact_counts;  // by step
};

// Runs the file's steps, with the contacts of state 0 or new ones in every step.
inline GoldenRun golden_run(const std::shared_ptr<Model>& model, float gap, float dt, int steps,
                            bool regenerate) {
  CollisionPipeline pipeline(model, {.soft_contact_margin = gap});
  SolverSemiImplicit solver(model);
  Contacts contacts = pipeline.contacts();
  const Control control = model->control();
  std::vector<SimState> states;
  for (int i = 0; i <= steps; ++i) states.push_back(model->state());
  GoldenRun run;
  for (size_t i = 0; i < static_cast<size_t>(steps); ++i) {
    states[i].clear_forces();
    if (i == 0 || regenerate) pipeline.collide(states[i], contacts);
    if (i == 0) run.contacts = contacts.soft_contacts();
    run.contact_counts.push_back(contacts.soft_contact_count.to_host()[0]);
    solver.step(states[i], states[i + 1], &control, &contacts, dt);
  }
  for (const SimState& state : states) {
    const auto append = [](std::vector<Vec3f>& to, const DeviceArray<Vec3f>& from) {
      const auto values = from.to_host();
      to.insert(to.end(), values.begin(), values.end());
    };
    append(run.q, state.particle_q);
    append(run.qd, state.particle_qd);
    append(run.f, state.particle_f);
  }
  return run;
}

inline std::vector<SoftContact> golden_contacts(const Npz& file) {
  std::vector<SoftContact> contacts(file["contact_particle"].size());
  for (size_t i = 0; i < contacts.size(); ++i) {
    contacts[i] = {file["contact_particle"].as<int32_t>()[i],
                   file["contact_shape"].as<int32_t>()[i], file["contact_body_pos"].as<Vec3f>()[i],
                   file["contact_body_vel"].as<Vec3f>()[i], file["contact_normal"].as<Vec3f>()[i]};
  }
  return contacts;
}

}  // namespace novaphy::testing
