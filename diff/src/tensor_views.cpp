#include "novaphy/diff/tensor_views.h"

#include <initializer_list>

#include "novaphy/diff/engine_kernels.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

void make_leaves(const SimState& state) {
  if (!state.requires_grad) return;
  for (const Array* array :
       std::initializer_list<const Array*>{&state.particle_q, &state.particle_qd, &state.body_q,
                                           &state.body_qd, &state.joint_q, &state.joint_qd})
    if (array->rows() != 0) nova::grad_info(*array->range()).requires_grad = true;
}

#define NOVAPHY_DEFINE_STATE_VIEW(field)                                           \
  nova::Tensor state_##field##_tensor(const SimState& state, bool requires_grad) { \
    make_leaves(state);                                                            \
    return nova::Tensor::view(state.field, requires_grad);                         \
  }
NOVAPHY_STATE_VIEWS(NOVAPHY_DEFINE_STATE_VIEW)

#define NOVAPHY_DEFINE_MODEL_VIEW(field)                                        \
  nova::Tensor model_##field##_tensor(const Model& model, bool requires_grad) { \
    return nova::Tensor::view(model.field, requires_grad);                      \
  }
NOVAPHY_MODEL_VIEWS(NOVAPHY_DEFINE_MODEL_VIEW)

#define NOVAPHY_DEFINE_ELEMENT_VIEW(name, field)                               \
  nova::Tensor model_##name##_tensor(const Model& model, bool requires_grad) { \
    return nova::Tensor::view(model.field, requires_grad);                     \
  }
NOVAPHY_ELEMENT_VIEWS(NOVAPHY_DEFINE_ELEMENT_VIEW)

#define NOVAPHY_DEFINE_CONTROL_VIEW(name, field)                                     \
  nova::Tensor control_##name##_tensor(const Control& control, bool requires_grad) { \
    return nova::Tensor::view(control.field, requires_grad);                         \
  }
NOVAPHY_CONTROL_VIEWS(NOVAPHY_DEFINE_CONTROL_VIEW)

namespace {
const nova::Kernel& inverse_mass_kernel() {
  static const nova::Kernel kernel = nova::make_kernel(
      "inverse_mass", {{"particle_mass", nova::DType::F32, 1, nova::Access::Direct}},
      {{"particle_inv_mass", 1}}, [](nova::TraceContext& c) {
        const nova::Real m = c.f32(0), zero = 0.0f;
        return std::vector{select(m == zero, zero, nova::Real(1.0f) / m)};
      });
  return kernel;
}
}  // namespace

void detail::add_view_kernels(std::vector<nova::EngineKernel>& list) {
  list.push_back({inverse_mass_kernel(), {}});  // never recorded
}

void update_inverse_mass(Model& model) {
  nova::NoGrad no_grad;
  const nova::Operand in = nova::Tensor::view(model.particle_mass).operand();
  const nova::Operand out = nova::Tensor::view(model.particle_inv_mass).operand();
  inverse_mass_kernel().launch(in.rows, {&in, 1}, {&out, 1});
}

}  // namespace novaphy::diff
