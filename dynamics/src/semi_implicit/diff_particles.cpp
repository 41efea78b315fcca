#include "novaphy/dynamics/semi_implicit/diff_particles.h"

#include <cmath>

#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/error.h"
#include "novaphy/dynamics/diff_model_reads.h"
#include "novaphy/dynamics/diff_operators.h"
#include "novaphy/dynamics/semi_implicit/particle_integrator_trace.h"

namespace novaphy::diff {

using detail::Shapes;
using detail::Worlds;
using nova::Access;
using nova::DType;
using nova::Int;
using nova::Operand;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

namespace {

// Returns the sources of the integration kernel after particle_q, particle_qd and particle_f.
std::vector<nova::SourceSpec> integration_sources(Worlds worlds) {
  const bool several = worlds == Worlds::Several;
  std::vector<nova::SourceSpec> sources = {
      {"particle_q", DType::F32, 3, Access::Direct},
      {"particle_qd", DType::F32, 3, Access::Direct},
      {"particle_f", DType::F32, 3, Access::Direct},
      {"particle_mass", DType::F32, 1, Access::Direct},
      {"particle_inv_mass", DType::F32, 1, Access::Direct},
      {"particle_flags", DType::I32, 1, Access::Direct},
      {"gravity", DType::F32, 3, several ? Access::Indexed : Access::Uniform}};
  if (several) sources.push_back({"particle_world", DType::I32, 1, Access::Direct});
  return sources;
}
constexpr int32_t kMaxVelocity = 0, kDt = 1;  // launch parameters

// Loads the stored 1/mass, and passes its gradient to the mass.
Real inverse_mass(TraceContext& c) {
  const Real w = detach(c.f32(c.source("particle_inv_mass")));
  return with_derivative(w, c.f32(c.source("particle_mass")), -(w * w));
}

Vec3<Real> load_gravity(TraceContext& c, Worlds worlds) {
  if (worlds == Worlds::One) return detail::load_vec3(c, "gravity");
  const size_t gravity = c.source("gravity");
  const Int world = c.i32(c.source("particle_world"));
  return {c.f32(gravity, world, 0), c.f32(gravity, world, 1), c.f32(gravity, world, 2)};
}

std::vector<Real> integrate(TraceContext& c, Worlds worlds, const Vec3<Real>& force) {
  const nova::Bool active = (c.i32(c.source("particle_flags")) & Int(1)) != Int(0);
  const ParticleState<Real> next = integrate_particle(
      active, detail::load_vec3(c, "particle_q"), detail::load_vec3(c, "particle_qd"), force,
      inverse_mass(c), load_gravity(c, worlds), c.param(kMaxVelocity), c.param(kDt));
  return {next.q.x, next.q.y, next.q.z, next.qd.x, next.qd.y, next.qd.z};
}

const std::vector<nova::OutputSpec> kOutputs = {{"particle_q", 3, "particle_q"},
                                                {"particle_qd", 3, "particle_qd"}};

// Adds a kernel variant that computes the gradients by the state only, the most frequent request to
// the kernels that also find contacts.
nova::Kernel with_state_gradients(const nova::Kernel& kernel) {
  return nova::with_gradient_sets(kernel, {"particle_q", "particle_qd"});
}

// particle_f comes from elements here, so its gradient is needed to reach the elements.
nova::Kernel make_integrate_kernel(const char* name, Worlds worlds) {
  return nova::with_gradient_sets(
      nova::make_kernel(name, integration_sources(worlds), kOutputs,
                        [worlds](TraceContext& c) {
                          return integrate(c, worlds, detail::load_vec3(c, "particle_f"));
                        }),
      {"particle_q", "particle_qd", "particle_f"});
}

std::vector<Real> load_force(TraceContext& c) {
  const Vec3<Real> f = detail::load_vec3(c, "particle_f");
  return {f.x, f.y, f.z};
}
nova::EpilogueFn integrate_sums(Worlds worlds) {
  return [worlds](TraceContext& c, std::span<const Real> sums) {
    return integrate(c, worlds, Vec3<Real>{sums[0], sums[1], sums[2]});
  };
}

// Makes the kernel that evaluates static contacts and integrates one substep.
nova::Kernel make_fused_kernel(const char* name, Worlds worlds, Shapes shapes) {
  std::vector<nova::SourceSpec> sources = integration_sources(worlds);
  sources.push_back({"particle_radius", DType::F32, 1, Access::Direct});
  for (const nova::SourceSpec& s : detail::static_shape_sources(worlds)) sources.push_back(s);
  return with_state_gradients(nova::make_reduce_kernel(
      name, sources, kOutputs,
      {.init = load_force,
       .body =
           [worlds, shapes](TraceContext& c) {
             const Vec3<Real> term = detail::static_shape_term(
                 c, worlds, shapes, detail::load_vec3(c, "particle_q"),
                 detail::load_vec3(c, "particle_qd"), c.f32(c.source("particle_radius")), kDt + 1);
             return std::vector{term.x, term.y, term.z};
           },
       .epilogue = integrate_sums(worlds)}));
}

// Makes the kernel that evaluates stored contacts and integrates one substep.
nova::Kernel make_step_kernel(const char* name, Worlds worlds) {
  std::vector<nova::SourceSpec> sources = integration_sources(worlds);
  sources.push_back({"particle_radius", DType::F32, 1, Access::Direct});
  for (const nova::SourceSpec& s : detail::soft_contact_sources()) sources.push_back(s);
  return with_state_gradients(nova::make_reduce_kernel(
      name, sources, kOutputs,
      {.init = load_force,
       .body =
           [](TraceContext& c) {
             const Vec3<Real> term = detail::soft_contact_term(
                 c, detail::load_vec3(c, "particle_q"), detail::load_vec3(c, "particle_qd"),
                 c.f32(c.source("particle_radius")), kDt + 1);
             return std::vector{term.x, term.y, term.z};
           },
       .epilogue = integrate_sums(worlds)}));
}

// The kernels for one world, or for several worlds.
struct Kernels {
  nova::Kernel integrate, fused, step;
};
const Kernels& kernels(Worlds worlds) {
  static const Kernels one = {
      make_integrate_kernel("integrate_particles", Worlds::One),
      make_fused_kernel("integrate_particles_with_static_contacts", Worlds::One, Shapes::Simple),
      make_step_kernel("step_particles", Worlds::One)};
  static const Kernels several = {
      make_integrate_kernel("integrate_particles_of_worlds", Worlds::Several),
      make_fused_kernel("integrate_particles_with_static_contacts_of_worlds", Worlds::Several,
                        Shapes::Simple),
      make_step_kernel("step_particles_of_worlds", Worlds::Several)};
  return worlds == Worlds::Several ? several : one;
}

// Returns the kernel with static contacts. Scenes with shapes that are not simple get a kernel that
// is not compiled ahead of time.
const nova::Kernel& fused_kernel(Worlds worlds, Shapes shapes) {
  if (shapes == Shapes::Simple) return kernels(worlds).fused;
  static const nova::Kernel one = make_fused_kernel("integrate_particles_with_all_static_contacts",
                                                    Worlds::One, Shapes::All),
                            several = make_fused_kernel(
                                "integrate_particles_with_all_static_contacts_of_worlds",
                                Worlds::Several, Shapes::All);
  return worlds == Worlds::Several ? several : one;
}

}  // namespace

void detail::add_particle_kernels(std::vector<nova::EngineKernel>& list) {
  for (const Worlds worlds : {Worlds::One, Worlds::Several}) {
    const auto& [integrate, fused, step] = kernels(worlds);
    for (const nova::Kernel& k : {integrate, fused, step}) list.push_back({k, k.gradients()});
  }
}

namespace {

std::vector<Operand> integration_operands(const Model& model, const Operand& particle_q,
                                          const Operand& particle_qd, const Operand& particle_f) {
  std::vector<Operand> operands = {particle_q,
                                   particle_qd,
                                   particle_f,
                                   nova::operand_of(model.particle_mass),
                                   nova::operand_of(model.particle_inv_mass),
                                   nova::operand_of(model.particle_flags),
                                   nova::operand_of(model.gravity)};
  if (detail::worlds_of(model) == Worlds::Several)
    operands.push_back(nova::operand_of(model.particle_world));
  return operands;
}

void check_dt(float dt, const char* op) {
  require(std::isfinite(dt) && dt > 0.0f, ErrorKind::Value, op,
          ", dt: expected a finite time step > 0, got ", dt);
}

}  // namespace

void integrate_particles(const Model& model, const Operand& particle_q, const Operand& particle_qd,
                         const Operand& particle_f, float dt, const Operand& q_out,
                         const Operand& qd_out) {
  check_dt(dt, "integrate_particles");
  const std::vector<Operand> in = integration_operands(model, particle_q, particle_qd, particle_f);
  const Operand out[] = {q_out, qd_out};
  const nova::Param params[] = {model.particle_max_velocity, dt};
  kernels(detail::worlds_of(model)).integrate.launch(particle_q.rows, in, out, {.params = params});
}

void step_particles(const Model& model, const Contacts& contacts,
                    const nova::Incidence& contacts_of, const Operand& particle_q,
                    const Operand& particle_qd, const Operand& particle_f, float kf_rate, float dt,
                    const Operand& q_out, const Operand& qd_out) {
  check_dt(dt, "step_particles");
  std::vector<Operand> in = integration_operands(model, particle_q, particle_qd, particle_f);
  in.push_back(nova::operand_of(model.particle_radius));
  for (Operand& o : detail::soft_contact_operands(model, contacts)) in.push_back(std::move(o));
  std::vector<nova::Param> params = {model.particle_max_velocity, dt};
  for (const nova::Param& p : detail::soft_contact_params(model, kf_rate)) params.push_back(p);
  const Operand out[] = {q_out, qd_out};
  kernels(detail::worlds_of(model))
      .step.launch(particle_q.rows, in, out, {.params = params, .csr = &contacts_of});
}

void step_particles_with_static_contacts(const Model& model, const WorldRows& rows,
                                         const Operand& particle_q, const Operand& particle_qd,
                                         const Operand& particle_f, float kf_rate,
                                         float soft_contact_margin, float dt, const Operand& q_out,
                                         const Operand& qd_out) {
  check_dt(dt, "step_particles_with_static_contacts");
  std::vector<Operand> in = integration_operands(model, particle_q, particle_qd, particle_f);
  in.push_back(nova::operand_of(model.particle_radius));
  for (const Operand& o : detail::static_shape_operands(model, rows)) in.push_back(o);
  std::vector<nova::Param> params = {model.particle_max_velocity, dt};
  for (const nova::Param& p : detail::static_shape_params(model, kf_rate, soft_contact_margin))
    params.push_back(p);
  const Operand out[] = {q_out, qd_out};
  fused_kernel(detail::worlds_of(model), rows.shapes())
      .launch(particle_q.rows, in, out, detail::static_shape_options(model, rows, params));
}

std::pair<Tensor, Tensor> integrate_particles_generated(const Model& model,
                                                        const Tensor& particle_q,
                                                        const Tensor& particle_qd,
                                                        const Tensor& particle_f, float dt) {
  const char* op = "integrate_particles_generated";
  detail::check_particle_tensor(model, particle_q, op, "particle_q");
  detail::check_particle_tensor(model, particle_qd, op, "particle_qd");
  detail::check_particle_tensor(model, particle_f, op, "particle_f");
  check_dt(dt, op);
  begin_model_reads(model, op);
  const Tensor q(particle_q.shape(), DType::F32, model.device()),
      qd(particle_q.shape(), DType::F32, model.device());
  WorldRows().update(model, false);
  integrate_particles(model, particle_q.operand(), particle_qd.operand(), particle_f.operand(), dt,
                      q.operand(), qd.operand());
  return {q, qd};
}

std::pair<Tensor, Tensor> integrate_particles_with_static_contacts_generated(
    const Model& model, const Tensor& particle_q, const Tensor& particle_qd,
    const Tensor& particle_f, float soft_contact_margin, float dt) {
  const char* op = "integrate_particles_with_static_contacts_generated";
  detail::check_particle_tensor(model, particle_q, op, "particle_q");
  detail::check_particle_tensor(model, particle_qd, op, "particle_qd");
  detail::check_particle_tensor(model, particle_f, op, "particle_f");
  check_dt(dt, op);
  detail::check_static_shapes(model);
  begin_model_reads(model, op);
  const Tensor q(particle_q.shape(), DType::F32, model.device()),
      qd(particle_q.shape(), DType::F32, model.device());
  WorldRows rows;
  rows.update(model, true);
  step_particles_with_static_contacts(model, rows, particle_q.operand(), particle_qd.operand(),
                                      particle_f.operand(), kNoKfBound, soft_contact_margin, dt,
                                      q.operand(), qd.operand());
  return {q, qd};
}

}  // namespace novaphy::diff
