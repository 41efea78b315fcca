// Internal: the tables of a model's convex hulls and meshes on its device. Each combination of
// mesh, type and scale has one table. The tables are rebuilt when their source arrays in the model
// were written.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "array_versions.h"
#include "novaphy/collision/geometry/geometry_view.h"
#include "novaphy/core/sim/model.h"

namespace novaphy::detail {

class ShapeGeometries {
 public:
  explicit ShapeGeometries(std::shared_ptr<const Model> model) : model_(std::move(model)) {}

  // Rebuilds outdated tables. ErrorKind::Value: a shape has a range outside of the model's vertices
  // or triangles, or convex_hull or build_mesh_tree fails. The message names the shape. Recorded
  // launches depend on the source arrays.
  void update();

  // The functions below require a call of update(). of_shape() has the row of each shape in the
  // views, or -1.
  const DeviceArray<int32_t>& of_shape() const { return of_shape_; }
  // The array of GeometryViews, followed by the tables to which their pointers refer.
  Array tables() const { return {DType::uint8, tables_->bytes(), 1, tables_->range()}; }
  // Returns the number of rebuilds.
  uint64_t version() const { return version_; }

 private:
  std::array<const Array*, 5> sources() const;

  std::shared_ptr<const Model> model_;
  ArrayVersions<5> versions_;
  uint64_t version_ = 0;
  DeviceArray<int32_t> of_shape_;
  std::shared_ptr<Storage> tables_;
};

}  // namespace novaphy::detail
