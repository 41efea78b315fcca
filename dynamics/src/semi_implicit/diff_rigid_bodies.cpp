#include "novaphy/dynamics/semi_implicit/diff_rigid_bodies.h"

#include <cmath>
#include <vector>

#include "diff_trace_columns.h"
#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/diff_model_reads.h"
#include "novaphy/dynamics/diff_operators.h"
#include "novaphy/dynamics/semi_implicit/rigid_integrator_trace.h"
#include "novaphy/dynamics/semi_implicit/rigid_plane_trace.h"

namespace novaphy::diff {

using detail::Columns;
using detail::Worlds;
using nova::Access;
using nova::Bool;
using nova::DType;
using nova::Int;
using nova::Operand;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

namespace {

constexpr int32_t kAngularDamping = 0, kSmoothing = 1, kDt = 2;  // launch parameters

std::vector<nova::SourceSpec> sources(Worlds worlds) {
  const bool several = worlds == Worlds::Several;
  std::vector<nova::SourceSpec> list = {
      {"body_q", DType::F32, 7, Access::Direct},
      {"body_qd", DType::F32, 6, Access::Direct},
      {"body_f", DType::F32, 6, Access::Direct},
      {"body_com", DType::F32, 3, Access::Direct},
      {"body_mass", DType::F32, 1, Access::Direct},
      {"body_inv_mass", DType::F32, 1, Access::Direct},
      {"body_inertia", DType::F32, 9, Access::Direct},
      {"body_inv_inertia", DType::F32, 9, Access::Direct},
      {"body_flags", DType::I32, 1, Access::Direct},
      {"gravity", DType::F32, 3, several ? Access::Indexed : Access::Uniform},
      {"pairs", DType::I32, 2, Access::CsrRow},
      {"shape_type", DType::I32, 1, Access::Indexed},
      {"shape_transform", DType::F32, 7, Access::Indexed},
      {"shape_scale", DType::F32, 3, Access::Indexed},
      {"shape_margin", DType::F32, 1, Access::Indexed},
      {"shape_gap", DType::F32, 1, Access::Indexed}};
  for (const nova::SourceSpec& s : detail::material_sources()) list.push_back(s);
  if (several) list.push_back({"body_world", DType::I32, 1, Access::Direct});
  return list;
}

std::vector<Operand> operands(const Model& m, const PlanePairs& pairs, const Operand& body_q,
                              const Operand& body_qd, const Operand& body_f) {
  std::vector<Operand> list = {body_q,
                               body_qd,
                               body_f,
                               nova::operand_of(m.body_com),
                               nova::operand_of(m.body_mass),
                               nova::operand_of(m.body_inv_mass),
                               nova::operand_of(m.body_inertia),
                               nova::operand_of(m.body_inv_inertia),
                               nova::operand_of(m.body_flags),
                               nova::operand_of(m.gravity),
                               pairs.pairs(),
                               nova::operand_of(m.shape_type),
                               nova::operand_of(m.shape_transform),
                               nova::operand_of(m.shape_scale),
                               nova::operand_of(m.shape_margin),
                               nova::operand_of(m.shape_gap)};
  for (Operand& o : detail::material_operands(m)) list.push_back(std::move(o));
  if (detail::worlds_of(m) == Worlds::Several) list.push_back(nova::operand_of(m.body_world));
  return list;
}

Vec3<Real> constant(const Vec3<Real>& v) { return {detach(v.x), detach(v.y), detach(v.z)}; }
Transform<Real> constant(const Transform<Real>& x) {
  return {constant(x.p), {detach(x.q.x), detach(x.q.y), detach(x.q.z), detach(x.q.w)}};
}

// Computes the wrench of the contacts of one plane-shape pair on the body.
std::vector<Real> pair_wrench(TraceContext& c) {
  const Int plane = c.i32(c.source("pairs"), 0), shape = c.i32(c.source("pairs"), 1);
  const Transform<Real> plane_pose = constant(Columns(c, "shape_transform", &plane).transform());
  const Int type = c.i32(c.source("shape_type"), shape, 0);
  const auto is = [&](GeoType wanted) { return type == Int(static_cast<int32_t>(wanted)); };
  const auto number = [&](const char* name, const Int& of) {
    return detach(Columns(c, name, &of)[0]);
  };
  const WorldPlane<Real> ground = {plane_pose.p,
                                   math::rotate(plane_pose.q, Vec3<Real>{0.0f, 0.0f, 1.0f}),
                                   number("shape_margin", plane)};
  const BodyShape<Bool, Real> body_shape = {
      is(GeoType::BOX), is(GeoType::CAPSULE),
      constant(Columns(c, "shape_transform", &shape).transform()),
      constant(Columns(c, "shape_scale", &shape).vec3()), number("shape_margin", shape)};
  const BodyMotion<Real> body = {Columns(c, "body_q").transform(), Columns(c, "body_qd").spatial(),
                                 Columns(c, "body_com").vec3()};
  const SpatialVector<Real> w = plane_contact_wrench(
      FrictionLaw::Huber, ground, body_shape, body,
      number("shape_gap", plane) + number("shape_gap", shape),
      mean_rigid_contact_material(detail::load_material(c, plane), detail::load_material(c, shape)),
      c.param(kSmoothing));
  return {w.linear.x, w.linear.y, w.linear.z, w.angular.x, w.angular.y, w.angular.z};
}

// Loads the stored inverse mass and inertia, and passes their gradients to mass and inertia.
RigidBodyMass<Real> load_mass(TraceContext& c) {
  RigidBodyMass<Real> mass;
  mass.com = Columns(c, "body_com").vec3();
  const Real w = detach(Columns(c, "body_inv_mass")[0]);
  mass.inv_mass = with_derivative(w, Columns(c, "body_mass")[0], -(w * w));
  const Columns inertia(c, "body_inertia"), stored(c, "body_inv_inertia");
  Mat33<Real> inverse;
  for (int32_t k = 0; k < 9; ++k) {
    mass.inertia.m[k / 3][k % 3] = inertia[k];
    inverse.m[k / 3][k % 3] = detach(stored[k]);
  }
  // d(I^-1) = -I^-1 dI I^-1, with the stored inverse I^-1. A kinematic body's stored inverse is
  // zero, so its gradient is zero.
  const Mat33<Real> change = math::multiply(math::multiply(inverse, mass.inertia), inverse);
  for (int32_t i = 0; i < 3; ++i)
    for (int32_t j = 0; j < 3; ++j)
      mass.inv_inertia.m[i][j] = with_derivative(inverse.m[i][j], change.m[i][j], Real(-1.0f));
  return mass;
}

std::vector<Real> integrate(TraceContext& c, Worlds worlds, bool newton_spin,
                            std::span<const Real> f) {
  const RigidBodyState<Real> now = {Columns(c, "body_q").transform(),
                                    Columns(c, "body_qd").spatial()};
  const Real dt = c.param(kDt);
  const RigidBodyMass<Real> mass = load_mass(c);
  Int world = 0;
  if (worlds == Worlds::Several) world = c.i32(c.source("body_world"));
  const Vec3<Real> gravity =
      Columns(c, "gravity", worlds == Worlds::Several ? &world : nullptr).vec3();
  const RigidBodyState<Real> moved =
      integrate_rigid_body(now, {{f[0], f[1], f[2]}, {f[3], f[4], f[5]}}, mass, gravity,
                           c.param(kAngularDamping), dt, newton_spin);
  const RigidBodyState<Real> follows = move_kinematic_body(now, mass.com, dt);
  const Bool kinematic =
      (c.i32(c.source("body_flags")) & Int(static_cast<int32_t>(BodyFlags::KINEMATIC))) != Int(0);
  const auto list = [](const RigidBodyState<Real>& s) {
    return std::vector<Real>{s.q.p.x,       s.q.p.y,       s.q.p.z,        s.q.q.x,
                             s.q.q.y,       s.q.q.z,       s.q.q.w,        s.qd.linear.x,
                             s.qd.linear.y, s.qd.linear.z, s.qd.angular.x, s.qd.angular.y,
                             s.qd.angular.z};
  };
  std::vector<Real> out = list(moved);
  const std::vector<Real> other = list(follows);
  for (size_t k = 0; k < out.size(); ++k) out[k] = select(kinematic, other[k], out[k]);
  return out;
}

nova::Kernel make_kernel(const char* name, Worlds worlds, bool newton_spin = false) {
  const nova::Kernel kernel = nova::make_reduce_kernel(
      name, sources(worlds), {{"body_q", 7, "body_q"}, {"body_qd", 6, "body_qd"}},
      {.init =
           [](TraceContext& c) {
             const Columns f(c, "body_f");
             return std::vector<Real>{f[0], f[1], f[2], f[3], f[4], f[5]};
           },
       .body = pair_wrench,
       .epilogue =
           [=](TraceContext& c, std::span<const Real> sums) {
             return integrate(c, worlds, newton_spin, sums);
           }});
  return nova::with_gradient_sets(kernel, {"body_q", "body_qd"});
}

const nova::Kernel& kernel(Worlds worlds) {
  static const nova::Kernel one = make_kernel("integrate_rigid_bodies_with_static_contacts",
                                              Worlds::One),
                            several =
                                make_kernel("integrate_rigid_bodies_with_static_contacts_of_worlds",
                                            Worlds::Several);
  return worlds == Worlds::Several ? several : one;
}

// The kernel with Newton's spin, which exists for comparisons only and is not compiled ahead of
// time.
const nova::Kernel& newton_kernel(Worlds worlds) {
  static const nova::Kernel one = make_kernel("newton_rigid_bodies_with_static_contacts",
                                              Worlds::One, true),
                            several =
                                make_kernel("newton_rigid_bodies_with_static_contacts_of_worlds",
                                            Worlds::Several, true);
  return worlds == Worlds::Several ? several : one;
}

void check_numbers(const RigidStepParameters& n, const char* op) {
  const auto check = [op](const char* name, float value) {
    require(std::isfinite(value) && value >= 0.0f, ErrorKind::Value, op, ", ", name,
            ": expected a finite number >= 0, got ", value);
  };
  check("angular_damping", n.angular_damping);
  check("friction_smoothing", n.friction_smoothing);
  require(std::isfinite(n.dt) && n.dt > 0.0f, ErrorKind::Value, op,
          ", dt: expected a finite time step > 0, got ", n.dt);
}

void check_tensor(const Model& model, const Tensor& tensor, int64_t width, const char* op,
                  const char* name) {
  require(tensor.defined() && tensor.dtype() == DType::F32, ErrorKind::Type, op, ", ", name,
          ": expected a float32 tensor");
  require(tensor.ndim() == 2 && tensor.rows() == model.body_count() && tensor.row_width() == width,
          ErrorKind::Value, op, ", ", name, ": expected {", model.body_count(), ", ", width,
          "} tightly packed float32, got ", nova::shape_str(tensor.shape()));
  require(tensor.device() == model.device(), ErrorKind::Value, op, ", ", name, ": expected device ",
          model.device().str(), ", got ", tensor.device().str());
}

void check_worlds(const Model& model) {
  if (model.world_count() == 1) return;
  const std::vector<int32_t> world = model.body_world.to_host();
  for (size_t b = 0; b < world.size(); ++b) {
    require(world[b] >= -1 && world[b] < model.world_count(), ErrorKind::Index, "model.body_world[",
            b, "]: expected 0 to ", model.world_count() - 1, ", got ", world[b]);
    require(world[b] >= 0, ErrorKind::NotImplemented, "model.body_world[", b,
            "]: bodies of all worlds (-1) are not supported in models of several worlds");
  }
}

}  // namespace

void PlanePairs::find_pairs(const Model& model) {
  const std::vector<Vec2i> candidates =
      with_contacts_ ? model.shape_contact_pairs().to_host() : std::vector<Vec2i>();
  const std::vector<int32_t> body = model.shape_body.to_host(), type = model.shape_type.to_host();
  const std::vector<Vec3f> scale = model.shape_scale.to_host();
  std::vector<int32_t> found, bodies;
  const int32_t shapes = model.shape_count(), model_bodies = model.body_count();
  for (int32_t s = 0; s < shapes; ++s) {
    const int32_t b = body[static_cast<size_t>(s)];
    require(b >= -1 && b < model_bodies, ErrorKind::Index, "model.shape_body[", s,
            "]: expected -1 to ", model_bodies - 1, ", got ", b);
  }
  for (const Vec2i& pair : candidates) {
    require(pair.x >= 0 && pair.y >= 0 && pair.x < shapes && pair.y < shapes, ErrorKind::Index,
            "model.shape_contact_pairs: expected shapes from 0 to ", shapes - 1, ", got (", pair.x,
            ", ", pair.y, ")");
    const auto at = [](int32_t shape) { return static_cast<size_t>(shape); };
    const auto type_of = [&](int32_t shape) { return static_cast<GeoType>(type[at(shape)]); };
    const auto is_plane = [&](int32_t shape) {
      const Vec3f& size = scale[at(shape)];
      return type_of(shape) == GeoType::PLANE && body[at(shape)] < 0 &&
             !(size.x > 0.0f && size.y > 0.0f);
    };
    const bool first = is_plane(pair.x);
    const int32_t plane = first ? pair.x : pair.y, shape = first ? pair.y : pair.x;
    const GeoType other = type_of(shape);
    const bool covered =
        is_plane(plane) && body[at(shape)] >= 0 &&
        (other == GeoType::BOX || other == GeoType::SPHERE || other == GeoType::CAPSULE);
    require(covered, ErrorKind::NotImplemented, "shapes ", pair.x, " (",
            geo_type_name(type_of(pair.x)), ") and ", pair.y, " (", geo_type_name(type_of(pair.y)),
            ") of model.shape_contact_pairs: static contacts of bodies cover infinite planes of "
            "the world with boxes, spheres and capsules of bodies");
    found.push_back(plane);
    found.push_back(shape);
    bodies.push_back(body[at(shape)]);
  }
  const Device device = model.device();
  const auto table = DeviceArray<int32_t>::from_host(bodies, device);
  DeviceArray<int32_t> pairs(bodies.size(), device, 2);
  pairs.copy_from_host(std::span<const int32_t>(found));
  pairs_ = nova::operand_of(pairs);
  pairs_of_bodies_ = nova::make_incidence(nova::operand_of(table), model.body_count());
}

void PlanePairs::update(const Model& model, bool with_contacts) {
  depend_on({&model.shape_body, &model.shape_type, &model.shape_scale, &model.body_world});
  // The computation of shape_contact_pairs takes time quadratic in the number of shapes.
  if (with_contacts) depend_on({&model.shape_contact_pairs()});
  if (known_ && with_contacts_ == with_contacts &&
      (!with_contacts || contact_pairs_.matches(model.shape_contact_pairs())) &&
      shape_body_.matches(model.shape_body) && shape_type_.matches(model.shape_type) &&
      shape_scale_.matches(model.shape_scale) && body_world_.matches(model.body_world))
    return;
  known_ = false;
  with_contacts_ = with_contacts;
  // A capture does not record the model's arrays, so the host may read them here.
  {
    const UntrackedScope untracked;
    check_worlds(model);
    find_pairs(model);
  }
  if (with_contacts) contact_pairs_.set(model.shape_contact_pairs());
  shape_body_.set(model.shape_body);
  shape_type_.set(model.shape_type);
  shape_scale_.set(model.shape_scale);
  body_world_.set(model.body_world);
  known_ = true;
}

void step_rigid_bodies_with_static_contacts(const Model& model, const PlanePairs& pairs,
                                            const Operand& body_q, const Operand& body_qd,
                                            const Operand& body_f,
                                            const RigidStepParameters& numbers,
                                            const Operand& q_out, const Operand& qd_out) {
  check_numbers(numbers, "step_rigid_bodies_with_static_contacts");
  const std::vector<Operand> in = operands(model, pairs, body_q, body_qd, body_f);
  const Operand out[] = {q_out, qd_out};
  const nova::Param params[] = {numbers.angular_damping, numbers.friction_smoothing, numbers.dt};
  const Worlds worlds = detail::worlds_of(model);
  (numbers.newton_spin ? newton_kernel(worlds) : kernel(worlds))
      .launch(body_q.rows, in, out, {.params = params, .csr = &pairs.pairs_of_bodies()});
}

std::pair<Tensor, Tensor> integrate_rigid_bodies_with_static_contacts_generated(
    const Model& model, const Tensor& body_q, const Tensor& body_qd, const Tensor& body_f,
    float angular_damping, float friction_smoothing, float dt, bool newton_spin) {
  const char* op = "integrate_rigid_bodies_with_static_contacts_generated";
  check_tensor(model, body_q, 7, op, "body_q");
  check_tensor(model, body_qd, 6, op, "body_qd");
  check_tensor(model, body_f, 6, op, "body_f");
  const RigidStepParameters numbers = {angular_damping, friction_smoothing, dt, newton_spin};
  check_numbers(numbers, op);
  begin_model_reads(model, op);
  PlanePairs pairs;
  pairs.update(model, true);
  const Tensor q(body_q.shape(), DType::F32, model.device()),
      qd(body_qd.shape(), DType::F32, model.device());
  step_rigid_bodies_with_static_contacts(model, pairs, body_q.operand(), body_qd.operand(),
                                         body_f.operand(), numbers, q.operand(), qd.operand());
  return {q, qd};
}

void detail::add_rigid_kernels(std::vector<nova::EngineKernel>& list) {
  for (const Worlds worlds : {Worlds::One, Worlds::Several})
    list.push_back({kernel(worlds), kernel(worlds).gradients()});
}

}  // namespace novaphy::diff
