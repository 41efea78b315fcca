#include "novaphy/core/error.h"
#include "novaphy/dynamics/diff_operators.h"
#include "novaphy/dynamics/semi_implicit/diff_elements.h"
#include "novaphy/dynamics/semi_implicit/tetrahedron_trace.h"

namespace novaphy::diff {

using nova::Access;
using nova::Bool;
using nova::DType;
using nova::Int;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

namespace {

// Adds a kernel variant for the gradients that optimization of materials needs: by the state, and
// by the materials except the damping. The material gradient accumulates in every step but the last
// of the backward pass. The damping of materials that assign_tet_materials has written needs no
// gradient. This set replaces the set of the state alone, which it contains.
detail::OperatorSpec with_material_gradients(detail::OperatorSpec spec) {
  constexpr uint32_t kDamping = 2;
  std::vector<nova::AdjointMask> masks = spec.kernel.gradients();
  const size_t material = spec.kernel.sources().size() - 1;
  masks[0].wrt[material] = masks[0].accumulate[material] = true;
  for (nova::AdjointMask& mask : masks) {
    mask.narrowed = static_cast<int32_t>(material);
    mask.unread = uint32_t{1} << kDamping;
  }
  spec.kernel = nova::with_gradients(spec.kernel, std::move(masks));
  return spec;
}

}  // namespace

const detail::OperatorSpec& detail::tetrahedron_operator() {
  static const OperatorSpec spec = with_material_gradients(with_kernel(
      {"tetrahedron_forces",
       "eval_tetrahedra_forces_generated",
       array_of<&Model::particle_tet_indices>,
       4,
       {{"pose", 9, array_of<&Model::particle_tet_pose>, nullptr},
        {"activation", 1,
         array_of<&Model::particle_tet_activation, &Control::particle_tet_activation>,
         "tet_activations"},
        {"is_lame", 1, array_of<&Model::particle_tet_is_lame>, nullptr, DType::I32},
        {"material", 3, array_of<&Model::particle_tet_material>, "tet_materials"}},
       [](TraceContext& c) {
         Vec3<Real> x[4], v[4];
         load_corners(c, x, v);
         Mat33<Real> pose;
         for (int32_t i = 0; i < 3; ++i)
           for (int32_t j = 0; j < 3; ++j) pose.m[i][j] = c.f32(c.source("pose"), 3 * i + j);
         const size_t m = c.source("material");
         const Bool is_lame = c.i32(c.source("is_lame")) != Int(0);
         const TetrahedronForces<Real> f = tetrahedron_forces<Real>(
             x, v, pose, c.f32(c.source("activation")),
             coefficients_of<Bool, Real>(is_lame, {c.f32(m, 0), c.f32(m, 1), c.f32(m, 2)}));
         return contributions({f.f0, f.f1, f.f2, f.f3});
       }}));
  return spec;
}

Tensor eval_tetrahedra_forces_generated(const Model& model, const Tensor& particle_q,
                                        const Tensor& particle_qd, const Tensor& particle_f,
                                        const Tensor& tet_activations,
                                        const Tensor& tet_materials) {
  return detail::eval_elements(model, detail::tetrahedron_operator(), particle_q, particle_qd,
                               particle_f, {tet_activations, tet_materials});
}

namespace {

// Makes the kernel that computes k_mu and k_lambda from parameters, of each row or of the whole
// model, and k_damp from the base.
nova::Kernel make_material_kernel(const char* name, Access access) {
  return nova::with_one_gradient_set(
      nova::make_kernel(name,
                        {{"base_tet_materials", DType::F32, 3, Access::Direct},
                         {"material_params", DType::F32, 2, access}},
                        {{"tet_materials", 3}}, [](TraceContext& c) {
                          return std::vector{c.f32(1, 0), c.f32(1, 1), c.f32(0, 2)};
                        }));
}
const nova::Kernel& shared_material_kernel() {
  static const nova::Kernel kernel =
      make_material_kernel("assign_shared_tet_materials", Access::Uniform);
  return kernel;
}
const nova::Kernel& own_material_kernel() {
  static const nova::Kernel kernel = make_material_kernel("assign_tet_materials", Access::Direct);
  return kernel;
}

}  // namespace

void detail::add_tet_material_kernels(std::vector<nova::EngineKernel>& list) {
  for (const nova::Kernel& k : {shared_material_kernel(), own_material_kernel()})
    list.push_back({k, k.gradients()});
}

Tensor assign_tet_materials_generated(const Tensor& material_params,
                                      const Tensor& base_tet_materials, int64_t tet_count) {
  const char* op = "assign_tet_materials_generated";
  require(tet_count >= 0, ErrorKind::Value, op, ", tet_count: expected >= 0, got ", tet_count);
  require(material_params.defined() && material_params.dtype() == DType::F32, ErrorKind::Type, op,
          ", material_params: expected a float32 tensor");
  require(base_tet_materials.defined() && base_tet_materials.dtype() == DType::F32, ErrorKind::Type,
          op, ", base_tet_materials: expected a float32 tensor");
  require(base_tet_materials.ndim() == 2 && base_tet_materials.rows() == tet_count &&
              base_tet_materials.row_width() == 3,
          ErrorKind::Value, op, ", base_tet_materials: expected {", tet_count,
          ", 3} tightly packed float32, got ", nova::shape_str(base_tet_materials.shape()));
  const bool pairs = material_params.ndim() == 2 && material_params.row_width() == 2;
  const bool flat = material_params.ndim() == 1;
  const bool own = material_params.size() == 2 * tet_count;
  const bool shared = material_params.size() == 2;
  require((pairs || flat) && (own || shared), ErrorKind::Value, op,
          ", material_params: expected {2} or {", 2 * tet_count, "} (or {1, 2} or {", tet_count,
          ", 2}), got ", nova::shape_str(material_params.shape()));
  require(material_params.device() == base_tet_materials.device(), ErrorKind::Value, op,
          ", material_params: expected device ", base_tet_materials.device().str(), ", got ",
          material_params.device().str());
  nova::Operand params = material_params.flat_operand();
  params.rows /= 2;
  params.width = 2;
  const nova::Operand in[] = {base_tet_materials.operand(), params};
  const Tensor out({tet_count, 3}, DType::F32, base_tet_materials.device());
  const nova::Operand to = out.operand();
  (own ? own_material_kernel() : shared_material_kernel()).launch(tet_count, in, to);
  return out;
}

}  // namespace novaphy::diff
