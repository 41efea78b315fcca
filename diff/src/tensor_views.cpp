#include "novaphy/diff/tensor_views.h"

namespace novaphy::diff {

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

}  // namespace novaphy::diff
