#include "novaphy/dynamics/featherstone/articulation_functions.h"

#include <algorithm>
#include <cstring>
#include <memory>

#include "articulation_functions_kernels.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/core/storage.h"
#include "novaphy/dynamics/featherstone/articulations.h"

namespace novaphy {
namespace detail {
const char* articulation_functions_kernels_source();
}
namespace {

using Function = ArticulationFunction;

const Kernel<ArticulationFunctionArguments>& kernel() {
  static const auto& kernel = *new Kernel<ArticulationFunctionArguments>(
      articulation_function, detail::articulation_functions_kernels_source);
  return kernel;
}

// `flatten` inlines the whole algorithm into the caller.
template <Function F>
[[gnu::flatten]] void evaluate(const ArticulationFunctionArguments& a, int64_t i) {
  ArticulationEvaluation(a, i).run<F>();
}

// Returns the size in floats of the workspace of an articulation.
size_t workspace_numbers(Function f, int32_t links, int32_t dofs) {
  return static_cast<size_t>(function_workspace_bytes(f, links, dofs) / 16 + 1) * 4;
}

// Returns the trees of a model. Each thread caches those of its last model. The functions' results
// go to the host.
const Articulations& trees_of(const Model& m, const char* function) {
  struct Last {
    uint64_t model = 0;
    ArrayStamp flags = {};
    std::unique_ptr<Articulations> trees = {};
  };
  static thread_local Last last;
  if (ArrayObserver* const observer = array_observer()) observer->host_read(function);
  m.check_structure(function);
  if (last.trees != nullptr && last.model == m.id() && last.flags.matches(m.body_flags))
    return *last.trees;
  last.trees = nullptr;
  last.trees = std::make_unique<Articulations>(m, function);
  last.model = m.id();
  last.flags.set(m.body_flags);
  return *last.trees;
}

// Evaluates a function of the articulations of a model, on the model's device.
class Evaluation {
 public:
  Evaluation(const Model& m, const SimState& state, const char* name)
      : model_(m), state_(state), name_(name), articulations_(trees_of(m, name)) {
    const auto dofs = static_cast<size_t>(m.joint_dof_count());
    const auto coords = static_cast<size_t>(m.joint_coord_count());
    require(state.joint_q.rows() == coords && state.joint_qd.rows() == dofs &&
                state.device() == m.device(),
            ErrorKind::Value, name, ", state: expected one of the model, with ", coords, " and ",
            dofs, " joint coordinates and velocities on ", m.device().str(), ", got ",
            state.joint_q.rows(), " and ", state.joint_qd.rows(), " on ", state.device().str());
  }
  size_t count() const { return static_cast<size_t>(articulations_.count()); }
  ArticulationMatrices matrices(int64_t rows = -1) const {
    const int64_t n = articulations_.count(), columns = articulations_.max_dofs();
    if (rows < 0) rows = columns;
    return {n, rows, columns, std::vector<float>(static_cast<size_t>(n * rows * columns))};
  }
  std::vector<float> dofs() const {
    return std::vector<float>(static_cast<size_t>(model_.joint_dof_count()));
  }
  void give(std::span<const float> values, const char* name) {
    const auto dofs = static_cast<size_t>(model_.joint_dof_count());
    require(values.size() == dofs, ErrorKind::Value, name_, ", ", name, ": expected ", dofs,
            " numbers, one per degree of freedom, got ", values.size());
    given_ = values;
  }
  void include_armature(bool include) { include_armature_ = include; }
  void into(std::vector<float>& to) { results_[result_count_++] = {to.data(), to.size()}; }
  void into(ArticulationMatrices& to) {
    matrix_rows_ = to.rows;
    into(to.values);
  }
  template <class Row>
  void into(std::vector<Row>& to) {
    results_[result_count_++] = {&to.data()->x, to.size() * sizeof(Row) / sizeof(float)};
  }

  template <Function F>
  void run() {
    std::vector<int32_t> status(count());
    if (model_.device().is_cpu())
      run_on_host<F>(status);
    else
      launch(F, status);
    for (const int32_t s : status)
      if (s != 0)
        fail(ErrorKind::Runtime, name_, ": ", articulations_.dof_name(model_, s - 1), ": ",
             articulations_.matrix_name(model_, s - 1, &state_),
             " is not positive definite there: expected mass or armature");
  }

 private:
  // Returns all arguments except the workspace.
  ArticulationFunctionArguments arguments(Function f, const Untyped& given,
                                          const std::array<Untyped, 3>& results,
                                          const Untyped& status) const {
    const Model& m = model_;
    return {.rows = Untyped(articulations_.rows()),
            .links = Untyped(articulations_.links()),
            .dof_parent = articulations_.dof_parent(),
            .X_p = m.joint_X_p,
            .X_c = m.joint_X_c,
            .axis = m.joint_axis,
            .mass = m.body_mass,
            .com = m.body_com,
            .inertia = m.body_inertia,
            .gravity = m.gravity,
            .armature = m.joint_armature,
            .q = state_.joint_q,
            .qd = state_.joint_qd,
            .given = given,
            .results = results,
            .status = status,
            .workspace = Untyped(nullptr),
            .stride = 0,
            .function = static_cast<int64_t>(f),
            .include_armature = include_armature_,
            .matrix_rows = matrix_rows_,
            .matrix_columns = articulations_.max_dofs()};
  }
  size_t numbers(Function f) const {
    return workspace_numbers(f, articulations_.max_links(), articulations_.max_dofs());
  }
  template <Function F>
  void run_on_host(std::vector<int32_t>& status) const {
    const size_t numbers = this->numbers(F);
    const ArticulationFunctionArguments all = in_memory(arguments(
        F, Untyped(given_.data()), each<3>([&](size_t k) { return Untyped(results_[k].data()); }),
        Untyped(status.data())));
    for_chunks(articulations_.count(), 4, [&](int64_t begin, int64_t end, int64_t) {
      // Each thread handles one articulation at a time and keeps this memory.
      static thread_local std::vector<uint64_t> memory;
      if (memory.size() < numbers / 2) memory.resize(numbers / 2);
      ArticulationFunctionArguments a = all;
      a.workspace = Untyped(memory.data());
      for (int64_t i = begin; i < end; ++i) evaluate<F>(a, i);
    });
  }
  void launch(Function f, std::vector<int32_t>& status) const {
    const UntrackedScope untracked;
    const Device device = model_.device();
    const DeviceArray<float> given = DeviceArray<float>::from_host(given_, device);
    const DeviceArray<float> workspace(count() * numbers(f), device);
    const DeviceArray<int32_t> failed(count(), device);
    DeviceArray<float> results[3];
    for (size_t k = 0; k < result_count_; ++k)
      results[k] = DeviceArray<float>(results_[k].size(), device);
    ArticulationFunctionArguments a = arguments(
        f, Untyped(given), each<3>([&](size_t k) { return Untyped(results[k]); }), Untyped(failed));
    a.workspace = workspace;
    a.stride = numbers(f);
    novaphy::run(kernel(), articulations_.count(), a);
    for (size_t k = 0; k < result_count_; ++k) {
      const std::vector<float> values = results[k].to_host();
      std::copy(values.begin(), values.end(), results_[k].begin());
    }
    status = failed.to_host();
  }

  const Model& model_;
  const SimState& state_;
  const char* name_;
  const Articulations& articulations_;
  std::span<const float> given_;
  std::span<float> results_[3];
  size_t result_count_ = 0;
  bool include_armature_ = true;
  int64_t matrix_rows_ = 0;
};

}  // namespace

std::vector<float> eval_inverse_dynamics(const Model& model, const SimState& state,
                                         std::span<const float> qdd) {
  Evaluation e(model, state, "eval_inverse_dynamics");
  e.give(qdd, "qdd");
  std::vector<float> tau = e.dofs();
  e.into(tau);
  e.run<Function::InverseDynamics>();
  return tau;
}

std::vector<float> eval_bias(const Model& model, const SimState& state) {
  Evaluation e(model, state, "eval_bias");
  std::vector<float> bias = e.dofs();
  e.into(bias);
  e.run<Function::Bias>();
  return bias;
}

std::vector<float> eval_forward_dynamics(const Model& model, const SimState& state,
                                         std::span<const float> tau) {
  Evaluation e(model, state, "eval_forward_dynamics");
  e.give(tau, "tau");
  std::vector<float> qdd = e.dofs();
  e.into(qdd);
  e.run<Function::ForwardDynamics>();
  return qdd;
}

ArticulationMatrices eval_mass_matrix(const Model& model, const SimState& state,
                                      bool include_armature) {
  Evaluation e(model, state, "eval_mass_matrix");
  e.include_armature(include_armature);
  ArticulationMatrices h = e.matrices();
  e.into(h);
  e.run<Function::MassMatrix>();
  return h;
}

ArticulationMatrices eval_jacobian(const Model& model, const SimState& state) {
  Evaluation e(model, state, "eval_jacobian");
  ArticulationMatrices jacobian =
      e.matrices(6 * static_cast<int64_t>(model.max_joints_per_articulation));
  e.into(jacobian);
  e.run<Function::Jacobian>();
  return jacobian;
}

InverseDynamicsDerivatives eval_inverse_dynamics_derivatives(const Model& model,
                                                             const SimState& state,
                                                             std::span<const float> qdd) {
  Evaluation e(model, state, "eval_inverse_dynamics_derivatives");
  e.give(qdd, "qdd");
  InverseDynamicsDerivatives all{e.matrices(), e.matrices(), e.matrices()};
  for (ArticulationMatrices* to : {&all.dtau_dq, &all.dtau_dqd, &all.mass_matrix}) e.into(*to);
  e.run<Function::InverseDynamicsDerivatives>();
  return all;
}

ForwardDynamicsDerivatives eval_forward_dynamics_derivatives(const Model& model,
                                                             const SimState& state,
                                                             std::span<const float> tau) {
  Evaluation e(model, state, "eval_forward_dynamics_derivatives");
  e.give(tau, "tau");
  ForwardDynamicsDerivatives all{e.matrices(), e.matrices(), e.matrices()};
  for (ArticulationMatrices* to : {&all.dqdd_dq, &all.dqdd_dqd, &all.inverse_mass_matrix})
    e.into(*to);
  e.run<Function::ForwardDynamicsDerivatives>();
  return all;
}

std::vector<Vec3f> eval_center_of_mass(const Model& model, const SimState& state) {
  Evaluation e(model, state, "eval_center_of_mass");
  std::vector<Vec3f> com(e.count());
  e.into(com);
  e.run<Function::CenterOfMass>();
  return com;
}

std::vector<Vec2f> eval_energy(const Model& model, const SimState& state) {
  Evaluation e(model, state, "eval_energy");
  std::vector<Vec2f> energy(e.count());
  e.into(energy);
  e.run<Function::Energy>();
  return energy;
}

}  // namespace novaphy
