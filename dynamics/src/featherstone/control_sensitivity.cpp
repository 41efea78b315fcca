#include "novaphy/dynamics/featherstone/control_sensitivity.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "../step_sources.h"
#include "active_contacts.h"
#include "articulation_step.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/joint_types.h"
#include "novaphy/dynamics/articulation/control_sensitivity.h"
#include "novaphy/dynamics/articulation/dual.h"

namespace novaphy {
namespace {

using articulation::Dual;
using articulation::PointState;
using articulation::StepInputs;
using articulation::StepOptions;
using articulation::Tree;
using articulation::Workspace;
using D = Dual<float>;

constexpr const char* kName = "FeatherstoneAnalyticControlSensitivity";
constexpr const char* kStep = "FeatherstoneAnalyticControlSensitivity.step";

template <class T>
struct OwnWorkspace {
  std::vector<uint64_t> memory;
  Workspace<T> ws;
  OwnWorkspace(int32_t links, int32_t dofs)
      : memory(static_cast<size_t>(articulation::workspace_bytes<T>(links, dofs) / 8 + 1)),
        ws(articulation::make_workspace<T>(memory.data(), links, dofs)) {}
};

// The arrays of a step as dual numbers with zero tangents, in memory that steps share.
class DualStep {
 public:
  void load(const NamedStepArrays& from, const Tree<float>& tree, const ArticulationArguments& a) {
    D* to[kStepArrays];
    for (size_t i = 0; i < kStepArrays; ++i) {
      const auto* const numbers = static_cast<const float*>(from[i].array->range()->data());
      arrays_[i].resize(from[i].array->bytes() / sizeof(float));
      for (size_t k = 0; k < arrays_[i].size(); ++k) arrays_[i][k] = {numbers[k], 0.0f};
      to[i] = arrays_[i].data();
    }
    point_arrays(arrays, to);
    point_arrays(in_, to);
    in_.target_mode = a.target_mode;
    tree_ = {tree.link_count, tree.dof_count, tree.links, tree.dof_parent, tree.first_dof};
    tree_.joints_in_a_row = tree.joints_in_a_row;
    articulation::set_arrays(in_, 0, tree_);
    tree_.gravity = {D(tree.gravity.x), D(tree.gravity.y), D(tree.gravity.z)};
  }
  const Tree<D>& tree() const { return tree_; }
  const StepInputs<D>& inputs() const { return in_; }

  articulation::StepArrays<articulation::WritePointers<D>> arrays = {};

 private:
  Tree<D> tree_;
  StepInputs<D> in_ = {};
  std::array<std::vector<D>, kStepArrays> arrays_;
};

void check_joints(const Model& m, const ControlSensitivityOptions& o) {
  const int32_t start = m.articulation_start.data()[o.articulation];
  const int32_t end = m.articulation_end.data()[o.articulation];
  for (int32_t j = start; j < end; ++j) {
    const auto type = static_cast<JointType>(m.joint_type.data()[j]);
    if (quaternion_at(type) < 0 && !joint_traits(type).is_chain) continue;
    const std::string& label = m.joint_label[static_cast<size_t>(j)];
    require(type == JointType::FREE, ErrorKind::NotImplemented, kName, ": model: joint ", j, " ('",
            label, "'): only FIXED, PRISMATIC and REVOLUTE joints, and a FREE root, are covered");
    require(m.joint_parent.data()[j] < 0 && j == start, ErrorKind::NotImplemented, kName,
            ": model: joint ", j, " ('", label, "'): a FREE joint is covered at the root only");
    require(o.kind == ControlKind::Torque, ErrorKind::NotImplemented, kName, ": model: joint ", j,
            " ('", label, "'): with a FREE root only kind \"torque\" is covered");
  }
}

}  // namespace

struct FeatherstoneAnalyticControlSensitivity::Impl {
  Impl(std::shared_ptr<const Model> model, const ControlSensitivityOptions& o)
      : m(std::move(model)),
        options(o),
        articulations(*m, kName),
        contacts(*m, articulations, o.articulation),
        single(articulations.max_links(), articulations.max_dofs()),
        dual(articulations.max_links(), articulations.max_dofs()) {
    const Tree<float> tree = articulations.tree(*m, o.articulation);
    for (int32_t i = 0; i < tree.link_count; ++i)
      require(!articulation::follows(tree.links[i]), ErrorKind::NotImplemented, kName,
              ": model: ", articulations.dof_name(*m, tree.links[i].dof),
              ": mimic joints are not supported");
    dofs = static_cast<size_t>(tree.dof_count);
    first_dof = tree.first_dof;
    for (int32_t i = 0; i < tree.link_count; ++i)
      if (tree.links[i].body == o.point_body) point_link = i;
    require(point_link >= 0, ErrorKind::Value, kName,
            ", point_body: expected a body of articulation ", o.articulation, ", got ",
            o.point_body);
    const auto columns = static_cast<size_t>(o.parameter_count);
    for (std::vector<float>* values : {&dq, &dv, &next_dq, &next_dv})
      values->resize(dofs * columns);
    jacobian.resize(3 * columns);
    velocity_jacobian.resize(3 * columns);
    q.resize(static_cast<size_t>(m->joint_coord_count()));
    qd.resize(static_cast<size_t>(m->joint_dof_count()));
    q_next = q;
    qd_next = qd;
    body_q.resize(static_cast<size_t>(m->body_count()));
    body_qd.resize(body_q.size());
    column.resize(3 * dofs);
    tangent.resize(dofs);
    stopped.resize(2 * dofs);
  }

  size_t parameters() const { return static_cast<size_t>(options.parameter_count); }
  bool is_torque() const { return options.kind == ControlKind::Torque; }

  void check_state(const SimState& state, const char* name, const char* function) const {
    require(state.joint_q.rows() == q.size() && state.joint_qd.rows() == qd.size() &&
                state.device() == m->device(),
            ErrorKind::Value, function, ", ", name, ": expected a state of the model, with ",
            q.size(), " and ", qd.size(), " joint coordinates and velocities, got ",
            state.joint_q.rows(), " and ", state.joint_qd.rows());
  }
  // Returns whether the articulation's rows of a state equal q_ and qd_. Rates may differ by `off`.
  // With `touches` positions are not compared, because contacts may have shifted them.
  bool same(const SimState& state, const std::vector<float>& q_, const std::vector<float>& qd_,
            const Tree<float>& tree, float off = 0.0f, bool touches = false) const {
    const auto near = [&](const float* values, const std::vector<float>& expected, int32_t row) {
      const float x = expected[static_cast<size_t>(row)];
      return std::abs(values[row] - x) <= (off == 0.0f ? 0.0f : off + 1e-6f * std::abs(x));
    };
    for (int32_t i = 0; i < tree.link_count; ++i) {
      const articulation::Link& link = tree.links[i];
      const int32_t coords = articulation::coordinate_count(link);
      for (int32_t k = link.coord; !touches && k < link.coord + coords; ++k)
        if (!near(state.joint_q.data(), q_, k)) return false;
      for (int32_t k = link.dof; k < link.dof + link.dofs; ++k)
        if (!near(state.joint_qd.data(), qd_, k)) return false;
    }
    return true;
  }
  void check_numbers(std::span<const float> values, const char* name) const {
    require(values.size() == dofs * parameters(), ErrorKind::Value, kStep, ", ", name,
            ": expected {", dofs, ", ", parameters(),
            "} numbers, one per degree of freedom and parameter, got ", values.size());
    for (size_t i = 0; i < values.size(); ++i)
      require(std::isfinite(values[i]), ErrorKind::Value, kStep, ", ", name, "[", i / parameters(),
              ", ", i % parameters(), "]: expected a finite number, got ", values[i]);
  }
  // Throws if a target without a drive changes, because its change would have no effect.
  void check_followed(const Tree<float>& tree, const StepInputs<float>& in,
                      std::span<const float> values, bool rate, const char* name) const {
    for (int32_t i = 0; i < tree.link_count; ++i) {
      const articulation::Link& link = tree.links[i];
      if (link.dofs == 0) continue;
      const int32_t mode = in.target_mode[link.dof];
      const bool one = articulation::has_one_dof(link);
      const bool follows =
          one && (rate ? articulation::has_velocity_drive(mode) && mode != 1 &&
                             in.target_kd[link.dof] > 0.0f
                       : articulation::has_position_drive(mode) && in.target_ke[link.dof] > 0.0f);
      if (follows) continue;
      const auto first = static_cast<size_t>(articulation::local_dof(tree, link)) * parameters();
      for (size_t k = first; k < first + static_cast<size_t>(link.dofs) * parameters(); ++k)
        require(values[k] == 0.0f, ErrorKind::Value, kStep, ", ", name, ": ",
                articulations.dof_name(*m, link.dof), " has no ", rate ? "velocity" : "position",
                " drive that follows the target, so its change has no effect: expected 0, got ",
                values[k]);
    }
  }

  // Returns one column of `values`: a number per dof for one parameter. Null: no change.
  const float* take_column(std::span<const float> values, size_t parameter, size_t slot) {
    if (values.empty()) return nullptr;
    float* const to = column.data() + slot * dofs;
    for (size_t k = 0; k < dofs; ++k) to[k] = values[k * parameters() + parameter];
    return to;
  }
  articulation::ControlTangent<float> control_tangent(std::span<const float> dcontrol,
                                                      std::span<const float> dtarget_qd,
                                                      size_t parameter) {
    articulation::ControlTangent<float> c;
    (is_torque() ? c.force : c.target_q) = take_column(dcontrol, parameter, 0);
    c.target_qd = take_column(dtarget_qd, parameter, 1);
    return c;
  }

  void frozen_change(const Tree<float>& tree, const StepInputs<float>& in,
                     const StepOptions<float>& o, const articulation::ControlTangent<float>& c,
                     const float* from_dq, const float* from_dv, float* to_dv) {
    articulation::frozen_force_change(tree, in, o, single.ws, c, from_dq, from_dv, tangent.data());
    const auto held = [&](size_t k) {
      return articulation::has(single.ws.branch[k], articulation::kVelocityClamped);
    };
    if (articulation::holds_rates(tree, single.ws)) {  // rates at a velocity limit stay constant
      for (size_t k = 0; k < dofs; ++k) stopped[k] = held(k) ? -from_dv[k] / o.dt : 0.0f;
      float *const with_them = stopped.data() + dofs, *const without = single.ws.rhs;
      const float* const rates = in.qd + first_dof;
      articulation::inverse_dynamics<float>(tree, rates, stopped.data(), single.ws, with_them);
      articulation::inverse_dynamics<float>(tree, rates, nullptr, single.ws, without);
      for (size_t k = 0; k < dofs; ++k) tangent[k] -= with_them[k] - without[k];
    }
    articulation::solve(tree, single.ws, tangent.data());
    for (size_t k = 0; k < dofs; ++k) to_dv[k] = held(k) ? 0.0f : from_dv[k] + o.dt * tangent[k];
    if (!contacts.empty()) contacts.project(to_dv);
  }

  // Computes the change of the rates by dual numbers, and then clears the tangents of the arrays.
  void exact_change(const StepOptions<float>& o, const articulation::ControlTangent<float>& c,
                    const Tree<float>& tree, const float* q_in, const float* from_dq,
                    const float* from_dv, float* to_dv) {
    const auto seed = [&](const float* force, const float* target_q, const float* target_qd,
                          const float* change_q, const float* change_v) {
      articulation::tangent_to_coordinates(tree, q_in, change_q, [&](int32_t row, float value) {
        duals.arrays.q[row].tangent = value;
      });
      for (int32_t i = 0; i < tree.link_count; ++i) {
        const articulation::Link& link = tree.links[i];
        for (int32_t j = 0; j < link.dofs; ++j) {
          const int32_t k = articulation::local_dof(tree, link) + j, row = link.dof + j;
          duals.arrays.qd[row].tangent = change_v[k];
          duals.arrays.joint_f[row].tangent = force ? force[k] : 0.0f;
          duals.arrays.target_qd[row].tangent = target_qd ? target_qd[k] : 0.0f;
          if (articulation::has_one_dof(link))
            duals.arrays.target_q[link.coord].tangent = target_q ? target_q[k] : 0.0f;
        }
      }
    };
    seed(c.force, c.target_q, c.target_qd, from_dq, from_dv);
    const StepOptions<D> options_of_dual = articulation::options_as<D>(o);
    articulation::forward_step(duals.tree(), duals.inputs(), options_of_dual, dual.ws);
    for (size_t k = 0; k < dofs; ++k) to_dv[k] = dual.ws.qd_next[k].tangent;
  }

  // Computes the point and its Jacobians after finish_step. `exact`: by dual numbers.
  void find_point(const Tree<float>& tree, const ArticulationArguments* a) {
    const size_t n = parameters();
    const PointState<float> at =
        articulation::point_state(single.ws, point_link, options.point_local);
    point = at.position;
    velocity = at.velocity;
    std::fill(jacobian.begin(), jacobian.end(), 0.0f);
    std::fill(velocity_jacobian.begin(), velocity_jacobian.end(), 0.0f);
    if (a == nullptr) return;
    if (options.exact) return exact_point(tree);
    articulation::point_jacobian(tree, single.ws, point_link, options.point_local,
                                 [&](int32_t k, const Vec3f& along) {
                                   const float axis[3] = {along.x, along.y, along.z};
                                   for (size_t p = 0; p < n; ++p) {
                                     const size_t from = p * dofs + static_cast<size_t>(k);
                                     for (size_t r = 0; r < 3; ++r) {
                                       jacobian[r * n + p] += axis[r] * dq[from];
                                       velocity_jacobian[r * n + p] += axis[r] * dv[from];
                                     }
                                   }
                                 });
  }
  void exact_point(const Tree<float>& tree) {
    const size_t n = parameters();
    const Vec3<D> local = {D(options.point_local.x), D(options.point_local.y),
                           D(options.point_local.z)};
    for (size_t k = 0; k < q.size(); ++k) duals.arrays.q[k] = {q[k], 0.0f};
    for (size_t k = 0; k < qd.size(); ++k) duals.arrays.qd[k] = {qd[k], 0.0f};
    for (size_t p = 0; p < n; ++p) {
      articulation::tangent_to_coordinates(
          tree, q.data(), dq.data() + p * dofs,
          [&](int32_t row, float value) { duals.arrays.q[row].tangent = value; });
      for (size_t k = 0; k < dofs; ++k)
        duals.arrays.qd[static_cast<size_t>(first_dof) + k].tangent = dv[p * dofs + k];
      articulation::link_frames(duals.tree(), duals.arrays.q, dual.ws);
      articulation::link_motions(duals.tree(), duals.arrays.qd + first_dof, dual.ws);
      const PointState<D> at = articulation::point_state(dual.ws, point_link, local);
      const D position[3] = {at.position.x, at.position.y, at.position.z};
      const D rate[3] = {at.velocity.x, at.velocity.y, at.velocity.z};
      for (size_t r = 0; r < 3; ++r) {
        jacobian[r * n + p] = position[r].tangent;
        velocity_jacobian[r * n + p] = rate[r].tangent;
      }
    }
  }

  // Transposes {parameters, dofs} to {dofs, parameters}.
  std::vector<float> by_dof(const std::vector<float>& by_parameter) const {
    std::vector<float> to(by_parameter.size());
    for (size_t p = 0; p < parameters(); ++p)
      for (size_t k = 0; k < dofs; ++k) to[k * parameters() + p] = by_parameter[p * dofs + k];
    return to;
  }
  void require_reset(const char* function) const {
    require(started, ErrorKind::Runtime, kName, ".", function, ": expected reset(state) before");
  }

  std::shared_ptr<const Model> m;
  ControlSensitivityOptions options;
  Articulations articulations;
  ActiveContacts contacts;
  OwnWorkspace<float> single;
  OwnWorkspace<D> dual;
  DualStep duals;
  size_t dofs = 0;
  int32_t first_dof = 0, point_link = -1;
  bool started = false;
  std::vector<float> dq, dv, next_dq, next_dv;     // {parameters, dofs}
  std::vector<float> jacobian, velocity_jacobian;  // {3, parameters}
  std::vector<float> q, qd, q_next, qd_next;       // as model arrays, at the end of the last step
  std::vector<Transformf> body_q;
  std::vector<SpatialVectorf> body_qd;
  std::vector<float> column, tangent, stopped;
  Vec3f point{}, velocity{};
};

FeatherstoneAnalyticControlSensitivity::FeatherstoneAnalyticControlSensitivity(
    std::shared_ptr<const Model> model, const ControlSensitivityOptions& o) {
  check_featherstone_model(*model, o.solver, kName);
  require_cpu(
      model->device(), kName,
      ": model: step a copy, model.to(\"cpu\"), or differentiate by DiffFeatherstoneSolver");
  require(o.articulation >= 0 && o.articulation < model->articulation_count(), ErrorKind::Index,
          kName, ", articulation: expected 0 <= articulation < ", model->articulation_count(),
          ", got ", o.articulation);
  require(model->actuator_count() == 0, ErrorKind::NotImplemented, kName,
          ": model: expected no actuators, got ", model->actuator_count(),
          ": differentiate by DiffFeatherstoneSolver");
  require(o.parameter_count > 0, ErrorKind::Value, kName,
          ", parameter_count: expected a number > 0, got ", o.parameter_count);
  require(o.point_body >= 0 && o.point_body < model->body_count(), ErrorKind::Index, kName,
          ", point_body: expected 0 <= point_body < ", model->body_count(), ", got ", o.point_body);
  const Vec3f& at = o.point_local;
  require(std::isfinite(at.x) && std::isfinite(at.y) && std::isfinite(at.z), ErrorKind::Value,
          kName, ", point_local: expected finite numbers, got (", at.x, ", ", at.y, ", ", at.z,
          ")");
  require(!o.contact_projection || !o.exact, ErrorKind::NotImplemented, kName,
          ", contact_projection: expected false with exact, which has no contacts: "
          "DiffFeatherstoneSolver has their exact gradient");
  require(!o.contact_projection || o.solver.contact == ArticulationContact::Pgs, ErrorKind::Value,
          kName, ", contact_projection: expected a solver with contact \"pgs\"");
  check_joints(*model, o);
  impl_ = std::make_unique<Impl>(std::move(model), o);
}
FeatherstoneAnalyticControlSensitivity::~FeatherstoneAnalyticControlSensitivity() = default;

const std::shared_ptr<const Model>& FeatherstoneAnalyticControlSensitivity::model() const {
  return impl_->m;
}
const ControlSensitivityOptions& FeatherstoneAnalyticControlSensitivity::options() const {
  return impl_->options;
}
int32_t FeatherstoneAnalyticControlSensitivity::dof_count() const {
  return static_cast<int32_t>(impl_->dofs);
}

void FeatherstoneAnalyticControlSensitivity::reset(const SimState& state) {
  Impl& s = *impl_;
  s.check_state(state, "state", "FeatherstoneAnalyticControlSensitivity.reset");
  std::copy_n(state.joint_q.data(), s.q.size(), s.q.begin());
  std::copy_n(state.joint_qd.data(), s.qd.size(), s.qd.begin());
  std::fill(s.dq.begin(), s.dq.end(), 0.0f);
  std::fill(s.dv.begin(), s.dv.end(), 0.0f);
  const Tree<float> tree = s.articulations.tree(*s.m, s.options.articulation);
  articulation::link_frames(tree, s.q.data(), s.single.ws);
  articulation::link_motions(tree, s.qd.data() + s.first_dof, s.single.ws);
  s.started = true;
  s.find_point(tree, nullptr);
}

void FeatherstoneAnalyticControlSensitivity::step(const SimState& state_in,
                                                  const SimState& state_out, const Control* control,
                                                  float dt, std::span<const float> dcontrol,
                                                  std::span<const float> dtarget_qd,
                                                  const Contacts* contacts) {
  Impl& s = *impl_;
  const Model& m = *s.m;
  s.require_reset("step");
  s.check_state(state_in, "state_in", kStep);
  s.check_state(state_out, "state_out", kStep);
  require(std::isfinite(dt) && dt > 0.0f, ErrorKind::Value, kStep,
          ", dt: expected a finite number > 0, got ", dt);
  s.check_numbers(dcontrol, "dcontrol");
  if (!dtarget_qd.empty()) s.check_numbers(dtarget_qd, "dtarget_qd");
  require(contacts == nullptr || s.options.contact_projection, ErrorKind::Value, kStep,
          ", contacts: expected none without contact_projection");
  m.update_derived();
  s.articulations.check_values(m, control, false, kStep);
  check_no_body_forces(m, kStep);
  const Tree<float> tree = s.articulations.tree(m, s.options.articulation);
  const ArticulationArguments a = in_memory(articulation_arguments(
      m, s.articulations, state_in, drives_of(m, control), state_in.body_f, s.options.solver, dt));
  const StepInputs<float> in = articulation_inputs(a);
  const StepOptions<float> options = articulation_options(a);
  if (!s.is_torque()) s.check_followed(tree, in, dcontrol, false, "dcontrol");
  if (!dtarget_qd.empty()) s.check_followed(tree, in, dtarget_qd, true, "dtarget_qd");
  require(s.same(state_in, s.q, s.qd, tree), ErrorKind::Runtime, kStep,
          ", state_in: expected the state that reset or the last step ended with");
  const bool touches = contacts != nullptr;
  bool stepped = articulation::accelerate(tree, in, options, false, s.single.ws) < 0;
  float off = 0.0f;  // tolerance of rates with contacts: 1e-5 of the largest intermediate rate
  for (int32_t round = 0; stepped; ++round) {
    articulation::free_rates(tree, in, options, s.single.ws);
    s.contacts.find(m, contacts, state_out, tree, s.single.ws, kStep);
    if (s.contacts.empty()) {
      stepped = articulation::hold_rates(tree, in, options, true, s.single.ws) < 0;
      articulation::free_rates(tree, in, options, s.single.ws);
      break;
    }
    off = 1e-5f * s.contacts.push(dt, s.single.ws);
    for (size_t k = 0; k < s.dofs; ++k)
      s.single.ws.qdd[k] =
          (s.single.ws.qd_next[k] - in.qd[s.first_dof + static_cast<int32_t>(k)]) / dt;
    if (!articulation::renew_branches(tree, in, options, true, round, s.single.ws)) break;
    stepped = articulation::solve_accelerations(tree, in, options, s.single.ws) < 0;
  }
  if (s.options.exact && stepped) s.duals.load(step_arrays(m, &state_in, control), tree, a);
  for (size_t p = 0; stepped && p < s.parameters(); ++p) {
    const auto c = s.control_tangent(dcontrol, dtarget_qd, p);
    float *const dq = s.next_dq.data() + p * s.dofs, *const dv = s.next_dv.data() + p * s.dofs;
    const float *const dq_in = s.dq.data() + p * s.dofs, *const dv_in = s.dv.data() + p * s.dofs;
    std::copy_n(dq_in, s.dofs, dq);
    if (s.options.exact) {
      s.exact_change(options, c, tree, in.q, dq_in, dv_in, dv);
    } else {
      s.frozen_change(tree, in, options, c, dq_in, dv_in, dv);
    }
    articulation::integrate_changes(tree, options, s.single.ws.qd_next, dq, dv);
  }
  if (stepped)
    articulation::finish_step(tree, in, options, s.single.ws, s.q_next.data(), s.qd_next.data(),
                              s.body_q.data(), s.body_qd.data());
  require(
      stepped && s.same(state_out, s.q_next, s.qd_next, tree, off, touches), ErrorKind::Runtime,
      kStep,
      ", state_out: expected what SolverFeatherstone.step gives from state_in with this control, "
      "dt, contacts, angular_damping (",
      s.options.solver.angular_damping, ") and implicit_drives (", s.options.solver.implicit_drives,
      ")");
  if (touches) {  // the next step starts from exactly these bits
    std::copy_n(state_out.joint_q.data(), s.q.size(), s.q_next.begin());
    std::copy_n(state_out.joint_qd.data(), s.qd.size(), s.qd_next.begin());
    articulation::link_frames(tree, s.q_next.data(), s.single.ws);
    articulation::link_motions(tree, s.qd_next.data() + s.first_dof, s.single.ws);
  }
  std::swap(s.q, s.q_next);
  std::swap(s.qd, s.qd_next);
  std::swap(s.dq, s.next_dq);
  std::swap(s.dv, s.next_dv);
  s.find_point(tree, &a);
}

std::vector<float> FeatherstoneAnalyticControlSensitivity::dq() const {
  impl_->require_reset("dq");
  return impl_->by_dof(impl_->dq);
}
std::vector<float> FeatherstoneAnalyticControlSensitivity::dqd() const {
  impl_->require_reset("dqd");
  return impl_->by_dof(impl_->dv);
}
std::vector<float> FeatherstoneAnalyticControlSensitivity::point_jacobian() const {
  impl_->require_reset("point_jacobian");
  return impl_->jacobian;
}
std::vector<float> FeatherstoneAnalyticControlSensitivity::point_velocity_jacobian() const {
  impl_->require_reset("point_velocity_jacobian");
  return impl_->velocity_jacobian;
}
Vec3f FeatherstoneAnalyticControlSensitivity::point() const {
  impl_->require_reset("point");
  return impl_->point;
}
Vec3f FeatherstoneAnalyticControlSensitivity::point_velocity() const {
  impl_->require_reset("point_velocity");
  return impl_->velocity;
}

}  // namespace novaphy
