// Internal: an index of boxes that do not move. A query finds the boxes that overlap a given box.
// Shapes are sorted along an axis within their world. Boxes that are much longer than the others,
// for example a ground, are kept in a separate list that every query tests.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/collision/geometry/rigid_shape.h"

namespace novaphy::detail {

class BoxIndex {
 public:
  // `world`: world of every shape of the model; -1: all worlds. A box with a NaN overlaps no box.
  void build(std::span<const int32_t> members, std::span<const RigidShape> shapes,
             std::span<const int32_t> world);
  size_t size() const { return entries_.size() + apart_.size(); }
  // Calls visit(shape) for the members of compatible worlds whose box overlaps `box`.
  template <class Visit>
  void visit_meeting(const geometry::Box3& box, int32_t world, const Visit& visit) const {
    for (const Entry& one : apart_)
      if (geometry::boxes_meet(one.box, box)) visit(one.shape);
    for (const Segment& segment : segments_)
      if (world < 0 || segment.world < 0 || segment.world == world)
        visit_segment(segment, box, visit);
  }

 private:
  struct Entry {
    float begin;  // lower end along the axis
    int32_t shape;
    geometry::Box3 box;
  };
  struct Segment {  // range of entries of one world
    int32_t world;
    size_t begin, end;
  };
  size_t first_behind(const Segment& segment, float begin) const;
  template <class Visit>
  void visit_segment(const Segment& segment, const geometry::Box3& box, const Visit& visit) const {
    const float lo = along(box.lo), hi = along(box.hi);
    for (size_t k = first_behind(segment, lo - longest_); k < segment.end; ++k) {
      const Entry& one = entries_[k];
      if (one.begin > hi) return;
      if (geometry::boxes_meet(one.box, box)) visit(one.shape);
    }
  }
  float along(const Vec3f& v) const { return axis_ == 0 ? v.x : axis_ == 1 ? v.y : v.z; }

  int axis_ = 0;
  float longest_ = 0.0f;  // m, length of the longest entry along the axis, plus rounding
  std::vector<Entry> entries_, apart_;
  std::vector<Segment> segments_;
};

}  // namespace novaphy::detail
