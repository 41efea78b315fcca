// The columns of bodies and shapes that the traced contact kernels read.
#pragma once

#include <vector>

#include "diff_trace_columns.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/semi_implicit/moving_contact_trace.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff::detail {

using nova::Access;
using nova::Bool;
using nova::DType;
using nova::Int;
using nova::Real;
using nova::TraceContext;

// A body in a contact. Row -1 is the world: zero velocity, identity pose.
struct ContactBody {
  Transform<Real> pose;
  SpatialVector<Real> twist;
  Vec3<Real> com;
  Bool is_world;
};
inline ContactBody load_body(TraceContext& c, const Int& body) {
  ContactBody b = {Columns(c, "body_q", &body).transform(), Columns(c, "body_qd", &body).spatial(),
                   Columns(c, "body_com", &body).vec3(), body < Int(0)};
  // A row that does not exist reads as zeros, so the world needs the unit quaternion.
  b.pose.q.w = select(b.is_world, Real(1.0f), b.pose.q.w);
  return b;
}

inline std::vector<nova::SourceSpec> body_sources() {
  return {{"body_q", DType::F32, 7, Access::Indexed},
          {"body_qd", DType::F32, 6, Access::Indexed},
          {"body_com", DType::F32, 3, Access::Indexed}};
}
// Returns the sources of shapes, for contacts whose points move with the bodies.
inline std::vector<nova::SourceSpec> shape_sources() {
  return {{"shape_type", DType::I32, 1, Access::Indexed},
          {"shape_transform", DType::F32, 7, Access::Indexed},
          {"shape_scale", DType::F32, 3, Access::Indexed}};
}
inline std::vector<Real> list(const Vec3<Real>& a) { return {a.x, a.y, a.z}; }
inline std::vector<Real> list(const Vec3<Real>& a, const Vec3<Real>& b) {
  return {a.x, a.y, a.z, b.x, b.y, b.z};
}

inline Vec3<Real> constant(const Vec3<Real>& v) { return {detach(v.x), detach(v.y), detach(v.z)}; }

// Loads a shape as a constant, because shapes carry no gradient.
inline ContactShape<Bool, Real> load_shape(TraceContext& c, const Int& shape) {
  const Int type = c.i32(c.source("shape_type"), shape, 0);
  const auto is = [&](GeoType wanted) { return type == Int(static_cast<int32_t>(wanted)); };
  const Transform<Real> x = Columns(c, "shape_transform", &shape).transform();
  ContactShape<Bool, Real> to = contact_shape<GeoType, Bool, Real>(
      is, {constant(x.p), {detach(x.q.x), detach(x.q.y), detach(x.q.z), detach(x.q.w)}},
      constant(Columns(c, "shape_scale", &shape).vec3()));
  const Bool no(false);
  const Real zero(0.0f);
  const Vec3<Real> none = {zero, zero, zero};
  to.polytope = {no, no, no, no, no, none, none, zero};
  return to;
}

}  // namespace novaphy::diff::detail
