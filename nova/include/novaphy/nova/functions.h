// The elementary functions of traced values, such as nova::sin(Real). Each function appends the
// formula of <novaphy/math/functions.h> to the Program. The header of the formulas states accuracy,
// special values and derivatives. The results have the same bits as the same function of a float.
// sqrt, abs, floor, min, max and fma are instructions (trace.h).
#pragma once

#include "novaphy/math/functions.h"
#include "novaphy/nova/trace.h"

namespace nova {

inline Real sin(const Real& x) { return novaphy::math::sin(x); }
inline Real cos(const Real& x) { return novaphy::math::cos(x); }
inline Real tan(const Real& x) { return novaphy::math::tan(x); }
inline Real exp(const Real& x) { return novaphy::math::exp(x); }
inline Real log(const Real& x) { return novaphy::math::log(x); }
inline Real pow(const Real& x, const Real& y) { return novaphy::math::pow(x, y); }
inline Real tanh(const Real& x) { return novaphy::math::tanh(x); }
inline Real asin(const Real& x) { return novaphy::math::asin(x); }
inline Real acos(const Real& x) { return novaphy::math::acos(x); }
inline Real atan2(const Real& y, const Real& x) { return novaphy::math::atan2(y, x); }
inline Real rsqrt(const Real& x) { return novaphy::math::rsqrt(x); }

}  // namespace nova
