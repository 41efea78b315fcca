#include "novaphy/core/sim/input_checks.h"

#include <cmath>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/contact_count.h"
#include "novaphy/core/storage.h"

namespace novaphy {
namespace {

bool is_unit(float square) { return !(std::abs(square - 1.0f) > 0.02f); }

}  // namespace

void check_rotations(const char* function, const SimState& state) {
  if (!state.device().is_cpu()) return;
  const UntrackedScope untracked;
  const Transformf* const q = state.body_q.data();
  for (size_t b = 0; b < state.body_q.rows(); ++b) {
    const Quatf& r = q[b].q;
    require(is_unit((r.x * r.x + r.y * r.y) + (r.z * r.z + r.w * r.w)), ErrorKind::Value, function,
            ": state.body_q[", b, "]: expected a quaternion of length 1, got (", r.x, ", ", r.y,
            ", ", r.z, ", ", r.w, ")");
  }
}

void check_normals(const char* function, const Contacts& contacts) {
  if (!contacts.device().is_cpu()) return;
  const UntrackedScope untracked;
  const int32_t count =
      filled_rows(*contacts.rigid_contact_count.data(), contacts.rigid_contact_max(),
                  contacts.rigid_contact_shape0.data());
  const Vec3f* const normals = contacts.rigid_contact_normal.data();
  for (int32_t row = 0; row < count; ++row) {
    const Vec3f& n = normals[row];
    require(is_unit(n.x * n.x + n.y * n.y + n.z * n.z), ErrorKind::Value, function,
            ": contacts.rigid_contact_normal[", row, "]: expected a vector of length 1, got (", n.x,
            ", ", n.y, ", ", n.z, ")");
  }
}

}  // namespace novaphy
