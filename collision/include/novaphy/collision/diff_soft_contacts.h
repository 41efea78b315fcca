// Differentiable contact forces of particles. If the build has nova, this code is a part of the
// library novaphy::dynamics.
//
// The gradient of each input:
//   input                               recorded contacts    static shapes
//   particle_q, particle_qd             exact                exact, with closest point and normal
//   particle_f                          exact (linear)       exact (linear)
//   particle_radius                     exact                exact
//   shape_material_ke, kd, kf, mu       exact                exact
//   contact point and normal            frozen               part of that by particle_q
//   shape_transform, shape_scale        none                 none
//   shape_margin, detection distance    none (compared only) none (compared only)
// The kinks of the law are listed in diff_soft_contact_trace.h.
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
// The shapes that a kernel supports. Simple: planes, boxes, spheres and capsules. A kernel with
// these shapes is faster. All: also cylinders, cones and ellipsoids.
enum class Shapes { Simple, All };
}  // namespace detail

// A table of the shapes that each particle may touch (candidate_pairs.h), for a model with several
// worlds. A model with one world needs no table, because each particle may touch each shape.
class NOVAPHY_DYNAMICS_API WorldRows {
 public:
  // Updates the table if its source arrays were written. A capture depends on these arrays. If
  // `with_shapes` is false, only the particles are checked. ErrorKind::NotImplemented: a particle
  // of all worlds (-1), for which gravity is not defined, or a shape that static contacts do not
  // support. ErrorKind::Index: a world that does not exist.
  void update(const Model& model, bool with_shapes);
  const nova::Operand& shape() const { return shape_; }  // shape of each pair
  const nova::Incidence& pairs_of_particles() const { return pairs_of_particles_; }
  detail::Shapes shapes() const { return shapes_; }

 private:
  void check_shapes(const Model& model);
  ArrayStamp particle_world_, shape_world_, shape_flags_;
  // versions of the arrays of which shapes_ is the result
  ArrayStamp covered_type_, covered_flags_, covered_body_;
  detail::Shapes shapes_ = detail::Shapes::Simple;
  nova::Operand shape_;
  nova::Incidence pairs_of_particles_;
};

// Returns particle_f {n, 3} (N) plus the contact forces of all world-owned plane, box, sphere,
// capsule, cylinder, cone and ellipsoid shapes, at the exact distance. A shape acts if a search
// with soft_contact_margin (m) would find a contact and the law is active. The tensors have one row
// for each particle and are packed float32 (ErrorKind::Type, ErrorKind::Value).
NOVAPHY_DYNAMICS_API nova::Tensor eval_static_particle_shape_contact_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, float soft_contact_margin = 0.0f);

// Writes the same forces into given memory, for solvers. `rows` must be up to date. kf_rate is r
// (1/s) of diff_soft_contact_trace.h. ErrorKind::Value: an invalid margin.
NOVAPHY_DYNAMICS_API void eval_static_contact_forces(const Model& model, const WorldRows& rows,
                                                     const nova::Operand& particle_q,
                                                     const nova::Operand& particle_qd,
                                                     const nova::Operand& particle_f, float kf_rate,
                                                     float soft_contact_margin,
                                                     const nova::Operand& forces);

// Computes `forces` = `particle_f` + the forces of recorded contacts, in slot order. `contacts_of`
// lists the contact slots of every particle (nova::make_incidence of soft_contact_particle).
NOVAPHY_DYNAMICS_API void eval_soft_contact_forces(const Model& model, const Contacts& contacts,
                                                   const nova::Incidence& contacts_of,
                                                   const nova::Operand& particle_q,
                                                   const nova::Operand& particle_qd,
                                                   const nova::Operand& particle_f, float kf_rate,
                                                   const nova::Operand& forces);

namespace detail {
// For a kernel that sums recorded contacts over a particle's slots: the sources in their order,
// their operands and parameters, and the term of one slot.
std::vector<nova::SourceSpec> soft_contact_sources();
std::vector<nova::Operand> soft_contact_operands(const Model& model, const Contacts& contacts);
// A kernel also needs the source particle_mass.
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
// For a kernel that sums static shapes over all shapes, or over the WorldRows of a particle: the
// sources in their order, the launch options, and the term of one shape.
std::vector<nova::SourceSpec> static_shape_sources(Worlds worlds);
std::vector<nova::Operand> static_shape_operands(const Model& model, const WorldRows& rows);
nova::LaunchOptions static_shape_options(const Model& model, const WorldRows& rows,
                                         std::span<const nova::Param> params);
Vec3<nova::Real> static_shape_term(nova::TraceContext& c, Worlds worlds, Shapes shapes,
                                   const Vec3<nova::Real>& x, const Vec3<nova::Real>& v,
                                   const nova::Real& radius, int32_t first_param);
// Returns the parameters of static_shape_term: contact material of the model, adhesion, kf_rate and
// margin. A kernel also needs the source particle_mass.
std::vector<nova::Param> static_shape_params(const Model& model, float kf_rate,
                                             float soft_contact_margin);
inline constexpr int32_t kStaticShapeParams = 7;
// Returns the shapes that a kernel has to support. Throws ErrorKind::NotImplemented unless every
// shape that collides with particles is world-owned and of a supported type.
Shapes check_static_shapes(const Model& model);
// Checks that a tensor is {n, 3} of float32 on the model's device.
void check_particle_tensor(const Model& model, const nova::Tensor& tensor, const char* op,
                           const char* name);
Vec3<nova::Real> load_vec3(nova::TraceContext& c, const char* source);
}  // namespace detail

}  // namespace novaphy::diff
