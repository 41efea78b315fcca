// What a search for overlaps of some shapes needs of a builder.
#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "builder_checks.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy {
namespace {

struct WorldBox {
  Vec3f centre, half;
};

WorldBox world_box(const Transformf& pose, const detail::ShapeBounds& of) {
  const Vec3f half = (of.upper - of.lower) * 0.5f;
  Vec3f reach{};
  for (const Vec3f& edge :
       {Vec3f{half.x, 0.0f, 0.0f}, Vec3f{0.0f, half.y, 0.0f}, Vec3f{0.0f, 0.0f, half.z}}) {
    const Vec3f e = math::rotate(pose.q, edge);
    reach = reach + Vec3f{std::abs(e.x), std::abs(e.y), std::abs(e.z)};
  }
  return {math::transform_point(pose, (of.lower + of.upper) * 0.5f), reach};
}

bool boxes_meet(const WorldBox& a, const WorldBox& b) {
  const Vec3f d = a.centre - b.centre, sum = a.half + b.half;
  return std::abs(d.x) <= sum.x && std::abs(d.y) <= sum.y && std::abs(d.z) <= sum.z;
}

}  // namespace

ModelBuilder ModelBuilder::shapes_whose_boxes_meet(std::vector<int32_t>& indices) const {
  std::vector<Shape> shapes;
  std::unordered_map<int32_t, int32_t> place;  // of an index
  for (const int32_t s : indices) {
    require(s >= 0 && s < shape_count(), ErrorKind::Index,
            "shapes_whose_boxes_meet: indices: expected 0 to ", shape_count() - 1, ", got ", s);
    place[s] = static_cast<int32_t>(shapes.size());
    shapes.push_back(shapes_[static_cast<size_t>(s)]);
  }
  std::set<std::pair<int32_t, int32_t>> filter_pairs;
  for (const auto& [i, j] : all_filter_pairs())
    if (const auto a = place.find(i), b = place.find(j); a != place.end() && b != place.end())
      filter_pairs.insert(std::minmax(a->second, b->second));

  std::vector<int32_t> body, flags, group, world;
  std::vector<WorldBox> boxes;
  for (const Shape& s : shapes) {
    body.push_back(s.body);
    flags.push_back(s.cfg.flags());
    group.push_back(s.cfg.collision_group);
    world.push_back(s.world);
    constexpr float kFar = 1.0e6f;  // m
    const Transformf pose =
        s.body < 0 ? s.xform : math::multiply(body_q[static_cast<size_t>(s.body)], s.xform);
    if (!s.cfg.has_shape_collision)
      boxes.push_back({});  // has no pairs
    else if (s.type == GeoType::PLANE)
      boxes.push_back({pose.p, {kFar, kFar, kFar}});
    else
      boxes.push_back(world_box(pose, s.mesh ? detail::mesh_bounds(s.mesh->vertices, s.scale)
                                             : detail::shape_bounds(s.type, s.scale)));
  }
  std::vector<char> near(shapes.size());
  for (const Vec2i& pair : make_shape_contact_pairs(body, flags, group, world, filter_pairs))
    if (const auto a = static_cast<size_t>(pair.x), b = static_cast<size_t>(pair.y);
        boxes_meet(boxes[a], boxes[b]))
      near[a] = near[b] = true;

  ModelBuilder alone(up_axis_);
  std::vector<int32_t> kept, now(shapes.size(), -1);
  std::unordered_map<int32_t, int32_t> body_of;
  for (size_t k = 0; k < shapes.size(); ++k) {
    if (!near[k]) continue;
    Shape& shape = shapes[k];
    shape.world = -1;
    shape.gap = 0.0f;
    if (shape.body >= 0) {
      const auto [at, is_new] = body_of.try_emplace(shape.body, alone.body_count());
      if (is_new)
        alone.add_body(
            {.xform = body_q[static_cast<size_t>(shape.body)],
             .mass = 1.0f,
             .inertia = Mat33f{{{1.0f, 0.0f, 0.0f}, {0.0f, 1.0f, 0.0f}, {0.0f, 0.0f, 1.0f}}},
             .lock_inertia = true});
      shape.body = at->second;
    }
    now[k] = alone.shape_count();
    kept.push_back(indices[k]);
    alone.shapes_.push_back(std::move(shape));
  }
  for (const auto& [i, j] : filter_pairs)
    if (const int32_t a = now[static_cast<size_t>(i)], b = now[static_cast<size_t>(j)];
        a >= 0 && b >= 0)
      alone.filter_pairs_.insert(std::minmax(a, b));
  indices = std::move(kept);
  return alone;
}

}  // namespace novaphy
