// Differentiable forces of springs, triangles, bending edges and tetrahedra. Compiled into
// novaphy::diff.
//
// Each is two kernels. The kernel over the elements writes the forces of each element on its
// particles. The kernel over the particles adds these to particle_f in the order of the elements.
// No sum needs atomics, forward or backward, and the bits are those of SolverSemiImplicit.
//
// The gradient of each input:
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

#include <cstddef>
#include <initializer_list>
#include <span>
#include <type_traits>
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

namespace detail {
struct OperatorSpec;
}

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
  struct Term {
    const detail::OperatorSpec* spec;
    nova::Operand contributions;  // {elements, 3 * corners}
    nova::Operand sum;            // {n, 3}: of the terms so far, but for the last
    nova::Incidence rows;         // which contributions a particle gets
  };
  std::vector<Term> terms_;
  size_t particle_count_ = 0;
};

namespace detail {
// The control's array where there is one, else the model's.
template <auto OfModel, auto OfControl = nullptr>
const Array& array_of(const Model& model, const Control* control) {
  if constexpr (!std::is_same_v<decltype(OfControl), std::nullptr_t>)
    if (control != nullptr) return control->*OfControl;
  return model.*OfModel;
}
using ArrayOf = const Array& (*)(const Model&, const Control*);

// What there is to know of one kind of element: its kernel's sources after indices, particle_q and
// particle_qd, where they come from, and the law.
struct OperatorSpec {
  struct Parameter {
    const char* source;  // the kernel's
    int32_t width;
    ArrayOf array;
    const char* argument;  // of the function above; null: always the model's
  };
  const char* kernel_name;
  const char* function;  // the one above
  ArrayOf indices;
  int32_t corners;
  std::vector<Parameter> parameters;
  nova::TraceFn law;
  nova::Kernel kernel = {};  // made of the rest by with_kernel
};
OperatorSpec with_kernel(OperatorSpec spec);
const OperatorSpec& spring_operator();
const OperatorSpec& triangle_operator();
const OperatorSpec& bending_operator();
const OperatorSpec& tetrahedron_operator();
// Position or velocity of a corner; zero for an absent one (a negative index).
Vec3<nova::Real> load_corner(nova::TraceContext& c, const char* source, int32_t corner);
// Positions and velocities of all corners.
void load_corners(nova::TraceContext& c, std::span<Vec3<nova::Real>> x,
                  std::span<Vec3<nova::Real>> v);
// The columns of an element's output, corner by corner.
std::vector<nova::Real> contributions(std::initializer_list<Vec3<nova::Real>> forces);
// sum {n, 3} = particle_f plus the contributions {m, 3} that belong to each particle, in their
// order.
void add_contributions(const nova::Operand& particle_f, const nova::Operand& contributions,
                       const nova::Incidence& rows, const nova::Operand& sum);
// The function of one kind of element. `parameters`: those with an argument, in the order of the
// spec.
nova::Tensor eval_elements(const Model& model, const OperatorSpec& spec,
                           const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
                           const nova::Tensor& particle_f,
                           std::initializer_list<nova::Tensor> parameters);
}  // namespace detail

}  // namespace novaphy::diff
