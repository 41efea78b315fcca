// Differentiable forces of springs, triangles, bending edges and tetrahedra. Compiled into
// novaphy::dynamics if nova is built.
//
// Each evaluation has two kernels. The kernel over the elements writes the forces of each element
// on its particles. The kernel over the particles adds these forces to particle_f in the order of
// the elements. The sums need no atomics, forward or backward, and the bits are those of
// SolverSemiImplicit.
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
// No gradient is a surrogate or frozen. The comments at the top of spring_trace.h,
// triangle_trace.h, bending_trace.h and tetrahedron_trace.h describe kinks and zero stiffness.
//
// Tensors are packed float32 on the model's device (ErrorKind::Type, ErrorKind::Value). Inputs are
// not changed.
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

// Returns materials {tet_count, 3} from parameters: k_mu and k_lambda (Pa) for all tetrahedra ({2}
// or {1, 2}) or for each one ({2 * tet_count} or {tet_count, 2}). The column k_damp comes from
// `base_tet_materials` {tet_count, 3}. Gradients by both inputs are exact; those by columns 0 and 1
// of the base are 0.
NOVAPHY_DYNAMICS_API nova::Tensor assign_tet_materials_generated(
    const nova::Tensor& material_params, const nova::Tensor& base_tet_materials, int64_t tet_count);

// Returns particle_f {n, 3} (N) plus the forces of all tetrahedra. Shapes: activations {tet_count},
// materials {tet_count, 3}.
NOVAPHY_DYNAMICS_API nova::Tensor eval_tetrahedra_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, const nova::Tensor& tet_activations,
    const nova::Tensor& tet_materials);
// Returns particle_f {n, 3} (N) plus the forces of all triangles. Shapes: activations {tri_count},
// materials {tri_count, 5}.
NOVAPHY_DYNAMICS_API nova::Tensor eval_triangle_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, const nova::Tensor& tri_activations,
    const nova::Tensor& tri_materials);
// Returns particle_f {n, 3} (N) plus the forces of all springs. Stiffness (N/m), damping (N*s/m)
// and rest lengths (m) are {spring_count} each.
NOVAPHY_DYNAMICS_API nova::Tensor eval_spring_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, const nova::Tensor& spring_stiffness,
    const nova::Tensor& spring_damping, const nova::Tensor& spring_rest_length);
// Returns particle_f {n, 3} (N) plus the forces of all bending edges. Shapes: materials
// {edge_count, 2}, rest angles {edge_count} (rad).
NOVAPHY_DYNAMICS_API nova::Tensor eval_bending_forces_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, const nova::Tensor& edge_materials,
    const nova::Tensor& edge_rest_angle);

// The kinds of elements that act.
struct ElementSet {
  bool springs = false, triangles = false, edges = false, tetrahedra = false;
};

namespace detail {
struct OperatorSpec;
}

// Computes the forces of a model's elements in given memory, for solvers. The object keeps the
// memory of the elements' contributions between steps. No adjoint reads this memory.
class NOVAPHY_DYNAMICS_API ElementOperators {
 public:
  ElementOperators() = default;  // no elements
  // Only the kinds of `set` that the model has elements of are evaluated.
  ElementOperators(const Model& model, const ElementSet& set);

  bool empty() const { return terms_.empty(); }
  size_t particle_count() const { return particle_count_; }
  // Computes forces = particle_f + the forces of the elements, with the model's materials.
  // Activations come from the control, or from the model if `control` is null. Recorded on an
  // active tape. Without recording, `forces` may be particle_f.
  void eval(const Model& model, const Control* control, const nova::Operand& particle_q,
            const nova::Operand& particle_qd, const nova::Operand& particle_f,
            const nova::Operand& forces);

 private:
  struct Term {
    const detail::OperatorSpec* spec;
    nova::Operand contributions;  // {elements, 3 * corners}
    nova::Operand sum;            // {n, 3}: sum up to this kind of element; the last kind has none
    nova::Incidence rows;         // contributions of each particle
  };
  std::vector<Term> terms_;
  size_t particle_count_ = 0;
};

namespace detail {
// Returns the control's array if a control is given, else the model's.
template <auto OfModel, auto OfControl = nullptr>
const Array& array_of(const Model& model, const Control* control) {
  if constexpr (!std::is_same_v<decltype(OfControl), std::nullptr_t>)
    if (control != nullptr) return control->*OfControl;
  return model.*OfModel;
}
using ArrayOf = const Array& (*)(const Model&, const Control*);

// The description of a kind of element: its law, and the inputs of its kernel after indices,
// particle_q and particle_qd.
struct OperatorSpec {
  struct Parameter {
    const char* source;  // name of the kernel's source
    int32_t width;
    ArrayOf array;
    const char* argument;  // argument of the public function; null: always the model's array
    nova::DType type = nova::DType::F32;
  };
  const char* kernel_name;
  const char* function;  // name of the public function
  ArrayOf indices;
  int32_t corners;
  std::vector<Parameter> parameters;
  nova::TraceFn law;
  nova::Kernel kernel = {};  // with_kernel makes the kernel from the other members
};
OperatorSpec with_kernel(OperatorSpec spec);
const OperatorSpec& spring_operator();
const OperatorSpec& triangle_operator();
const OperatorSpec& bending_operator();
const OperatorSpec& tetrahedron_operator();
// Returns the position or velocity of a corner; zero for a missing corner (a negative index).
Vec3<nova::Real> load_corner(nova::TraceContext& c, const char* source, int32_t corner);
// Loads the positions and velocities of all corners.
void load_corners(nova::TraceContext& c, std::span<Vec3<nova::Real>> x,
                  std::span<Vec3<nova::Real>> v);
// Returns the columns of an element's output: the forces, corner by corner.
std::vector<nova::Real> contributions(std::initializer_list<Vec3<nova::Real>> forces);
// Computes sum {n, 3} = particle_f plus the rows of `contributions` {m, 3} of each particle, in
// order.
void add_contributions(const nova::Operand& particle_f, const nova::Operand& contributions,
                       const nova::Incidence& rows, const nova::Operand& sum);
// Evaluates one kind of element. `parameters`: tensors for the parameters that have an `argument`,
// in the order of the spec.
nova::Tensor eval_elements(const Model& model, const OperatorSpec& spec,
                           const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
                           const nova::Tensor& particle_f,
                           std::initializer_list<nova::Tensor> parameters);
}  // namespace detail

}  // namespace novaphy::diff
