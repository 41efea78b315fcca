// Functions of tensors, recorded on an active tape. Every function returns a new tensor. Sums have
// a fixed order, so the bits are the same on every device, for any number of threads, and in
// replays. Operands of different shapes are broadcast as in NumPy: shapes are aligned at the last
// dimension, and a dimension that is 1 or missing is repeated.
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
NOVAPHY_NOVA_API Tensor sqrt(const Tensor& x);  // gradient 0 at 0
NOVAPHY_NOVA_API Tensor exp(const Tensor& x);
NOVAPHY_NOVA_API Tensor log(const Tensor& x);
NOVAPHY_NOVA_API Tensor sin(const Tensor& x);
NOVAPHY_NOVA_API Tensor cos(const Tensor& x);
NOVAPHY_NOVA_API Tensor tanh(const Tensor& x);
NOVAPHY_NOVA_API Tensor acos(const Tensor& x);  // x limited to [-1, 1]; gradient 0 at and beyond
                                                // the limits
NOVAPHY_NOVA_API Tensor atan2(const Tensor& y, const Tensor& x);  // gradient 0 at the origin
// Limits x to [lower, upper], where lower <= upper. The gradient is 1 inside and at the bounds, and
// 0 outside.
NOVAPHY_NOVA_API Tensor clamp(const Tensor& x, float lower, float upper);
// Returns a to the power of b. Values and derivatives are those of math::pow
// (<novaphy/math/functions.h>). The number 2 as exponent gives a * a.
NOVAPHY_NOVA_API Tensor pow(const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor pow(const Tensor& a, float b);
NOVAPHY_NOVA_API Tensor pow(float a, const Tensor& b);

// Returns float32 values without a gradient: 1 where the comparison holds, else 0. With a NaN only
// Ne holds.
enum class Comparison : uint8_t { Lt, Le, Eq, Ne, Ge, Gt };
NOVAPHY_NOVA_API Tensor compare(Comparison what, const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor compare(Comparison what, const Tensor& a, float b);
// Returns condition ? a : b. The condition is int32 or float32, and nonzero means true. The
// condition gets no gradient.
NOVAPHY_NOVA_API Tensor where(const Tensor& condition, const Tensor& a, const Tensor& b);

// Reduces all values to {1}, in the order of the row-sum rule.
NOVAPHY_NOVA_API Tensor sum(const Tensor& x);
NOVAPHY_NOVA_API Tensor mean(const Tensor& x);
// Reduces one dimension. The dimension is removed (a result without dimensions is {1}), or stays
// with size 1 for keepdims. axis: -ndim to ndim - 1 (ErrorKind::Index).
NOVAPHY_NOVA_API Tensor sum(const Tensor& x, int64_t axis, bool keepdims = false);
NOVAPHY_NOVA_API Tensor mean(const Tensor& x, int64_t axis, bool keepdims = false);
// Returns the largest or the smallest value of all values, or along a dimension. If several values
// are equal, only one of them gets the gradient. ErrorKind::Value: no values.
NOVAPHY_NOVA_API Tensor max(const Tensor& x);
NOVAPHY_NOVA_API Tensor min(const Tensor& x);
NOVAPHY_NOVA_API Tensor max(const Tensor& x, int64_t axis, bool keepdims = false);
NOVAPHY_NOVA_API Tensor min(const Tensor& x, int64_t axis, bool keepdims = false);
NOVAPHY_NOVA_API Tensor dot(const Tensor& a, const Tensor& b);
NOVAPHY_NOVA_API Tensor norm(const Tensor& x);  // gradient 0 at 0
// Returns the sum of the rows of x {n, w} as {1, w}.
NOVAPHY_NOVA_API Tensor sum_rows(const Tensor& x);
// Repeats x to a shape by the broadcasting rule. The gradient is the sum over the repetitions.
NOVAPHY_NOVA_API Tensor broadcast_to(const Tensor& x, const Shape& shape);
// Returns the common shape of two broadcast operands. `call` is for the error message.
NOVAPHY_NOVA_API Shape broadcast_shape(const char* call, const Shape& a, const Shape& b);

// Returns a copy of `count` entries start, start + step, ... along one dimension, for float32 or
// int32. ErrorKind::Index: an entry does not exist. The gradient goes to the entries that were
// read, and is 0 elsewhere.
NOVAPHY_NOVA_API Tensor slice(const Tensor& x, int64_t axis, int64_t start, int64_t count,
                              int64_t step = 1);
// Returns x[index[k], ...] for every entry of `index` (int32, any shape), with the shape
// index.shape + x.shape[1:], for float32 or int32. An index may occur several times: the gradient
// of a row is the sum over its entries, in their order. ErrorKind::Index: an entry outside of [0,
// rows). A capture depends on the values of the index, and a launch throws if they have changed.
NOVAPHY_NOVA_API Tensor gather(const Tensor& x, const Tensor& index);
// Joins tensors along a dimension. The other dimensions are equal.
NOVAPHY_NOVA_API Tensor concat(std::span<const Tensor> parts, int64_t axis = 0);
// Joins tensors of one shape along a new dimension, which is number `axis` of the result.
NOVAPHY_NOVA_API Tensor stack(std::span<const Tensor> parts, int64_t axis = 0);
// Permutes the dimensions: dimension axes[k] of x becomes dimension k. Without axes the order is
// reversed. The result is a copy, except for tensors of one dimension. ErrorKind::Value: axes that
// are not a permutation of the dimensions.
NOVAPHY_NOVA_API Tensor transpose(const Tensor& x, std::span<const int64_t> axes = {});

// Returns the matrix product of {n, k} and {k, m}. A vector {k} is a row on the left or a column on
// the right, and its dimension is removed from the result; two vectors give {1}. Each value is
// summed from +0 in ascending k, and each product is rounded before it is added.
NOVAPHY_NOVA_API Tensor matmul(const Tensor& a, const Tensor& b);

// Functions of the last dimension: vectors {..., 3}, and quaternions {..., 4} as (x, y, z, w).
// Leading dimensions are broadcast.
NOVAPHY_NOVA_API Tensor cross(const Tensor& a, const Tensor& b);
// Returns the Hamilton product: the rotation b, then a.
NOVAPHY_NOVA_API Tensor quat_mul(const Tensor& a, const Tensor& b);
// Returns the vector v rotated by the unit quaternion q.
NOVAPHY_NOVA_API Tensor quat_rotate(const Tensor& q, const Tensor& v);
// quat_exp returns the unit quaternion of a rotation vector r (rad). quat_log is the inverse with
// |r| <= pi; q and -q give the same r. Derivatives are valid at r = 0; the derivative of quat_log
// jumps at half a turn. quat_log does not depend on the length of q, which must not be 0.
NOVAPHY_NOVA_API Tensor quat_exp(const Tensor& r);
NOVAPHY_NOVA_API Tensor quat_log(const Tensor& q);

}  // namespace nova
