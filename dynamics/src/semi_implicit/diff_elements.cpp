#include "novaphy/dynamics/semi_implicit/diff_elements.h"

#include <algorithm>

#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/error.h"
#include "novaphy/dynamics/diff_operators.h"
#include "particle_indices.h"

namespace novaphy::diff {

using nova::Access;
using nova::DType;
using nova::Int;
using nova::Operand;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

namespace {

// particle_f plus what the elements gave to each particle, in the order of the elements.
const nova::Kernel& sum_kernel() {
  static const nova::Kernel kernel = [] {
    const nova::Kernel made =
        nova::make_reduce_kernel("sum_element_forces",
                                 {{"particle_f", DType::F32, 3, Access::Direct},
                                  {"contribution", DType::F32, 3, Access::CsrRow}},
                                 {{"particle_f", 3}},
                                 {.init =
                                      [](TraceContext& c) {
                                        return std::vector{c.f32(0, 0), c.f32(0, 1), c.f32(0, 2)};
                                      },
                                  .body =
                                      [](TraceContext& c) {
                                        return std::vector{c.f32(1, 0), c.f32(1, 1), c.f32(1, 2)};
                                      },
                                  .epilogue = {}});
    return nova::with_gradient_sets(made, {"particle_f"});
  }();
  return kernel;
}

// The same bytes as one row per corner.
Operand per_corner(Operand contributions, int32_t corners) {
  contributions.rows *= corners;
  contributions.width = 3;
  return contributions;
}

Operand allocate(int64_t rows, int32_t width, Device device) {
  const auto bytes = static_cast<size_t>(rows) * static_cast<size_t>(width) * sizeof(float);
  return {Storage::allocate(bytes, device)->range(), rows, width};
}

// For a table that is about to be sorted anew. It does not change while a capture records, so the
// host may read it there too.
void check_table(const Model& model, const Array& indices) {
  const Unobserved unobserved;
  const Array on_host = indices.to(Device::cpu());
  const std::span entries(static_cast<const int32_t*>(on_host.raw()),
                          on_host.bytes() / sizeof(int32_t));
  for_each_field(model, [&](const FieldInfo& info, const Array& array) {
    if (&array == &indices)
      check_corners(entries, model.particle_count(), info.name,
                    &array == &model.particle_edge_indices);
  });
}

// The slots of every particle in a table of the model, sorted once for all operators.
nova::Incidence rows_of(const Model& model, const Array& indices) {
  const nova::GradInfo* info = nova::find_grad_info(*indices.range());
  const auto is_known = [&](const auto& rows) {
    return rows->rows == model.particle_count() && nova::is_current(*rows, *indices.range());
  };
  if (!info || !std::ranges::any_of(info->incidences, is_known)) check_table(model, indices);
  return nova::cached_incidence(nova::operand_of(indices), model.particle_count());
}

void launch_elements(const nova::Kernel& kernel, const std::vector<Operand>& in,
                     const Operand& particle_f, const Operand& contributions,
                     const nova::Incidence& rows, const Operand& forces) {
  const Operand& indices = in[0];
  kernel.launch(indices.rows, in, {&contributions, 1});
  detail::add_contributions(particle_f, per_corner(contributions, indices.width), rows, forces);
}

}  // namespace

void detail::add_contributions(const Operand& particle_f, const Operand& contributions,
                               const nova::Incidence& rows, const Operand& sum) {
  const Operand terms[] = {particle_f, contributions};
  sum_kernel().launch(particle_f.rows, terms, {&sum, 1}, {.csr = &rows});
}

std::vector<nova::SourceSpec> detail::element_sources(int32_t corners) {
  return {{"indices", DType::I32, corners, Access::Direct},
          {"particle_q", DType::F32, 3, Access::Indexed},
          {"particle_qd", DType::F32, 3, Access::Indexed}};
}

Vec3<Real> detail::load_corner(TraceContext& c, const char* source, int32_t corner) {
  const Int particle = c.i32(0, corner);
  const size_t s = c.source(source);
  return {c.f32(s, particle, 0), c.f32(s, particle, 1), c.f32(s, particle, 2)};
}

void detail::load_corners(TraceContext& c, std::span<Vec3<Real>> x, std::span<Vec3<Real>> v) {
  for (size_t k = 0; k < x.size(); ++k) {
    x[k] = load_corner(c, "particle_q", static_cast<int32_t>(k));
    v[k] = load_corner(c, "particle_qd", static_cast<int32_t>(k));
  }
}

std::vector<Real> detail::contributions(std::initializer_list<Vec3<Real>> forces) {
  std::vector<Real> columns;
  for (const Vec3<Real>& f : forces) columns.insert(columns.end(), {f.x, f.y, f.z});
  return columns;
}

void detail::check_element_tensor(const Model& model, const Tensor& tensor, int64_t rows,
                                  int32_t width, const char* op, const char* name) {
  require(tensor.defined() && tensor.dtype() == DType::F32, ErrorKind::Type, op, ", ", name,
          ": expected a float32 tensor");
  const bool right =
      width == 1 ? tensor.ndim() == 1 && tensor.rows() == rows
                 : tensor.ndim() == 2 && tensor.rows() == rows && tensor.row_width() == width;
  const std::string columns = width == 1 ? "" : ", " + std::to_string(width);
  require(right, ErrorKind::Value, op, ", ", name, ": expected {", rows, columns,
          "} tightly packed float32, got ", nova::shape_str(tensor.shape()));
  require(tensor.device() == model.device(), ErrorKind::Value, op, ", ", name, ": expected device ",
          model.device().str(), ", got ", tensor.device().str());
}

Tensor detail::eval_elements(const Model& model, const char* op, const nova::Kernel& kernel,
                             const Array& indices, const Tensor& particle_q,
                             const Tensor& particle_qd, const Tensor& particle_f,
                             std::vector<Operand> parameters) {
  check_particle_tensor(model, particle_q, op, "particle_q");
  check_particle_tensor(model, particle_qd, op, "particle_qd");
  check_particle_tensor(model, particle_f, op, "particle_f");
  std::vector<Operand> in = {nova::operand_of(indices), particle_q.operand(),
                             particle_qd.operand()};
  in.insert(in.end(), parameters.begin(), parameters.end());
  const Tensor forces(particle_f.shape(), DType::F32, model.device());
  launch_elements(kernel, in, particle_f.operand(),
                  allocate(in[0].rows, 3 * in[0].width, model.device()), rows_of(model, indices),
                  forces.operand());
  return forces;
}

nova::Kernel detail::element_kernel(const char* name, const std::vector<nova::SourceSpec>& sources,
                                    int32_t corners, const nova::TraceFn& law) {
  const nova::Kernel kernel =
      nova::make_kernel(name, sources, {{"contribution", 3 * corners}}, law);
  std::vector<nova::AdjointMask> masks = nova::gradient_sets(kernel, {"particle_q", "particle_qd"});
  // The gradient of the forces on the particles is read through `indices`.
  for (nova::AdjointMask& mask : masks) mask.table = 0;
  return nova::with_gradients(kernel, std::move(masks));
}

void detail::add_element_kernels(std::vector<nova::EngineKernel>& list) {
  for (const nova::Kernel& k :
       {spring_kernel(), triangle_kernel(), bending_kernel(), tetrahedron_kernel()})
    list.push_back({k, k.gradients()});
  list.push_back({sum_kernel(), sum_kernel().gradients()});
  add_tet_material_kernels(list);
}

ElementOperators::ElementOperators(const Model& model, const ElementSet& set)
    : particle_count_(static_cast<size_t>(model.particle_count())) {
  const auto add = [&](Kind kind, bool wanted, const Array& indices) {
    if (!wanted || indices.rows() == 0) return;
    const Operand table = nova::operand_of(indices);
    terms_.push_back({kind, allocate(table.rows, 3 * table.width, model.device()),
                      allocate(model.particle_count(), 3, model.device()), nullptr});
  };
  add(Kind::Spring, set.springs, model.particle_spring_indices);
  add(Kind::Triangle, set.triangles, model.particle_tri_indices);
  add(Kind::Edge, set.edges, model.particle_edge_indices);
  add(Kind::Tetrahedron, set.tetrahedra, model.particle_tet_indices);
}

void ElementOperators::eval(const Model& m, const Control* control, const Operand& particle_q,
                            const Operand& particle_qd, const Operand& particle_f,
                            const Operand& forces) {
  const auto kernel_of = [](Kind kind) -> const nova::Kernel& {
    switch (kind) {
      case Kind::Spring:
        return detail::spring_kernel();
      case Kind::Triangle:
        return detail::triangle_kernel();
      case Kind::Edge:
        return detail::bending_kernel();
      case Kind::Tetrahedron:
        break;
    }
    return detail::tetrahedron_kernel();
  };
  const auto inputs_of = [&](Kind kind) -> std::vector<const Array*> {
    switch (kind) {
      case Kind::Spring:
        return {&m.particle_spring_indices, &m.particle_spring_stiffness,
                &m.particle_spring_damping, &m.particle_spring_rest_length};
      case Kind::Triangle:
        return {&m.particle_tri_indices, &m.particle_tri_pose,
                control ? &control->particle_tri_activation : &m.particle_tri_activation,
                &m.particle_tri_material};
      case Kind::Edge:
        return {&m.particle_edge_indices, &m.particle_edge_material, &m.particle_edge_rest_angle};
      case Kind::Tetrahedron:
        break;
    }
    return {&m.particle_tet_indices, &m.particle_tet_pose,
            control ? &control->particle_tet_activation : &m.particle_tet_activation,
            &m.particle_tet_material};
  };
  Operand f = particle_f;
  for (Term& term : terms_) {
    const std::vector<const Array*> arrays = inputs_of(term.kind);
    std::vector<Operand> in = {nova::operand_of(*arrays[0]), particle_q, particle_qd};
    for (size_t k = 1; k < arrays.size(); ++k) in.push_back(nova::operand_of(*arrays[k]));
    if (!term.rows || term.rows->table.range != in[0].range ||
        !nova::is_current(*term.rows, *in[0].range))
      term.rows = rows_of(m, *arrays[0]);
    const Operand& to = &term == &terms_.back() ? forces : term.sum;
    launch_elements(kernel_of(term.kind), in, f, term.contributions, term.rows, to);
    f = to;
  }
}

}  // namespace novaphy::diff
