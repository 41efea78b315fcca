#include "overlaps.h"

#include <algorithm>
#include <limits>
#include <map>
#include <memory>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/storage.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace {

constexpr float kLeast = 1e-3f;  // of the smaller collision radius
constexpr size_t kNamed = 3;     // pairs of a message

// Whether forces move each body: joints of type FIXED hold what hangs on the world.
std::vector<char> moving_bodies(const Model& m) {
  const std::vector<int32_t> flags = m.body_flags.to_host(), type = m.joint_type.to_host(),
                             parent = m.joint_parent.to_host(), child = m.joint_child.to_host();
  const std::vector<uint8_t> enabled = m.joint_enabled.to_host();
  std::vector<char> moves(flags.size());
  for (size_t b = 0; b < flags.size(); ++b) moves[b] = !has_flag(flags[b], BodyFlags::KINEMATIC);
  for (bool again = true; again;) {  // in any order of the joints
    again = false;
    for (size_t j = 0; j < type.size(); ++j) {
      const auto below = static_cast<size_t>(child[j]);
      if (type[j] != static_cast<int32_t>(JointType::FIXED) || enabled[j] == 0 || !moves[below] ||
          (parent[j] >= 0 && moves[static_cast<size_t>(parent[j])]))
        continue;
      moves[below] = false;
      again = true;
    }
  }
  return moves;
}

struct NothingRecorded {
  const Unobserved unobserved{};
  LaunchRecorder* const before = set_launch_recorder(nullptr);
  NothingRecorded() = default;
  NothingRecorded(const NothingRecorded&) = delete;
  NothingRecorded& operator=(const NothingRecorded&) = delete;
  ~NothingRecorded() { set_launch_recorder(before); }
};

}  // namespace

std::vector<ShapeOverlap> detail::overlaps_of(const Model& m, RigidContacts& search) {
  if (m.body_count() == 0) return {};
  const NothingRecorded nothing;
  const SimState state = m.state(false);
  Contacts found({.rigid_contact_max = rigid_rows(m, search.most_rows()), .model_id = m.id()},
                 m.device());
  search.collide(state, found, 0.0f);
  const auto rows = static_cast<size_t>(
      std::min(found.rigid_contact_count.to_host()[0], found.rigid_contact_max()));
  if (rows == 0) return {};
  const std::vector<int32_t> shape0 = found.rigid_contact_shape0.to_host(),
                             shape1 = found.rigid_contact_shape1.to_host(),
                             body = m.shape_body.to_host();
  const std::vector<Vec3f> point0 = found.rigid_contact_point0.to_host(),
                           point1 = found.rigid_contact_point1.to_host(),
                           normal = found.rigid_contact_normal.to_host();
  const std::vector<float> margin0 = found.rigid_contact_margin0.to_host(),
                           margin1 = found.rigid_contact_margin1.to_host(),
                           radius = m.shape_collision_radius.to_host();
  const std::vector<Transformf> q = state.body_q.to_host();
  const std::vector<char> moves = moving_bodies(m);
  std::map<std::pair<int32_t, int32_t>, float> deepest;
  for (size_t k = 0; k < rows; ++k) {
    const auto a = static_cast<size_t>(shape0[k]), b = static_cast<size_t>(shape1[k]);
    const auto can_move = [&](size_t s) { return moves[static_cast<size_t>(body[s])] != 0; };
    const auto in_world = [&](size_t s, const Vec3f& p) {
      return math::transform_point(q[static_cast<size_t>(body[s])], p);
    };
    if (body[a] < 0 || body[b] < 0 || (!can_move(a) && !can_move(b))) continue;
    const float depth = margin0[k] + margin1[k] -
                        math::dot(in_world(b, point1[k]) - in_world(a, point0[k]), normal[k]);
    if (!(depth > kLeast * std::min(radius[a], radius[b]))) continue;
    float& most = deepest[std::minmax(shape0[k], shape1[k])];
    most = std::max(most, depth);
  }
  std::vector<ShapeOverlap> overlaps;
  const auto label = [&](int32_t shape) { return m.shape_label[static_cast<size_t>(shape)]; };
  for (const auto& [pair, depth] : deepest)
    overlaps.push_back({pair.first, pair.second, depth, label(pair.first), label(pair.second)});
  std::stable_sort(overlaps.begin(), overlaps.end(),
                   [](const ShapeOverlap& a, const ShapeOverlap& b) { return a.depth > b.depth; });
  return overlaps;
}

std::vector<ShapeOverlap> find_overlaps(const ModelBuilder& builder, std::vector<int32_t> shapes) {
  const ModelBuilder alone = builder.shapes_whose_boxes_meet(shapes);
  if (shapes.empty()) return {};
  const std::shared_ptr<const Model> model = alone.finalize(Device::cpu());
  detail::RigidContacts search(model, std::make_shared<detail::ShapeGeometries>(model),
                               BroadPhase::Explicit, NarrowPhase::Auto, 8, {});
  std::vector<ShapeOverlap> overlaps = detail::overlaps_of(*model, search);
  for (ShapeOverlap& o : overlaps) {
    const auto of = [&](int32_t k) { return shapes[static_cast<size_t>(k)]; };
    o.shape0 = of(o.shape0);
    o.shape1 = of(o.shape1);
  }
  return overlaps;
}

std::string overlap_text(std::span<const ShapeOverlap> overlaps) {
  std::string text =
      std::to_string(overlaps.size()) +
      (overlaps.size() == 1 ? " pair of shapes overlaps" : " pairs of shapes overlap") +
      " at the start: ";
  const auto add = [&](const auto&... parts) { (text.append(MessagePart(parts).text()), ...); };
  for (size_t k = 0; k < std::min(overlaps.size(), kNamed); ++k)
    add(k == 0 ? "\"" : ", \"", overlaps[k].label0, "\" and \"", overlaps[k].label1, "\" by ",
        overlaps[k].depth, " m");
  if (overlaps.size() > kNamed) add(" and others");
  return text;
}

}  // namespace novaphy
