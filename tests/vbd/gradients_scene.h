// All gradients of a rollout of DiffSolverVBD, on any device.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/trajectory.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "novaphy/vbd/diff_vbd.h"
#include "vbd/everything_scene.h"

namespace novaphy::testing {

struct VbdGradientRun {
  diff::DiffVbdOptions options = {.iterations = 4};
  int32_t steps = 3;
  int32_t checkpoint = 1;
  int32_t replays = 0;  // 0: direct
  float kd = 1.0f;      // damping of contacts
  bool contacts = true, targets = true, conflicts = false;
  std::vector<std::string> only = {};  // gradients; none: all
};
using NamedValues = std::vector<std::pair<std::string, std::vector<float>>>;

inline NamedValues vbd_gradients(Device device, const VbdGradientRun& how) {
  using nova::Tensor;
  const auto model = EverythingScene::make(how.kd, device);
  if (how.conflicts) {
    std::vector<int32_t> colors = model->particle_colors.to_host();
    for (int32_t& color : colors) color /= 2;
    model->particle_colors.copy_from_host(std::span<const int32_t>(colors));
  }
  CollisionPipeline pipeline(model, {.soft_contact_margin = 0.05f});
  diff::DiffSolverVBD solver(model, how.options);
  Trajectory trajectory(model, how.steps, true, how.checkpoint);
  Control control = model->control();
  control.particle_tri_activation.fill(0.05f);
  control.particle_tet_activation.fill(-0.03f);
  std::vector<Vec3f> velocities, forces, goals;
  for (int32_t p = 0; p < model->particle_count(); ++p) {
    const auto k = static_cast<float>(p);
    velocities.push_back({0.1f * k - 2.0f, 0.4f, -0.5f - 0.01f * k});
    forces.push_back({0.01f, 0.001f * k, -0.02f});
  }
  const int32_t held = solver.kinematic_count();
  for (int32_t k = 0; k < how.steps * held; ++k)
    goals.push_back({0.002f * static_cast<float>(k), 0.1f * static_cast<float>(k % held), 0.51f});
  const auto targets = DeviceArray<Vec3f>::from_host(goals, device);
  SimState& start = trajectory.state(0);
  start.particle_qd.copy_from_host(std::span<const Vec3f>(velocities));
  start.particle_f.copy_from_host(std::span<const Vec3f>(forces));

  std::vector<std::pair<std::string, Tensor>> leaves;
  const auto leaf = [&](const std::string& name, const Array& array) {
    bool wanted = how.only.empty();
    for (const std::string& one : how.only) wanted = wanted || one == name;
    if (wanted) leaves.emplace_back(name, Tensor::view(array, true));
  };
  leaf("particle_q", start.particle_q);
  leaf("particle_qd", start.particle_qd);
  leaf("particle_f", start.particle_f);
  if (how.targets) leaf("targets", targets);
  leaf("tri_activation", control.particle_tri_activation);
  leaf("tet_activation", control.particle_tet_activation);
#define NOVAPHY_LEAF(name) leaf(#name, model->name);
  NOVAPHY_LEAF(gravity)
  NOVAPHY_LEAF(particle_mass)
  NOVAPHY_LEAF(particle_spring_stiffness)
  NOVAPHY_LEAF(particle_spring_damping)
  NOVAPHY_LEAF(particle_spring_rest_length)
  NOVAPHY_LEAF(particle_tri_pose)
  NOVAPHY_LEAF(particle_tri_area)
  NOVAPHY_LEAF(particle_tri_material)
  NOVAPHY_LEAF(particle_edge_material)
  NOVAPHY_LEAF(particle_edge_rest_angle)
  NOVAPHY_LEAF(particle_edge_rest_length)
  NOVAPHY_LEAF(particle_tet_pose)
  NOVAPHY_LEAF(particle_tet_material)
  if (how.contacts) {
    NOVAPHY_LEAF(particle_radius)
    NOVAPHY_LEAF(shape_margin)
    NOVAPHY_LEAF(shape_material_ke)
    NOVAPHY_LEAF(shape_material_kd)
    NOVAPHY_LEAF(shape_material_mu)
  }
#undef NOVAPHY_LEAF

  RolloutOptions options;
  if (how.targets) options.targets = &targets;
  if (how.contacts) options.pipeline = &pipeline;
  const SimState& last = trajectory.any_state(how.steps);
  Tensor loss;
  {
    nova::ScopedCapture scope;
    if (how.replays == 0) scope.end();
    {
      nova::Tape tape;
      const nova::TapeScope on_tape(tape);
      solver.reset();
      solver.rollout(trajectory, &control, nullptr, 1.0f / 120.0f, options);
      const Tensor q = diff::state_particle_q_tensor(last),
                   qd = diff::state_particle_qd_tensor(last);
      loss = nova::add(nova::sum(nova::mul(q, q)), nova::sum(nova::mul(qd, qd)));
      tape.backward(loss);
    }
    scope.end();
    for (int32_t k = 0; k < how.replays; ++k) scope.graph()->launch();
  }
  NamedValues all;
  all.emplace_back("loss", loss.to_host());
  all.emplace_back("particle_q at the end", diff::state_particle_q_tensor(last).to_host());
  for (const auto& [name, tensor] : leaves) all.emplace_back(name, tensor.grad().to_host());
  const diff::DiffVbdGradientInfo info = solver.gradient_info();
  all.emplace_back(info.label, std::vector<float>{static_cast<float>(info.primal.relative),
                                                  static_cast<float>(info.primal.force),
                                                  static_cast<float>(info.primal.iterations),
                                                  static_cast<float>(info.linear_residual),
                                                  static_cast<float>(info.linear_sweeps)});
  return all;
}

}  // namespace novaphy::testing
