// Functions that load the columns of bodies and shapes in traced kernels as vectors, poses and
// materials.
#pragma once

#include <vector>

#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"
#include "novaphy/math/spatial.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff::detail {

// The columns of a source, at the row of the launch or at a given row.
struct Columns {
  nova::TraceContext& c;
  size_t source;
  const nova::Int* row = nullptr;
  Columns(nova::TraceContext& context, const char* name, const nova::Int* at = nullptr)
      : c(context), source(context.source(name)), row(at) {}
  nova::Real operator[](int32_t k) const { return row ? c.f32(source, *row, k) : c.f32(source, k); }
  Vec3<nova::Real> vec3(int32_t k = 0) const {
    return {(*this)[k], (*this)[k + 1], (*this)[k + 2]};
  }
  Transform<nova::Real> transform() const {
    return {vec3(), {(*this)[3], (*this)[4], (*this)[5], (*this)[6]}};
  }
  SpatialVector<nova::Real> spatial() const { return {vec3(), vec3(3)}; }
};

// The following functions are for the contact material of shapes: the sources, the operands, and
// the material of one shape.
inline std::vector<nova::SourceSpec> material_sources() {
  using nova::Access;
  using nova::DType;
  return {{"shape_material_ke", DType::F32, 1, Access::Indexed},
          {"shape_material_kd", DType::F32, 1, Access::Indexed},
          {"shape_material_kf", DType::F32, 1, Access::Indexed},
          {"shape_material_ka", DType::F32, 1, Access::Indexed},
          {"shape_material_mu", DType::F32, 1, Access::Indexed}};
}
inline std::vector<nova::Operand> material_operands(const Model& m) {
  return {nova::operand_of(m.shape_material_ke), nova::operand_of(m.shape_material_kd),
          nova::operand_of(m.shape_material_kf), nova::operand_of(m.shape_material_ka),
          nova::operand_of(m.shape_material_mu)};
}
inline RigidContactMaterial<nova::Real> load_material(nova::TraceContext& c,
                                                      const nova::Int& shape) {
  const auto of = [&](const char* name) { return Columns(c, name, &shape)[0]; };
  return {of("shape_material_ke"), of("shape_material_kd"), of("shape_material_kf"),
          detach(of("shape_material_ka")), of("shape_material_mu")};
}

}  // namespace novaphy::diff::detail
