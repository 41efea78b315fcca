#include "novaphy/dynamics/featherstone/articulation_functions.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <memory>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/dynamics/articulation/derivatives.h"
#include "novaphy/dynamics/featherstone/articulations.h"

namespace novaphy {
namespace {

using articulation::Tree;
using articulation::Workspace;

// The algorithms with all that they call inlined.
[[gnu::flatten]] void kinematics(const Tree<float>& tree, const float* q, Workspace<float>& ws) {
  articulation::kinematics(tree, q, ws);
  articulation::clear_wrenches(tree, ws);
}
[[gnu::flatten]] void inverse_dynamics(const Tree<float>& tree, const float* qd, const float* qdd,
                                       Workspace<float>& ws, float* tau) {
  articulation::inverse_dynamics(tree, qd, qdd, ws, tau);
}
[[gnu::flatten]] void mass_matrix(const Tree<float>& tree, Workspace<float>& ws) {
  articulation::mass_matrix(tree, ws);
}
[[gnu::flatten]] void inverse_dynamics_derivatives(const Tree<float>& tree, const float* qd,
                                                   const float* qdd, Workspace<float>& ws,
                                                   articulation::DerivativeWorkspace<float>& memory,
                                                   float* dq, float* dqd) {
  articulation::composite_inertias(tree, ws);
  articulation::inverse_dynamics_derivatives(tree, qd, qdd, ws, memory, dq, dqd);
}

// Memory of one articulation at a time, which a thread keeps.
struct Place {
  Workspace<float> ws;
  explicit Place(const Tree<float>& tree) {
    static thread_local std::vector<uint64_t> memory;
    const auto words = static_cast<size_t>(
        articulation::workspace_bytes<float>(tree.link_count, tree.dof_count) / 8 + 1);
    if (memory.size() < words) memory.resize(words);
    ws = articulation::make_workspace<float>(memory.data(), tree.link_count, tree.dof_count);
  }
};

// The trees of the model that this thread asked for last.
const Articulations& trees_of(const Model& m, const char* function) {
  struct Last {
    uint64_t model = 0;
    ArrayStamp flags = {};
    std::unique_ptr<Articulations> trees = {};
  };
  static thread_local Last last;
  m.check_structure(function);
  if (last.trees != nullptr && last.model == m.id() && last.flags.matches(m.body_flags))
    return *last.trees;
  last.trees = nullptr;
  last.trees = std::make_unique<Articulations>(m, function);
  last.model = m.id();
  last.flags.set(m.body_flags);
  return *last.trees;
}

// What a function reads.
class Evaluation {
 public:
  Evaluation(const Model& m, const SimState& state, const char* function)
      : model_(m), function_(function), articulations_(trees_of(m, function)) {
    const auto dofs = static_cast<size_t>(m.joint_dof_count());
    const auto coords = static_cast<size_t>(m.joint_coord_count());
    require(state.joint_q.rows() == coords && state.joint_qd.rows() == dofs, ErrorKind::Value,
            function, ", state: expected one of the model, with ", coords, " and ", dofs,
            " joint coordinates and velocities, got ", state.joint_q.rows(), " and ",
            state.joint_qd.rows());
    q_ = state.joint_q.data();
    qd_ = state.joint_qd.data();
    failed_.assign(static_cast<size_t>(count()), -1);
  }
  int64_t count() const { return articulations_.count(); }
  int32_t max_dofs() const { return articulations_.max_dofs(); }
  const Model& model() const { return model_; }
  const float* qd(const Tree<float>& tree) const { return qd_ + tree.first_dof; }
  const float* armature(const Tree<float>& tree) const {
    return model_.joint_armature.data() + tree.first_dof;
  }
  void check_dofs(std::span<const float> values, const char* name) const {
    const auto dofs = static_cast<size_t>(model_.joint_dof_count());
    require(values.size() == dofs, ErrorKind::Value, function_, ", ", name, ": expected ", dofs,
            " numbers, one per degree of freedom, got ", values.size());
  }
  ArticulationMatrices matrices(int64_t rows, int64_t columns) const {
    return {count(), rows, columns,
            std::vector<float>(static_cast<size_t>(count() * rows * columns), 0.0f)};
  }

  // body(i, tree, workspace) behind kinematics, for every articulation.
  template <class Body>
  void run(Body&& body) {
    for_chunks(count(), 4, [&](int64_t begin, int64_t end, int64_t) {
      for (int64_t i = begin; i < end; ++i) {
        const Tree<float> tree = articulations_.tree(model_, i);
        Place place(tree);
        kinematics(tree, q_, place.ws);
        body(i, tree, place.ws);
      }
    });
    for (const int32_t dof : failed_)
      if (dof >= 0)
        fail(ErrorKind::Runtime, function_, ": ", articulations_.dof_name(model_, dof),
             ": the mass matrix is not positive definite there: expected mass or armature");
  }
  // M, factored; false: it is singular.
  bool factored(int64_t i, const Tree<float>& tree, Workspace<float>& ws) {
    mass_matrix(tree, ws);
    for (int64_t k = 0; k < tree.dof_count; ++k)
      ws.matrix[k * tree.dof_count + k] += armature(tree)[k];
    const int32_t dof = articulation::factor(tree, ws.matrix);
    if (dof >= 0) failed_[static_cast<size_t>(i)] = tree.first_dof + dof;
    return dof < 0;
  }

 private:
  const Model& model_;
  const char* function_;
  const Articulations& articulations_;
  const float *q_ = nullptr, *qd_ = nullptr;
  std::vector<int32_t> failed_;
};

// An {n, n} matrix into the i-th of {D, D}.
void store(const float* matrix, int64_t n, ArticulationMatrices& to, int64_t i) {
  float* target = to.values.data() + i * to.rows * to.columns;
  for (int64_t r = 0; r < n; ++r)
    std::copy(matrix + r * n, matrix + (r + 1) * n, target + r * to.columns);
}
// H of mass_matrix, both triangles.
void store_symmetric(const Tree<float>& tree, const float* lower, const float* armature,
                     ArticulationMatrices& to, int64_t i) {
  const int64_t n = tree.dof_count;
  float* target = to.values.data() + i * to.rows * to.columns;
  for (int32_t k = 0; k < n; ++k)
    for (int32_t j = k; j >= 0; j = tree.dof_parent[j])
      target[k * to.columns + j] = target[j * to.columns + k] =
          lower[k * n + j] + (j == k && armature ? armature[k] : 0.0f);
}

// qdd = M^-1 (tau - bias), and M's factor in the workspace.
bool accelerations(Evaluation& e, int64_t i, const Tree<float>& tree, Workspace<float>& ws,
                   const float* tau) {
  inverse_dynamics(tree, e.qd(tree), nullptr, ws, ws.bias);
  for (int32_t k = 0; k < tree.dof_count; ++k) ws.qdd[k] = tau[k] - ws.bias[k];
  if (!e.factored(i, tree, ws)) return false;
  articulation::solve(tree, ws.matrix, ws.qdd);
  return true;
}

struct Derivatives {
  std::vector<float> dq, dqd;
  Derivatives(const Tree<float>& tree, const float* qd, const float* qdd, Workspace<float>& ws) {
    const auto n = static_cast<size_t>(tree.dof_count);
    dq.resize(n * n);
    dqd.resize(n * n);
    static thread_local std::vector<articulation::DofMotion<float>> motions;
    static thread_local std::vector<articulation::MotionBias<float>> biases;
    motions.resize(std::max(motions.size(), n));
    biases.resize(std::max(biases.size(), static_cast<size_t>(tree.link_count)));
    articulation::DerivativeWorkspace<float> memory{motions.data(), biases.data()};
    inverse_dynamics(tree, qd, qdd, ws, ws.bias);
    inverse_dynamics_derivatives(tree, qd, qdd, ws, memory, dq.data(), dqd.data());
  }
};

}  // namespace

std::vector<float> eval_inverse_dynamics(const Model& model, const SimState& state,
                                         std::span<const float> qdd) {
  Evaluation e(model, state, "eval_inverse_dynamics");
  e.check_dofs(qdd, "qdd");
  std::vector<float> tau(qdd.size());
  e.run([&](int64_t, const Tree<float>& tree, Workspace<float>& ws) {
    const float* const a = qdd.data() + tree.first_dof;
    float* const t = tau.data() + tree.first_dof;
    inverse_dynamics(tree, e.qd(tree), a, ws, t);
    for (int32_t k = 0; k < tree.dof_count; ++k) t[k] += e.armature(tree)[k] * a[k];
  });
  return tau;
}

std::vector<float> eval_bias(const Model& model, const SimState& state) {
  Evaluation e(model, state, "eval_bias");
  std::vector<float> bias(static_cast<size_t>(model.joint_dof_count()));
  e.run([&](int64_t, const Tree<float>& tree, Workspace<float>& ws) {
    inverse_dynamics(tree, e.qd(tree), nullptr, ws, bias.data() + tree.first_dof);
  });
  return bias;
}

std::vector<float> eval_forward_dynamics(const Model& model, const SimState& state,
                                         std::span<const float> tau) {
  Evaluation e(model, state, "eval_forward_dynamics");
  e.check_dofs(tau, "tau");
  std::vector<float> qdd(tau.size());
  e.run([&](int64_t i, const Tree<float>& tree, Workspace<float>& ws) {
    if (!accelerations(e, i, tree, ws, tau.data() + tree.first_dof)) return;
    std::copy(ws.qdd, ws.qdd + tree.dof_count, qdd.data() + tree.first_dof);
  });
  return qdd;
}

ArticulationMatrices eval_mass_matrix(const Model& model, const SimState& state,
                                      bool include_armature) {
  Evaluation e(model, state, "eval_mass_matrix");
  ArticulationMatrices h = e.matrices(e.max_dofs(), e.max_dofs());
  e.run([&](int64_t i, const Tree<float>& tree, Workspace<float>& ws) {
    mass_matrix(tree, ws);
    store_symmetric(tree, ws.matrix, include_armature ? e.armature(tree) : nullptr, h, i);
  });
  return h;
}

ArticulationMatrices eval_jacobian(const Model& model, const SimState& state) {
  Evaluation e(model, state, "eval_jacobian");
  ArticulationMatrices jacobian =
      e.matrices(6 * static_cast<int64_t>(model.max_joints_per_articulation), e.max_dofs());
  e.run([&](int64_t i, const Tree<float>& tree, Workspace<float>& ws) {
    float* row = jacobian.values.data() + i * jacobian.rows * jacobian.columns;
    for (int32_t link = 0; link < tree.link_count; ++link) {
      if (tree.links[link].body < 0) continue;
      for (int32_t on = link; on >= 0; on = tree.links[on].parent) {
        const int32_t first = articulation::local_dof(tree, tree.links[on]);
        for (int32_t k = first; k < first + tree.links[on].dofs; ++k) {
          const SpatialVectorf m = math::motion_at(ws.axes[k], ws.links[link].com);
          const float column[6] = {m.linear.x,  m.linear.y,  m.linear.z,
                                   m.angular.x, m.angular.y, m.angular.z};
          for (int64_t r = 0; r < 6; ++r) row[r * jacobian.columns + k] = column[r];
        }
      }
      row += 6 * jacobian.columns;
    }
  });
  return jacobian;
}

InverseDynamicsDerivatives eval_inverse_dynamics_derivatives(const Model& model,
                                                             const SimState& state,
                                                             std::span<const float> qdd) {
  Evaluation e(model, state, "eval_inverse_dynamics_derivatives");
  e.check_dofs(qdd, "qdd");
  const ArticulationMatrices none = e.matrices(e.max_dofs(), e.max_dofs());
  InverseDynamicsDerivatives all{none, none, none};
  e.run([&](int64_t i, const Tree<float>& tree, Workspace<float>& ws) {
    const Derivatives d(tree, e.qd(tree), qdd.data() + tree.first_dof, ws);
    store(d.dq.data(), tree.dof_count, all.dtau_dq, i);
    store(d.dqd.data(), tree.dof_count, all.dtau_dqd, i);
    mass_matrix(tree, ws);
    store_symmetric(tree, ws.matrix, e.armature(tree), all.mass_matrix, i);
  });
  return all;
}

ForwardDynamicsDerivatives eval_forward_dynamics_derivatives(const Model& model,
                                                             const SimState& state,
                                                             std::span<const float> tau) {
  Evaluation e(model, state, "eval_forward_dynamics_derivatives");
  e.check_dofs(tau, "tau");
  const ArticulationMatrices none = e.matrices(e.max_dofs(), e.max_dofs());
  ForwardDynamicsDerivatives all{none, none, none};
  e.run([&](int64_t i, const Tree<float>& tree, Workspace<float>& ws) {
    if (!accelerations(e, i, tree, ws, tau.data() + tree.first_dof)) return;
    Derivatives d(tree, e.qd(tree), ws.qdd, ws);
    std::vector<float> inverse(d.dq.size());
    articulation::forward_dynamics_derivatives(tree, ws.matrix, d.dq.data(), d.dqd.data(),
                                               inverse.data());
    store(d.dq.data(), tree.dof_count, all.dqdd_dq, i);
    store(d.dqd.data(), tree.dof_count, all.dqdd_dqd, i);
    store(inverse.data(), tree.dof_count, all.inverse_mass_matrix, i);
  });
  return all;
}

std::vector<Vec3f> eval_center_of_mass(const Model& model, const SimState& state) {
  Evaluation e(model, state, "eval_center_of_mass");
  std::vector<Vec3f> com(static_cast<size_t>(e.count()));
  e.run([&](int64_t i, const Tree<float>& tree, Workspace<float>& ws) {
    com[static_cast<size_t>(i)] = articulation::center_of_mass(tree, ws).com;
  });
  return com;
}

std::vector<Vec2f> eval_energy(const Model& model, const SimState& state) {
  Evaluation e(model, state, "eval_energy");
  std::vector<Vec2f> all(static_cast<size_t>(e.count()));
  e.run([&](int64_t i, const Tree<float>& tree, Workspace<float>& ws) {
    articulation::link_motions(tree, e.qd(tree), ws);
    const articulation::TreeEnergy<float> energy = articulation::energy(tree, ws);
    all[static_cast<size_t>(i)] = {energy.kinetic, energy.potential};
  });
  return all;
}

}  // namespace novaphy
