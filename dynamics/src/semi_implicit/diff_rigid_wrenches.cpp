#include "diff_rigid_wrenches.h"

#include "diff_contact_columns.h"
#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/nova/registry.h"

namespace novaphy::diff::detail {
namespace {

struct RigidKernel {
  FrictionLaw law = FrictionLaw::Huber;
  PenaltyLaw penalty = PenaltyLaw::Sampled;
  bool follow = false;   // points and normals move with the bodies
  bool of_rows = false;  // contact rows have their own materials
};
std::vector<Real> rigid_wrenches(TraceContext& c, const RigidKernel& of) {
  const size_t bodies = c.source("bodies");
  const auto side = [&](int32_t k, const char* point, const char* margin) {
    const ContactBody body = load_body(c, c.i32(bodies, k));
    return RigidContactSide<Real>{body.pose,
                                  body.twist,
                                  body.com,
                                  Columns(c, point).vec3(),
                                  Columns(c, margin)[0],
                                  select(body.is_world, Real(0.0f), Real(1.0f))};
  };
  const Int shape0 = c.i32(c.source("shape0")), shape1 = c.i32(c.source("shape1"));
  const RigidContactSide<Real> a = side(0, "point0", "margin0"), b = side(1, "point1", "margin1");
  const Vec3<Real> normal = Columns(c, "normal").vec3();
  const Vec3<Real> at_a = math::transform_point(a.pose, a.point),
                   at_b = math::transform_point(b.pose, b.point);
  MovingContact<Bool, Real> at;
  at.a = at_a;
  at.b = at_b;
  at.normal = normal;
  if (of.follow)
    at = moving_contact(
        contact_feature_of(load_shape(c, shape0), a.pose, a.point, at_b, normal, true),
        contact_feature_of(load_shape(c, shape1), b.pose, b.point, at_a, normal, false), normal);
  RigidContactMaterial<Real> material =
      mean_rigid_contact_material(load_material(c, shape0), load_material(c, shape1));
  if (of.of_rows)
    material = rigid_contact_material_of_row(material, Columns(c, "stiffness")[0],
                                             Columns(c, "damping")[0], Columns(c, "friction")[0]);
  RigidContactLaw<Real> law = {of.law, c.param(0), of.penalty, Real(0.0f)};
  if (of.penalty == PenaltyLaw::Mean) law.half_step = c.param(1);
  const RigidContactForce<Real> f =
      rigid_contact_force_at(law, a, b, at.a, at.b, at.normal, material);
  std::vector<Real> out = list(-f.force, -math::cross(f.arm_a, f.force));
  for (const Real& x : list(f.force, math::cross(f.arm_b, f.force))) out.push_back(x);
  return out;
}

nova::Kernel make_rigid_kernel(const char* name, const RigidKernel& of) {
  std::vector<nova::SourceSpec> sources = {
      {"bodies", DType::I32, 2, Access::Direct},  {"shape0", DType::I32, 1, Access::Direct},
      {"shape1", DType::I32, 1, Access::Direct},  {"point0", DType::F32, 3, Access::Direct},
      {"point1", DType::F32, 3, Access::Direct},  {"margin0", DType::F32, 1, Access::Direct},
      {"margin1", DType::F32, 1, Access::Direct}, {"normal", DType::F32, 3, Access::Direct}};
  const std::vector<nova::SourceSpec> bodies = body_sources(), shapes = shape_sources();
  sources.insert(sources.end(), bodies.begin(), bodies.end());
  for (const nova::SourceSpec& s : material_sources()) sources.push_back(s);
  if (of.follow) sources.insert(sources.end(), shapes.begin(), shapes.end());
  if (of.of_rows)
    for (const char* own : {"stiffness", "damping", "friction"})
      sources.push_back({own, DType::F32, 1, Access::Direct});
  return nova::with_one_gradient_set(nova::make_kernel(
      name, sources, {{"wrench", 12}}, [of](TraceContext& c) { return rigid_wrenches(c, of); }));
}

}  // namespace

const nova::Kernel& rigid_kernel(bool follow) {
  static const nova::Kernel following =
                                make_rigid_kernel("rigid_contact_wrenches", {.follow = true}),
                            held = make_rigid_kernel("held_rigid_contact_wrenches", {});
  return follow ? following : held;
}
// Returns the kernel for contact rows with their own materials.
const nova::Kernel& own_rigid_kernel(bool follow) {
  static const nova::Kernel following = make_rigid_kernel("own_rigid_contact_wrenches",
                                                          {.follow = true, .of_rows = true}),
                            held = make_rigid_kernel("own_held_rigid_contact_wrenches",
                                                     {.of_rows = true});
  return follow ? following : held;
}
// Returns the kernel of PenaltyLaw::Mean. The interpreter runs it, as the kernels below, because
// few scenes use it.
const nova::Kernel& mean_kernel(bool follow, bool of_rows) {
  const auto make = [](const char* name, bool follows, bool own) {
    return make_rigid_kernel(name,
                             {.penalty = PenaltyLaw::Mean, .follow = follows, .of_rows = own});
  };
  static const nova::Kernel kernels[2][2] = {
      {make("mean_held_rigid_contact_wrenches", false, false),
       make("own_mean_held_rigid_contact_wrenches", false, true)},
      {make("mean_rigid_contact_wrenches", true, false),
       make("own_mean_rigid_contact_wrenches", true, true)}};
  return kernels[follow][of_rows];
}
// Returns the kernel of a friction law of Newton. These laws are for comparisons only, so their
// kernels are not compiled ahead of time.
const nova::Kernel& newton_kernel(FrictionLaw law, bool of_rows) {
  const auto make = [](const char* name, FrictionLaw of, bool own) {
    return make_rigid_kernel(name, {.law = of, .of_rows = own});
  };
  static const nova::Kernel kernels[2][2] = {
      {make("newton17_contact_wrenches", FrictionLaw::Newton17, false),
       make("own_newton17_contact_wrenches", FrictionLaw::Newton17, true)},
      {make("newton18_contact_wrenches", FrictionLaw::Newton18, false),
       make("own_newton18_contact_wrenches", FrictionLaw::Newton18, true)}};
  return kernels[law == FrictionLaw::Newton18][of_rows];
}

}  // namespace novaphy::diff::detail
