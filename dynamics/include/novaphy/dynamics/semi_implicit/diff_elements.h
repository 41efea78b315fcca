// Differentiable forces of springs, triangles, bending edges and tetrahedra. Compiled into
// novaphy::diff.
//
// Each is two kernels: one over the elements, which writes what every element adds to its
// particles, and one over the particles, which adds that to particle_f in the order of the
// elements. So nothing is summed by atomics, forward or backward, and the bits are those of
// SolverSemiImplicit.
//
// What each input's gradient is:
//   input                                     springs   triangles  bending   tetrahedra
//   particle_q, particle_qd                   exact     exact      exact     exact
//   particle_f                                exact     exact      exact     exact     (linear)
//   activation                                -         exact      -         exact
//   material columns, stiffness, damping      exact     exact      exact     exact
//   rest length, rest angle                   exact     -          exact     -
//   rest pose (particle_*_pose), indices      none      none       none      none
//   spring control, rest area, rest volume    none      none       none      none      (unused)
// Nothing is a surrogate or frozen. At kinks and for zero stiffness see the head comments of
// spring_trace.h, triangle_trace.h, bending_trace.h and tetrahedron_trace.h.
//
// Tensors are tightly packed float32 on the model's device (ErrorKind::Type, ErrorKind::Value);
// inputs are not changed.
#pragma once

#include <span>
#include <vector>

#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/nova/incidence.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff {

// Materials {tet_count, 3} from parameters: k_mu and k_lambda (Pa) for all ({2} or {1, 2}) or for
// each tetrahedron ({2 * tet_count} or {tet_count, 2}), k_damp from `base_tet_materials`
// {tet_count, 3}. Exact gradients for both; columns 0 and 1 of the base have none to give.
NOVAPHY_DYNAMICS_API nova::Tensor assign_tet_materials_generated(
    const nova::Tensor& material_params, const nova::Tensor& base_tet_materials, int64_t tet_count);

// particle_f {n, 3} (N) plus the forces of all tetrahedra; activations {tet_count}, materials
// {tet_count, 3}.
NOVAPHY_DYNAMICS_API nova::Tensor eval_tetrahedra_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, const nova::Tensor& tet_activations,
    const nova::Tensor& tet_materials);
// Of all triangles; activations {tri_count}, materials {tri_count, 5}.
NOVAPHY_DYNAMICS_API nova::Tensor eval_triangle_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, const nova::Tensor& tri_activations,
    const nova::Tensor& tri_materials);
// Of all springs; stiffness (N/m), damping (N*s/m) and rest lengths (m) {spring_count} each.
NOVAPHY_DYNAMICS_API nova::Tensor eval_spring_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, const nova::Tensor& spring_stiffness,
    const nova::Tensor& spring_damping, const nova::Tensor& spring_rest_length);
// Of all bending edges; materials {edge_count, 2}, rest angles (rad) {edge_count}.
NOVAPHY_DYNAMICS_API nova::Tensor eval_bending_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, const nova::Tensor& edge_materials,
    const nova::Tensor& edge_rest_angle);

// Which elements act.
struct ElementSet {
  bool springs = false, triangles = false, edges = false, tetrahedra = false;
};

// The forces of a model's elements into given memory: what the solver calls. Keeps the memory that
// the elements write to, which no adjoint reads, from step to step.
class NOVAPHY_DYNAMICS_API ElementOperators {
 public:
  ElementOperators() = default;  // none
  // Elements that the model does not have are left out.
  ElementOperators(const Model& model, const ElementSet& set);

  bool empty() const { return terms_.empty(); }
  size_t particle_count() const { return particle_count_; }
  // forces = particle_f + what the elements add, from the model's own materials; activations are
  // the control's, or the model's without one. Recorded on an active tape; `forces` may be
  // particle_f where nothing is recorded.
  void eval(const Model& model, const Control* control, const nova::Operand& particle_q,
            const nova::Operand& particle_qd, const nova::Operand& particle_f,
            const nova::Operand& forces);

 private:
  enum class Kind : uint8_t { Spring, Triangle, Edge, Tetrahedron };
  struct Term {
    Kind kind;
    nova::Operand contributions;  // {elements, 3 * corners}
    nova::Operand sum;            // {n, 3}: of the terms so far, but for the last
    nova::Incidence rows;         // which contributions a particle gets
  };
  std::vector<Term> terms_;
  size_t particle_count_ = 0;
};

namespace detail {
// The kernels over the elements. Sources, in order: indices, particle_q, particle_qd, then
//   springs      stiffness, damping, rest length      triangles   pose, activation, material
//   edges        material, rest angle                 tetrahedra  pose, activation, material
const nova::Kernel& spring_kernel();
const nova::Kernel& triangle_kernel();
const nova::Kernel& bending_kernel();
const nova::Kernel& tetrahedron_kernel();
// The first three sources, for elements of `corners` particles.
std::vector<nova::SourceSpec> element_sources(int32_t corners);
// The kernel of elements of `corners` particles.
nova::Kernel element_kernel(const char* name, const std::vector<nova::SourceSpec>& sources,
                            int32_t corners, const nova::TraceFn& law);
// Position or velocity of a corner; zero for an absent one (a negative index).
Vec3<nova::Real> load_corner(nova::TraceContext& c, const char* source, int32_t corner);
// Positions and velocities of all corners.
void load_corners(nova::TraceContext& c, std::span<Vec3<nova::Real>> x,
                  std::span<Vec3<nova::Real>> v);
// The columns of an element's output, corner by corner.
std::vector<nova::Real> contributions(std::initializer_list<Vec3<nova::Real>> forces);
// particle_f, a model array or a tensor of {rows} or {rows, width}.
void check_element_tensor(const Model& model, const nova::Tensor& tensor, int64_t rows,
                          int32_t width, const char* op, const char* name);
// sum {n, 3} = particle_f plus the contributions {m, 3} that belong to each particle, in their
// order.
void add_contributions(const nova::Operand& particle_f, const nova::Operand& contributions,
                       const nova::Incidence& rows, const nova::Operand& sum);
// The operator of one kind of element, for the functions above. `parameters`: the kernel's sources
// after particle_qd.
nova::Tensor eval_elements(const Model& model, const char* op, const nova::Kernel& kernel,
                           const Array& indices, const nova::Tensor& particle_q,
                           const nova::Tensor& particle_qd, const nova::Tensor& particle_f,
                           std::vector<nova::Operand> parameters);
}  // namespace detail

}  // namespace novaphy::diff
