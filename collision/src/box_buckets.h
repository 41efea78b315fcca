// A hashed grid of boxes, for many small boxes of about the same size.
//
// Each box lies in the cell of its lower corner. A cell is as large as the largest box, so a box
// meets only boxes of its own cell and of neighboring cells. Each world has cells of its own,
// unless a box belongs to all worlds.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy::detail {

class BoxBuckets {
 public:
  // Makes the grid. `boxes` must stay valid until the next call. `asked` has the boxes that visit()
  // gets later. `worlds` has the world of each box; -1 means all worlds.
  void build(std::span<const geometry::Box3> boxes, std::span<const geometry::Box3> asked,
             std::span<const int32_t> worlds) {
    boxes_ = boxes;
    worlds_ = worlds;
    size_ = 1e-6;
    for (const auto& all : {boxes, asked})
      for (const geometry::Box3& b : all)
        size_ =
            std::max({size_, static_cast<double>(b.hi.x - b.lo.x),
                      static_cast<double>(b.hi.y - b.lo.y), static_cast<double>(b.hi.z - b.lo.z)});
    by_world_ = std::all_of(worlds.begin(), worlds.end(), [](int32_t w) { return w >= 0; });
    size_t buckets = 16;
    while (buckets < 2 * boxes.size()) buckets *= 2;
    mask_ = buckets - 1;
    cells_.resize(boxes.size());
    begin_.assign(buckets + 1, 0);
    for (size_t k = 0; k < boxes.size(); ++k) {
      cells_[k] = cell_of(boxes[k].lo, worlds[k]);
      ++begin_[bucket_of(cells_[k]) + 1];
    }
    for (size_t b = 1; b <= buckets; ++b) begin_[b] += begin_[b - 1];
    items_.resize(boxes.size());
    for (size_t k = 0; k < boxes.size(); ++k)
      items_[static_cast<size_t>(begin_[bucket_of(cells_[k])]++)] = static_cast<int32_t>(k);
    for (size_t b = buckets; b > 0; --b) begin_[b] = begin_[b - 1];
    begin_[0] = 0;
  }

  // Calls body(index) for each box of the same world that meets `box`, in no particular order.
  template <class Body>
  void visit(const geometry::Box3& box, int32_t world, const Body& body) const {
    const auto back = static_cast<float>(size_);
    const Cell first = cell_of(box.lo - Vec3f{back, back, back} * 1.00001f, world);
    const Cell last = cell_of(box.hi, world);
    for (int64_t x = first.x; x <= last.x; ++x)
      for (int64_t y = first.y; y <= last.y; ++y)
        for (int64_t z = first.z; z <= last.z; ++z)
          visit_cell({x, y, z, last.world}, box, world, body);
  }

 private:
  struct Cell {
    int64_t x, y, z;
    int32_t world;
    bool operator==(const Cell&) const = default;
  };
  Cell cell_of(const Vec3f& v, int32_t world) const {
    const auto index = [this](float c) {
      return static_cast<int64_t>(
          std::clamp(std::floor(static_cast<double>(c) / size_), -1e9, 1e9));
    };
    return {index(v.x), index(v.y), index(v.z), by_world_ ? world : 0};
  }
  size_t bucket_of(const Cell& c) const {
    const auto part = [](int64_t v, uint64_t by) { return static_cast<uint64_t>(v) * by; };
    const uint64_t key = part(c.x, 0x9E3779B97F4A7C15u) ^ part(c.y, 0xC2B2AE3D27D4EB4Fu) ^
                         part(c.z, 0x165667B19E3779F9u) ^ part(c.world, 0x27D4EB2F165667C5u);
    return static_cast<size_t>(key >> 29) & mask_;
  }
  template <class Body>
  void visit_cell(const Cell& cell, const geometry::Box3& box, int32_t world,
                  const Body& body) const {
    const size_t bucket = bucket_of(cell);
    for (int32_t i = begin_[bucket]; i < begin_[bucket + 1]; ++i) {
      const int32_t k = items_[static_cast<size_t>(i)], other = worlds_[static_cast<size_t>(k)];
      if (!(cells_[static_cast<size_t>(k)] == cell)) continue;
      if (world >= 0 && other >= 0 && other != world) continue;
      if (geometry::boxes_meet(box, boxes_[static_cast<size_t>(k)])) body(k);
    }
  }

  std::span<const geometry::Box3> boxes_;
  std::span<const int32_t> worlds_;
  double size_ = 1.0;
  bool by_world_ = false;
  size_t mask_ = 0;
  std::vector<Cell> cells_;
  std::vector<int32_t> begin_, items_;
};

}  // namespace novaphy::detail
