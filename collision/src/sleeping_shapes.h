// Internal: the pairs of a search where bodies sleep (core/sim/sleep.h), on the CPU. Only shapes
// that move, or whose body wakes, look for partners. So a search takes the time of what moves, and
// a look at each body.
//
//   begin()   which shapes move, and which of the others are to be moved to the world again
//   pairs()   of those that move. A sleeping body that may have a row with one of them wakes with
//             its island, and looks for its own partners.
//
// A step asks again, with the rows that were found, and wakes the same bodies or fewer.
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
  // False: none sleeps, or so few that a search over all shapes takes less time; then the shapes
  // are to be moved by others. `version`: of the geometries.
  bool begin(const Model& model, const SimState& state, std::span<const RigidShape> shapes,
             float dt, uint64_t version);
  // Shapes that are not where the last search left them, ascending.
  std::span<const int32_t> moved() const { return moved_; }
  // (i < j), behind the move of these.
  std::vector<Vec2i> pairs(const Model& model, std::span<const RigidShape> shapes,
                           const ShapePairRules& rules);
  // Others have moved the shapes.
  void forget() { stamp_ = 0; }

 private:
  void renew(const Model& model);
  void list(const Model& model, const SimState& state, std::span<const RigidShape> shapes);
  void index(std::span<const RigidShape> shapes, const ShapePairRules& rules);
  void add_pairs(const Model& model, std::span<const RigidShape> shapes,
                 const ShapePairRules& rules, int32_t shape);
  void wake();

  SleepingBodies bodies_;
  uint64_t stamp_ = 0, version_ = 0;  // of what is known
  float dt_ = 0.0f;
  IndexRows shapes_of_;             // each body
  std::vector<uint8_t> is_still_;   // of each shape: it is where it was, at rest
  std::vector<uint8_t> is_active_;  // it looks for partners
  std::vector<uint8_t> is_indexed_, is_done_;
  std::vector<int32_t> moved_, queue_, others_, woken_;
  BoxIndex still_, loose_;  // shapes of the index, and all others
  std::vector<Vec2i> found_;
};

}  // namespace novaphy::detail
