// Functions of tensors, recorded on an active tape. Every one makes a new tensor; sums have a fixed
// order, so the bits are the same on every device, for any number of threads, run or replayed.
// Operands of different shapes are broadcast as in NumPy: shapes are compared from the last
// dimension on, and a dimension that is 1, or missing, is repeated.
#pragma once

#include <span>

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
NOVAPHY_NOVA_API Tensor acos(const Tensor& x);  // x limited to [-1, 1]; there no gradient
NOVAPHY_NOVA_API Tensor atan2(const Tensor& y, const Tensor& x);  // no gradient at the origin
// x limited to [lower, upper]; gradient 1 inside and at the bounds, 0 outside. lower <= upper.
NOVAPHY_NOVA_API Tensor clamp(const Tensor& x, float lower, float upper);
// a to the power of b; values and derivatives are those of math::pow (<novaphy/math/functions.h>).
// An exponent that is the number 2 gives a * a.
NOVAPHY_NOVA_API Tensor pow(const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor pow(const Tensor& a, float b);
NOVAPHY_NOVA_API Tensor pow(float a, const Tensor& b);

// 1 where the comparison holds and 0 elsewhere, float32 without a gradient. With a NaN only Ne
// holds.
enum class Comparison : uint8_t { Lt, Le, Eq, Ne, Ge, Gt };
NOVAPHY_NOVA_API Tensor compare(Comparison what, const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor compare(Comparison what, const Tensor& a, float b);
// condition (int32 or float32, non-zero is true) ? a : b. No gradient flows to the condition.
NOVAPHY_NOVA_API Tensor where(const Tensor& condition, const Tensor& a, const Tensor& b);

// Over all values, in the order of the row-sum rule: {1}.
NOVAPHY_NOVA_API Tensor sum(const Tensor& x);
NOVAPHY_NOVA_API Tensor mean(const Tensor& x);
// Over one dimension, which goes away ({1} if it was the only one), or stays as 1 with keepdims.
// axis: -ndim to ndim - 1 (ErrorKind::Index).
NOVAPHY_NOVA_API Tensor sum(const Tensor& x, int64_t axis, bool keepdims = false);
NOVAPHY_NOVA_API Tensor mean(const Tensor& x, int64_t axis, bool keepdims = false);
// The largest and the smallest value, likewise. Of equal values one gets the gradient.
// ErrorKind::Value: no values.
NOVAPHY_NOVA_API Tensor max(const Tensor& x);
NOVAPHY_NOVA_API Tensor min(const Tensor& x);
NOVAPHY_NOVA_API Tensor max(const Tensor& x, int64_t axis, bool keepdims = false);
NOVAPHY_NOVA_API Tensor min(const Tensor& x, int64_t axis, bool keepdims = false);
NOVAPHY_NOVA_API Tensor dot(const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor norm(const Tensor& x);  // no gradient at 0
// Sums of the rows of x {n, w}: {1, w}.
NOVAPHY_NOVA_API Tensor sum_rows(const Tensor& x);
// x repeated to a shape, by the rule above; the gradient is the sum over the repetitions.
NOVAPHY_NOVA_API Tensor broadcast_to(const Tensor& x, const Shape& shape);
// The shape that both are broadcast to; `call` is for the message.
NOVAPHY_NOVA_API Shape broadcast_shape(const char* call, const Shape& a, const Shape& b);

// A copy of entries start, start + step, ... (`count` of them) along one dimension; float32 or
// int32. Entries that are not there are ErrorKind::Index. The gradient goes to the entries that
// were read, and is 0 at the others.
NOVAPHY_NOVA_API Tensor slice(const Tensor& x, int64_t axis, int64_t start, int64_t count,
                              int64_t step = 1);
// x[index[k], ...] for every entry of index (int32, any shape): index.shape + x.shape[1:]; float32
// or int32. The gradient of a row is the sum over the entries that name it, in their order, so an
// index may be given twice. ErrorKind::Index for an entry outside of [0, rows). A capture keeps the
// index of record time, and refuses to run once it was changed.
NOVAPHY_NOVA_API Tensor gather(const Tensor& x, const Tensor& index);
// Tensors one after the other along a dimension; their other dimensions are equal.
NOVAPHY_NOVA_API Tensor concat(std::span<const Tensor> parts, int64_t axis = 0);
// Tensors of one shape along a new dimension, which is number `axis` of the result.
NOVAPHY_NOVA_API Tensor stack(std::span<const Tensor> parts, int64_t axis = 0);
// Dimension axes[k] of x becomes dimension k; without axes their order is reversed. A copy, but for
// tensors of one dimension. ErrorKind::Value: axes that are not all dimensions, each once.
NOVAPHY_NOVA_API Tensor transpose(const Tensor& x, std::span<const int64_t> axes = {});

// The matrix product: {n, k} by {k, m}, where a vector {k} is a row on the left and a column on the
// right, a dimension that the result lacks ({1} of two vectors). Each value is a left fold from +0
// in ascending k, products rounded before they are added.
NOVAPHY_NOVA_API Tensor matmul(const Tensor& a, const Tensor& b);

// Functions of the last dimension: vectors {..., 3}, quaternions {..., 4} as (x, y, z, w). The
// dimensions before are broadcast.
NOVAPHY_NOVA_API Tensor cross(const Tensor& a, const Tensor& b);
// The Hamilton product: the rotation b, then a.
NOVAPHY_NOVA_API Tensor quat_mul(const Tensor& a, const Tensor& b);
// The vector v rotated by the unit quaternion q.
NOVAPHY_NOVA_API Tensor quat_rotate(const Tensor& q, const Tensor& v);
// The unit quaternion of the rotation vector r (rad), and back: |r| <= pi, and q and -q give the
// same r. Derivatives hold at r = 0 too; that of quat_log jumps at half a turn. quat_log does not
// depend on the length of q, which is not 0.
NOVAPHY_NOVA_API Tensor quat_exp(const Tensor& r);
NOVAPHY_NOVA_API Tensor quat_log(const Tensor& q);

}  // namespace nova
