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

// Returns the kernel that sums particle_f and the forces of the elements on each particle, in the
// order of the elements.
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

// Returns a view of the same memory with one row per corner.
Operand per_corner(Operand contributions, int32_t corners) {
  contributions.rows *= corners;
  contributions.width = 3;
  return contributions;
}

Operand allocate(int64_t rows, int32_t width, Device device) {
  const auto bytes = static_cast<size_t>(rows) * static_cast<size_t>(width) * sizeof(float);
  return {Storage::allocate(bytes, device)->range(), rows, width};
}

// Checks a table of corners before it is sorted. The table does not change while a capture records,
// so the host may read it in a capture too.
void check_table(const Model& model, const Array& indices) {
  const UntrackedScope untracked;
  const Array on_host = indices.to(Device::cpu());
  const std::span entries(static_cast<const int32_t*>(on_host.raw()),
                          on_host.bytes() / sizeof(int32_t));
  for_each_field(model, [&](const FieldInfo& info, const Array& array) {
    if (&array == &indices)
      check_corners(entries, model.particle_count(), info.name,
                    &array == &model.particle_edge_indices);
  });
}

// Returns the slots of every particle in a table of the model. Each table is sorted once for all
// operators.
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
  kernel.launch(indices.rows, in, contributions);
  detail::add_contributions(particle_f, per_corner(contributions, indices.width), rows, forces);
}

}  // namespace

void detail::add_contributions(const Operand& particle_f, const Operand& contributions,
                               const nova::Incidence& rows, const Operand& sum) {
  const Operand terms[] = {particle_f, contributions};
  sum_kernel().launch(particle_f.rows, terms, sum, {.csr = &rows});
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

namespace {

void check_element_tensor(const Model& model, const Tensor& tensor, int64_t rows, int32_t width,
                          const char* op, const char* name) {
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

const detail::OperatorSpec* const* all_operators() {
  static const detail::OperatorSpec* const all[] = {
      &detail::spring_operator(), &detail::triangle_operator(), &detail::bending_operator(),
      &detail::tetrahedron_operator(), nullptr};
  return all;
}

}  // namespace

Tensor detail::eval_elements(const Model& model, const OperatorSpec& spec, const Tensor& particle_q,
                             const Tensor& particle_qd, const Tensor& particle_f,
                             std::initializer_list<Tensor> parameters) {
  check_particle_tensor(model, particle_q, spec.function, "particle_q");
  check_particle_tensor(model, particle_qd, spec.function, "particle_qd");
  check_particle_tensor(model, particle_f, spec.function, "particle_f");
  const Array& indices = spec.indices(model, nullptr);
  std::vector<Operand> in = {nova::operand_of(indices), particle_q.operand(),
                             particle_qd.operand()};
  const Tensor* next = parameters.begin();
  for (const OperatorSpec::Parameter& p : spec.parameters) {
    if (p.argument == nullptr) {
      in.push_back(nova::operand_of(p.array(model, nullptr)));
      continue;
    }
    check_element_tensor(model, *next, in[0].rows, p.width, spec.function, p.argument);
    in.push_back(p.width == 1 ? next->flat_operand() : next->operand());
    ++next;
  }
  const Tensor forces(particle_f.shape(), DType::F32, model.device());
  launch_elements(spec.kernel, in, particle_f.operand(),
                  allocate(in[0].rows, 3 * in[0].width, model.device()), rows_of(model, indices),
                  forces.operand());
  return forces;
}

detail::OperatorSpec detail::with_kernel(OperatorSpec spec) {
  std::vector<nova::SourceSpec> sources = {{"indices", DType::I32, spec.corners, Access::Direct},
                                           {"particle_q", DType::F32, 3, Access::Indexed},
                                           {"particle_qd", DType::F32, 3, Access::Indexed}};
  for (const OperatorSpec::Parameter& p : spec.parameters)
    sources.push_back({p.source, p.type, p.width, Access::Direct});
  const nova::Kernel kernel =
      nova::make_kernel(spec.kernel_name, sources, {{"contribution", 3 * spec.corners}}, spec.law);
  std::vector<nova::AdjointMask> masks = nova::gradient_sets(kernel, {"particle_q", "particle_qd"});
  // The adjoint reads the gradient by the forces on the particles through `indices`.
  for (nova::AdjointMask& mask : masks) mask.table = 0;
  spec.kernel = nova::with_gradients(kernel, std::move(masks));
  return spec;
}

void detail::add_element_kernels(std::vector<nova::EngineKernel>& list) {
  for (const auto* spec = all_operators(); *spec != nullptr; ++spec)
    list.push_back({(*spec)->kernel, (*spec)->kernel.gradients()});
  list.push_back({sum_kernel(), sum_kernel().gradients()});
  add_tet_material_kernels(list);
}

ElementOperators::ElementOperators(const Model& model, const ElementSet& set)
    : particle_count_(static_cast<size_t>(model.particle_count())) {
  const bool wanted[] = {set.springs, set.triangles, set.edges, set.tetrahedra};
  for (size_t k = 0; all_operators()[k] != nullptr; ++k) {
    const detail::OperatorSpec& spec = *all_operators()[k];
    const Array& indices = spec.indices(model, nullptr);
    if (!wanted[k] || indices.rows() == 0) continue;
    const Operand table = nova::operand_of(indices);
    terms_.push_back({&spec, allocate(table.rows, 3 * table.width, model.device()),
                      allocate(model.particle_count(), 3, model.device()), nullptr});
  }
}

void ElementOperators::eval(const Model& m, const Control* control, const Operand& particle_q,
                            const Operand& particle_qd, const Operand& particle_f,
                            const Operand& forces) {
  Operand f = particle_f;
  for (Term& term : terms_) {
    const Array& indices = term.spec->indices(m, control);
    std::vector<Operand> in = {nova::operand_of(indices), particle_q, particle_qd};
    for (const detail::OperatorSpec::Parameter& p : term.spec->parameters)
      in.push_back(nova::operand_of(p.array(m, control)));
    if (!term.rows || term.rows->table.range != in[0].range ||
        !nova::is_current(*term.rows, *in[0].range))
      term.rows = rows_of(m, indices);
    const Operand& to = &term == &terms_.back() ? forces : term.sum;
    launch_elements(term.spec->kernel, in, f, term.contributions, term.rows, to);
    f = to;
  }
}

}  // namespace novaphy::diff
