// A rigid scene of Newton 1.8.0 (cpu, dt 1/960, 480 substeps) and its reference run.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <span>
#include <string>
#include <utility>

#include "novaphy/core/sim/model_builder.h"
#include "support/bits.h"
#include "support/npz.h"

namespace novaphy::testing {

class NewtonRigidScene {
 public:
  explicit NewtonRigidScene(std::string name) : name_(std::move(name)) {}

  const NpyArray& operator[](const std::string& array) const { return file_[name_ + "_" + array]; }
  float dt() const { return static_cast<float>((*this)["dt"].scalar<double>()); }

  // Builds the scene. Mass and inertia come from the file: Newton sums those of the shapes in
  // float32, with other rounding.
  std::shared_ptr<Model> model(Device device = Device::cpu()) const {
    ModelBuilder builder(Axis::Z, (*this)["model_gravity"].as<Vec3f>()[0]);
    const size_t bodies = (*this)["model_body_mass"].size();
    for (size_t b = 0; b < bodies; ++b)
      builder.add_body({.xform = (*this)["model_body_q"].as<Transformf>()[b],
                        .com = (*this)["model_body_com"].as<Vec3f>()[b],
                        .mass = (*this)["model_body_mass"].as<float>()[b],
                        .inertia = (*this)["model_body_inertia"].as<Mat33f>()[b],
                        .lock_inertia = true});
    const auto number = [&](const char* array, size_t s) {
      return (*this)[std::string("model_shape_") + array].as<float>()[s];
    };
    for (size_t s = 0; s < (*this)["model_shape_type"].size(); ++s)
      builder.add_shape({.body = (*this)["model_shape_body"].as<int32_t>()[s],
                         .type = static_cast<GeoType>((*this)["model_shape_type"].as<int32_t>()[s]),
                         .xform = (*this)["model_shape_transform"].as<Transformf>()[s],
                         .scale = (*this)["model_shape_scale"].as<Vec3f>()[s],
                         .cfg = ShapeConfig{.ke = number("material_ke", s),
                                            .kd = number("material_kd", s),
                                            .kf = number("material_kf", s),
                                            .ka = number("material_ka", s),
                                            .mu = number("material_mu", s),
                                            .margin = number("margin", s),
                                            .gap = number("gap", s)}});
    return builder.finalize(device);
  }
  // The state before substep t.
  void load(size_t t, SimState& state) const {
    const size_t n = state.body_q.rows();
    state.body_q.copy_from_host((*this)["body_q"].as<Transformf>().subspan(t * n, n));
    state.body_qd.copy_from_host((*this)["body_qd"].as<SpatialVectorf>().subspan(t * n, n));
  }
  ::testing::AssertionResult is_at(size_t t, const SimState& state) const {
    const size_t n = state.body_q.rows();
    const auto q = state.body_q.to_host();
    const auto qd = state.body_qd.to_host();
    return same_bits(std::span(q), (*this)["body_q"].as<Transformf>().subspan(t * n, n)) &&
                   same_bits(std::span(qd),
                             (*this)["body_qd"].as<SpatialVectorf>().subspan(t * n, n))
               ? ::testing::AssertionSuccess()
               : ::testing::AssertionFailure() << name_ << ", after substep " << t;
  }

 private:
  std::string name_;
  Npz file_ = golden("newton_rigid_scenes.npz");
};

}  // namespace novaphy::testing
