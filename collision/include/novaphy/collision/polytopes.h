// The tables of a model's convex hulls and meshes for the gradients of contacts.
#pragma once

#include <memory>

#include "novaphy/collision/export.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

class NOVAPHY_COLLISION_API Polytopes {
 public:
  explicit Polytopes(const Model& model);  // the model must outlive this object
  ~Polytopes();
  // Builds the tables, or builds them again if their arrays in the model were written. Throws as a
  // search of contacts does.
  void update();

  // The functions below require a call of update(). of_shape() {shapes} has the row of each shape
  // in views(), or -1. views() has geometry::GeometryViews, and no rows without hulls and meshes.
  const DeviceArray<int32_t>& of_shape() const;
  const Array& views() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace novaphy
