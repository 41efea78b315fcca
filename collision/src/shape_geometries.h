// Internal: the tables of a model's convex hulls and meshes on its device, one for each combination
// of mesh, type and scale. The tables are rebuilt when their source arrays in the model were
// written.
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

  // Rebuilds outdated tables. ErrorKind::Value, with the shape: a range outside of the model's
  // vertices or triangles, or an error of convex_hull or build_mesh_tree. Recorded launches depend
  // on the source arrays.
  void update();

  // The functions below need a call of update() first. of_shape: for each shape its row in the
  // views, or -1.
  const DeviceArray<int32_t>& of_shape() const { return of_shape_; }
  // GeometryViews, followed by the tables that they point to.
  Array tables() const { return {DType::uint8, tables_->bytes(), 1, tables_->range()}; }
  // Number of rebuilds.
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
