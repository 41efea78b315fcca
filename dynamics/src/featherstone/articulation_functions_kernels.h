// Kernels of the dynamics functions (articulation_functions.h), with a row per articulation. The
// freestanding algorithms read the arrays of models and states, on the host and on devices.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/arguments.h"
#include "novaphy/dynamics/articulation/derivatives.h"

namespace novaphy {

enum class ArticulationFunction : int32_t {
  InverseDynamics,
  Bias,
  ForwardDynamics,
  MassMatrix,
  Jacobian,
  InverseDynamicsDerivatives,
  ForwardDynamicsDerivatives,
  CenterOfMass,
  Energy,
};

// Arguments. given {dofs}: the argument of a function, if it has one. results: up to three outputs,
// either rows of dofs or matrices {articulations, matrix_rows, matrix_columns} padded with zeros.
// CenterOfMass has three numbers per articulation, Energy has two. status: per articulation 0, or 1
// + the dof at which M is not positive definite. stride: floats of the workspace of an
// articulation.
struct ArticulationFunctionArguments {
  NOVAPHY_ARGUMENTS(Given<ArticulationRows> rows; Given<articulation::Link> links;
                    Given<int32_t> dof_parent; Given<Transformf> X_p, X_c; Given<Vec3f> axis;
                    Given<float> mass; Given<Vec3f> com; Given<Mat33f> inertia;
                    Given<Vec3f> gravity; Given<float> armature, q, qd, given;
                    Each<Writes<float>, 3> results; Writes<int32_t> status; Writes<float> workspace;
                    Number<int64_t> stride, function, include_armature;
                    Number<int64_t> matrix_rows, matrix_columns;)
};

inline int64_t function_workspace_bytes(ArticulationFunction f, int64_t links, int64_t dofs) {
  using namespace articulation;
  const int64_t own =
      workspace_bytes<float>(static_cast<int32_t>(links), static_cast<int32_t>(dofs));
  if (f != ArticulationFunction::InverseDynamicsDerivatives &&
      f != ArticulationFunction::ForwardDynamicsDerivatives)
    return own;
  return own + dofs * static_cast<int64_t>(sizeof(DofMotion<float>)) +
         links * static_cast<int64_t>(sizeof(MotionBias<float>)) +
         3 * dofs * dofs * static_cast<int64_t>(sizeof(float));
}

// Evaluates the functions for one articulation.
class ArticulationEvaluation {
 public:
  ArticulationEvaluation(const ArticulationFunctionArguments& arguments, int64_t row)
      : a(arguments), i(row) {
    const ArticulationRows& rows = a.rows[i];
    tree.link_count = rows.link_count;
    tree.dof_count = rows.dof_count;
    tree.links = a.links + rows.first_link;
    tree.dof_parent = a.dof_parent + rows.first_dof;
    tree.first_dof = rows.first_dof;
    tree.X_p = a.X_p;
    tree.X_c = a.X_c;
    tree.axis = a.axis;
    tree.mass = a.mass;
    tree.com = a.com;
    tree.inertia = a.inertia;
    tree.gravity = a.gravity[rows.world];
    tree.mimics = rows.mimics;
    tree.joints_in_a_row = rows.joints_in_a_row;
    unsigned char* const memory = reinterpret_cast<unsigned char*>(a.workspace + i * a.stride);
    ws = articulation::make_workspace<float>(memory, tree.link_count, tree.dof_count);
    behind = memory + articulation::workspace_bytes<float>(tree.link_count, tree.dof_count);
    q = a.q;
    qd = a.qd + tree.first_dof;
    armature = a.armature + tree.first_dof;
    a.status[i] = 0;
    articulation::kinematics(tree, q, ws);
    articulation::clear_wrenches(tree, ws);
  }

  void inverse_dynamics(const float* qdd, float* tau) {
    articulation::inverse_dynamics(tree, qd, qdd, ws, tau);
    for (int32_t k = 0; qdd != nullptr && k < tree.dof_count; ++k) tau[k] += armature[k] * qdd[k];
  }
  // Computes ws.qdd = M^-1 (tau - bias), and factors M. Returns false if M is not positive
  // definite.
  bool accelerate(const float* tau) {
    articulation::bias_forces(tree, qd, ws);
    for (int32_t k = 0; k < tree.dof_count; ++k) {
      ws.rhs[k] = tau[k] - ws.bias[k];
      ws.diagonal[k] = armature[k];
      ws.cone[k] = 0.0f;
    }
    const int32_t dof = articulation::factor(tree, q, ws);
    if (dof >= 0) a.status[i] = 1 + tree.first_dof + dof;
    if (dof >= 0) return false;
    articulation::find_accelerations(tree, qd, ws);
    return true;
  }
  // Writes both triangles of the mass matrix H.
  void write_mass_matrix(int result, bool include_armature) {
    articulation::mass_matrix(tree, ws);
    float* const to = cleared(result);
    const int64_t n = tree.dof_count;
    for (int32_t k = 0; k < n; ++k)
      for (int32_t j = k; j >= 0; j = tree.dof_parent[j])
        to[k * a.matrix_columns + j] = to[j * a.matrix_columns + k] =
            ws.matrix[k * n + j] + (j == k && include_armature ? armature[k] : 0.0f);
  }
  void write_jacobian() {
    float* row = cleared(0);
    for (int32_t link = 0; link < tree.link_count; ++link) {
      if (tree.links[link].body < 0) continue;
      for (int32_t on = link; on >= 0; on = tree.links[on].parent) {
        const int32_t first = articulation::local_dof(tree, tree.links[on]);
        for (int32_t k = first; k < first + tree.links[on].dofs; ++k) {
          const SpatialVectorf m = math::motion_at(ws.axes[k], ws.links[link].com);
          const float column[6] = {m.linear.x,  m.linear.y,  m.linear.z,
                                   m.angular.x, m.angular.y, m.angular.z};
          for (int64_t r = 0; r < 6; ++r) row[r * a.matrix_columns + k] = column[r];
        }
      }
      row += 6 * a.matrix_columns;
    }
  }
  // Returns the derivatives of inverse dynamics, first d tau / d q and then d tau / d qd, in memory
  // behind the workspace.
  float* derivatives(const float* qdd) {
    articulation::DerivativeWorkspace<float> memory;
    memory.motions = reinterpret_cast<articulation::DofMotion<float>*>(behind);
    memory.biases =
        reinterpret_cast<articulation::MotionBias<float>*>(memory.motions + tree.dof_count);
    float* const dq = reinterpret_cast<float*>(memory.biases + tree.link_count);
    articulation::inverse_dynamics(tree, qd, qdd, ws, ws.bias);
    articulation::composite_inertias(tree, ws);
    articulation::inverse_dynamics_derivatives(tree, qd, qdd, ws, memory, dq,
                                               dq + tree.dof_count * tree.dof_count);
    return dq;
  }
  void write_derivatives(const float* dq, int count) {
    const int64_t n = tree.dof_count;
    for (int result = 0; result < count; ++result) {
      float* const to = cleared(result);
      for (int64_t r = 0; r < n; ++r)
        for (int64_t c = 0; c < n; ++c) to[r * a.matrix_columns + c] = dq[(result * n + r) * n + c];
    }
  }

  // Runs function F. As a template, each function has its own code on the host.
  template <ArticulationFunction F>
  void run() {
    using Function = ArticulationFunction;
    if constexpr (F == Function::InverseDynamics) inverse_dynamics(given(), of_dofs());
    if constexpr (F == Function::Bias) inverse_dynamics(nullptr, of_dofs());
    if constexpr (F == Function::ForwardDynamics) {
      const bool done = accelerate(given());
      for (int32_t k = 0; k < tree.dof_count; ++k) of_dofs()[k] = done ? ws.qdd[k] : 0.0f;
    }
    if constexpr (F == Function::MassMatrix) write_mass_matrix(0, a.include_armature.value != 0);
    if constexpr (F == Function::Jacobian) write_jacobian();
    if constexpr (F == Function::InverseDynamicsDerivatives) {
      write_derivatives(derivatives(given()), 2);
      write_mass_matrix(2, true);
    }
    if constexpr (F == Function::ForwardDynamicsDerivatives) {
      if (!accelerate(given())) return;
      float* const dq = derivatives(ws.qdd);
      const int64_t square = static_cast<int64_t>(tree.dof_count) * tree.dof_count;
      articulation::forward_dynamics_derivatives(tree, ws, dq, dq + square, dq + 2 * square);
      write_derivatives(dq, 3);
    }
    if constexpr (F == Function::CenterOfMass) {
      const Vec3f com = articulation::center_of_mass(tree, ws).com;
      float* const to = a.results[0];
      reinterpret_cast<Vec3f*>(to)[i] = com;
    }
    if constexpr (F == Function::Energy) {
      articulation::link_motions(tree, qd, ws);
      const articulation::TreeEnergy<float> energy = articulation::energy(tree, ws);
      a.results[0][2 * i] = energy.kinetic;
      a.results[0][2 * i + 1] = energy.potential;
    }
  }

 private:
  const float* given() const { return a.given + tree.first_dof; }
  float* of_dofs() const { return a.results[0] + tree.first_dof; }
  float* cleared(int result) const {
    const int64_t size = a.matrix_rows * a.matrix_columns;
    float* const to = a.results[result] + i * size;
    for (int64_t k = 0; k < size; ++k) to[k] = 0.0f;
    return to;
  }

  const ArticulationFunctionArguments& a;
  int64_t i;
  articulation::Tree<float> tree;
  articulation::Workspace<float> ws;
  unsigned char* behind;  // memory behind the workspace
  const float *q, *qd, *armature;
};

NOVAPHY_ROW_KERNEL(articulation_function, ArticulationFunctionArguments) {
  using Function = ArticulationFunction;
  ArticulationEvaluation e(a, row);
  switch (static_cast<Function>(a.function.value)) {
    case Function::InverseDynamics:
      return e.run<Function::InverseDynamics>();
    case Function::Bias:
      return e.run<Function::Bias>();
    case Function::ForwardDynamics:
      return e.run<Function::ForwardDynamics>();
    case Function::MassMatrix:
      return e.run<Function::MassMatrix>();
    case Function::Jacobian:
      return e.run<Function::Jacobian>();
    case Function::InverseDynamicsDerivatives:
      return e.run<Function::InverseDynamicsDerivatives>();
    case Function::ForwardDynamicsDerivatives:
      return e.run<Function::ForwardDynamicsDerivatives>();
    case Function::CenterOfMass:
      return e.run<Function::CenterOfMass>();
    case Function::Energy:
      return e.run<Function::Energy>();
  }
}

}  // namespace novaphy
