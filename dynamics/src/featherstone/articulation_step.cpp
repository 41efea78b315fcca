#include "articulation_step.h"

#include <algorithm>
#include <cmath>

#include "../step_sources.h"
#include "mimic_limits.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/row_scratch.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/core/sim/joint_args.h"
#include "novaphy/core/sim/on_host.h"

namespace novaphy {
namespace detail {
const char* articulation_kernels_source();
}

// The object is never destroyed, because recordings refer to the kernel.
const Kernel<ArticulationStepArguments>& tree_step_kernel() {
  static const auto& kernel = *new Kernel<ArticulationStepArguments>(
      kInChunks<articulation_step, kTreeRows>, detail::articulation_kernels_source);
  return kernel;
}

namespace {

void check_contact_options(const FeatherstoneOptions& o, const char* user) {
  const FeatherstoneOptions d;
  struct Number {
    const char* name;
    float value, by_default;
    ArticulationContact of;
  };
  constexpr auto kPgs = ArticulationContact::Pgs, kPenalty = ArticulationContact::Penalty;
  const Number numbers[] = {
      {"pgs_tolerance", o.pgs_tolerance, d.pgs_tolerance, kPgs},
      {"pgs_erp", o.pgs_erp, d.pgs_erp, kPgs},
      {"pgs_slop", o.pgs_slop, d.pgs_slop, kPgs},
      {"pgs_cfm", o.pgs_cfm, d.pgs_cfm, kPgs},
      {"max_depenetration_velocity", o.max_depenetration_velocity, d.max_depenetration_velocity,
       kPgs},
      {"restitution_threshold", o.restitution_threshold, d.restitution_threshold, kPgs},
      {"friction_smoothing", o.friction_smoothing, d.friction_smoothing, kPenalty}};
  for (const Number& n : numbers) {
    require(std::isfinite(n.value) && n.value >= 0.0f, ErrorKind::Value, user, ": ", n.name,
            ": expected a finite number >= 0, got ", n.value);
    require(o.contact == n.of || n.value == n.by_default, ErrorKind::Value, user, ": ", n.name,
            ": expected ", n.by_default, " where the contact is not ",
            n.of == kPgs ? "pgs" : "penalty", ", got ", n.value);
  }
  require(o.pgs_iterations >= 1, ErrorKind::Value, user,
          ": pgs_iterations: expected at least 1, got ", o.pgs_iterations);
  require(o.pgs_erp <= 1.0f, ErrorKind::Value, user, ": pgs_erp: expected 0 to 1, got ", o.pgs_erp);
  const bool others = o.friction_cone != d.friction_cone || o.warm_start != d.warm_start ||
                      o.compliant_contacts != d.compliant_contacts;
  require(
      o.contact == kPgs || !others, ErrorKind::Value, user,
      ": friction_cone, warm_start, compliant_contacts: expected the defaults where the contact "
      "is not pgs");
  require(!o.compliant_contacts || (o.pgs_erp == d.pgs_erp && o.pgs_slop == d.pgs_slop),
          ErrorKind::Value, user,
          ": pgs_erp, pgs_slop: expected the defaults with compliant_contacts, got ", o.pgs_erp,
          " and ", o.pgs_slop);
}

void check_joint_limits(const Model& m, const FeatherstoneOptions& options, const char* user) {
  const bool rows = options.joint_limits == JointLimits::Row;
  const float elastic = options.joint_limit_restitution;
  require(elastic >= 0.0f && elastic <= (rows ? 1.0f : 0.0f), ErrorKind::Value, user,
          ": joint_limit_restitution: expected ",
          rows ? "0 to 1" : "0 without joint_limits=\"row\"", ", got ", elastic);
  MimicLimits().check(m, options, user);
}

}  // namespace

void MimicLimits::check(const Model& m, const FeatherstoneOptions& options, const char* user) {
  if (options.joint_limits != JointLimits::Row) return;
  const Array* const arrays[] = {&m.joint_mimic, &m.joint_limit_lower, &m.joint_limit_upper};
  bool same = true;
  for (size_t i = 0; i < checked_.size(); ++i) same = same && checked_[i].matches(*arrays[i]);
  if (same) return;
  const UntrackedScope untracked;
  const OnHost<int32_t> leader(m.joint_mimic), first(m.joint_qd_start);
  const OnHost<float> lower(m.joint_limit_lower), upper(m.joint_limit_upper);
  for (size_t j = 0; j < leader.size(); ++j) {
    const auto k = static_cast<size_t>(first[j]);
    if (leader[j] < 0 || k >= lower.size()) continue;
    require(lower[k] <= -kJointUnlimited && upper[k] >= kJointUnlimited, ErrorKind::NotImplemented,
            user, ": joint_limits: \"row\" does not support limits of joint ", j, " ('",
            m.joint_label[j], "'), which follows joint ", leader[j],
            ": limit that one, got ", lower[k], " to ", upper[k]);
  }
  for (size_t i = 0; i < checked_.size(); ++i) checked_[i].set(*arrays[i]);
}

void check_featherstone_model(const Model& m, const FeatherstoneOptions& options,
                              const char* user) {
  require(std::isfinite(options.angular_damping) && options.angular_damping >= 0.0f,
          ErrorKind::Value, user, ": angular_damping: expected a finite number >= 0, got ",
          options.angular_damping);
  check_joint_limits(m, options, user);
  check_contact_options(options, user);
  require(m.particle_count() == 0, ErrorKind::NotImplemented, user,
          ": model: expected particle_count 0 (particles are not supported), got ",
          m.particle_count());
}

UnsupportedMaterials unsupported_materials(ArticulationContact contact, const char* user) {
  const bool pgs = contact == ArticulationContact::Pgs;
  return {user, {.ka = !pgs, .restitution = pgs}};
}

void check_status(const Model& m, const Articulations& articulations,
                  std::span<const int32_t> status, const char* user, const SimState* state) {
  for (const int32_t s : status)
    if (s != 0)
      fail(ErrorKind::Runtime, user, ": ", articulations.dof_name(m, s - 1), ": ",
           articulations.matrix_name(m, s - 1, state),
           " is not positive definite there, or its acceleration is not finite: expected mass or "
           "armature, and finite coordinates, velocities and forces");
}

void check_exploded(const Model& m, const Articulations& articulations,
                    std::span<const int32_t> status, const SimState& from, float dt,
                    const std::string& largest_force, const char* user) {
  const float* const qd = from.joint_qd.data();
  const auto* const rows = reinterpret_cast<const ArticulationRows*>(articulations.rows().data());
  int32_t fastest = -1;
  float rate = 0.0f;
  for (size_t i = 0; i < status.size(); ++i)
    for (int32_t k = 0; status[i] != 0 && k < rows[i].dof_count; ++k) {
      const int32_t dof = rows[i].first_dof + k;
      if (std::abs(qd[dof]) <= rate) continue;
      fastest = dof;
      rate = std::abs(qd[dof]);
    }
  if (!(rate * dt >= 1.0f) || std::isinf(rate))
    return check_status(m, articulations, status, user, &from);
  fail(ErrorKind::Runtime, user, ": the motion has exploded: state_in.joint_qd of ",
       articulations.dof_name(m, fastest), " is ", qd[fastest],
       " rad/s or m/s, expected less than 1 rad or m a step (dt ", dt, " s)",
       largest_force.empty() ? "" : "; the largest force of a contact was ", largest_force);
}

void check_contact_status(std::span<const int32_t> status, const char* user, const Model* m,
                          const int32_t* shape0, const int32_t* shape1) {
  const auto bad = std::find_if(status.begin(), status.end(), [](int32_t s) { return s < 0; });
  if (bad == status.end()) return;
  const int32_t row = -1 - *bad;
  for (int side = 0; m != nullptr && side < 2; ++side) {
    const int32_t shape = (side == 0 ? shape0 : shape1)[row];
    require(shape >= 0 && shape < m->shape_count(), ErrorKind::Index, user,
            ": contacts: rigid_contact_shape", side, "[", row, "]: expected 0 to ",
            m->shape_count() - 1, ", got ", shape);
  }
  fail(ErrorKind::Index, user, ": contacts: row ", row,
       ": expected two shapes of the model, of bodies of one world");
}

void depend_on_modes(const Model& m, const Control* control) {
  depend_on({&m.joint_enabled, control ? &control->joint_act : &m.joint_act});
}

void depend_on_values(const Model& m, const Control* control) {
  depend_on_modes(m, control);
  depend_on({&m.joint_friction});
}

void place_bodies(const Articulations& articulations, const ArticulationArguments& in,
                  Transformf* body_q, SpatialVectorf* body_qd) {
  for_chunks(articulations.count(), kTreeRows, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t i = begin; i < end; ++i) {
      const ArticulationRows& rows = in.rows[i];
      const articulation::Tree<float> tree = articulation_tree(in, rows);
      const int64_t bytes = articulation::workspace_bytes<float>(rows.link_count, rows.dof_count);
      auto ws = articulation::make_workspace<float>(thread_numbers(bytes / 8 + 1), rows.link_count,
                                                    rows.dof_count);
      articulation::link_frames(tree, in.arrays.q.rows(), ws);
      articulation::link_motions(tree, in.arrays.qd + rows.first_dof, ws);
      articulation::write_bodies(tree, ws, body_q, body_qd);
    }
  });
}

namespace {

int64_t beyond(int64_t bytes, int64_t stack) {
  return bytes <= stack ? 0 : (bytes + 3) / static_cast<int64_t>(sizeof(float));
}

}  // namespace

int64_t device_workspace(const Articulations& articulations) {
  return beyond(
      articulation::workspace_bytes<float>(articulations.max_links(), articulations.max_dofs()),
      kDeviceRowStack);
}
int64_t step_workspace(const Articulations& articulations) {
  const int32_t links = articulations.max_links(), dofs = articulations.max_dofs();
  return beyond(articulation::workspace_bytes<float>(links, dofs) +
                    articulation::adjoint_bytes<float>(links, dofs),
                articulations.rows().device().is_cpu() ? kRowStack : 0);
}

NamedStepArrays step_arrays(const Model& m, const SimState* state, const Control* control) {
  NamedStepArrays all;
  articulation::for_each_array(
      [&](const auto& source, int32_t place) {
        all[static_cast<size_t>(place)] = {source.name, source.find(m, state, control),
                                           source.is_constant()};
      },
      kStepSources, kAt);
  return all;
}

ArticulationArguments articulation_arguments(const Model& m, const Articulations& articulations,
                                             const SimState& in, const StepDrives& drives,
                                             const Array& body_f,
                                             const FeatherstoneOptions& options, float dt) {
  const Array* arrays[kStepArrays];
  articulation::for_each_array(
      [&](const auto& source, int32_t place) { arrays[place] = source.find(m, &in, nullptr); },
      kStepSources, kAt);
  for (size_t i = 0; i < std::size(kActuatedPlaces); ++i) arrays[kActuatedPlaces[i]] = &drives[i];
  arrays[kAt.body_f] = &body_f;
  return arguments_of<float>([&](int32_t place) { return Untyped(*arrays[place]); },
                             {m.joint_target_mode, Untyped(articulations.rows()),
                              Untyped(articulations.links()), articulations.dof_parent()},
                             options, dt);
}

}  // namespace novaphy
