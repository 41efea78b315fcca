#include "novaphy/dynamics/semi_implicit/diff_body_contacts.h"

#include "diff_contact_columns.h"
#include "diff_rigid_wrenches.h"
#include "novaphy/collision/contact_bodies.h"
#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/error.h"
#include "novaphy/dynamics/diff_operators.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

using namespace detail;
using nova::Operand;

namespace {

void add_shapes(const Model& m, std::vector<Operand>& in) {
  for (const Array* of_shapes :
       std::initializer_list<const Array*>{&m.shape_type, &m.shape_transform, &m.shape_scale})
    in.push_back(nova::operand_of(*of_shapes));
}

// Returns the kernel that computes the force on body B.
const nova::Kernel& force_kernel() {
  static const nova::Kernel kernel =
      nova::make_kernel("rigid_contact_forces", {{"wrench", DType::F32, 12, Access::Direct}},
                        {{"force", 3}}, [](TraceContext& c) {
                          return std::vector{c.f32(0, 6), c.f32(0, 7), c.f32(0, 8)};
                        });
  return kernel;
}

Vec3<Real> with_derivative_of(const Vec3<Real>& value, const Vec3<Real>& live) {
  const Vec3<Real> still = constant(value);
  const Real one = 1.0f;
  return {with_derivative(still.x, live.x, one), with_derivative(still.y, live.y, one),
          with_derivative(still.z, live.z, one)};
}

// A point on a shape (in the frame of its body) and the normal there (in the world frame).
struct SoftPoint {
  Vec3<Real> point, normal;
};
// Returns the stored point and normal, with derivatives by the particle position x and by the
// body's pose.
SoftPoint following_point(TraceContext& c, const Int& shape, const ContactBody& body,
                          const Vec3<Real>& x, const SoftPoint& stored) {
  using namespace math;
  const Int type = c.i32(c.source("shape_type"), shape, 0);
  const auto is = [&](GeoType wanted) { return type == Int(static_cast<int32_t>(wanted)); };
  const Transform<Real> at = Columns(c, "shape_transform", &shape).transform();
  const Transform<Real> xform = {constant(at.p),
                                 {detach(at.q.x), detach(at.q.y), detach(at.q.z), detach(at.q.w)}};
  const Vec3<Real> in_body = transform_point(inverse(body.pose), x);
  const Vec3<Real> in_shape = transform_point(inverse(xform), in_body);
  const SurfaceDistance<Real> surface =
      static_shape_distance<true>(static_shape_type<GeoType, Bool>(is),
                                  constant(Columns(c, "shape_scale", &shape).vec3()), in_shape);
  // Hulls and meshes are treated as the half space at the point, whose normal rotates with the
  // body.
  const Quat<Real>& q = body.pose.q;
  const Vec3<Real> face = constant(rotate_inverse(q, stored.normal));
  const Bool polytope = either(is(GeoType::CONVEX_MESH), is(GeoType::MESH));
  const Vec3<Real> point =
      select(polytope, in_body - face * dot(face, in_body - constant(stored.point)),
             transform_point(xform, in_shape - surface.normal * surface.distance));
  const Vec3<Real> normal = rotate(q, select(polytope, face, rotate(xform.q, surface.normal)));
  return {with_derivative_of(stored.point, point), with_derivative_of(stored.normal, normal)};
}

// Computes the force and the wrench of a particle contact. `follow`: points and normals move with
// the particles and the bodies.
std::vector<Real> soft_forces(TraceContext& c, bool follow) {
  const Int particle = c.i32(c.source("particle")), shape = c.i32(c.source("shape")),
            row = c.i32(c.source("body"));
  const ContactBody body = load_body(c, row);
  const Vec3<Real> x = Columns(c, "particle_q", &particle).vec3();
  SoftPoint at = {Columns(c, "body_pos").vec3(), Columns(c, "normal").vec3()};
  if (follow) at = following_point(c, shape, body, x, at);
  const SoftContactBody<Real> point =
      soft_contact_body(body.pose, body.twist, body.com, at.point, Columns(c, "body_vel").vec3());
  const auto of_shape = [&](const char* name) { return Columns(c, name, &shape)[0]; };
  const Vec3<Real> term = soft_contact_force_term(
      x, Columns(c, "particle_qd", &particle).vec3(), Columns(c, "particle_radius", &particle)[0],
      math::select(body.is_world, at.point, point.position),
      math::select(body.is_world, Columns(c, "body_vel").vec3(), point.velocity), at.normal,
      with_bounded_kf(mean_soft_contact_material<Real>(
                          {c.param(0), c.param(1), c.param(2), c.param(3)},
                          {of_shape("shape_material_ke"), of_shape("shape_material_kd"),
                           of_shape("shape_material_kf"), of_shape("shape_material_mu")}),
                      Columns(c, "particle_mass", &particle)[0], c.param(5)),
      c.param(4));
  std::vector<Real> out = list(term);
  for (const Real& t : list(-term, math::cross(point.arm, -term))) out.push_back(t);
  return out;
}

nova::Kernel make_soft_kernel(const char* name, bool follow) {
  std::vector<nova::SourceSpec> sources = {{"particle", DType::I32, 1, Access::Direct},
                                           {"shape", DType::I32, 1, Access::Direct},
                                           {"body", DType::I32, 1, Access::Direct},
                                           {"body_pos", DType::F32, 3, Access::Direct},
                                           {"body_vel", DType::F32, 3, Access::Direct},
                                           {"normal", DType::F32, 3, Access::Direct},
                                           {"particle_q", DType::F32, 3, Access::Indexed},
                                           {"particle_qd", DType::F32, 3, Access::Indexed},
                                           {"particle_mass", DType::F32, 1, Access::Indexed},
                                           {"particle_radius", DType::F32, 1, Access::Indexed},
                                           {"shape_material_ke", DType::F32, 1, Access::Indexed},
                                           {"shape_material_kd", DType::F32, 1, Access::Indexed},
                                           {"shape_material_kf", DType::F32, 1, Access::Indexed},
                                           {"shape_material_mu", DType::F32, 1, Access::Indexed}};
  for (const nova::SourceSpec& of_body : body_sources()) sources.push_back(of_body);
  if (follow)
    for (const nova::SourceSpec& of_shape : shape_sources()) sources.push_back(of_shape);
  return nova::with_one_gradient_set(
      nova::make_kernel(name, sources, {{"force", 3}, {"wrench", 6}},
                        [follow](TraceContext& c) { return soft_forces(c, follow); }));
}
const nova::Kernel& soft_kernel(bool follow) {
  static const nova::Kernel following = make_soft_kernel("following_soft_contact_wrenches", true),
                            held = make_soft_kernel("soft_contact_wrenches", false);
  return follow ? following : held;
}

const nova::Kernel& sum_kernel() {
  static const nova::Kernel kernel = [] {
    const auto load = [](size_t source) {
      return [source](TraceContext& c) {
        std::vector<Real> w;
        for (int32_t k = 0; k < 6; ++k) w.push_back(c.f32(source, k));
        return w;
      };
    };
    return nova::with_one_gradient_set(nova::make_reduce_kernel(
        "sum_body_wrenches",
        {{"body_f", DType::F32, 6, Access::Direct}, {"wrench", DType::F32, 6, Access::CsrRow}},
        {{"body_f", 6}}, {.init = load(0), .body = load(1), .epilogue = {}}));
  }();
  return kernel;
}

// Sorts the table. The sorted arrays of the last call are reused if the table has the same memory.
// Sorting is always recorded as a rebuild, which a group of recomputed operations runs again.
void sort(const Array& table, int64_t rows, nova::Incidence& sorted) {
  const Operand operand = nova::operand_of(table);
  if (!sorted || sorted->rows != rows || sorted->table.range != operand.range)
    sorted = nova::make_incidence(operand, rows);
  nova::rebuild(sorted);
}

}  // namespace

void ContactTables::update(const Model& model, const Contacts& contacts, const Wanted& wanted) {
  of_this_state_ = wanted.of_this_state;
  particles_move_ = wanted.particles_move;
  if (!wanted.particles || contacts.soft_contact_max() == 0) {
    slots_of_particles_ = nullptr;
  } else if (const auto& range = contacts.soft_contact_particle.range();
             !slots_of_particles_ || slots_of_particles_->table.range != range ||
             !nova::is_current(*slots_of_particles_, *range)) {
    try {
      slots_of_particles_ = nova::make_incidence(nova::operand_of(contacts.soft_contact_particle),
                                                 model.particle_count());
    } catch (const Error& error) {
      fail(error.kind(), "contacts.soft_contact_particle: ", error.what());
    }
  }
  const auto same = [](const ArrayStamp& stamp, const Array& array) {
    return array.rows() == 0 || stamp.matches(array);
  };
  const bool known =
      nova::current_capture() == nullptr && same(soft_shape_, contacts.soft_contact_shape) &&
      same(shape0_, contacts.rigid_contact_shape0) &&
      same(shape1_, contacts.rigid_contact_shape1) && same(shape_body_, model.shape_body);
  if (known) return;
  if (nova::Tape::active() != nullptr) {  // the tape still refers to the tables of other contacts
    soft_bodies_ = {};
    rigid_bodies_ = {};
  }
  rebuild_bodies(model, contacts, wanted);
  soft_shape_.set(contacts.soft_contact_shape);
  shape0_.set(contacts.rigid_contact_shape0);
  shape1_.set(contacts.rigid_contact_shape1);
  shape_body_.set(model.shape_body);
}

void ContactTables::rebuild(const Model& model, const Contacts& contacts, const Wanted& wanted) {
  of_this_state_ = wanted.of_this_state;
  particles_move_ = wanted.particles_move;
  if (wanted.particles && contacts.soft_contact_max() > 0)
    sort(contacts.soft_contact_particle, model.particle_count(), slots_of_particles_);
  rebuild_bodies(model, contacts, wanted);
}

void ContactTables::rebuild_bodies(const Model& model, const Contacts& contacts,
                                   const Wanted& wanted) {
  const auto fit = [&](DeviceArray<int32_t>& table, bool is_wanted, int32_t count, size_t width) {
    const size_t rows = is_wanted ? static_cast<size_t>(count) : 0;
    if (table.rows() != rows) table = DeviceArray<int32_t>(rows, model.device(), width);
  };
  fit(soft_bodies_, wanted.particles && (wanted.particles_on_bodies || wanted.particles_move),
      contacts.soft_contact_max(), 1);
  fit(rigid_bodies_, wanted.bodies, contacts.rigid_contact_max(), 2);
  find_contact_bodies(model, contacts, rigid_bodies_, soft_bodies_);
  if (soft_bodies_.rows() > 0 && wanted.particles_on_bodies)
    sort(soft_bodies_, model.body_count(), slots_of_bodies_);
  if (rigid_bodies_.rows() > 0) sort(rigid_bodies_, model.body_count(), sides_of_bodies_);
}

void eval_rigid_contacts(const Model& m, const Contacts& c, const ContactTables& tables,
                         const Operand& body_q, const Operand& body_qd,
                         const RigidContactLaw<float>& law, const Operand& wrenches) {
  std::vector<Operand> in = {nova::operand_of(tables.rigid_bodies()),
                             nova::operand_of(c.rigid_contact_shape0),
                             nova::operand_of(c.rigid_contact_shape1),
                             nova::operand_of(c.rigid_contact_point0),
                             nova::operand_of(c.rigid_contact_point1),
                             nova::operand_of(c.rigid_contact_margin0),
                             nova::operand_of(c.rigid_contact_margin1),
                             nova::operand_of(c.rigid_contact_normal),
                             body_q,
                             body_qd,
                             nova::operand_of(m.body_com)};
  for (Operand& o : detail::material_operands(m)) in.push_back(std::move(o));
  const bool newton = is_of_newton(law.friction), mean = law.penalty == PenaltyLaw::Mean;
  const bool follow = tables.of_this_state() && !newton;
  if (follow) add_shapes(m, in);
  const bool of_rows = c.per_contact_shape_properties();
  if (of_rows)
    for (const Array* own : std::initializer_list<const Array*>{
             &c.rigid_contact_stiffness, &c.rigid_contact_damping, &c.rigid_contact_friction})
      in.push_back(nova::operand_of(*own));
  std::vector<nova::Param> params = {law.friction == FrictionLaw::Viscous ? 0.0f : law.smoothing};
  if (mean) params.push_back(law.half_step);
  (newton    ? newton_kernel(law.friction, of_rows)
   : mean    ? mean_kernel(follow, of_rows)
   : of_rows ? own_rigid_kernel(follow)
             : rigid_kernel(follow))
      .launch(wrenches.rows, in, wrenches, {.params = params});
}

void write_rigid_contact_forces(const Contacts& c, const Operand& wrenches) {
  const nova::NoGrad no_grad;
  const Operand forces = nova::operand_of(c.rigid_contact_force),
                count = nova::operand_of(c.rigid_contact_count);
  force_kernel().launch(wrenches.rows, wrenches, forces, {.active = &count});
}

void eval_soft_contacts(const Model& m, const Contacts& c, const ContactTables& tables,
                        const Operand& particle_q, const Operand& particle_qd,
                        const Operand& body_q, const Operand& body_qd, float kf_rate,
                        const Operand& forces, const Operand& wrenches) {
  std::vector<Operand> in = {nova::operand_of(c.soft_contact_particle),
                             nova::operand_of(c.soft_contact_shape),
                             nova::operand_of(tables.soft_bodies()),
                             nova::operand_of(c.soft_contact_body_pos),
                             nova::operand_of(c.soft_contact_body_vel),
                             nova::operand_of(c.soft_contact_normal),
                             particle_q,
                             particle_qd,
                             nova::operand_of(m.particle_mass),
                             nova::operand_of(m.particle_radius),
                             nova::operand_of(m.shape_material_ke),
                             nova::operand_of(m.shape_material_kd),
                             nova::operand_of(m.shape_material_kf),
                             nova::operand_of(m.shape_material_mu),
                             body_q,
                             body_qd,
                             nova::operand_of(m.body_com)};
  const std::array params = detail::soft_contact_params(m, kf_rate);
  const Operand out[] = {forces, wrenches};
  const bool follow = tables.particles_move();
  if (follow) add_shapes(m, in);
  soft_kernel(follow).launch(forces.rows, in, out, {.params = params});
}

void add_wrenches(const Operand& body_f, const Operand& wrenches, const nova::Incidence& of_bodies,
                  const Operand& sum) {
  const Operand in[] = {body_f, wrenches};
  sum_kernel().launch(body_f.rows, in, sum, {.csr = &of_bodies});
}

void detail::add_body_contact_kernels(std::vector<nova::EngineKernel>& list) {
  for (const nova::Kernel& k :
       {rigid_kernel(true), rigid_kernel(false), own_rigid_kernel(true), own_rigid_kernel(false),
        soft_kernel(true), soft_kernel(false), sum_kernel()})
    list.push_back({k, k.gradients()});
  list.push_back({force_kernel(), {}});
}

}  // namespace novaphy::diff
