#include "novaphy/dynamics/semi_implicit/diff_particles.h"

#include <cmath>

#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/error.h"
#include "novaphy/diff/engine_kernels.h"
#include "novaphy/diff/model_reads.h"
#include "novaphy/dynamics/semi_implicit/particle_integrator_trace.h"

namespace novaphy::diff {

using nova::Access;
using nova::DType;
using nova::Int;
using nova::Operand;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

namespace {

// Sources of the integration, after particle_q, particle_qd and particle_f.
std::vector<nova::SourceSpec> integration_sources() {
  return {{"particle_q", DType::F32, 3, Access::Direct},
          {"particle_qd", DType::F32, 3, Access::Direct},
          {"particle_f", DType::F32, 3, Access::Direct},
          {"particle_mass", DType::F32, 1, Access::Direct},
          {"particle_inv_mass", DType::F32, 1, Access::Direct},
          {"particle_flags", DType::I32, 1, Access::Direct},
          {"gravity", DType::F32, 3, Access::Uniform}};
}
constexpr int32_t kMaxVelocity = 0, kDt = 1;  // launch parameters

// 1/mass as stored, whose gradient goes to the mass.
Real inverse_mass(TraceContext& c) {
  const Real w = detach(c.f32(c.source("particle_inv_mass")));
  return with_derivative(w, c.f32(c.source("particle_mass")), -(w * w));
}

std::vector<Real> integrate(TraceContext& c, const Vec3<Real>& force) {
  const nova::Bool active = (c.i32(c.source("particle_flags")) & Int(1)) != Int(0);
  const ParticleState<Real> next = integrate_particle(
      active, detail::load_vec3(c, "particle_q"), detail::load_vec3(c, "particle_qd"), force,
      inverse_mass(c), detail::load_vec3(c, "gravity"), c.param(kMaxVelocity), c.param(kDt));
  return {next.q.x, next.q.y, next.q.z, next.qd.x, next.qd.y, next.qd.z};
}

const std::vector<nova::OutputSpec> kOutputs = {{"particle_q", 3}, {"particle_qd", 3}};

const nova::Kernel& integrate_kernel() {
  static const nova::Kernel kernel = nova::make_kernel(
      "integrate_particles", integration_sources(), kOutputs,
      [](TraceContext& c) { return integrate(c, detail::load_vec3(c, "particle_f")); });
  return kernel;
}

std::vector<Real> load_force(TraceContext& c) {
  const Vec3<Real> f = detail::load_vec3(c, "particle_f");
  return {f.x, f.y, f.z};
}
std::vector<Real> integrate_sums(TraceContext& c, std::span<const Real> sums) {
  return integrate(c, Vec3<Real>{sums[0], sums[1], sums[2]});
}

const nova::Kernel& fused_kernel() {
  static const nova::Kernel kernel = [] {
    std::vector<nova::SourceSpec> sources = integration_sources();
    sources.push_back({"particle_radius", DType::F32, 1, Access::Direct});
    for (const nova::SourceSpec& s : detail::static_shape_sources()) sources.push_back(s);
    constexpr int32_t first_contact_param = kDt + 1;
    return nova::make_reduce_kernel(
        "integrate_particles_with_static_contacts", sources, kOutputs,
        {.init = load_force,
         .body =
             [](TraceContext& c) {
               const Vec3<Real> term = detail::static_shape_term(
                   c, detail::load_vec3(c, "particle_q"), detail::load_vec3(c, "particle_qd"),
                   c.f32(c.source("particle_radius")), first_contact_param);
               return std::vector{term.x, term.y, term.z};
             },
         .epilogue = integrate_sums});
  }();
  return kernel;
}

// Contacts and integration of one substep.
const nova::Kernel& step_kernel() {
  static const nova::Kernel kernel = [] {
    std::vector<nova::SourceSpec> sources = integration_sources();
    sources.push_back({"particle_radius", DType::F32, 1, Access::Direct});
    for (const nova::SourceSpec& s : detail::soft_contact_sources()) sources.push_back(s);
    return nova::make_reduce_kernel("step_particles", sources, kOutputs,
                                    {.init = load_force,
                                     .body =
                                         [](TraceContext& c) {
                                           const Vec3<Real> term = detail::soft_contact_term(
                                               c, detail::load_vec3(c, "particle_q"),
                                               detail::load_vec3(c, "particle_qd"),
                                               c.f32(c.source("particle_radius")), kDt + 1);
                                           return std::vector{term.x, term.y, term.z};
                                         },
                                     .epilogue = integrate_sums});
  }();
  return kernel;
}

}  // namespace

void detail::add_particle_kernels(std::vector<nova::EngineKernel>& list) {
  const std::vector<std::string> state = {"particle_q", "particle_qd"};
  const std::vector<std::string> others = {"particle_f", "particle_mass", "gravity"};
  const std::vector<std::string> with_contacts = {
      "particle_f",        "particle_mass",     "gravity",          "particle_radius",
      "shape_material_ke", "shape_material_kd", "shape_material_mu"};
  const std::vector<std::string> materials = {"shape_material_ke", "shape_material_kd",
                                              "shape_material_kf", "shape_material_mu"};
  list.push_back({integrate_kernel(), rollout_gradients(integrate_kernel(), state, others, {})});
  list.push_back({fused_kernel(), rollout_gradients(fused_kernel(), state, others, materials)});
  list.push_back(
      {step_kernel(), rollout_gradients(step_kernel(), state, with_contacts, materials)});
}

namespace {

std::vector<Operand> integration_operands(const Model& model, const Operand& particle_q,
                                          const Operand& particle_qd, const Operand& particle_f) {
  return {particle_q,
          particle_qd,
          particle_f,
          nova::operand_of(model.particle_mass),
          nova::operand_of(model.particle_inv_mass),
          nova::operand_of(model.particle_flags),
          nova::operand_of(model.gravity)};
}

void check_model(const Model& model, float dt, const char* op) {
  require(std::isfinite(dt) && dt > 0.0f, ErrorKind::Value, op,
          ", dt: expected a finite time step > 0, got ", dt);
  require(model.gravity.rows() == 1, ErrorKind::NotImplemented, op,
          ": models of several worlds are not covered");
}

}  // namespace

void integrate_particles(const Model& model, const Operand& particle_q, const Operand& particle_qd,
                         const Operand& particle_f, float dt, const Operand& q_out,
                         const Operand& qd_out) {
  check_model(model, dt, "integrate_particles");
  const std::vector<Operand> in = integration_operands(model, particle_q, particle_qd, particle_f);
  const Operand out[] = {q_out, qd_out};
  const nova::Param params[] = {model.particle_max_velocity, dt};
  integrate_kernel().launch(particle_q.rows, in, out, {.params = params});
}

void step_particles(const Model& model, const Contacts& contacts,
                    const nova::Incidence& contacts_of, const Operand& particle_q,
                    const Operand& particle_qd, const Operand& particle_f, float dt,
                    const Operand& q_out, const Operand& qd_out) {
  check_model(model, dt, "step_particles");
  std::vector<Operand> in = integration_operands(model, particle_q, particle_qd, particle_f);
  in.push_back(nova::operand_of(model.particle_radius));
  for (Operand& o : detail::soft_contact_operands(model, contacts)) in.push_back(std::move(o));
  std::vector<nova::Param> params = {model.particle_max_velocity, dt};
  for (const nova::Param& p : detail::soft_contact_params(model)) params.push_back(p);
  const Operand out[] = {q_out, qd_out};
  step_kernel().launch(particle_q.rows, in, out, {.params = params, .csr = &contacts_of});
}

void step_particles_with_static_contacts(const Model& model, const Operand& particle_q,
                                         const Operand& particle_qd, const Operand& particle_f,
                                         float soft_contact_margin, float dt, const Operand& q_out,
                                         const Operand& qd_out) {
  check_model(model, dt, "step_particles_with_static_contacts");
  std::vector<Operand> in = integration_operands(model, particle_q, particle_qd, particle_f);
  in.push_back(nova::operand_of(model.particle_radius));
  for (const Operand& o : detail::static_shape_operands(model)) in.push_back(o);
  std::vector<nova::Param> params = {model.particle_max_velocity, dt};
  for (const nova::Param& p : detail::static_shape_params(model, soft_contact_margin))
    params.push_back(p);
  const Operand out[] = {q_out, qd_out};
  fused_kernel().launch(particle_q.rows, in, out,
                        {.params = params, .extent = model.shape_count()});
}

std::pair<Tensor, Tensor> integrate_particles_generated(const Model& model,
                                                        const Tensor& particle_q,
                                                        const Tensor& particle_qd,
                                                        const Tensor& particle_f, float dt) {
  const char* op = "integrate_particles_generated";
  detail::check_particle_tensor(model, particle_q, op, "particle_q");
  detail::check_particle_tensor(model, particle_qd, op, "particle_qd");
  detail::check_particle_tensor(model, particle_f, op, "particle_f");
  check_model(model, dt, op);
  begin_model_reads(model, op);
  const Tensor q(particle_q.shape(), DType::F32, model.device()),
      qd(particle_q.shape(), DType::F32, model.device());
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
  check_model(model, dt, op);
  detail::check_static_shapes(model);
  begin_model_reads(model, op);
  const Tensor q(particle_q.shape(), DType::F32, model.device()),
      qd(particle_q.shape(), DType::F32, model.device());
  step_particles_with_static_contacts(model, particle_q.operand(), particle_qd.operand(),
                                      particle_f.operand(), soft_contact_margin, dt, q.operand(),
                                      qd.operand());
  return {q, qd};
}

}  // namespace novaphy::diff
