// Differentiable contact forces of particles. Compiled into novaphy::dynamics where nova is built.
//
// The gradient of each input:
//   input                               recorded contacts    static shapes
//   particle_q, particle_qd             exact                exact, with closest point and normal
//   particle_f                          exact (linear)       exact (linear)
//   particle_radius                     exact                exact
//   shape_material_ke, kd, kf, mu       exact                exact
//   contact point and normal            frozen               part of particle_q's
//   shape_transform, shape_scale        none                 none
//   shape_margin, detection distance    none (they choose)   none (they choose)
// At the kinks of the law see diff_soft_contact_trace.h.
#pragma once

#include <array>
#include <span>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff {

namespace detail {
// Whether a kernel serves cylinders, cones and ellipsoids besides planes, boxes, spheres and
// capsules, which cost less without them.
enum class Shapes { Simple, All };
}  // namespace detail

// Of a model of several worlds: the shapes that each particle may meet (candidate_pairs.h), as rows
// of a table. A model of one world needs none: each particle may meet each shape.
class NOVAPHY_DYNAMICS_API WorldRows {
 public:
  // Made anew when the arrays that they are made from were written, and a capture depends on these;
  // `with_shapes` false checks the particles only. ErrorKind::NotImplemented: a particle of all
  // worlds (-1), whose gravity is that of none, a shape that static contacts do not cover;
  // ErrorKind::Index: no such world.
  void update(const Model& model, bool with_shapes);
  const nova::Operand& shape() const { return shape_; }  // of each pair
  const nova::Incidence& pairs_of_particles() const { return pairs_of_particles_; }
  detail::Shapes shapes() const { return shapes_; }

 private:
  void check_shapes(const Model& model);
  ArrayStamp particle_world_, shape_world_, shape_flags_;
  ArrayStamp covered_type_, covered_flags_, covered_body_;  // the shapes that were checked
  detail::Shapes shapes_ = detail::Shapes::Simple;
  nova::Operand shape_;
  nova::Incidence pairs_of_particles_;
};

// particle_f {n, 3} plus the forces of all world-owned plane, box, sphere, capsule, cylinder, cone
// and ellipsoid shapes, evaluated at the true distance: {n, 3}, N. A shape acts where a contact
// would be detected within soft_contact_margin (m) and the law says so. Tensors of the model's
// particle count, tightly packed float32 (ErrorKind::Type, ErrorKind::Value).
NOVAPHY_DYNAMICS_API nova::Tensor eval_static_particle_shape_contact_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, float soft_contact_margin = 0.0f);

// The same into given memory: what the solver calls, with `rows` that are up to date. kf_rate is r
// of diff_soft_contact_trace.h; the operator has none.
// ErrorKind::Value for a bad margin.
NOVAPHY_DYNAMICS_API void eval_static_contact_forces(const Model& model, const WorldRows& rows,
                                                     const nova::Operand& particle_q,
                                                     const nova::Operand& particle_qd,
                                                     const nova::Operand& particle_f, float kf_rate,
                                                     float soft_contact_margin,
                                                     const nova::Operand& forces);

// The forces of recorded contacts, in slot order: `forces` = `particle_f` + the terms of the
// contacts. `contacts_of` lists the slots of every particle (nova::make_incidence of
// soft_contact_particle).
NOVAPHY_DYNAMICS_API void eval_soft_contact_forces(const Model& model, const Contacts& contacts,
                                                   const nova::Incidence& contacts_of,
                                                   const nova::Operand& particle_q,
                                                   const nova::Operand& particle_qd,
                                                   const nova::Operand& particle_f, float kf_rate,
                                                   const nova::Operand& forces);

namespace detail {
// Sources, in order, of recorded contacts inside a sum over a particle's slots; their operands, the
// parameters, and the term of one slot.
std::vector<nova::SourceSpec> soft_contact_sources();
std::vector<nova::Operand> soft_contact_operands(const Model& model, const Contacts& contacts);
// The kernels have the source particle_mass besides.
inline constexpr int32_t kSoftContactParams = 6;
std::array<nova::Param, kSoftContactParams> soft_contact_params(const Model& model, float kf_rate);
Vec3<nova::Real> soft_contact_term(nova::TraceContext& c, const Vec3<nova::Real>& x,
                                   const Vec3<nova::Real>& v, const nova::Real& radius,
                                   int32_t first_param);
// Whether a kernel serves models of one world or of several.
enum class Worlds { One, Several };
inline Worlds worlds_of(const Model& model) {
  return model.world_count() > 1 ? Worlds::Several : Worlds::One;
}
// Sources, in order, of the static shapes inside a sum over all shapes, or over the WorldRows of a
// particle; the options of such a launch; and the term of one shape.
std::vector<nova::SourceSpec> static_shape_sources(Worlds worlds);
std::vector<nova::Operand> static_shape_operands(const Model& model, const WorldRows& rows);
nova::LaunchOptions static_shape_options(const Model& model, const WorldRows& rows,
                                         std::span<const nova::Param> params);
Vec3<nova::Real> static_shape_term(nova::TraceContext& c, Worlds worlds, Shapes shapes,
                                   const Vec3<nova::Real>& x, const Vec3<nova::Real>& v,
                                   const nova::Real& radius, int32_t first_param);
// The parameters that static_shape_term reads: contact material of the model, adhesion, rate of kf,
// margin. The kernels have the source particle_mass besides.
std::vector<nova::Param> static_shape_params(const Model& model, float kf_rate,
                                             float soft_contact_margin);
inline constexpr int32_t kStaticShapeParams = 7;
// ErrorKind::NotImplemented unless every particle-colliding shape is world-owned and of a covered
// type. Returns whether there are cylinders, cones or ellipsoids.
Shapes check_static_shapes(const Model& model);
// Shape checks shared by the operators: {n, 3} float32 on the model's device.
void check_particle_tensor(const Model& model, const nova::Tensor& tensor, const char* op,
                           const char* name);
Vec3<nova::Real> load_vec3(nova::TraceContext& c, const char* source);
}  // namespace detail

}  // namespace novaphy::diff
