// The contact points of a pair of shapes: at most 8 points with a common normal.
//
// Frame: inside of collide.h the frame of shape A, else the world frame. `normal` is a unit vector
// from A to B. The position of a point lies midway between the two surfaces. `distance` (m) is
// signed along the normal, < 0 for an overlap. The surface points are
//   on A: position - normal (distance / 2),    on B: position + normal (distance / 2).
// `feature` identifies the touching features of A and B (contact_feature). The number is unique in
// a manifold and constant while the same features touch, so that contacts can be matched between
// steps. The function collide() sorts points by feature, so that the order of discovery has no
// effect. Points of planes keep the order of plane_pairs.h.
//
// Reduction (reduce_contacts) selects the deepest point, then the point farthest from the first.
// The third point gives the largest triangle. The fourth point gives the largest triangle on the
// other side of the longest edge. Each further point is the farthest from the selected points. If
// two points are equally good, the point with the smaller feature is selected.
#pragma once

#include "novaphy/math/types.h"

// Device compilers inline everything by default. If the large functions stay out of line, a kernel
// for all pairs compiles seven times faster.
#define NOVAPHY_OUT_OF_LINE __attribute__((noinline)) inline

namespace novaphy::geometry {

inline constexpr int32_t kManifoldCapacity = 8;
inline constexpr int32_t kCandidateCapacity = 40;  // points from clipping, and a nearest one

struct ContactPoint {
  Vec3f position{};      // m
  float distance{};      // m
  int32_t feature = -1;  // -1: no feature
};

template <int32_t Capacity>
struct ContactSet {
  Vec3f normal{};
  int32_t count = 0;
  ContactPoint points[Capacity];
};
using Manifold = ContactSet<kManifoldCapacity>;
using ContactCandidates = ContactSet<kCandidateCapacity>;

// Packs a feature into an integer: the face of A, the face of B (or an edge, or 0), and a code of
// the point, in 11, 11 and 7 bits.
inline constexpr int32_t kWitnessCode = 127;
inline int32_t contact_feature(int32_t face_a, int32_t face_b, int32_t code) {
  return ((face_a & 2047) << 18) | ((face_b & 2047) << 7) | code;
}

// Adds a point unless the set is full.
template <int32_t Capacity>
void add_contact(ContactSet<Capacity>& set, const Vec3f& position, float distance,
                 int32_t feature) {
  if (set.count < Capacity) set.points[set.count++] = {position, distance, feature};
}

template <int32_t Capacity>
void sort_contacts(ContactSet<Capacity>& set) {  // sorts by feature
  for (int32_t i = 1; i < set.count; ++i) {
    const ContactPoint point = set.points[i];
    int32_t j = i;
    for (; j > 0 && set.points[j - 1].feature > point.feature; --j)
      set.points[j] = set.points[j - 1];
    set.points[j] = point;
  }
}

// Returns the set with A and B exchanged. The frame stays the same.
template <int32_t Capacity>
ContactSet<Capacity> exchanged(ContactSet<Capacity> set) {
  set.normal = -set.normal;
  return set;
}
// Returns the set in an outer frame. `pose` is the pose of the set's current frame in the outer
// frame.
template <int32_t Capacity>
ContactSet<Capacity> in_frame(ContactSet<Capacity> set, const Transformf& pose) {
  set.normal = math::rotate(pose.q, set.normal);
  for (int32_t i = 0; i < set.count; ++i)
    set.points[i].position = math::transform_point(pose, set.points[i].position);
  return set;
}

// Selects up to `limit` (at most 8) points of a set by the rule at the head of the file.
// set.point(i) for i < set.size() are the points. If two points are equally good, the first is
// selected. set.open(i) returns whether a point may be selected, and set.take(i) selects the point.
// The selection ends when all open points are within `least` (m) of a selected point.
template <class Set>
void take_extremes(Set& set, const Vec3f& n, int32_t limit, float least) {
  Vec3f corner[kManifoldCapacity];
  int32_t count = 0;
  auto take_best = [&](auto score, bool bounded, float bound) {
    int32_t best = -1;
    float best_score = 0.0f;
    for (int32_t i = 0; i < set.size(); ++i) {
      if (!set.open(i)) continue;
      const float s = score(set.point(i));
      if (best >= 0 && !(s > best_score)) continue;
      best = i;
      best_score = s;
    }
    if (best < 0 || (bounded && !(best_score > bound))) return false;
    corner[count++] = set.point(best).position;
    set.take(best);
    return true;
  };
  auto square = [](const Vec3f& d) { return math::dot(d, d); };
  // Twice the signed area of the triangle of p and the first edge, signed about the normal n.
  auto area = [&](const Vec3f& p) {
    return math::dot(n, math::cross(corner[1] - corner[0], p - corner[0]));
  };
  using Point = ContactPoint;
  if (!take_best([](const Point& p) { return -p.distance; }, false, 0.0f)) return;
  if (count == limit || !take_best([&](const Point& p) { return square(p.position - corner[0]); },
                                   true, least * least))
    return;
  const float thin = least * math::length(corner[1] - corner[0]);
  if (count == limit ||
      !take_best([&](const Point& p) { return math::abs(area(p.position)); }, true, thin))
    return;
  const float side = area(corner[2]) > 0.0f ? -1.0f : 1.0f;
  if (count < limit) take_best([&](const Point& p) { return side * area(p.position); }, true, thin);
  while (count < limit && take_best(
                              [&](const Point& p) {
                                float nearest = -1.0f;
                                for (int32_t i = 0; i < count; ++i) {
                                  const float d = square(p.position - corner[i]);
                                  if (nearest < 0.0f || d < nearest) nearest = d;
                                }
                                return nearest;
                              },
                              true, least * least)) {
  }
}

// Returns at most `limit` (1 to Kept) of the points, sorted by feature.
template <int32_t Kept, int32_t Capacity>
__attribute__((noinline)) ContactSet<Kept> reduce_contacts(const ContactSet<Capacity>& found,
                                                           int32_t limit = Kept) {
  ContactSet<Capacity> set = found;  // parameters are not passed by value: docs/design/0023
  sort_contacts(set);
  struct Points {
    const ContactSet<Capacity>& set;
    bool chosen[Capacity];
    int32_t size() const { return set.count; }
    const ContactPoint& point(int32_t i) const { return set.points[i]; }
    bool open(int32_t i) const { return !chosen[i]; }
    void take(int32_t i) { chosen[i] = true; }
  } points{set, {}};
  const bool all = set.count <= limit;
  if (!all) take_extremes(points, set.normal, limit, 0.0f);
  ContactSet<Kept> kept;
  kept.normal = set.normal;
  for (int32_t i = 0; i < set.count; ++i)
    if (all || points.chosen[i]) kept.points[kept.count++] = set.points[i];
  return kept;
}

}  // namespace novaphy::geometry
