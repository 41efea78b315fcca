// The collision pipeline.
#include "convert.h"
#include "doc_collision.h"
#include "novaphy/collision/collision_pipeline.h"

namespace novaphy::python {

namespace {

std::optional<std::vector<Vec2i>> to_shape_pairs(py::handle value) {
  if (value.is_none()) return std::nullopt;
  constexpr const char* name = "shape_pairs_filtered";
  std::vector<Vec2i> pairs;
  for (const py::handle row : py::iter(value)) {
    int32_t shapes[2] = {};
    size_t count = 0;
    for (const py::handle shape : py::iter(row)) {
      if (count < 2) shapes[count] = to_int32(shape, name);
      ++count;
    }
    require(count == 2, ErrorKind::Value, name, ": expected rows of two shapes, got one of ",
            count);
    pairs.push_back({shapes[0], shapes[1]});
  }
  return pairs;
}

}  // namespace

void bind_collision(py::module_& m) {
  py::class_<CollisionPipeline>(m, "CollisionPipeline", doc::kPipeline)
      .def(py::init([](const std::shared_ptr<Model>& model, const std::string& broad_phase,
                       const std::string& narrow_phase, std::optional<int32_t> rigid_contact_max,
                       int32_t contacts_per_pair, std::optional<int32_t> soft_contact_max,
                       std::optional<float> soft_contact_margin,
                       std::optional<float> soft_contact_gap, std::optional<bool> requires_grad,
                       bool deterministic, bool reduce_contacts, py::handle shape_pairs_filtered) {
             require(!soft_contact_margin || !soft_contact_gap, ErrorKind::Value,
                     "soft_contact_gap: another name of soft_contact_margin; give one of them");
             require(
                 reduce_contacts, ErrorKind::NotImplemented,
                 "reduce_contacts: expected True: the contacts of a mesh with a shape are always "
                 "reduced, to at most 32 rows");
             CollisionOptions options;
             options.broad_phase = parse_broad_phase(broad_phase);
             options.narrow_phase = parse_narrow_phase(narrow_phase);
             options.rigid_contact_max = rigid_contact_max;
             options.contacts_per_pair = contacts_per_pair;
             options.soft_contact_max = soft_contact_max;
             if (soft_contact_margin) options.soft_contact_margin = *soft_contact_margin;
             if (soft_contact_gap) options.soft_contact_margin = *soft_contact_gap;
             options.deterministic = deterministic;
             options.requires_grad = requires_grad;
             options.shape_pairs_filtered = to_shape_pairs(shape_pairs_filtered);
             return std::make_unique<CollisionPipeline>(model, options);
           }),
           py::arg("model").none(false), py::kw_only(), "broad_phase"_a = "explicit",
           "narrow_phase"_a = "auto", "rigid_contact_max"_a = py::none(), "contacts_per_pair"_a = 8,
           "soft_contact_max"_a = py::none(), "soft_contact_margin"_a = py::none(),
           "soft_contact_gap"_a = py::none(), "requires_grad"_a = py::none(),
           "deterministic"_a = true, "reduce_contacts"_a = true,
           "shape_pairs_filtered"_a = py::none(), doc::kPipelineInit)
      .def_property_readonly(
          "model",
          [](const CollisionPipeline& p) { return std::const_pointer_cast<Model>(p.model()); },
          "The model of the pipeline.")
      .def("__repr__",
           [](const CollisionPipeline& p) {
             return std::string("CollisionPipeline(broad_phase='") +
                    broad_phase_name(p.broad_phase()) +
                    "', rigid_contact_max=" + std::to_string(p.rigid_contact_max()) +
                    ", soft_contact_max=" + std::to_string(p.soft_contact_max()) + ", device='" +
                    p.model()->device().str() + "')";
           })
      .def_property_readonly(
          "broad_phase",
          [](const CollisionPipeline& p) { return broad_phase_name(p.broad_phase()); },
          "The broad phase: \"explicit\", \"nxn\" or \"sap\".")
      .def_property_readonly(
          "narrow_phase",
          [](const CollisionPipeline& p) { return narrow_phase_name(p.narrow_phase()); },
          "The narrow phase: \"auto\" or \"fcl\".")
      .def_property_readonly(
          "shape_pairs_filtered",
          [](const CollisionPipeline& p) -> py::object {
            if (!p.shape_pairs_filtered()) return py::none();
            py::list pairs;
            for (const Vec2i& pair : *p.shape_pairs_filtered())
              pairs.append(py::make_tuple(pair.x, pair.y));
            return pairs;
          },
          doc::kFilteredPairs)
      .def_property_readonly("fcl_pair_count", &CollisionPipeline::fcl_pair_count, doc::kFclPairs)
      .def_property_readonly("fcl_fallback_count", &CollisionPipeline::fcl_fallback_count,
                             doc::kFclFallbacks)
      .def_property_readonly("soft_contact_margin", &CollisionPipeline::soft_contact_margin,
                             "The distance up to which collide finds soft contacts (m).")
      .def_property_readonly("rigid_contact_max", &CollisionPipeline::rigid_contact_max,
                             "The number of rows for rigid contacts in contacts().")
      .def_property_readonly("soft_contact_max", &CollisionPipeline::soft_contact_max,
                             "The number of slots for soft contacts in contacts().")
      .def_property_readonly("soft_contact_pair_count", &CollisionPipeline::soft_contact_pair_count,
                             "The number of candidate pairs: particles times colliding shapes.")
      .def("contacts", py::overload_cast<bool>(&CollisionPipeline::contacts, py::const_),
           py::kw_only(), "per_contact_shape_properties"_a = false, doc::kContacts)
      .def("collide", &CollisionPipeline::collide, "state"_a, "contacts"_a, py::kw_only(),
           "soft_contact_margin"_a = py::none(), "dt"_a = py::none(), release_gil(), doc::kCollide);
}

}  // namespace novaphy::python
