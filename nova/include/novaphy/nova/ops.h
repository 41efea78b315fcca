// Element-wise functions of tensors and reductions, recorded on an active tape. Operands have the
// same shape, or one of them holds a single value, which is broadcast.
#pragma once

#include "novaphy/nova/tensor.h"

namespace nova {

NOVAPHY_NOVA_API Tensor add(const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor sub(const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor mul(const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor div(const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor minimum(const Tensor& a,
                                const Tensor& b);  // gradient to a where a < b, else to b
NOVAPHY_NOVA_API Tensor maximum(const Tensor& a,
                                const Tensor& b);  // gradient to a where a > b, else to b
NOVAPHY_NOVA_API Tensor add(const Tensor& a, float b);
NOVAPHY_NOVA_API Tensor sub(const Tensor& a, float b);
NOVAPHY_NOVA_API Tensor sub(float a, const Tensor& b);
NOVAPHY_NOVA_API Tensor mul(const Tensor& a, float b);
NOVAPHY_NOVA_API Tensor div(const Tensor& a, float b);
NOVAPHY_NOVA_API Tensor div(float a, const Tensor& b);
NOVAPHY_NOVA_API Tensor neg(const Tensor& x);
NOVAPHY_NOVA_API Tensor abs(const Tensor& x);   // derivative -1 below 0, else +1
NOVAPHY_NOVA_API Tensor sqrt(const Tensor& x);  // no gradient at 0
NOVAPHY_NOVA_API Tensor exp(const Tensor& x);
NOVAPHY_NOVA_API Tensor log(const Tensor& x);
NOVAPHY_NOVA_API Tensor sin(const Tensor& x);
NOVAPHY_NOVA_API Tensor cos(const Tensor& x);
NOVAPHY_NOVA_API Tensor tanh(const Tensor& x);
// x limited to [lower, upper]; gradient 1 inside and at the bounds, 0 outside. lower <= upper.
NOVAPHY_NOVA_API Tensor clamp(const Tensor& x, float lower, float upper);
// condition (int32, non-zero is true) ? a : b
NOVAPHY_NOVA_API Tensor where(const Tensor& condition, const Tensor& a, const Tensor& b);
// Over all values, in the order of the row-sum rule: {1}.
NOVAPHY_NOVA_API Tensor sum(const Tensor& x);
NOVAPHY_NOVA_API Tensor mean(const Tensor& x);
NOVAPHY_NOVA_API Tensor dot(const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor norm(const Tensor& x);  // no gradient at 0
// Sums of the rows of x {n, w}: {1, w}.
NOVAPHY_NOVA_API Tensor sum_rows(const Tensor& x);

}  // namespace nova
