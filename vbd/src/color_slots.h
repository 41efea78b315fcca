// The groups of a model's particles and the slots of their elements (elements/list.h), as tables on
// the host.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/vbd/elements/list.h"

namespace novaphy::vbd {

class ColorSlots {
 public:
  struct Source {  // the element of one lane of a slot, and the own corner
    int32_t element = -1, corner = 0;
  };
  struct Table {
    std::vector<Source> of_particles;  // the elements of all particles, particle by particle
    std::vector<int64_t> particle_begin;
    std::vector<int64_t> begin;
    std::vector<Source> sources;
    std::vector<int64_t> places;  // index in `sources` of each corner of each element; -1: none
    std::vector<int32_t> ints;
    mutable std::vector<float> floats;
    bool damped = false;
  };

  // Makes groups of `lanes` particles, and slots for the elements with a coefficient other than 0.
  // Kinematic particles have no slots. Errors: as for the constructor of SolverVBD.
  void build(const Model& model, int lanes);
  // Computes the numbers of the slots for the step size dt (s) and for zero activation.
  void set_constants(const Model& model, float dt);

  const std::vector<int32_t>& kinematic() const { return kinematic_; }
  const std::vector<int32_t>& kinematic_flags() const { return is_kinematic_; }  // 1: kinematic
  bool is_kinematic(int32_t particle) const {
    return is_kinematic_[static_cast<size_t>(particle)] != 0;
  }
  // Returns the connected component of each particle, or -1 for a kinematic particle. Components
  // are numbered in the order of their first particles.
  const std::vector<int32_t>& components() const { return component_; }
  int32_t component_count() const { return static_cast<int32_t>(is_free_.size()); }
  // Whether no element connects component c to a kinematic particle.
  bool is_free(int32_t c) const { return is_free_[static_cast<size_t>(c)] != 0; }
  // The groups of color c are [color_begin()[c], color_begin()[c + 1]).
  const std::vector<int64_t>& color_begin() const { return color_begin_; }
  // Returns whether an element has two moving particles of the same color.
  bool has_conflicts() const { return has_conflicts_; }
  int lanes() const { return lanes_; }
  const Table& table(int role) const { return tables_[role]; }
  // Returns the index of the first number of each role in the concatenated numbers of all roles.
  // The last entry is the count of all numbers.
  const std::vector<int64_t>& floats_begin() const { return floats_begin_; }
  // Returns the index of the first number of a source in the numbers of its role. `source` is an
  // index in Table::sources.
  size_t offset_of(int role, size_t source) const {
    const auto lanes = static_cast<size_t>(lanes_);
    return source / lanes * lanes * static_cast<size_t>(kFloats[role]) + source % lanes;
  }
  // Values of each lane of each group: see VbdSweepArguments. set_constants computes the masses.
  const std::vector<int32_t>& particles() const { return particle_; }
  const std::vector<int32_t>& filled() const { return filled_; }
  const std::vector<float>& masses_by_h2() const { return mass_by_h2_; }

 private:
  void find_kinematic(const Model& model);
  void find_components(const Model& model);
  void collect(const Model& model);
  void find_conflicts(const std::vector<int32_t>& colors, const Model& model);
  void make_groups(const std::vector<int32_t>& colors);
  template <class Slot>
  void lay_slots(Table& table, const int32_t* corners, size_t elements);

  int lanes_ = 1;
  std::vector<int32_t> is_kinematic_;
  std::vector<int32_t> kinematic_, component_;
  std::vector<char> is_free_;  // of components
  std::vector<int64_t> color_begin_, floats_begin_;
  std::vector<int32_t> particle_, filled_;
  std::vector<float> mass_by_h2_;
  Table tables_[kRoles];
  bool has_conflicts_ = false;
};

// Returns the particles of each world. Particles of all worlds (world -1) are listed with the last
// world, whose gravity they feel.
IndexRows particles_of_worlds(const Model& model);

}  // namespace novaphy::vbd
