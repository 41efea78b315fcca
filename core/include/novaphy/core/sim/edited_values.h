// Numbers of a model's bodies and shapes that were written after it was made: refused where the
// builder would have refused them, so that a NaN or a negative stiffness is named instead of
// spreading through the state.
#pragma once

#include <array>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/export.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

class NOVAPHY_CORE_API EditedValues {
 public:
  explicit EditedValues(const char* solver) : solver_(solver) {}

  // Cheap while the arrays were not written since the last call. ErrorKind::Value names array and
  // row: of dynamic bodies body_mass and the diagonal of body_inertia > 0, all of body_inertia and
  // body_com finite; shape_material_ke, _kd, _kf, _ka, _mu and shape_gap >= 0 and finite,
  // shape_margin finite. On other devices than the CPU, arrays that another library may write are
  // not read. Host reads are not observed: no kernel depends on them.
  void check(const Model& model);

 private:
  static constexpr size_t kBodyArrays = 4, kShapeArrays = 7;
  void check_bodies(const Model& model);
  void check_shapes(const Model& model);

  const char* solver_;
  std::array<ArrayStamp, kBodyArrays> bodies_;
  std::array<ArrayStamp, kShapeArrays> shapes_;
};

}  // namespace novaphy
