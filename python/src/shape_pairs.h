// The shape pairs of a Model (shape_contact_pairs, ...): Python properties, and pickle support.
#pragma once

#include "novaphy/core/sim/model.h"
#include "pickle.h"

namespace novaphy::python {

template <class ModelClass>
void bind_shape_pairs(ModelClass& c) {
  const FieldInfo info = {
      "shape_contact_pairs",
      DType::vec2i,
      1,
      "shape_contact_pair_count",
      "",
      "",
      "shape pairs (i < j) that the broad phase \"explicit\" tests, in lexicographic order. The "
      "list is made at the first access"};
  c.def_property(
      "shape_contact_pairs",
      [](const Model& self) { return static_cast<Array>(self.shape_contact_pairs()); },
      [](Model& self, py::handle source) {
        Array pairs = self.shape_contact_pairs();
        assign_array(pairs, source);
      },
      field_doc(info).c_str());
  c.def_property_readonly("shape_contact_pair_count", &Model::shape_contact_pair_count,
                          "The number of rows of shape_contact_pairs.");
  c.def_readonly("shape_collision_filter_pairs", &Model::shape_collision_filter_pairs,
                 "The shape pairs (i < j) whose contacts are excluded.");
}

inline void keep_shape_pairs(const Model& model, py::dict& kept) {
  const ShapePairList& list = model.shape_pair_list();
  const ShapePairList::Columns none, &of = list.columns() ? *list.columns() : none;
  kept["shape_collision_filter_pairs"] = model.shape_collision_filter_pairs;
  kept["shape_pair_columns"] = py::make_tuple(of.body, of.flags, of.collision_group, of.world);
  kept["shape_contact_pairs"] =
      list.is_made() ? py::cast(static_cast<Array>(model.shape_contact_pairs())) : py::none();
}

inline void take_shape_pairs(Model& model, const py::dict& kept) {
  using Column = std::vector<int32_t>;
  model.shape_collision_filter_pairs = unpickled(kept, "shape_collision_filter_pairs")
                                           .cast<decltype(model.shape_collision_filter_pairs)>();
  const auto columns = unpickled(kept, "shape_pair_columns").cast<py::tuple>();
  ShapePairList& list = model.shape_pair_list();
  list.follow(std::make_shared<const ShapePairList::Columns>(
      ShapePairList::Columns{columns[0].cast<Column>(), columns[1].cast<Column>(),
                             columns[2].cast<Column>(), columns[3].cast<Column>()}));
  const py::handle pairs = unpickled(kept, "shape_contact_pairs");
  if (!pairs.is_none()) list.set(DeviceArray<Vec2i>(pairs.cast<const Array&>()));
}

}  // namespace novaphy::python
