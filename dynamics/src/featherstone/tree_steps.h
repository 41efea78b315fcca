// TreeSteps: steps of the articulations that touch only the world, on the CPU. Identical trees (as
// `replicate` makes them) step several at once, one tree per SIMD lane (lane_step.h). The result of
// a tree has the same bits with and without lanes, and for any number of threads.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "articulation_kernels.h"
#include "lane_step.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/dynamics/articulation/islands.h"
#include "novaphy/dynamics/featherstone/articulations.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {

using articulation::kMostTreeContacts;  // contacts of a tree that TreeSteps takes
// The contacts of trees with the world, as TreeSteps reads them.
class TreeContacts {
 public:
  virtual int32_t count(int64_t tree) const = 0;
  // Writes contact i of a tree as the numbers of a TreeContact, with a spacing of `stride`. Returns
  // the contact's link.
  virtual int32_t fill(int64_t tree, int32_t i, float* numbers, int32_t stride) = 0;
  // Receives the impulses of contact i along n, t1, t2, with a spacing of `stride`.
  virtual void take(int64_t tree, int32_t i, const float* impulses, int32_t stride) = 0;
  virtual void solved(int64_t tree, const articulation::IslandResult& result) = 0;

 protected:
  ~TreeContacts() = default;
};

class TreeSteps {
 public:
  TreeSteps(const Model& model, const Articulations& articulations);

  // Steps the given trees, which are in ascending order. `status` gets a row for each. A tree that
  // fails keeps its rows of the new state. `contacts` null: no contacts. `keep`: also writes qdd
  // and branch.
  void step(const ArticulationStepArguments& step, const Model& model,
            std::span<const int32_t> trees, const FeatherstoneOptions& options,
            TreeContacts* contacts, bool keep = false);
  // Switches SIMD lanes on or off. Lanes read the constants of the model, so a step with other
  // constants needs use_lanes(false).
  void use_lanes(bool use) { uses_lanes_ = use; }
  // Runs the adjoint of a step without contacts for the given trees, with the result of
  // articulation_step_vjp.
  void vjp(const ArticulationStepVjpArguments& step, const Model& model,
           std::span<const int32_t> trees);

 private:
  struct alignas(64) Line {
    float numbers[16];
  };
  struct Group {  // identical trees
    articulation::TreeShape shape = {};
    std::vector<articulation::Link> links = {};
    std::vector<int32_t> target_mode = {};
    bool same = false;                 // all trees have the same constants
    std::vector<Line> lines = {};      // constants: {batches or 1, numbers, lanes}
    std::vector<int32_t> packed = {};  // trees of the batches, if constants differ
  };
  struct FirstRows {
    int32_t coord = 0, body = 0, joint = 0, group = -1;  // first rows of a tree; group -1: no lanes
  };
  struct Batch {
    int32_t group = 0, begin = 0, count = 0;  // begin, count: a range of sorted_
    int32_t contacts = 0;                     // largest number of contacts of a tree
  };
  struct Memory;

  void find_groups(const Model& model);
  void renew(const Model& model);
  int32_t most_in_batch(size_t trees, int32_t group) const;
  void make_packs(std::span<const int32_t> trees, const TreeContacts* contacts);
  void constants_of(const Model& model, int32_t tree, float* to, int32_t stride) const;
  void single(const ArticulationStepArguments& step, int64_t tree,
              const FeatherstoneOptions& options, TreeContacts* contacts, bool keep,
              Memory& memory);
  static Memory& thread_memory();
  bool has_lanes(const Batch& batch) const;
  struct FirstOfLanes;
  void set_lanes(articulation::LaneStepArguments& to, const ArticulationArguments& in,
                 const Model& model, const Batch& batch, FirstOfLanes& first,
                 float* constants) const;
  void vjp_lanes(const ArticulationStepVjpArguments& step, const Model& model, const Batch& batch,
                 Memory& memory) const;
  bool lanes(const ArticulationStepArguments& step, const Model& model, const Batch& batch,
             const FeatherstoneOptions& options, TreeContacts* contacts, bool keep,
             Memory& memory) const;

  bool uses_lanes_ = true;
  const articulation::LaneLevel& level_ = articulation::lane_level();
  const Articulations& articulations_;
  const ArticulationRows* trees_;
  std::vector<FirstRows> first_;  // for each tree
  std::vector<Group> groups_;
  ArrayStamp stamps_[kStepArrays];  // of the arrays in groups
  ArrayStamp mode_stamp_;
  std::vector<int32_t> sorted_, counts_, keys_;
  IndexRows order_;
  std::vector<Batch> batches_;
};

}  // namespace novaphy
