#include "novaphy/collision/polytopes.h"

#include <algorithm>

#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/enums.h"
#include "shape_geometries.h"

namespace novaphy {

struct Polytopes::Impl {
  detail::ShapeGeometries geometries;
  uint64_t version = 0;
  Array views;
};

Polytopes::Polytopes(const Model& model)
    : impl_(new Impl{detail::ShapeGeometries({std::shared_ptr<void>(), &model}), 0, {}}) {}
Polytopes::~Polytopes() = default;

void Polytopes::update() {
  Impl& p = *impl_;
  p.geometries.update();
  if (p.version == p.geometries.version()) return;
  p.version = p.geometries.version();
  const auto is_one = [](int32_t view) { return view >= 0; };
  const bool has_any = std::ranges::any_of(p.geometries.of_shape().to_host(), is_one);
  p.views = has_any ? p.geometries.tables() : Array();
}

const DeviceArray<int32_t>& Polytopes::of_shape() const { return impl_->geometries.of_shape(); }
const Array& Polytopes::views() const { return impl_->views; }

}  // namespace novaphy
