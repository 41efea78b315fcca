#include "novaphy/collision/overlaps.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <set>
#include <utility>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/contact_count.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace {

constexpr float kLeast = 1e-2f;    // of the smaller collision radius
constexpr float kMoved = 1e-3f;    // m, smallest displacement that counts as moved
constexpr float kAlike = 0.9999f;  // smallest dot product of equal rotations, 0.03 rad
constexpr size_t kNamed = 5;       // pairs listed in a message

using Pair = std::pair<int32_t, int32_t>;

// Returns for each body a representative body of its mechanism. All bodies that joints connect have
// the same representative.
std::vector<int32_t> mechanisms(const Model& m) {
  std::vector<int32_t> up(static_cast<size_t>(m.body_count()));
  std::iota(up.begin(), up.end(), 0);
  const auto root = [&](int32_t b) {
    while (up[static_cast<size_t>(b)] != b) b = up[static_cast<size_t>(b)];
    return b;
  };
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    const int32_t parent = m.joint_parent.data()[j], child = m.joint_child.data()[j];
    if (parent < 0 || child < 0) continue;
    const int32_t a = root(parent), b = root(child);
    up[static_cast<size_t>(std::max(a, b))] = std::min(a, b);
  }
  for (int32_t b = 0; b < m.body_count(); ++b) up[static_cast<size_t>(b)] = root(b);
  return up;
}

// Returns whether two bodies have the same relative pose as in Model::body_q.
bool at_start(const Model& m, const Transformf* q, int32_t a, int32_t b) {
  const Transformf* const first = m.body_q.data();
  const Transformf now = math::multiply(math::inverse(q[a]), q[b]);
  const Transformf then = math::multiply(math::inverse(first[a]), first[b]);
  const float turned =
      now.q.x * then.q.x + now.q.y * then.q.y + now.q.z * then.q.z + now.q.w * then.q.w;
  return math::length(now.p - then.p) < kMoved && math::abs(turned) > kAlike;
}

}  // namespace

std::vector<ShapeOverlap> find_overlaps(const Model& m, const SimState& state, const Contacts& c) {
  std::map<Pair, float> deepest;
  const int32_t rows = filled_rows(*c.rigid_contact_count.data(), c.rigid_contact_max(),
                                   c.rigid_contact_shape0.data());
  const int32_t* const body = m.shape_body.data();
  const float* const radius = m.shape_collision_radius.data();
  const Transformf* const q = state.body_q.data();
  for (int32_t k = 0; m.joint_count() > 0 && k < rows; ++k) {
    const int32_t a = c.rigid_contact_shape0.data()[k], b = c.rigid_contact_shape1.data()[k];
    if (body[a] < 0 || body[b] < 0) continue;
    const Vec3f apart = math::transform_point(q[body[b]], c.rigid_contact_point1.data()[k]) -
                        math::transform_point(q[body[a]], c.rigid_contact_point0.data()[k]);
    const float depth = c.rigid_contact_margin0.data()[k] + c.rigid_contact_margin1.data()[k] -
                        math::dot(apart, c.rigid_contact_normal.data()[k]);
    if (!(depth > kLeast * std::min(radius[a], radius[b]))) continue;
    float& most = deepest[std::minmax(a, b)];
    most = std::max(most, depth);
  }
  std::vector<ShapeOverlap> overlaps;
  if (deepest.empty()) return overlaps;
  const std::vector<int32_t> mechanism = mechanisms(m);
  for (const auto& [pair, depth] : deepest) {
    const int32_t a = body[pair.first], b = body[pair.second];
    if (mechanism[static_cast<size_t>(a)] == mechanism[static_cast<size_t>(b)] &&
        at_start(m, q, a, b))
      overlaps.push_back({pair.first, pair.second, depth});
  }
  std::stable_sort(overlaps.begin(), overlaps.end(),
                   [](const ShapeOverlap& a, const ShapeOverlap& b) { return a.depth > b.depth; });
  return overlaps;
}

std::vector<ShapeOverlap> find_overlaps(std::shared_ptr<const Model> model) {
  CollisionPipeline pipeline(model, {.warns_of_overlaps = false});
  Contacts contacts = pipeline.contacts();
  const SimState state = model->state(false);
  pipeline.collide(state, contacts);
  return find_overlaps(*model, state, contacts);
}

std::string overlap_text(const Model& model, std::span<const ShapeOverlap> overlaps) {
  std::string named;
  std::set<std::pair<std::string, std::string>> seen;
  const auto add = [&](const auto&... parts) { (named.append(MessagePart(parts).text()), ...); };
  for (const ShapeOverlap& o : overlaps) {
    const std::string& a = model.shape_label[static_cast<size_t>(o.shape0)];
    const std::string& b = model.shape_label[static_cast<size_t>(o.shape1)];
    if (!seen.emplace(a, b).second || seen.size() > kNamed) continue;
    add(seen.size() == 1 ? "\"" : ", \"", a, "\" and \"", b, "\" by ", o.depth, " m");
  }
  const size_t pairs = seen.size();
  if (pairs > kNamed) add(", and ", pairs - kNamed, pairs == kNamed + 1 ? " other" : " others");
  return std::to_string(pairs) +
         (pairs == 1 ? " pair of shapes overlaps" : " pairs of shapes overlap") +
         " at the start: " + named;
}

}  // namespace novaphy
