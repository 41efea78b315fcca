// The groups of a model's particles and the slots of their elements (elements/list.h), as
// tables.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/vbd/elements/list.h"

namespace novaphy::vbd {

class ColorSlots {
 public:
  struct Source {  // the element of a slot's lane, and which of its corners the particle is
    int32_t element = -1, corner = 0;
  };
  struct Table {
    std::vector<Source> of_particles;  // of each particle in the order of the elements
    std::vector<int64_t> particle_begin;
    std::vector<int64_t> begin;
    std::vector<Source> sources;
    std::vector<int64_t> places;  // of each corner of each element among the sources; -1: none
    std::vector<int32_t> ints;
    mutable std::vector<float> floats;
    bool damped = false;
  };

  // Groups of `lanes` particles, and the elements that act. Kinematic particles have none.
  // Errors as SolverVBD's constructor.
  void build(const Model& model, int lanes);
  // The numbers of the slots, without activation.
  void set_constants(const Model& model, float dt);

  const std::vector<int32_t>& held() const { return held_; }
  const std::vector<int32_t>& held_flags() const { return is_held_; }  // of each particle
  bool is_held(int32_t particle) const { return is_held_[static_cast<size_t>(particle)] != 0; }
  // The groups of color c are [color_begin()[c], color_begin()[c + 1]).
  const std::vector<int64_t>& color_begin() const { return color_begin_; }
  // Two particles of an element have the same color.
  bool has_conflicts() const { return has_conflicts_; }
  int lanes() const { return lanes_; }
  const Table& table(int role) const { return tables_[role]; }
  // Where the floats of each role begin among those of all roles, and their number.
  const std::vector<int64_t>& numbers_begin() const { return numbers_begin_; }
  // Where the first number of a source of a role is among the floats.
  size_t place_of(int role, size_t source) const {
    const auto lanes = static_cast<size_t>(lanes_);
    return source / lanes * lanes * static_cast<size_t>(kFloats[role]) + source % lanes;
  }
  // Of each lane of each group: see VbdSweepArguments. The last as set_constants made them.
  const std::vector<int32_t>& particles() const { return particle_; }
  const std::vector<int32_t>& filled() const { return filled_; }
  const std::vector<float>& masses_by_h2() const { return mass_by_h2_; }

 private:
  void find_held(const Model& model);
  void collect(const Model& model);
  void find_conflicts(const std::vector<int32_t>& colors, const Model& model);
  void make_groups(const std::vector<int32_t>& colors);
  template <class Slot>
  void lay_slots(Table& table, const int32_t* corners, size_t elements);

  int lanes_ = 1;
  std::vector<int32_t> is_held_;
  std::vector<int32_t> held_;
  std::vector<int64_t> color_begin_, numbers_begin_;
  std::vector<int32_t> particle_, filled_;
  std::vector<float> mass_by_h2_;
  Table tables_[kRoles];
  bool has_conflicts_ = false;
};

// By the world whose gravity they feel.
IndexRows particles_of_worlds(const Model& model);

}  // namespace novaphy::vbd
