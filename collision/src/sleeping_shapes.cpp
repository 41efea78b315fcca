#include "sleeping_shapes.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "rigid_contact_kernels.h"

namespace novaphy::detail {
namespace {

// Tolerances for rounding: kNearly (m), and kOfPlace relative to the positions. The search wakes a
// body if a pair may have a row. The step then tests whether the row touches.
constexpr float kNearly = 1.0e-4f, kOfPlace = 1.0e-6f;

bool may_have_rows(const RigidShape& s0, const RigidShape& s1) {
  if (!geometry::boxes_meet(s0.box, s1.box)) return false;
  if (is_mesh_pair(s0.type, s1.type)) return true;
  const geometry::Manifold found = rigid_manifold(s0, s1, reach_of(s0, s1));
  for (int32_t k = 0; k < found.count; ++k) {
    const Vec3f& at = found.points[k].position;
    const float place = std::max({std::abs(at.x), std::abs(at.y), std::abs(at.z)});
    const float gap = found.points[k].distance - (s0.margin + s1.margin);
    if (!(gap > (s0.row_gap + s1.row_gap) + (kNearly + kOfPlace * place))) return true;
  }
  return false;
}

}  // namespace

void SleepingShapes::renew(const Model& model) {
  const auto count = static_cast<size_t>(model.shape_count());
  is_still_.assign(count, 0);
  is_indexed_.assign(count, 0);
  still_ = {};
  std::vector<int32_t> body = model.shape_body.to_host();
  shapes_of_.build(body, model.body_count());
}

bool SleepingShapes::begin(const Model& model, const SimState& state,
                           std::span<const RigidShape> shapes, float dt, uint64_t version) {
  const auto bodies = static_cast<size_t>(model.body_count());
  if (state.body_sleep.rows() != bodies || state.body_qd.rows() != bodies ||
      state.body_f.rows() != bodies)
    return false;
  const Vec2i* const sleep = state.body_sleep.data();
  const auto is_marked = [](const Vec2i& of) { return of.x < 0; };
  if (std::none_of(sleep, sleep + state.body_sleep.rows(), is_marked)) return false;
  if (!bodies_.find(model, state)) return false;
  if (stamp_ != bodies_.stamp() || version_ != version || dt_ != dt ||
      shapes.size() != is_still_.size())
    renew(model);
  stamp_ = bodies_.stamp();
  version_ = version;
  dt_ = dt;
  list(model, state, shapes);
  if (2 * queue_.size() <= is_still_.size()) return true;
  forget();
  return false;
}

void SleepingShapes::list(const Model& model, const SimState& state,
                          std::span<const RigidShape> shapes) {
  const int32_t* const body = model.shape_body.data();
  const Transformf* const q = state.body_q.data();
  moved_.clear();
  queue_.clear();
  is_active_.assign(is_still_.size(), 0);
  is_done_.assign(is_still_.size(), 0);
  for (size_t s = 0; s < is_still_.size(); ++s) {
    const int32_t b = body[s];
    const bool rests = !bodies_.stirs(b);
    const bool stays = rests && is_still_[s] != 0 &&
                       (b < 0 || std::memcmp(&shapes[s].owner, &q[b], sizeof(q[b])) == 0);
    if (!stays) {
      moved_.push_back(static_cast<int32_t>(s));
      is_indexed_[s] = 0;
    }
    is_still_[s] = rests ? 1 : 0;
    is_active_[s] = rests ? 0 : 1;
    if (!rests) queue_.push_back(static_cast<int32_t>(s));
  }
}

// Rebuilds the index if many shapes are missing in it.
void SleepingShapes::index(std::span<const RigidShape> shapes, const ShapePairRules& rules) {
  others_.clear();
  size_t rest = 0;
  for (size_t s = 0; s < shapes.size(); ++s) {
    if (is_indexed_[s] != 0) continue;
    others_.push_back(static_cast<int32_t>(s));
    rest += is_active_[s] == 0 ? 1 : 0;
  }
  if (rest > 64 + shapes.size() / 16) {
    std::vector<int32_t> members;
    others_.clear();
    for (size_t s = 0; s < shapes.size(); ++s) {
      is_indexed_[s] = is_active_[s] == 0 ? 1 : 0;
      (is_indexed_[s] != 0 ? members : others_).push_back(static_cast<int32_t>(s));
    }
    still_.build(members, shapes, rules.world);
  }
  loose_.build(others_, shapes, rules.world);
}

void SleepingShapes::add_pairs(const Model& model, std::span<const RigidShape> shapes,
                               const ShapePairRules& rules, int32_t shape) {
  const int32_t* const body = model.shape_body.data();
  const RigidShape& mine = shapes[static_cast<size_t>(shape)];
  const auto add = [&](int32_t other) {
    const auto at = static_cast<size_t>(other);
    if (other == shape || is_done_[at] != 0) return;
    const int32_t i = std::min(shape, other), j = std::max(shape, other);
    if (!may_touch(rules, i, j)) return;
    found_.push_back({i, j});
    if (!bodies_.is_asleep(body[at])) return;
    const RigidShape& theirs = shapes[at];
    const bool in_order = mine.type < theirs.type || (mine.type == theirs.type && shape < other);
    if (may_have_rows(in_order ? mine : theirs, in_order ? theirs : mine)) bodies_.wake(body[at]);
  };
  still_.visit_meeting(mine.box, rules.world[static_cast<size_t>(shape)], [&](int32_t other) {
    if (is_indexed_[static_cast<size_t>(other)] != 0) add(other);
  });
  loose_.visit_meeting(mine.box, rules.world[static_cast<size_t>(shape)], add);
  is_done_[static_cast<size_t>(shape)] = 1;
}

void SleepingShapes::wake() {
  woken_.clear();
  bodies_.wake_islands(woken_);
  for (const int32_t b : woken_)
    for (const int32_t shape : shapes_of_.items(b)) queue_.push_back(shape);
}

std::vector<Vec2i> SleepingShapes::pairs(const Model& model, std::span<const RigidShape> shapes,
                                         const ShapePairRules& rules) {
  index(shapes, rules);
  found_.clear();
  for (size_t next = 0; next < queue_.size();) {
    for (; next < queue_.size(); ++next) add_pairs(model, shapes, rules, queue_[next]);
    wake();
  }
  return found_;
}

}  // namespace novaphy::detail
