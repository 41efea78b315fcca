// Smooth and clipped ramp functions, as templates over the scalar (scalar.h). T = float runs in the
// engine, and T = nova::Real is traced.
//
//   sigmoid(x)  = 1 / (1 + exp(-x))           derivative sigmoid(x) sigmoid(-x)
//   softplus(x) = max(x, 0) + log1p(exp(-|x|))   derivative sigmoid(x)
//   relu(x)     = max(x, 0)                   derivative 1 above 0, 0 below and at 0
// No function overflows. sigmoid and softplus have an error of 3 ulp, and are exactly 0 below x =
// -103.97, where exp is 0.
#pragma once

#include "novaphy/math/functions.h"

namespace novaphy::math {

template <FormulaScalar T>
T sigmoid(const T& x) {
  const T one = T(1.0f), power = exp(-abs(x));
  const T inverse = one / (one + power), other = power * inverse;
  const T value = select(x < T(0.0f), other, inverse);
  return with_derivative(detach(value), x, detach(other * inverse));
}

template <FormulaScalar T>
T softplus(const T& x) {
  const T one = T(1.0f), power = exp(-abs(x));
  // log1p(u) is log(w) u / (w - 1), where w is 1 + u after rounding. The rounding error of w
  // cancels in the quotient.
  const T w = one + power, rounded = w - one;
  const T log1p = select(rounded == T(0.0f), power, log(w) * (power / rounded));
  return with_derivative(detach(max(x, T(0.0f)) + log1p), x, detach(sigmoid(x)));
}

template <FormulaScalar T>
T relu(const T& x) {
  return select(x > T(0.0f), x, T(0.0f));
}

}  // namespace novaphy::math
