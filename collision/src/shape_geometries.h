// Internal: the tables of a model's convex hulls and meshes on its device, one for each (mesh,
// type, scale) that shapes have. The tables follow from arrays of the model and are made anew when
// these were written.
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

  // Makes what is out of date. ErrorKind::Value, naming the shape: a range outside of the model's
  // vertices or triangles, what convex_hull or build_mesh_tree refuse. Recorded launches depend on
  // the arrays.
  void update();

  // The rest after update().
  // Of each shape its row in the views, or -1.
  const DeviceArray<int32_t>& of_shape() const { return of_shape_; }
  // GeometryViews, then the tables that they point to.
  Array tables() const { return {DType::uint8, tables_->bytes(), 1, tables_->range()}; }
  // How often they were made.
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
