// Internal: the candidate pairs of the search for rigid contacts.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "array_versions.h"
#include "novaphy/collision/box_pairs.h"
#include "novaphy/collision/broad_phase.h"
#include "novaphy/collision/geometry/rigid_shape.h"
#include "novaphy/core/sim/model.h"
#include "rigid_tree.h"

namespace novaphy::detail {

class RigidPairs {
 public:
  RigidPairs(std::shared_ptr<const Model> model, BroadPhase broad_phase, int32_t contacts_per_pair,
             std::optional<std::vector<Vec2i>> explicit_pairs);

  // Reads the model's arrays if they were written since the last call. Also lists the pairs, unless
  // a sweep finds them in each search. ErrorKind::NotImplemented: a pair of shapes that may touch
  // is not supported.
  void update();
  // The arrays that update() reads.
  std::array<const Array*, 7> sources() const;
  // Returns an upper bound of the number of rows.
  int64_t most_rows() const { return most_rows_; }

  // Returns whether each search finds the pairs from the current boxes of the shapes (RigidShape).
  // On the host sweep() finds the pairs. On a device find_by_kernels() launches kernels, and the
  // pairs stay on the device.
  bool are_swept() const { return broad_phase_ == BroadPhase::Sap; }
  void sweep(std::span<const RigidShape> shapes);
  void find_by_kernels(const Array& shapes);
  // Uses pairs (i < j) that were found elsewhere in place of a sweep.
  void take_swept(std::vector<Vec2i> found) { take(std::move(found)); }
  ShapePairRules rules() const;

  int64_t count() const { return count_; }
  // Pairs (shape0, shape1) in ascending order. The array may have more rows than pairs.
  const DeviceArray<Vec2i>& rows() const { return rows_; }
  // The number of valid rows if kernels found the pairs. Null: all rows are valid.
  const DeviceArray<int32_t>* found() const { return found_; }
  // Returns the number of pairs with a mesh and without a plane.
  int64_t mesh_count() const { return mesh_count_; }
  const DeviceArray<int32_t>& mesh_rows() const { return mesh_rows_; }

 private:
  GeoType type_of(int32_t shape) const {
    return static_cast<GeoType>(type_[static_cast<size_t>(shape)]);
  }
  bool lists_model_pairs() const { return broad_phase_ == BroadPhase::Explicit && !explicit_; }
  int32_t orient(Vec2i& pair) const;
  int64_t take(std::vector<Vec2i> found);
  void take_mesh_rows(std::span<const Vec2i> found);
  void make_room(size_t count);
  void check_all() const;

  std::shared_ptr<const Model> model_;
  BroadPhase broad_phase_;
  int32_t contacts_per_pair_;
  std::optional<std::vector<Vec2i>> explicit_;  // pairs that replace the model's list
  Array no_pairs_;                              // an empty array in place of the model's list
  ArrayVersions<7> versions_;
  std::vector<int32_t> body_, type_, flags_, group_, world_;  // columns of the shapes' arrays
  std::vector<Vec3f> scale_;
  SweepAndPrune host_sweep_;
  RigidTree tree_;           // for devices and recordings
  bool tree_known_ = false;  // whether the tables of tree_ are up to date
  std::vector<geometry::Box3> boxes_;
  int64_t most_rows_ = 0, count_ = 0, mesh_count_ = 0;
  DeviceArray<Vec2i> rows_;
  DeviceArray<int32_t> mesh_rows_;
  const DeviceArray<int32_t>* found_ = nullptr;
};

}  // namespace novaphy::detail
