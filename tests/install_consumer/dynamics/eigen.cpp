// Solves the equation of motion of an arm by Eigen, on the memory of what the engine returns.
#include <Eigen/Dense>
#include <iostream>
#include <span>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/featherstone/articulation_functions.h"

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// A matrix of one of the articulations.
Eigen::Map<const Matrix> mapped(const novaphy::ArticulationMatrices& all, int64_t articulation) {
  return {all.values.data() + articulation * all.rows * all.columns, all.rows, all.columns};
}
Eigen::Map<const Eigen::VectorXf> mapped(const std::vector<float>& dofs) {
  return {dofs.data(), static_cast<Eigen::Index>(dofs.size())};
}

int main() {
  novaphy::ModelBuilder builder;
  std::vector<int32_t> joints;
  int32_t parent = -1;
  for (int k = 0; k < 3; ++k) {
    const novaphy::Mat33f inertia = {
        {{0.02f, 0.0f, 0.0f}, {0.0f, 0.02f, 0.0f}, {0.0f, 0.0f, 0.01f}}};
    const int32_t link =
        builder.add_link({.com = {0.0f, 0.0f, -0.2f}, .mass = 1.0f, .inertia = inertia});
    novaphy::Transformf at = novaphy::Transformf::identity();
    at.p = {0.0f, 0.0f, parent < 0 ? 0.0f : -0.4f};
    const novaphy::Vec3f axis = {k == 1 ? 1.0f : 0.0f, k == 1 ? 0.0f : 1.0f, 0.0f};
    joints.push_back(builder.add_joint_revolute(
        parent, link, {.parent_xform = at, .dof = novaphy::JointDofConfig{.axis = axis}}));
    parent = link;
  }
  builder.add_articulation(joints);
  builder.joint_q = {0.3f, -0.5f, 0.8f};
  builder.joint_qd = {0.1f, 0.4f, -0.2f};
  const auto model = builder.finalize();
  const novaphy::SimState state = model->state();

  // M qdd + b = tau, with Eigen's vector as the engine's argument.
  const novaphy::ArticulationMatrices mass = novaphy::eval_mass_matrix(*model, state);
  const std::vector<float> bias = novaphy::eval_bias(*model, state);
  const Eigen::VectorXf tau = Eigen::Vector3f(0.5f, -1.0f, 0.25f);
  const Eigen::VectorXf qdd = mapped(mass, 0).llt().solve(tau - mapped(bias));
  const std::vector<float> found = novaphy::eval_forward_dynamics(
      *model, state, std::span(tau.data(), static_cast<size_t>(tau.size())));
  const float error = (qdd - mapped(found)).norm() / qdd.norm();
  std::cout << "accelerations " << qdd.transpose() << " rad/s^2, off by " << error << "\n";
  return error < 1e-5f ? 0 : 1;
}
