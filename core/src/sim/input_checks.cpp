#include "novaphy/core/sim/input_checks.h"

#include <atomic>
#include <cmath>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/contact_count.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/core/storage.h"

namespace novaphy {
namespace {

bool is_unit(float square) { return !(std::abs(square - 1.0f) > 0.02f); }
float squared(const Quatf& r) { return (r.x * r.x + r.y * r.y) + (r.z * r.z + r.w * r.w); }
float squared(const Vec3f& n) { return n.x * n.x + n.y * n.y + n.z * n.z; }

// Returns whether all rows have length 1. row(k): a rotation or a normal.
template <class Row>
bool are_units(int64_t count, const Row& row) {
  constexpr int64_t kChunk = 4096;
  std::atomic<bool> all{true};
  for_chunks(count, kChunk, [&](int64_t begin, int64_t end, int64_t) {
    bool here = true;
    for (int64_t k = begin; k < end; ++k) here = is_unit(squared(row(k))) && here;
    if (!here) all = false;
  });
  return all;
}

}  // namespace

void check_rotations(const char* function, const SimState& state) {
  if (!state.device().is_cpu()) return;
  const UntrackedScope untracked;
  const Transformf* const q = state.body_q.data();
  const auto count = static_cast<int64_t>(state.body_q.rows());
  if (are_units(count, [q](int64_t b) { return q[b].q; })) return;
  for (int64_t b = 0; b < count; ++b) {
    const Quatf& r = q[b].q;
    require(is_unit(squared(r)), ErrorKind::Value, function, ": state.body_q[", b,
            "]: expected a quaternion of length 1, got (", r.x, ", ", r.y, ", ", r.z, ", ", r.w,
            ")");
  }
}

void check_normals(const char* function, const Contacts& contacts) {
  if (!contacts.device().is_cpu()) return;
  const UntrackedScope untracked;
  const int32_t count =
      filled_rows(*contacts.rigid_contact_count.data(), contacts.rigid_contact_max(),
                  contacts.rigid_contact_shape0.data());
  const Vec3f* const normals = contacts.rigid_contact_normal.data();
  if (are_units(count, [normals](int64_t row) { return normals[row]; })) return;
  for (int32_t row = 0; row < count; ++row) {
    const Vec3f& n = normals[row];
    require(is_unit(squared(n)), ErrorKind::Value, function, ": contacts.rigid_contact_normal[",
            row, "]: expected a vector of length 1, got (", n.x, ", ", n.y, ", ", n.z, ")");
  }
}

}  // namespace novaphy
