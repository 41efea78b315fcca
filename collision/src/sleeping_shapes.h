// Internal: the broad phase for sleeping bodies (core/sim/sleep.h), on the CPU. Only shapes that
// move, or whose body wakes, search for partners. A search costs time for the moving shapes, and
// one check for each body.
//   begin()   finds the shapes that move, and other shapes whose world pose is outdated
//   pairs()   finds the pairs of moving shapes. If a sleeping body may have a row with a moving
//             shape, the body wakes with its island. Its shapes then search for partners, too.
//
// The solver step tests the rows that were found again, and wakes the same bodies or fewer.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "box_index.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/shape_pair_rules.h"
#include "novaphy/core/sim/sleep.h"

namespace novaphy::detail {

class SleepingShapes {
 public:
  // Returns false if no body sleeps, or if so few bodies sleep that a full search is faster. The
  // caller then moves all shapes. `version`: version of the geometries.
  bool begin(const Model& model, const SimState& state, std::span<const RigidShape> shapes,
             float dt, uint64_t version);
  // Returns the shapes that have moved since the last search, in ascending order.
  std::span<const int32_t> moved() const { return moved_; }
  // Returns pairs (i < j). Requires that the caller has moved the shapes of moved().
  std::vector<Vec2i> pairs(const Model& model, std::span<const RigidShape> shapes,
                           const ShapePairRules& rules);
  // Tells the object that the caller has moved all shapes.
  void forget() { stamp_ = 0; }

 private:
  void renew(const Model& model);
  void list(const Model& model, const SimState& state, std::span<const RigidShape> shapes);
  void index(std::span<const RigidShape> shapes, const ShapePairRules& rules);
  void add_pairs(const Model& model, std::span<const RigidShape> shapes,
                 const ShapePairRules& rules, int32_t shape);
  void wake();

  SleepingBodies bodies_;
  uint64_t stamp_ = 0, version_ = 0;  // versions of the cached data
  float dt_ = 0.0f;
  IndexRows shapes_of_;             // shapes of each body
  std::vector<uint8_t> is_still_;   // for each shape: at rest, with the same pose
  std::vector<uint8_t> is_active_;  // for each shape: searches for partners
  std::vector<uint8_t> is_indexed_, is_done_;
  std::vector<int32_t> moved_, queue_, others_, woken_;
  BoxIndex still_, loose_;  // shapes of the index, and all other shapes
  std::vector<Vec2i> found_;
};

}  // namespace novaphy::detail
