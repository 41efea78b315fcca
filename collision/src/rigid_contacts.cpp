#include "rigid_contacts.h"

#include <algorithm>
#include <utility>

#include "fcl_contacts.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "rigid_launches.h"
#include "rigid_pairs.h"
#include "sleeping_shapes.h"

namespace novaphy::detail {

struct RigidContacts::Impl {
  std::shared_ptr<const Model> model;
  std::shared_ptr<ShapeGeometries> geometries;
  NarrowPhase narrow_phase;
  int32_t contacts_per_pair;
  RigidPairs pairs;
  RigidLaunches launches = {};
  FclContacts fcl = {};
  SleepingShapes sleeping = {};
  // Version of rigid_contact_shape0 after the last call. The rows from `used` on are empty.
  ArrayStamp emptied = {};
  int64_t used = 0;

  void update() {
    geometries->update();
    pairs.update();
  }
  void query_fcl() {
    fcl.use_tables(geometries->version());
    const auto moved = launches.host_shapes();
    int32_t* const counts = launches.host_counts();
    for (int64_t k = 0; k < pairs.count(); ++k) {
      const Vec2i pair = pairs.rows().data()[k];
      const RigidShape& s0 = moved[static_cast<size_t>(pair.x)];
      const RigidShape& s1 = moved[static_cast<size_t>(pair.y)];
      if (s0.type == GeoType::CONVEX_MESH && s1.type == GeoType::CONVEX_MESH &&
          geometry::boxes_meet(s0.box, s1.box))
        counts[k] = fcl.query(s0, s1, counts[k], contacts_per_pair, launches.host_manifolds()[k]);
    }
  }
};

RigidContacts::RigidContacts(std::shared_ptr<const Model> model,
                             std::shared_ptr<ShapeGeometries> geometries, BroadPhase broad_phase,
                             NarrowPhase narrow_phase, int32_t contacts_per_pair,
                             std::optional<std::vector<Vec2i>> explicit_pairs)
    : impl_(new Impl{.model = model,
                     .geometries = std::move(geometries),
                     .narrow_phase = narrow_phase,
                     .contacts_per_pair = contacts_per_pair,
                     .pairs = {model, broad_phase, contacts_per_pair, std::move(explicit_pairs)}}) {
}
RigidContacts::~RigidContacts() = default;

int64_t RigidContacts::fcl_pairs() const { return impl_->fcl.pairs(); }
int64_t RigidContacts::fcl_fallbacks() const { return impl_->fcl.fallbacks(); }

int64_t RigidContacts::most_rows() {
  impl_->update();
  return impl_->pairs.most_rows();
}

bool RigidContacts::waits() const { return runs_at_once(impl_->model->device()); }

void RigidContacts::collide(const SimState& state, Contacts& c, float dt) {
  const Model& m = *impl_->model;
  RigidPairs& pairs = impl_->pairs;
  RigidLaunches& launches = impl_->launches;
  impl_->update();
  depend_on(pairs.sources());  // the host has read these arrays
  const bool uses_fcl = impl_->narrow_phase == NarrowPhase::Fcl;
  require(!uses_fcl || launch_recorder() == nullptr, ErrorKind::Runtime,
          "collide: the narrow phase \"fcl\" asks on the host, so it cannot be recorded; use "
          "\"auto\"");
  const int64_t rows = c.rigid_contact_max();
  // Without pairs and rows, as in a model without bodies, no kernel runs.
  if (!pairs.are_swept() && pairs.count() == 0 && rows == 0) return;
  // If the host waits for the launches, it uses the faster sweep on the host. The host then also
  // knows which rows are already empty.
  const bool waits = this->waits();
  const bool knows_empty = waits && impl_->emptied.matches(c.rigid_contact_shape0);
  const bool sleeps =
      waits && pairs.are_swept() && !uses_fcl &&
      impl_->sleeping.begin(m, state, launches.host_shapes(), dt, impl_->geometries->version());
  if (sleeps)
    launches.move_some(m, state, *impl_->geometries, dt, impl_->sleeping.moved());
  else if (pairs.are_swept() || pairs.count() > 0)
    launches.move(m, state, *impl_->geometries, dt);
  if (pairs.are_swept()) {
    if (!sleeps) impl_->sleeping.forget();
    if (sleeps)
      pairs.take_swept(impl_->sleeping.pairs(m, launches.host_shapes(), pairs.rules()));
    else if (waits)
      pairs.sweep(launches.host_shapes());
    else
      pairs.find_by_kernels(launches.shapes());
  }
  if (pairs.count() > 0) {
    launches.find(pairs, impl_->contacts_per_pair);
    if (uses_fcl) impl_->query_fcl();
    launches.scan(pairs);
    // If the host waits for the number of rows, it checks here whether the rows fit. Otherwise
    // kernels check this.
    const bool limited = waits ? launches.rows_found(pairs) > rows : rows < pairs.most_rows();
    if (limited) launches.limit(pairs, rows);
    launches.write(pairs, limited, c);
  }
  int64_t used = rows;
  if (waits) {
    const UntrackedScope untracked;
    used = pairs.count() > 0 ? std::min<int64_t>(rows, *c.rigid_contact_count.data()) : 0;
  }
  launches.clear(pairs.count(), knows_empty ? std::max(used, impl_->used) : rows, c);
  impl_->emptied.reset();
  if (waits) impl_->emptied.set(c.rigid_contact_shape0);
  impl_->used = used;
}

}  // namespace novaphy::detail
