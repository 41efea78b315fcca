// Internal: the pairs of a model's shapes that the search for rigid contacts looks at.
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

  // Reads the model's arrays when they were written since the last call: which pairs there are, if
  // they are not swept. ErrorKind::NotImplemented: two shapes that may meet and are not covered.
  void update();
  // The arrays that update() has read.
  std::array<const Array*, 7> sources() const;
  // Rows that no state can exceed.
  int64_t most_rows() const { return most_rows_; }

  // Whether the pairs are those whose boxes meet now, of shapes (RigidShape) that were moved to the
  // world: found by the host, or by launches, which leave what they find on the device.
  bool are_swept() const { return broad_phase_ == BroadPhase::Sap; }
  void sweep(std::span<const RigidShape> shapes);
  void find_by_kernels(const Array& shapes);
  // Instead of a sweep: pairs (i < j) that others found.
  void take_swept(std::vector<Vec2i> found) { take(std::move(found)); }
  ShapePairRules rules() const;

  int64_t count() const { return count_; }
  // (shape0, shape1) in ascending order, at least as many rows as pairs.
  const DeviceArray<Vec2i>& rows() const { return rows_; }
  // How many of the rows kernels have found; null: all.
  const DeviceArray<int32_t>* found() const { return found_; }
  // Rows with a mesh and no plane.
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
  std::optional<std::vector<Vec2i>> explicit_;  // instead of the model's
  Array no_pairs_;                              // of the model, which are not asked for
  ArrayVersions<7> versions_;
  std::vector<int32_t> body_, type_, flags_, group_, world_;  // of the shapes
  std::vector<Vec3f> scale_;
  SweepAndPrune host_sweep_;
  RigidTree tree_;           // on devices, and what is recorded
  bool tree_known_ = false;  // its tables
  std::vector<geometry::Box3> boxes_;
  int64_t most_rows_ = 0, count_ = 0, mesh_count_ = 0;
  DeviceArray<Vec2i> rows_;
  DeviceArray<int32_t> mesh_rows_;
  const DeviceArray<int32_t>* found_ = nullptr;
};

}  // namespace novaphy::detail
