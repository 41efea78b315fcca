#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "device_steps.h"
#include "element_forces.h"
#include "joint_forces.h"
#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/edited_values.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/core/sim/input_checks.h"
#include "novaphy/core/sim/unsupported_materials.h"
#include "novaphy/core/storage.h"
#include "novaphy/dynamics/semi_implicit/contact_stability.h"
#include "novaphy/dynamics/semi_implicit/friction_laws.h"
#include "novaphy/dynamics/semi_implicit/particle_integrator_trace.h"
#include "novaphy/dynamics/semi_implicit/particle_stability.h"
#include "particle_contacts.h"
#include "rigid_bodies.h"

namespace novaphy {
namespace {

constexpr const char* kName = "SolverSemiImplicit.step";
constexpr int64_t kChunk = 512;  // particles per thread

void check_option(const char* name, float value) {
  require(std::isfinite(value) && value >= 0.0f, ErrorKind::Value, "SolverSemiImplicit: ", name,
          ": expected a finite number >= 0, got ", value);
}

RigidStep rigid_step(const SemiImplicitOptions& o, float dt) {
  return {.friction_law = o.friction_law,
          .friction_smoothing = *o.friction_smoothing,
          .angular_damping = o.angular_damping,
          .dt = dt,
          .stick_ke = o.stick_ke,
          .penalty_law = o.penalty_law};
}

void refuse_tape(const std::optional<SleepConfig>& sleep) {
  check_not_on_tape(sleep, kName);
  if (ArrayObserver* observer = array_observer()) observer->untracked_operation(kName);
}

void check_covered(const Model& model) { JointForces::check_covered(model, "SolverSemiImplicit"); }

}  // namespace

struct SolverSemiImplicit::Cache {
  Cache(const Model& m, FrictionLaw law, const std::optional<SleepConfig>& of_sleep)
      : materials("SolverSemiImplicit", {.ka = m.body_count() > 0, .ropes = false}) {
    materials.check(m);
    if (law == FrictionLaw::Huber || law == FrictionLaw::Newton17) watch.leave_out_friction();
    if (of_sleep) sleep.emplace(*of_sleep);
  }
  ParticleContacts contacts;
  ElementForces elements;
  JointForces joints;
  RigidBodies bodies;
  UnsupportedMaterials materials;  // only contacts of bodies have adhesion
  EditedValues values{"SolverSemiImplicit"};
  ContactWatch watch{kName};
  ParticleWatch particle_watch{kName};
  std::optional<SleepStep> sleep;
};

SolverSemiImplicit::SolverSemiImplicit(std::shared_ptr<const Model> model,
                                       const SemiImplicitOptions& options)
    : SolverBase(std::move(model)),
      options_(options),
      cache_(std::make_unique<Cache>(*this->model(), options.friction_law, options.sleep)) {
  require(options.particle_kf_bound >= 0.0f, ErrorKind::Value,
          "SolverSemiImplicit: particle_kf_bound: expected a number >= 0, got ",
          options.particle_kf_bound);
  check_option("angular_damping", options.angular_damping);
  options_.friction_smoothing = checked_friction_smoothing(
      "SolverSemiImplicit", options.friction_law, options.friction_smoothing);
  check_option("stick_ke", options.stick_ke);
  require(options.stick_ke == 0.0f || options.friction_law == FrictionLaw::Viscous,
          ErrorKind::Value,
          "SolverSemiImplicit: stick_ke: expected 0 with a friction law other than \"viscous\", "
          "got ",
          options.stick_ke);
  check_penalty_law("SolverSemiImplicit", options.penalty_law, options.friction_law,
                    this->model()->particle_count() > 0);
  require(options.stick_ke == 0.0f || options.penalty_law == PenaltyLaw::Sampled,
          ErrorKind::NotImplemented,
          "SolverSemiImplicit: penalty_law: expected \"sampled\" with stick_ke, got \"mean\"");
  check_option("joint_attach_ke", options.joint_attach_ke);
  check_option("joint_attach_kd", options.joint_attach_kd);
  if (options.sleep) {
    check_sleep("SolverSemiImplicit", *options.sleep);
    require_cpu(this->model()->device(), "SolverSemiImplicit: sleep");
  }
  check_covered(*this->model());
  on_device_ = detail::make_device_steps(this->model(), options_);
}

SolverSemiImplicit::~SolverSemiImplicit() = default;

void SolverSemiImplicit::notify_model_changed(ModelFlags) {
  const ExclusiveUse::Scope scope = use("SolverSemiImplicit.notify_model_changed");
  *cache_ = Cache(*model(), options_.friction_law, options_.sleep);
  on_device_ = detail::make_device_steps(model(), options_);
}

float SolverSemiImplicit::stable_dt(const SimState& state, const Contacts& contacts) const {
  return std::min(stable_contact_dt("SolverSemiImplicit.stable_dt", *model(), state, contacts,
                                    options_.stick_ke),
                  enough_particle_dt("SolverSemiImplicit.stable_dt", *model(), state, &contacts,
                                     {.kf_bound = options_.particle_kf_bound}));
}
float SolverSemiImplicit::stable_dt(const SimState& state) const {
  return enough_particle_dt("SolverSemiImplicit.stable_dt", *model(), state, nullptr,
                            {.contacts = false, .kf_bound = options_.particle_kf_bound});
}

void SolverSemiImplicit::rollout(Trajectory& trajectory, const Control* control,
                                 const Contacts* contacts, float dt,
                                 const RolloutOptions& options) {
  if (on_device_ == nullptr) return SolverBase::rollout(trajectory, control, contacts, dt, options);
  if (ArrayObserver* observer = array_observer())
    observer->untracked_operation("SolverSemiImplicit.rollout");
  on_device_->rollout(trajectory, control, contacts, dt, options);
}

void SolverSemiImplicit::step(SimState& state_in, SimState& state_out, const Control* control,
                              const Contacts* contacts, float dt) {
  if (&state_in == &state_out) {
    SimState& next = next_state(kName);
    step(state_in, next, control, contacts, dt);
    take_next(state_in);
    return cache_->bodies.were_copied(next.body_q, state_in.body_q);
  }
  refuse_tape(options_.sleep);
  const ExclusiveUse::Scope scope = use(kName);
  const Model& m = *model();
  check_step(kName, state_in, state_out, control, contacts, dt);
  check_rotations(kName, state_in);
  m.check_numbers(kName);
  m.check_structure(kName);
  cache_->materials.check(m);
  if (on_device_ != nullptr) return on_device_->step(state_in, state_out, control, contacts, dt);
  m.update_derived();
  cache_->values.check(m);
  if (contacts != nullptr) cache_->contacts.update(m, *contacts);
  cache_->bodies.prepare(m, contacts);
  const JointAttachOptions attach = {options_.joint_attach_ke, options_.joint_attach_kd};
  cache_->joints.check_edits(m, control, "SolverSemiImplicit");
  cache_->joints.prepare(m, attach, dt);
  if (m.particle_count() > 0)
    cache_->particle_watch.look(
        m, {.contacts = contacts != nullptr, .kf_bound = options_.particle_kf_bound}, dt);

  const Vec3f* q = state_in.particle_q.data();
  const Vec3f* qd = state_in.particle_qd.data();
  const int32_t* flags = m.particle_flags.data();
  const int32_t* world = m.particle_world.data();
  const float* inv_mass = m.particle_inv_mass.data();
  const Vec3f* gravity = m.gravity.data();
  const int32_t last_world = m.world_count() - 1;
  Vec3f* const q_out = state_out.particle_q.mutable_data();
  Vec3f* const qd_out = state_out.particle_qd.mutable_data();

  const auto integrate = [&](int64_t p, const Vec3f& f) {
    const bool active = has_flag(flags[p], ParticleFlags::ACTIVE);
    const ParticleState<float> next = integrate_particle(
        active, q[p], qd[p], f, inv_mass[p], gravity[world[p] < 0 ? last_world : world[p]],
        m.particle_max_velocity, dt);
    q_out[p] = next.q;
    qd_out[p] = next.qd;
  };

  const bool touching = contacts != nullptr && !cache_->contacts.empty();
  const bool deformable = ElementForces::any(m);
  if (deformable) cache_->elements.evaluate(m, control, q, qd);
  cache_->joints.evaluate(m, state_in, control, attach);
  if (touching)
    cache_->contacts.evaluate(m, state_in, *contacts, kf_rate(options_.particle_kf_bound, dt));
  const bool particles_touch = touching && cache_->contacts.touches_bodies();
  cache_->bodies.step(m, state_in, state_out, contacts, cache_->joints,
                      particles_touch ? &cache_->contacts : nullptr, rigid_step(options_, dt),
                      cache_->watch, cache_->sleep ? &*cache_->sleep : nullptr);
  if (!touching && !deformable) {
    const Vec3f* f = state_in.particle_f.data();
    for_chunks(m.particle_count(), kChunk, [&](int64_t begin, int64_t end, int64_t) {
      for (int64_t p = begin; p < end; ++p) integrate(p, f[p]);
    });
    return;
  }
  Vec3f* const f = state_in.particle_f.mutable_data();
  for_chunks(m.particle_count(), kChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t p = begin; p < end; ++p) {
      if (deformable) f[p] = cache_->elements.add(p, f[p]);
      if (touching) f[p] = cache_->contacts.add(p, f[p]);
      integrate(p, f[p]);
    }
  });
}

}  // namespace novaphy
