// Differentiable contact forces of particles. The file is compiled into novaphy::dynamics if nova
// is built.
//
// The gradient of each input:
//   input                               recorded contacts    static shapes
//   particle_q, particle_qd             exact                exact, with closest point and normal
//   particle_f                          exact (linear)       exact (linear)
//   particle_radius                     exact                exact
//   shape_material_ke, kd, kf, mu       exact                exact
//   contact point and normal            frozen               part of particle_q's
//   shape_transform, shape_scale        none                 none
//   shape_margin, detection distance    none (select)        none (select)
// diff_soft_contact_trace.h describes the kinks of the law.
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
// The shapes that a kernel supports. Simple: planes, boxes, spheres and capsules, which is faster.
// All: also cylinders, cones and ellipsoids.
enum class Shapes { Simple, All };
}  // namespace detail

// For a model with several worlds: the shapes that each particle may touch (candidate_pairs.h), as
// rows of a table. A model with one world needs no table, because each particle may touch each
// shape.
class NOVAPHY_DYNAMICS_API WorldRows {
 public:
  // Updates the table if its source arrays were written. A capture depends on these arrays.
  // `with_shapes` false: checks the particles only. ErrorKind::NotImplemented: a particle of all
  // worlds (-1), for which gravity is not defined, or a shape that static contacts do not support.
  // ErrorKind::Index: a world that does not exist.
  void update(const Model& model, bool with_shapes);
  const nova::Operand& shape() const { return shape_; }  // shape of each pair
  const nova::Incidence& pairs_of_particles() const { return pairs_of_particles_; }
  detail::Shapes shapes() const { return shapes_; }

 private:
  void check_shapes(const Model& model);
  ArrayStamp particle_world_, shape_world_, shape_flags_;
  // stamps of the arrays behind the checked shapes
  ArrayStamp covered_type_, covered_flags_, covered_body_;
  detail::Shapes shapes_ = detail::Shapes::Simple;
  nova::Operand shape_;
  nova::Incidence pairs_of_particles_;
};

// Returns particle_f {n, 3} (N) plus the forces of all world-owned plane, box, sphere, capsule,
// cylinder, cone and ellipsoid shapes at the true distance. A shape acts if a contact would be
// detected within soft_contact_margin (m) and the law is active. The tensors have one row per
// particle and are packed float32 (ErrorKind::Type, ErrorKind::Value).
NOVAPHY_DYNAMICS_API nova::Tensor eval_static_particle_shape_contact_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, float soft_contact_margin = 0.0f);

// The same into given memory, as solvers call it. `rows` must be up to date. kf_rate is r of
// diff_soft_contact_trace.h. ErrorKind::Value: a bad margin.
NOVAPHY_DYNAMICS_API void eval_static_contact_forces(const Model& model, const WorldRows& rows,
                                                     const nova::Operand& particle_q,
                                                     const nova::Operand& particle_qd,
                                                     const nova::Operand& particle_f, float kf_rate,
                                                     float soft_contact_margin,
                                                     const nova::Operand& forces);

// Computes `forces` = `particle_f` + the forces of recorded contacts, in slot order. `contacts_of`
// lists the slots of every particle (nova::make_incidence of soft_contact_particle).
NOVAPHY_DYNAMICS_API void eval_soft_contact_forces(const Model& model, const Contacts& contacts,
                                                   const nova::Incidence& contacts_of,
                                                   const nova::Operand& particle_q,
                                                   const nova::Operand& particle_qd,
                                                   const nova::Operand& particle_f, float kf_rate,
                                                   const nova::Operand& forces);

namespace detail {
// The sources, in order, of recorded contacts inside a sum over a particle's slots; their operands
// and parameters; and the term of one slot.
std::vector<nova::SourceSpec> soft_contact_sources();
std::vector<nova::Operand> soft_contact_operands(const Model& model, const Contacts& contacts);
// The kernels also have the source particle_mass.
inline constexpr int32_t kSoftContactParams = 6;
std::array<nova::Param, kSoftContactParams> soft_contact_params(const Model& model, float kf_rate);
Vec3<nova::Real> soft_contact_term(nova::TraceContext& c, const Vec3<nova::Real>& x,
                                   const Vec3<nova::Real>& v, const nova::Real& radius,
                                   int32_t first_param);
// Whether a kernel supports models of one world or of several.
enum class Worlds { One, Several };
inline Worlds worlds_of(const Model& model) {
  return model.world_count() > 1 ? Worlds::Several : Worlds::One;
}
// The sources, in order, of static shapes inside a sum over all shapes or over the WorldRows of a
// particle; the options of such a launch; and the term of one shape.
std::vector<nova::SourceSpec> static_shape_sources(Worlds worlds);
std::vector<nova::Operand> static_shape_operands(const Model& model, const WorldRows& rows);
nova::LaunchOptions static_shape_options(const Model& model, const WorldRows& rows,
                                         std::span<const nova::Param> params);
Vec3<nova::Real> static_shape_term(nova::TraceContext& c, Worlds worlds, Shapes shapes,
                                   const Vec3<nova::Real>& x, const Vec3<nova::Real>& v,
                                   const nova::Real& radius, int32_t first_param);
// The parameters of static_shape_term: contact material of the model, adhesion, rate of kf, margin.
// The kernels also have the source particle_mass.
std::vector<nova::Param> static_shape_params(const Model& model, float kf_rate,
                                             float soft_contact_margin);
inline constexpr int32_t kStaticShapeParams = 7;
// Throws ErrorKind::NotImplemented unless every shape that collides with particles is world-owned
// and of a supported type. Returns the kernel's shapes.
Shapes check_static_shapes(const Model& model);
// Checks that operators share: a tensor {n, 3} of float32 on the model's device.
void check_particle_tensor(const Model& model, const nova::Tensor& tensor, const char* op,
                           const char* name);
Vec3<nova::Real> load_vec3(nova::TraceContext& c, const char* source);
}  // namespace detail

}  // namespace novaphy::diff
