#include "novaphy/collision/diff_soft_contacts.h"

#include <cmath>

#include "novaphy/collision/candidate_pairs.h"
#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/diff_model_reads.h"
#include "novaphy/dynamics/diff_operators.h"

namespace novaphy::diff {

using nova::Access;
using nova::Bool;
using nova::DType;
using nova::Int;
using nova::Operand;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

namespace detail {

Vec3<Real> load_vec3(TraceContext& c, const char* source) {
  const size_t s = c.source(source);
  return {c.f32(s, 0), c.f32(s, 1), c.f32(s, 2)};
}

void check_particle_tensor(const Model& model, const Tensor& tensor, const char* op,
                           const char* name) {
  require(tensor.defined() && tensor.dtype() == DType::F32, ErrorKind::Type, op, ", ", name,
          ": expected a float32 tensor");
  if (tensor.ndim() != 2 || tensor.rows() != model.particle_count() || tensor.row_width() != 3)
    fail(ErrorKind::Value, op, ", ", name, ": expected {", model.particle_count(),
         ", 3} tightly packed float32, got ", nova::shape_str(tensor.shape()));
  if (tensor.device() != model.device())
    fail(ErrorKind::Value, op, ", ", name, ": expected device ", model.device().str(), ", got ",
         tensor.device().str());
}

}  // namespace detail

namespace {

SoftContactMaterial<Real> material_params(TraceContext& c, int32_t first) {
  return {c.param(first), c.param(first + 1), c.param(first + 2), c.param(first + 3)};
}
}  // namespace

namespace detail {

std::vector<nova::SourceSpec> soft_contact_sources() {
  return {{"soft_contact_shape", DType::I32, 1, Access::CsrRow},
          {"soft_contact_body_pos", DType::F32, 3, Access::CsrRow},
          {"soft_contact_normal", DType::F32, 3, Access::CsrRow},
          {"shape_material_ke", DType::F32, 1, Access::Indexed},
          {"shape_material_kd", DType::F32, 1, Access::Indexed},
          {"shape_material_kf", DType::F32, 1, Access::Indexed},
          {"shape_material_mu", DType::F32, 1, Access::Indexed}};
}

std::vector<Operand> soft_contact_operands(const Model& model, const Contacts& contacts) {
  return {nova::operand_of(contacts.soft_contact_shape),
          nova::operand_of(contacts.soft_contact_body_pos),
          nova::operand_of(contacts.soft_contact_normal),
          nova::operand_of(model.shape_material_ke),
          nova::operand_of(model.shape_material_kd),
          nova::operand_of(model.shape_material_kf),
          nova::operand_of(model.shape_material_mu)};
}

std::array<nova::Param, kSoftContactParams> soft_contact_params(const Model& model, float kf_rate) {
  return {model.soft_contact_ke, model.soft_contact_kd,   model.soft_contact_kf,
          model.soft_contact_mu, model.particle_adhesion, kf_rate};
}

Vec3<Real> soft_contact_term(TraceContext& c, const Vec3<Real>& x, const Vec3<Real>& v,
                             const Real& radius, int32_t first_param) {
  const Int shape = c.i32(c.source("soft_contact_shape"));
  auto of_shape = [&](const char* name) { return c.f32(c.source(name), shape, 0); };
  const SoftContactMaterial<Real> shape_material{
      of_shape("shape_material_ke"), of_shape("shape_material_kd"), of_shape("shape_material_kf"),
      of_shape("shape_material_mu")};
  const Vec3<Real> zero{0.0f, 0.0f, 0.0f};  // world-owned shapes do not move
  return soft_contact_force_term(
      x, v, radius, load_vec3(c, "soft_contact_body_pos"), zero,
      load_vec3(c, "soft_contact_normal"),
      with_bounded_kf(mean_soft_contact_material(material_params(c, first_param), shape_material),
                      c.f32(c.source("particle_mass")), c.param(first_param + 5)),
      c.param(first_param + 4));
}

}  // namespace detail

namespace {

const nova::Kernel& soft_contact_kernel() {
  static const nova::Kernel kernel = [] {
    std::vector<nova::SourceSpec> sources = {{"particle_q", DType::F32, 3, Access::Direct},
                                             {"particle_qd", DType::F32, 3, Access::Direct},
                                             {"particle_f", DType::F32, 3, Access::Direct},
                                             {"particle_mass", DType::F32, 1, Access::Direct},
                                             {"particle_radius", DType::F32, 1, Access::Direct}};
    for (const nova::SourceSpec& s : detail::soft_contact_sources()) sources.push_back(s);
    return nova::with_one_gradient_set(nova::make_reduce_kernel(
        "soft_contact_forces", sources, {{"particle_f", 3}},
        {.init =
             [](TraceContext& c) {
               const Vec3<Real> f = detail::load_vec3(c, "particle_f");
               return std::vector{f.x, f.y, f.z};
             },
         .body =
             [](TraceContext& c) {
               const Vec3<Real> term = detail::soft_contact_term(
                   c, detail::load_vec3(c, "particle_q"), detail::load_vec3(c, "particle_qd"),
                   c.f32(c.source("particle_radius")), 0);
               return std::vector{term.x, term.y, term.z};
             },
         .epilogue = {}}));
  }();
  return kernel;
}

}  // namespace

void eval_soft_contact_forces(const Model& model, const Contacts& contacts,
                              const nova::Incidence& contacts_of, const Operand& particle_q,
                              const Operand& particle_qd, const Operand& particle_f, float kf_rate,
                              const Operand& forces) {
  std::vector<Operand> in = {particle_q, particle_qd, particle_f,
                             nova::operand_of(model.particle_mass),
                             nova::operand_of(model.particle_radius)};
  for (Operand& o : detail::soft_contact_operands(model, contacts)) in.push_back(std::move(o));
  const std::array params = detail::soft_contact_params(model, kf_rate);
  soft_contact_kernel().launch(particle_q.rows, in, forces,
                               {.params = params, .csr = &contacts_of});
}

void WorldRows::check_shapes(const Model& model) {
  depend_on({&model.shape_type, &model.shape_flags, &model.shape_body});
  if (covered_type_.matches(model.shape_type) && covered_flags_.matches(model.shape_flags) &&
      covered_body_.matches(model.shape_body))
    return;
  // A capture does not record the model, so that these host reads are allowed in a capture, too.
  const UntrackedScope untracked;
  shapes_ = detail::check_static_shapes(model);
  covered_type_.set(model.shape_type);
  covered_flags_.set(model.shape_flags);
  covered_body_.set(model.shape_body);
}

void WorldRows::update(const Model& model, bool with_shapes) {
  if (with_shapes) check_shapes(model);
  if (model.world_count() == 1) return;
  depend_on({&model.particle_world});
  if (with_shapes) depend_on({&model.shape_world, &model.shape_flags});
  const bool same_particles = particle_world_.matches(model.particle_world);
  if (same_particles && (!with_shapes || (shape_world_.matches(model.shape_world) &&
                                          shape_flags_.matches(model.shape_flags))))
    return;
  std::vector<int32_t> world;
  CandidatePairs pairs;
  {
    // A capture does not record the model, so that these host reads are allowed in a capture, too.
    const UntrackedScope untracked;
    world = model.particle_world.to_host();
    if (with_shapes) pairs = make_candidate_pairs(model);
  }
  for (size_t p = 0; p < world.size(); ++p) {
    require(world[p] >= -1 && world[p] < model.world_count(), ErrorKind::Index,
            "model.particle_world[", p, "]: expected 0 to ", model.world_count() - 1, ", got ",
            world[p]);
    require(world[p] >= 0, ErrorKind::NotImplemented, "model.particle_world[", p,
            "]: particles of all worlds (-1) are not supported in models of several worlds");
  }
  particle_world_.set(model.particle_world);
  if (!with_shapes) return;
  shape_ = nova::operand_of(DeviceArray<int32_t>::from_host(pairs.shape, model.device()));
  const auto particle = DeviceArray<int32_t>::from_host(pairs.particle, model.device());
  pairs_of_particles_ = nova::make_incidence(nova::operand_of(particle), model.particle_count());
  shape_world_.set(model.shape_world);
  shape_flags_.set(model.shape_flags);
}

namespace detail {

std::vector<nova::SourceSpec> static_shape_sources(Worlds worlds) {
  const bool several = worlds == Worlds::Several;
  const Access access = several ? Access::Indexed : Access::Reduced;
  std::vector<nova::SourceSpec> sources = {
      {"shape_type", DType::I32, 1, access},        {"shape_flags", DType::I32, 1, access},
      {"shape_body", DType::I32, 1, access},        {"shape_transform", DType::F32, 7, access},
      {"shape_scale", DType::F32, 3, access},       {"shape_margin", DType::F32, 1, access},
      {"shape_material_ke", DType::F32, 1, access}, {"shape_material_kd", DType::F32, 1, access},
      {"shape_material_kf", DType::F32, 1, access}, {"shape_material_mu", DType::F32, 1, access}};
  if (several) sources.push_back({"pair_shape", DType::I32, 1, Access::CsrRow});
  return sources;
}

std::vector<Operand> static_shape_operands(const Model& model, const WorldRows& rows) {
  std::vector<Operand> operands = {
      nova::operand_of(model.shape_type),        nova::operand_of(model.shape_flags),
      nova::operand_of(model.shape_body),        nova::operand_of(model.shape_transform),
      nova::operand_of(model.shape_scale),       nova::operand_of(model.shape_margin),
      nova::operand_of(model.shape_material_ke), nova::operand_of(model.shape_material_kd),
      nova::operand_of(model.shape_material_kf), nova::operand_of(model.shape_material_mu)};
  if (worlds_of(model) == Worlds::Several) operands.push_back(rows.shape());
  return operands;
}

nova::LaunchOptions static_shape_options(const Model& model, const WorldRows& rows,
                                         std::span<const nova::Param> params) {
  if (worlds_of(model) == Worlds::Several)
    return {.params = params, .csr = &rows.pairs_of_particles()};
  return {.params = params, .extent = model.shape_count()};
}

std::vector<nova::Param> static_shape_params(const Model& model, float kf_rate,
                                             float soft_contact_margin) {
  require(std::isfinite(soft_contact_margin) && soft_contact_margin >= 0.0f, ErrorKind::Value,
          "soft_contact_margin: expected a finite distance >= 0, got ", soft_contact_margin);
  const std::array law = soft_contact_params(model, kf_rate);
  std::vector<nova::Param> params(law.begin(), law.end());
  params.emplace_back(soft_contact_margin);
  return params;
}

Shapes check_static_shapes(const Model& model) {
  Shapes shapes = Shapes::Simple;
  if (model.particle_count() == 0) return shapes;
  const std::vector<int32_t> type = model.shape_type.to_host(), flags = model.shape_flags.to_host(),
                             body = model.shape_body.to_host();
  for (size_t s = 0; s < type.size(); ++s) {
    if (!(flags[s] & static_cast<int32_t>(ShapeFlags::COLLIDE_PARTICLES))) continue;
    const auto t = static_cast<GeoType>(type[s]);
    const ShapeTraits traits = shape_traits(t);
    const bool covered =
        body[s] < 0 && traits.size != ShapeSize::NONE && traits.size != ShapeSize::FACTORS;
    require(covered, ErrorKind::NotImplemented, "shape ", s, " (", geo_type_name(t),
            "): static contacts cover world-owned planes, boxes, spheres, capsules, cylinders, "
            "cones and ellipsoids");
    if (traits.is_curved) shapes = Shapes::All;
  }
  return shapes;
}

Vec3<Real> static_shape_term(TraceContext& c, Worlds worlds, Shapes shapes, const Vec3<Real>& x,
                             const Vec3<Real>& v, const Real& radius, int32_t first_param) {
  const Int shape = worlds == Worlds::Several ? c.i32(c.source("pair_shape")) : c.reduce_index();
  auto of_shape = [&](const char* name, int32_t column = 0) {
    return c.f32(c.source(name), shape, column);
  };
  const Int type = c.i32(c.source("shape_type"), shape, 0);
  const Int flags = c.i32(c.source("shape_flags"), shape, 0);
  auto at = [&](int32_t column) { return of_shape("shape_transform", column); };
  const Transform<Real> xform{{at(0), at(1), at(2)}, {at(3), at(4), at(5), at(6)}};
  const Vec3<Real> scale{of_shape("shape_scale", 0), of_shape("shape_scale", 1),
                         of_shape("shape_scale", 2)};
  auto is = [&](GeoType wanted) { return type == Int(static_cast<int32_t>(wanted)); };
  const StaticShapeType<Bool> shape_type = static_shape_type<GeoType, Bool>(is);
  const StaticContact<Real> contact =
      shapes == Shapes::All ? static_shape_contact<true>(shape_type, xform, scale, x)
                            : static_shape_contact<false>(shape_type, xform, scale, x);
  const SoftContactMaterial<Real> shape_material{
      of_shape("shape_material_ke"), of_shape("shape_material_kd"), of_shape("shape_material_kf"),
      of_shape("shape_material_mu")};
  const Vec3<Real> zero{0.0f, 0.0f, 0.0f};
  const Vec3<Real> term = soft_contact_force_term(
      x, v, radius, contact.point, zero, contact.normal,
      with_bounded_kf(mean_soft_contact_material(material_params(c, first_param), shape_material),
                      c.f32(c.source("particle_mass")), c.param(first_param + 5)),
      c.param(first_param + 4));
  const Bool collides =
      (flags & Int(static_cast<int32_t>(ShapeFlags::COLLIDE_PARTICLES))) != Int(0);
  const Bool world_owned = c.i32(c.source("shape_body"), shape, 0) < Int(0);
  // A NaN position fails every comparison. The contact then counts as detected, so that the NaN
  // reaches the force, as in the law.
  const Bool lost = contact.point.x != contact.point.x;
  const Bool detected = either(
      lost, contact.distance < (c.param(first_param + 6) + of_shape("shape_margin")) + radius);
  const Real none = -0.0f;
  return math::select(both(both(collides, world_owned), detected), term,
                      Vec3<Real>{none, none, none});
}

}  // namespace detail

namespace {

nova::Kernel make_static_contact_kernel(const char* name, detail::Worlds worlds,
                                        detail::Shapes shapes) {
  std::vector<nova::SourceSpec> sources = {{"particle_q", DType::F32, 3, Access::Direct},
                                           {"particle_qd", DType::F32, 3, Access::Direct},
                                           {"particle_f", DType::F32, 3, Access::Direct},
                                           {"particle_mass", DType::F32, 1, Access::Direct},
                                           {"particle_radius", DType::F32, 1, Access::Direct},
                                           {"particle_flags", DType::I32, 1, Access::Direct}};
  for (const nova::SourceSpec& s : detail::static_shape_sources(worlds)) sources.push_back(s);
  return nova::make_reduce_kernel(
      name, sources, {{"particle_f", 3}},
      {.init =
           [](TraceContext& c) {
             const Vec3<Real> f = detail::load_vec3(c, "particle_f");
             return std::vector{f.x, f.y, f.z};
           },
       .body =
           [worlds, shapes](TraceContext& c) {
             const Vec3<Real> term = detail::static_shape_term(
                 c, worlds, shapes, detail::load_vec3(c, "particle_q"),
                 detail::load_vec3(c, "particle_qd"), c.f32(c.source("particle_radius")), 0);
             const Bool active = (c.i32(c.source("particle_flags")) & Int(1)) != Int(0);
             const Real none = -0.0f;
             const Vec3<Real> acting = math::select(active, term, Vec3<Real>{none, none, none});
             return std::vector{acting.x, acting.y, acting.z};
           },
       .epilogue = {}});
}

const nova::Kernel& static_contact_kernel(detail::Worlds worlds, detail::Shapes shapes) {
  using detail::Shapes, detail::Worlds;
  static const nova::Kernel
      one = nova::with_one_gradient_set(make_static_contact_kernel(
          "static_particle_shape_contact_forces", Worlds::One, Shapes::Simple)),
      several = nova::with_one_gradient_set(make_static_contact_kernel(
          "static_particle_shape_contact_forces_of_worlds", Worlds::Several, Shapes::Simple)),
      one_all = make_static_contact_kernel("static_particle_all_shape_contact_forces", Worlds::One,
                                           Shapes::All),
      several_all = make_static_contact_kernel("static_particle_all_shape_contact_forces_of_worlds",
                                               Worlds::Several, Shapes::All);
  if (shapes == Shapes::All) return worlds == Worlds::Several ? several_all : one_all;
  return worlds == Worlds::Several ? several : one;
}

}  // namespace

void detail::add_contact_kernels(std::vector<nova::EngineKernel>& list) {
  for (const nova::Kernel& k :
       {soft_contact_kernel(), static_contact_kernel(Worlds::One, Shapes::Simple),
        static_contact_kernel(Worlds::Several, Shapes::Simple)})
    list.push_back({k, k.gradients()});
}

void eval_static_contact_forces(const Model& model, const WorldRows& rows,
                                const Operand& particle_q, const Operand& particle_qd,
                                const Operand& particle_f, float kf_rate, float soft_contact_margin,
                                const Operand& forces) {
  const std::vector<nova::Param> params =
      detail::static_shape_params(model, kf_rate, soft_contact_margin);
  std::vector<Operand> in = {particle_q,
                             particle_qd,
                             particle_f,
                             nova::operand_of(model.particle_mass),
                             nova::operand_of(model.particle_radius),
                             nova::operand_of(model.particle_flags)};
  for (const Operand& o : detail::static_shape_operands(model, rows)) in.push_back(o);
  static_contact_kernel(detail::worlds_of(model), rows.shapes())
      .launch(particle_q.rows, in, forces, detail::static_shape_options(model, rows, params));
}

Tensor eval_static_particle_shape_contact_forces_generated(const Model& model,
                                                           const Tensor& particle_q,
                                                           const Tensor& particle_qd,
                                                           const Tensor& particle_f,
                                                           float soft_contact_margin) {
  const char* op = "eval_static_particle_shape_contact_forces_generated";
  detail::check_particle_tensor(model, particle_q, op, "particle_q");
  detail::check_particle_tensor(model, particle_qd, op, "particle_qd");
  detail::check_particle_tensor(model, particle_f, op, "particle_f");
  detail::check_static_shapes(model);
  begin_model_reads(model, op);
  const Tensor out(particle_f.shape(), DType::F32, model.device());
  WorldRows rows;
  rows.update(model, true);
  eval_static_contact_forces(model, rows, particle_q.operand(), particle_qd.operand(),
                             particle_f.operand(), kNoKfBound, soft_contact_margin, out.operand());
  return out;
}

}  // namespace novaphy::diff
