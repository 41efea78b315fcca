#include "rigid_pairs.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "novaphy/collision/geometry/mesh_mesh.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/model_builder.h"
#include "rigid_contact_kernels.h"

namespace novaphy::detail {
namespace {

// Returns the largest number of contacts of a pair of types a <= b. The result is 0 if the pair is
// not supported.
int32_t most_contacts(GeoType a, GeoType b, int32_t per_pair) {
  if (is_mesh_pair(a, b)) {
    const GeoType other = a == GeoType::MESH ? b : a;
    const bool is_known = shape_traits(other).is_convex || other == GeoType::MESH;
    return is_known ? geometry::kMeshContacts : 0;
  }
  if (a == GeoType::PLANE) return shape_traits(b).plane_contacts;
  if (!shape_traits(a).is_convex || !shape_traits(b).is_convex) return 0;
  return a == GeoType::SPHERE ? 1 : per_pair;
}

}  // namespace

RigidPairs::RigidPairs(std::shared_ptr<const Model> model, BroadPhase broad_phase,
                       int32_t contacts_per_pair, std::optional<std::vector<Vec2i>> explicit_pairs)
    : model_(std::move(model)),
      broad_phase_(broad_phase),
      contacts_per_pair_(contacts_per_pair),
      explicit_(std::move(explicit_pairs)) {}

std::array<const Array*, 7> RigidPairs::sources() const {
  const Model& m = *model_;
  return {&m.shape_body,
          &m.shape_type,
          lists_model_pairs() ? &m.shape_contact_pairs() : &no_pairs_,
          &m.shape_scale,
          &m.shape_flags,
          &m.shape_world,
          &m.shape_collision_group};
}
ShapePairRules RigidPairs::rules() const {
  return {body_, flags_, group_, world_, &model_->shape_collision_filter_pairs};
}

void RigidPairs::update() {
  if (versions_.match(sources())) return;
  versions_.reset();
  const Model& m = *model_;
  body_ = m.shape_body.to_host();
  for (size_t s = 0; s < body_.size(); ++s)
    require(body_[s] >= -1 && body_[s] < m.body_count(), ErrorKind::Index,
            "CollisionPipeline: model.shape_body[", s, "]: expected -1 to ", m.body_count() - 1,
            ", got ", body_[s]);
  type_ = m.shape_type.to_host();
  flags_ = m.shape_flags.to_host();
  group_ = m.shape_collision_group.to_host();
  world_ = m.shape_world.to_host();
  scale_ = m.shape_scale.to_host();
  tree_known_ = false;
  if (are_swept()) {
    most_rows_ = std::numeric_limits<int64_t>::max();
    if (!m.device().is_cpu()) check_all();
  } else {
    rows_ = {};
    most_rows_ =
        take(explicit_             ? *explicit_
             : lists_model_pairs() ? m.shape_contact_pairs().to_host()
                                   : make_shape_contact_pairs(body_, flags_, group_, world_,
                                                              m.shape_collision_filter_pairs));
  }
  versions_.set(sources());
}

// Exchanges the shapes of a pair if the order is wrong. Returns the largest number of its rows.
int32_t RigidPairs::orient(Vec2i& pair) const {
  const int32_t last = model_->shape_count() - 1;
  require(pair.x >= 0 && pair.y >= 0 && pair.x <= last && pair.y <= last, ErrorKind::Index,
          "CollisionPipeline: model.shape_contact_pairs: expected shapes from 0 to ", last,
          ", got (", pair.x, ", ", pair.y, ")");
  if (type_of(pair.x) > type_of(pair.y)) std::swap(pair.x, pair.y);
  const GeoType a = type_of(pair.x), b = type_of(pair.y);
  const int32_t most = most_contacts(a, b, contacts_per_pair_);
  require(most > 0, ErrorKind::NotImplemented, "CollisionPipeline: shapes ", pair.x, " (",
          geo_type_name(a), ") and ", pair.y, " (", geo_type_name(b),
          ") may meet, and contacts of this pair of types are not supported; ",
          explicit_ ? "leave it out of shape_pairs_filtered"
                    : "ModelBuilder.add_shape_collision_filter_pair or collision groups part them");
  const Vec3f& size = scale_[static_cast<size_t>(pair.x)];
  require(a != GeoType::PLANE || !(size.x > 0.0f && size.y > 0.0f), ErrorKind::NotImplemented,
          "CollisionPipeline: shape ", pair.x,
          ": expected an infinite plane (width and length 0) for contacts with shapes, got one of ",
          size.x, " by ", size.y);
  return most;
}

// Takes pairs (i < j) as the candidates. Returns the largest number of their rows.
int64_t RigidPairs::take(std::vector<Vec2i> found) {
  int64_t rows = 0;
  for (Vec2i& pair : found) rows += orient(pair);
  const auto before = [](const Vec2i& a, const Vec2i& b) {
    return a.x != b.x ? a.x < b.x : a.y < b.y;
  };
  if (!std::is_sorted(found.begin(), found.end(), before))
    std::sort(found.begin(), found.end(), before);
  make_room(found.size());
  count_ = static_cast<int64_t>(found.size());
  found_ = nullptr;
  take_mesh_rows(found);
  if (runs_at_once(model_->device())) {
    std::copy(found.begin(), found.end(), rows_.mutable_data());
  } else {
    found.resize(rows_.rows());
    rows_.copy_from_host(std::span<const Vec2i>(found));
  }
  return rows;
}
void RigidPairs::take_mesh_rows(std::span<const Vec2i> found) {
  std::vector<int32_t> rows;
  for (size_t k = 0; k < found.size(); ++k)
    if (is_mesh_pair(type_of(found[k].x), type_of(found[k].y)))
      rows.push_back(static_cast<int32_t>(k));
  mesh_count_ = static_cast<int64_t>(rows.size());
  if (rows.size() > mesh_rows_.rows())
    mesh_rows_ = DeviceArray<int32_t>(rows.size(), model_->device());
  rows.resize(mesh_rows_.rows());
  mesh_rows_.copy_from_host(std::span<const int32_t>(rows));
}
void RigidPairs::make_room(size_t count) {
  if (count > rows_.rows() || rows_.rows() == 0)
    rows_ = DeviceArray<Vec2i>(count, model_->device());
}

// Checks all pairs in advance, because kernels cannot throw.
void RigidPairs::check_all() const {
  const ShapePairRules rule = rules();
  const auto count = static_cast<int32_t>(type_.size());
  for (int32_t s = 0; s < count; ++s) {
    const GeoType type = type_of(s);
    if (shape_traits(type).is_convex) continue;
    for (int32_t other = 0; other < count; ++other) {
      if (other == s || !may_touch(rule, s, other)) continue;
      Vec2i pair{std::min(s, other), std::max(s, other)};
      orient(pair);
      require(type != GeoType::MESH, ErrorKind::NotImplemented, "CollisionPipeline: shapes ",
              pair.x, " and ", pair.y,
              " may meet: the broad phase \"sap\" finds pairs of meshes on the cpu only, and not "
              "where it is recorded; use \"explicit\" or \"nxn\"");
    }
  }
}

void RigidPairs::sweep(std::span<const RigidShape> shapes) {
  boxes_.resize(shapes.size());
  for (size_t s = 0; s < boxes_.size(); ++s) boxes_[s] = shapes[s].box;
  take(host_sweep_.box_pairs(boxes_, rules()));
}

// Finds as many pairs as fit into the list. Outside of a recording the list has room for all pairs.
void RigidPairs::find_by_kernels(const Array& shapes) {
  if (!tree_known_) {
    const UntrackedScope untracked;  // a capture does not record the model
    check_all();
    tree_.update(*model_, world_);
    tree_known_ = true;
  }
  const auto shape_count = static_cast<int64_t>(type_.size());
  constexpr int64_t kFew = 1024, kPerShape = 16;
  make_room(static_cast<size_t>(std::max<int64_t>(
      1, std::min(shape_count * (shape_count - 1) / 2, std::max(kFew, kPerShape * shape_count)))));
  tree_.count(*model_, shapes);
  tree_.write(*model_, shapes, rows_);
  if (launch_recorder() == nullptr) {
    const auto found = static_cast<size_t>(tree_.found().to_host()[0]);
    if (found > rows_.rows()) {
      make_room(found + found / 4);
      tree_.write(*model_, shapes, rows_);
    }
  }
  count_ = static_cast<int64_t>(rows_.rows());
  found_ = &tree_.found();
  mesh_count_ = 0;
}

}  // namespace novaphy::detail
