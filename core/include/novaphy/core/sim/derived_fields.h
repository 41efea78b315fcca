// Derived arrays of a model. A derived array is computed from a source array when the model is
// made, and again after each write to the source. One X-macro lists the derived arrays:
//
//   #define NOVAPHY_DERIVED_MODEL_FIELDS(X)  X(derived, source, rule) ...
//
// Model::update_derived and the kernels that a capture records follow from the list. A new derived
// array needs one line in the list and one rule here. A rule reads one row of the source and writes
// one row of the derived array, as packed scalars: float on the host, nova::Real in a kernel.
#pragma once

#include <atomic>
#include <cstdint>

#include "novaphy/core/device_array.h"
#include "novaphy/core/export.h"
#include "novaphy/math/ldlt.h"
#include "novaphy/math/scalar.h"

namespace novaphy {

// Returns 1/x, and 0 for x = 0.
struct InverseOrZero {
  static constexpr const char* name = "inverse_or_zero";
  static constexpr int32_t source_width = 1, derived_width = 1;  // scalars per row
  template <class T>
  void operator()(const T* source, T* derived) const {
    derived[0] = math::inverse_or_zero(source[0]);
  }
};

// Returns the inverse of a symmetric positive definite 3x3 matrix. Only the lower triangle with the
// diagonal is read. A matrix whose diagonal is 0 gives 0.
struct InverseInertia {
  static constexpr const char* name = "inverse_inertia";
  static constexpr int32_t source_width = 9, derived_width = 9;
  template <class T>
  void operator()(const T* source, T* derived) const {
    const T zero = T(0.0f);
    const T matrix[3][3] = {{source[0], source[1], source[2]},
                            {source[3], source[4], source[5]},
                            {source[6], source[7], source[8]}};
    const auto factors = math::ldlt(matrix);
    using math::select;
    const auto nothing = (source[0] + source[4]) + source[8] == zero;
    for (int j = 0; j < 3; ++j) {
      const T unit[3] = {T(j == 0 ? 1.0f : 0.0f), T(j == 1 ? 1.0f : 0.0f), T(j == 2 ? 1.0f : 0.0f)};
      T column[3];
      math::solve(factors, unit, column);
      for (int i = j; i < 3; ++i)
        derived[3 * i + j] = derived[3 * j + i] = select(nothing, zero, column[i]);
    }
  }
};

// The memory range and the version that a derived array was computed from.
class NOVAPHY_CORE_API DerivedStamp {
 public:
  // Returns whether the source has not changed since `set`. For a source with a writable export,
  // the checksums are compared. The function takes no lock: while another thread sets the stamp to
  // a new source, the answer for this source is false.
  bool matches(const Array& source) const;
  void set(const Array& source);

 private:
  std::atomic<const Range*> range_{nullptr};
  std::atomic<uint64_t> version_{0}, checksum_{0};
  std::atomic<bool> has_checksum_{false};
};

}  // namespace novaphy
