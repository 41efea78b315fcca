// Bindings of the enumerations, Model, SimState, Control and Contacts.
#include <map>
#include <tuple>

#include "doc_sim.h"
#include "new_state.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/joint_types.h"
#include "shape_pairs.h"

namespace novaphy::python {
namespace {

using Names = std::initializer_list<std::pair<const char*, int>>;

// Adds an enum.IntEnum or enum.IntFlag to the module. Functions of the engine take its members as
// ints.
void add_enum(py::module_& m, const char* base, const char* name, const char* doc,
              const Names& members) {
  py::dict values;
  for (const auto& [member, value] : members) values[member] = value;
  py::object type = py::module_::import("enum").attr(base)(name, values, "module"_a = "novaphy");
  type.attr("__doc__") = doc;
  m.attr(name) = type;
}

template <class E>
constexpr int value_of(E e) {
  return static_cast<int>(e);
}

// Returns a copy of C++ structs as a structured NumPy array with these fields.
template <class Row>
py::object structured(const std::vector<Row>& rows, const py::list& fields) {
  const py::bytes data(reinterpret_cast<const char*>(rows.data()), rows.size() * sizeof(Row));
  return py::module_::import("numpy")
      .attr("frombuffer")(data, numpy().dtype(fields))
      .attr("copy")();
}

// A rigid contact with further columns, which are computed from the model and a state.
struct PlacedContact {
  RigidContact contact;
  int32_t body0, body1;
  Vec3f position;
  float penetration;
};

std::vector<PlacedContact> placed(const std::vector<RigidContact>& rows, const Model& model,
                                  const SimState& state) {
  const std::vector<int32_t> bodies = model.shape_body.to_host();
  const std::vector<Transformf> poses = state.body_q.to_host();
  std::vector<PlacedContact> result;
  for (const RigidContact& c : rows) {
    const auto body_of = [&](int32_t shape) {
      require(shape >= 0 && shape < model.shape_count(), ErrorKind::Index,
              "rigid_contacts: expected shapes 0 to ", model.shape_count() - 1, ", got ", shape);
      return bodies[static_cast<size_t>(shape)];
    };
    const int32_t body0 = body_of(c.shape0), body1 = body_of(c.shape1);
    const auto surface = [&](int32_t body, const Vec3f& point, float along) {
      const Vec3f p =
          body < 0 ? point : math::transform_point(poses[static_cast<size_t>(body)], point);
      return p + c.normal * along;
    };
    const Vec3f a = surface(body0, c.point0, c.margin0), b = surface(body1, c.point1, -c.margin1);
    result.push_back({c, body0, body1, (a + b) * 0.5f, math::dot(a - b, c.normal)});
  }
  return result;
}

py::object rigid_contact_rows(const Contacts& contacts, const Model* model, const SimState* state) {
  require((model == nullptr) == (state == nullptr), ErrorKind::Value,
          "rigid_contacts: expected a model and a state, or none of them");
  const std::vector<RigidContact> rows = contacts.rigid_contacts();
  static_assert(sizeof(RigidContact) == 92 && sizeof(PlacedContact) == 116);
  py::list fields;
  for (const char* name : {"shape0", "shape1"}) fields.append(py::make_tuple(name, "<i4"));
  for (const char* name : {"point0", "point1", "offset0", "offset1", "normal"})
    fields.append(py::make_tuple(name, "<f4", 3));
  for (const char* name : {"margin0", "margin1"}) fields.append(py::make_tuple(name, "<f4"));
  fields.append(py::make_tuple("point_id", "<i4"));
  fields.append(py::make_tuple("force", "<f4", 3));
  if (model == nullptr) return structured(rows, fields);
  for (const uint64_t id : {state->model_id(), contacts.model_id()})
    require(id == model->id(), ErrorKind::Value,
            "rigid_contacts: expected contacts and a state of the model, got one of another");
  for (const char* name : {"body0", "body1"}) fields.append(py::make_tuple(name, "<i4"));
  fields.append(py::make_tuple("position", "<f4", 3));
  fields.append(py::make_tuple("penetration", "<f4"));
  return structured(placed(rows, *model, *state), fields);
}

// Returns for every rigid contact the first row in `previous` with the same shapes and, unless
// `pairs`, the same point; -1: no such row.
py::object match(const Contacts& contacts, const Contacts& previous, bool pairs) {
  require(contacts.model_id() == previous.model_id(), ErrorKind::Value,
          "match, previous: expected contacts of the same model");
  using Name = std::tuple<int32_t, int32_t, int32_t>;
  const auto name_of = [pairs](const RigidContact& c) {
    return Name(c.shape0, c.shape1, pairs ? 0 : c.point_id);
  };
  std::map<Name, int32_t> known;
  int32_t row = 0;
  for (const RigidContact& c : previous.rigid_contacts()) known.try_emplace(name_of(c), row++);
  std::vector<int32_t> rows;
  for (const RigidContact& c : contacts.rigid_contacts()) {
    const auto found = known.find(name_of(c));
    rows.push_back(found == known.end() ? -1 : found->second);
  }
  return numpy().asarray(rows, numpy_dtype(Scalar::I32));
}

// Returns the repr. Inside of a capture it has no counts, which are not known yet.
std::string contacts_repr(const Contacts& c) {
  std::string rigid = std::to_string(c.rigid_contact_max()),
              soft = std::to_string(c.soft_contact_max());
  if (launch_recorder() == nullptr) {
    rigid = std::to_string(c.active_rigid_contact_count()) + " of " + rigid;
    soft = std::to_string(c.active_soft_contact_count()) + " of " + soft;
  }
  return "Contacts(rigid: " + rigid + ", soft: " + soft + ", device='" + c.device().str() + "'" +
         (c.requires_grad ? ", requires_grad=True)" : ")");
}

py::object soft_contact_rows(const Contacts& contacts) {
  const std::vector<SoftContact> rows = contacts.soft_contacts();
  static_assert(sizeof(SoftContact) == 44);
  py::list fields;
  fields.append(py::make_tuple("particle", "<i4"));
  fields.append(py::make_tuple("shape", "<i4"));
  for (const char* name : {"body_pos", "body_vel", "normal"})
    fields.append(py::make_tuple(name, "<f4", 3));
  return structured(rows, fields);
}

py::list shape_sources(const Model& model) {
  const std::vector<int32_t> ranges = model.shape_mesh_range.to_host();
  const auto copy_of = [](const Array& array) { return py::cast(array).attr("numpy")(); };
  const py::object vertices = copy_of(model.mesh_vertices), indices = copy_of(model.mesh_indices);
  std::map<std::pair<int32_t, int32_t>, py::object> meshes;  // by first vertex and triangle
  py::list sources;
  for (size_t k = 0; k < ranges.size(); k += 4) {
    const auto rows = [&](const py::object& of, size_t first) {
      return of[py::slice(ranges[k + first], ranges[k + first] + ranges[k + first + 1], 1)].attr(
          "copy")();
    };
    if (ranges[k + 1] == 0) {
      sources.append(py::none());
      continue;
    }
    py::object& mesh = meshes[{ranges[k], ranges[k + 2]}];
    if (!mesh)
      mesh = py::module_::import("novaphy.io").attr("Mesh")(rows(vertices, 0), rows(indices, 2));
    sources.append(mesh);
  }
  return sources;
}

using ModelClass = py::class_<Model, std::shared_ptr<Model>>;

void add_model_pickle(ModelClass& c) {
  c.def_readonly("actuator_label", &Model::actuator_label, "The name of each actuator.");
  c.def(py::pickle(
      [](const Model& model) {
        model.check_structure("Model, pickle");
        model.update_derived();
        py::dict kept = keep_fields(model);
        kept["model_id"] = model.id();
        kept["up_axis"] = value_of(model.up_axis());
#define NOVAPHY_KEEP(name, by_default, infinite, unit, doc) kept[#name] = model.name;
        NOVAPHY_MODEL_NUMBERS(NOVAPHY_KEEP)
#undef NOVAPHY_KEEP
        kept["body_label"] = model.body_label;
        kept["shape_label"] = model.shape_label;
        kept["joint_label"] = model.joint_label;
        kept["articulation_label"] = model.articulation_label;
        kept["actuator_label"] = model.actuator_label;
        kept["max_joints_per_articulation"] = model.max_joints_per_articulation;
        kept["max_dofs_per_articulation"] = model.max_dofs_per_articulation;
        keep_shape_pairs(model, kept);
        return kept;
      },
      [](const py::dict& kept) {
        const std::shared_ptr<Model> model = Model::restore(
            unpickled_counts(kept), to_device(unpickled(kept, "device")),
            to_axis(unpickled(kept, "up_axis")), unpickled(kept, "model_id").cast<uint64_t>());
        take_fields(*model, kept);
        model->accept_derived();
        model->keep_structure();
#define NOVAPHY_TAKE(name, by_default, infinite, unit, doc) \
  model->name = unpickled(kept, #name).cast<float>();
        NOVAPHY_MODEL_NUMBERS(NOVAPHY_TAKE)
#undef NOVAPHY_TAKE
        model->body_label = unpickled(kept, "body_label").cast<decltype(model->body_label)>();
        model->shape_label = unpickled(kept, "shape_label").cast<decltype(model->shape_label)>();
        model->joint_label = unpickled(kept, "joint_label").cast<decltype(model->joint_label)>();
        model->articulation_label =
            unpickled(kept, "articulation_label").cast<decltype(model->articulation_label)>();
        model->actuator_label =
            unpickled(kept, "actuator_label").cast<decltype(model->actuator_label)>();
        model->max_joints_per_articulation =
            unpickled(kept, "max_joints_per_articulation").cast<int32_t>();
        model->max_dofs_per_articulation =
            unpickled(kept, "max_dofs_per_articulation").cast<int32_t>();
        take_shape_pairs(*model, kept);
        return model;
      }));
}

// Binds the numbers of a model, which are checked when they are set.
void bind_numbers(ModelClass& c) {
#define NOVAPHY_BIND_NUMBER(name, by_default, infinite, unit, doc)                  \
  c.def_property(                                                                   \
      #name, [](const Model& self) { return self.name; },                           \
      [](Model& self, float value) {                                                \
        check_number("Model", ".", NumberInfo{#name, infinite, unit, doc}, value);  \
        self.name = value;                                                          \
      },                                                                            \
      unit ", >= 0: " doc                                                           \
           ". A captured graph uses the value at its capture, and raises an error " \
           "if the value has changed.");
  NOVAPHY_MODEL_NUMBERS(NOVAPHY_BIND_NUMBER)
#undef NOVAPHY_BIND_NUMBER
}

// Binds a derived field, such as particle_inv_mass, which is computed from another array. A read or
// an assignment first updates the field. Inside of a tape or capture, the recorded operations
// update it.
template <class T>
void bind_derived(ModelClass& c, const char* name, DeviceArray<T> ModelFields::*member) {
  const auto array = [member](const Model& self) {
    if (array_observer() == nullptr) self.update_derived();
    return static_cast<Array>(self.*member);
  };
  const auto doc = c.attr(name).attr("__doc__").cast<std::string>() +
                   " The values are computed from another array. An assigned value stays until "
                   "that array is written.";
  c.def_property(
      name, array,
      [array](Model& self, py::handle source) {
        Array target = array(self);
        assign_array(target, source);
      },
      doc.c_str());
}

void bind_model(py::module_& m) {
  py::class_<Model, std::shared_ptr<Model>> c(m, "Model", doc::kModel);
  using Fields = ModelFields;
  NOVAPHY_MODEL_FIELDS(NOVAPHY_BIND_FIELD)
#define NOVAPHY_BIND_DERIVED(derived, source, rule) bind_derived(c, #derived, &Fields::derived);
  NOVAPHY_DERIVED_MODEL_FIELDS(NOVAPHY_BIND_DERIVED)
#undef NOVAPHY_BIND_DERIVED
  bind_counts(c);
  bind_shape_pairs(c);
  // The same arrays under Newton's names.
  bind_field(
      c, {"shape_aabb_lower", DType::vec3, 1, "shape_count", "m", "shape", "as shape_aabb_lower"},
      &Fields::shape_aabb_lower, "shape_collision_aabb_lower");
  bind_field(
      c, {"shape_aabb_upper", DType::vec3, 1, "shape_count", "m", "shape", "as shape_aabb_upper"},
      &Fields::shape_aabb_upper, "shape_collision_aabb_upper");
#define NOVAPHY_ALIAS(name, field)                                              \
  c.def_property(                                                               \
      #name, [](const Model& self) { return static_cast<Array>(self.field); },  \
      [](Model& self, py::handle source) { assign_array(self.field, source); }, \
      "Newton's name of " #field ".");
  NOVAPHY_ALIAS(spring_indices, particle_spring_indices)
  NOVAPHY_ALIAS(spring_rest_length, particle_spring_rest_length)
  NOVAPHY_ALIAS(spring_stiffness, particle_spring_stiffness)
  NOVAPHY_ALIAS(spring_damping, particle_spring_damping)
  NOVAPHY_ALIAS(spring_control, particle_spring_control)
  NOVAPHY_ALIAS(tri_indices, particle_tri_indices)
  NOVAPHY_ALIAS(tri_poses, particle_tri_pose)
  NOVAPHY_ALIAS(tri_areas, particle_tri_area)
  NOVAPHY_ALIAS(tri_activations, particle_tri_activation)
  NOVAPHY_ALIAS(tri_materials, particle_tri_material)
  NOVAPHY_ALIAS(edge_indices, particle_edge_indices)
  NOVAPHY_ALIAS(edge_rest_angle, particle_edge_rest_angle)
  NOVAPHY_ALIAS(edge_rest_length, particle_edge_rest_length)
  NOVAPHY_ALIAS(edge_bending_properties, particle_edge_material)
  NOVAPHY_ALIAS(tet_indices, particle_tet_indices)
  NOVAPHY_ALIAS(tet_poses, particle_tet_pose)
  NOVAPHY_ALIAS(tet_activations, particle_tet_activation)
  NOVAPHY_ALIAS(tet_materials, particle_tet_material)
#undef NOVAPHY_ALIAS
  bind_numbers(c);
  c.def_readonly("body_label", &Model::body_label, "The name of each body.")
      .def_property_readonly(
          "body_shapes",
          [](const Model& self) {
            std::map<int32_t, std::vector<int32_t>> shapes;
            for (int32_t b = -1; b < self.body_count(); ++b) shapes[b];
            const std::vector<int32_t> body = self.shape_body.to_host();
            for (size_t s = 0; s < body.size(); ++s)
              shapes[body[s]].push_back(static_cast<int32_t>(s));
            return shapes;
          },
          "A dict: body (-1: the world) -> list of its shapes in ascending order.")
      .def_readonly("shape_label", &Model::shape_label, "The name of each shape.")
      .def_property_readonly("shape_source", &shape_sources, doc::kShapeSource)
      .def_readonly("joint_label", &Model::joint_label, "The name of each joint.")
      .def_readonly("articulation_label", &Model::articulation_label,
                    "The name of each articulation.")
      .def_readonly("max_joints_per_articulation", &Model::max_joints_per_articulation,
                    "The number of joints of the largest articulation.")
      .def_readonly("max_dofs_per_articulation", &Model::max_dofs_per_articulation,
                    "The largest number of degrees of freedom of an articulation.")
      .def_property_readonly(
          "particle_color_groups",
          [](const Model& self) {
            py::list groups;
            for (const std::vector<int32_t>& group : self.particle_color_groups())
              groups.append(numpy().asarray(group, numpy_dtype(Scalar::I32)));
            return groups;
          },
          doc::kColorGroups)
      .def_property_readonly(
          "up_axis", [](const Model& self) { return value_of(self.up_axis()); },
          "The index of the up axis: 0, 1 or 2.")
      .def("state", &new_state, "requires_grad"_a = py::none(), doc::kNewState)
      .def(
          "control",
          [](const Model& self, bool clone_variables, std::optional<bool> grad) {
            require(clone_variables, ErrorKind::NotImplemented,
                    "control, clone_variables: a control always has arrays of its own");
            return self.control(grad);
          },
          "clone_variables"_a = true, "requires_grad"_a = py::none(), doc::kNewControl)
      .def(
          "contacts",
          [](const std::shared_ptr<Model>& self, CollisionPipeline* pipeline) {
            return pipeline != nullptr ? pipeline->contacts() : CollisionPipeline(self).contacts();
          },
          "collision_pipeline"_a = py::none(), doc::kNewContacts)
      .def(
          "collide",
          [](const std::shared_ptr<Model>& self, const SimState& state, py::object contacts,
             CollisionPipeline* given) {
            std::optional<CollisionPipeline> made;
            CollisionPipeline& pipeline = given != nullptr ? *given : made.emplace(self);
            if (contacts.is_none()) contacts = py::cast(pipeline.contacts());
            auto& target = contacts.cast<Contacts&>();
            const ReleasedGil release;
            pipeline.collide(state, target);
            return contacts;
          },
          "state"_a, "contacts"_a = py::none(), py::kw_only(), "collision_pipeline"_a = py::none(),
          doc::kModelCollide)
      .def(
          "set_gravity",
          [](Model& self, py::handle value, std::optional<int32_t> world) {
            self.set_gravity(to_vec3(value, "gravity"), world);
          },
          "value"_a, "world"_a = py::none(), doc::kSetGravity)
      .def("clone", &Model::clone, "Returns a copy on the same device.")
      .def(
          "to", [](const Model& self, py::handle device) { return self.to(to_device(device)); },
          "device"_a, "Returns a copy on a device.");
  add_model_pickle(c);
}

void bind_state(py::module_& m) {
  py::class_<SimState> c(m, "SimState", doc::kSimState);
  using Fields = StateFields;
  NOVAPHY_STATE_FIELDS(NOVAPHY_BIND_FIELD)
  bind_counts(c);
  c.def("clear_forces", &SimState::clear_forces, release_gil(),
        "Sets particle_f and body_f to zero.")
      .def("assign", &SimState::assign, "source"_a, release_gil(), doc::kAssignState)
      .def("clone", &SimState::clone, "Returns a copy.");
  add_field_pickle(c);
}

void bind_control(py::module_& m) {
  py::class_<Control> c(m, "Control", doc::kControl);
  using Fields = ControlFields;
  NOVAPHY_CONTROL_FIELDS(NOVAPHY_BIND_FIELD)
  bind_field(
      c, {"tri_activations", DType::float32, 1, "tri_count", "1", "", "as particle_tri_activation"},
      &Fields::particle_tri_activation, "tri_activations");
  bind_field(
      c, {"tet_activations", DType::float32, 1, "tet_count", "1", "", "as particle_tet_activation"},
      &Fields::particle_tet_activation, "tet_activations");
  bind_counts(c);
  c.def(
       "clear",
       [](Control& self, const Model* model) {
         self.clear();
         if (model != nullptr) self.joint_target_q.assign(model->joint_target_q);
       },
       "model"_a = py::none(),
       "Sets all arrays to zero. If a model is given, joint_target_q gets the model's targets.")
      .def("assign", &Control::assign, "source"_a,
           "Copies all values of another control. ValueError: sizes or devices differ.")
      .def("clone", &Control::clone, "Returns a copy.");
  add_field_pickle(c);
}

void bind_contacts(py::module_& m) {
  py::class_<Contacts> c(m, "Contacts", doc::kContactsClass);
  using Fields = ContactFields;
  c.def(py::init([](int32_t rigid_contact_max, int32_t soft_contact_max, py::handle device,
                    bool requires_grad, bool per_contact_shape_properties) {
          return Contacts({.soft_contact_max = soft_contact_max,
                           .rigid_contact_max = rigid_contact_max,
                           .requires_grad = requires_grad,
                           .per_contact_shape_properties = per_contact_shape_properties},
                          to_device(device));
        }),
        "rigid_contact_max"_a = 0, "soft_contact_max"_a = 0, py::kw_only(), "device"_a = py::none(),
        "requires_grad"_a = false, "per_contact_shape_properties"_a = false, doc::kContactsInit);
  NOVAPHY_CONTACT_FIELDS(NOVAPHY_BIND_FIELD)
  c.def_property_readonly("soft_contact_max", &Contacts::soft_contact_max,
                          "The number of slots for soft contacts.")
      .def_property_readonly("rigid_contact_max", &Contacts::rigid_contact_max,
                             "The number of rows for rigid contacts.")
      .def_property_readonly("per_contact_shape_properties",
                             &Contacts::per_contact_shape_properties, doc::kPerContact)
      .def_property_readonly("active_rigid_contact_count", &Contacts::active_rigid_contact_count,
                             doc::kActiveRigid)
      .def("__len__",
           [](const Contacts& found) {
             return found.active_rigid_contact_count() + found.active_soft_contact_count();
           })
      .def("__repr__", &contacts_repr)
      .def("rigid_contacts", &rigid_contact_rows, "model"_a = py::none(), "state"_a = py::none(),
           doc::kRigidContacts)
      .def("match", &match, "previous"_a, "pairs"_a = false, doc::kMatch)
      .def_property_readonly("soft_contact_pair_count", &Contacts::soft_contact_pair_count,
                             "The number of candidate (particle, shape) pairs.")
      .def_property_readonly("device", &Contacts::device, "The device of the arrays.")
      .def_readwrite("requires_grad", &Contacts::requires_grad, "Whether gradients are requested.")
      .def_property_readonly("overflowed", &Contacts::overflowed, doc::kOverflowed)
      .def_property_readonly("active_soft_contact_count", &Contacts::active_soft_contact_count,
                             doc::kActiveSoft)
      .def("clear", &Contacts::clear, "Removes all contacts.")
      .def("soft_contacts", &soft_contact_rows, doc::kSoftContacts)
      .def("assign", &Contacts::assign, "source"_a,
           "Copies all values of other contacts. ValueError: sizes or devices differ.")
      .def("clone", &Contacts::clone, "Returns a copy.");
}

}  // namespace

void bind_enums(py::module_& m) {
  add_enum(m, "IntEnum", "Axis", "A coordinate axis.", {{"X", 0}, {"Y", 1}, {"Z", 2}});
  add_enum(m, "IntEnum", "GeoType", "The type of a shape, see Model.shape_type.",
           {
#define NOVAPHY_VALUE(name, value, ...) {#name, value},
               NOVAPHY_SHAPE_TYPES(NOVAPHY_VALUE)
#undef NOVAPHY_VALUE
           });
  add_enum(m, "IntEnum", "JointType", "The type of a joint, see Model.joint_type.",
           {
#define NOVAPHY_VALUE(name, value, ...) {#name, value},
               NOVAPHY_JOINT_TYPES(NOVAPHY_VALUE)
#undef NOVAPHY_VALUE
           });
  add_enum(m, "IntEnum", "ActuatorDynamics",
           "The law by which the activation of an actuator follows its control.",
           {{"NONE", value_of(ActuatorDynamics::NONE)},
            {"INTEGRATOR", value_of(ActuatorDynamics::INTEGRATOR)},
            {"FILTER", value_of(ActuatorDynamics::FILTER)},
            {"FILTER_EXACT", value_of(ActuatorDynamics::FILTER_EXACT)}});
  add_enum(m, "IntEnum", "JointTargetMode", "The targets of a drive.",
           {{"NONE", value_of(JointTargetMode::NONE)},
            {"POSITION", value_of(JointTargetMode::POSITION)},
            {"VELOCITY", value_of(JointTargetMode::VELOCITY)},
            {"POSITION_VELOCITY", value_of(JointTargetMode::POSITION_VELOCITY)},
            {"EFFORT", value_of(JointTargetMode::EFFORT)}});
  add_enum(m, "IntFlag", "ParticleFlags", "Bits of Model.particle_flags.",
           {{"ACTIVE", value_of(ParticleFlags::ACTIVE)}});
  add_enum(
      m, "IntFlag", "BodyFlags", "Bits of Model.body_flags.",
      {{"DYNAMIC", value_of(BodyFlags::DYNAMIC)}, {"KINEMATIC", value_of(BodyFlags::KINEMATIC)}});
  add_enum(m, "IntFlag", "ShapeFlags", "Bits of Model.shape_flags.",
           {{"VISIBLE", value_of(ShapeFlags::VISIBLE)},
            {"COLLIDE_SHAPES", value_of(ShapeFlags::COLLIDE_SHAPES)},
            {"COLLIDE_PARTICLES", value_of(ShapeFlags::COLLIDE_PARTICLES)},
            {"SITE", value_of(ShapeFlags::SITE)}});
  add_enum(m, "IntFlag", "ModelFlags", "The parts of a model for notify_model_changed.",
           {{"JOINT_PROPERTIES", value_of(ModelFlags::JOINT_PROPERTIES)},
            {"JOINT_DOF_PROPERTIES", value_of(ModelFlags::JOINT_DOF_PROPERTIES)},
            {"BODY_PROPERTIES", value_of(ModelFlags::BODY_PROPERTIES)},
            {"BODY_INERTIAL_PROPERTIES", value_of(ModelFlags::BODY_INERTIAL_PROPERTIES)},
            {"SHAPE_PROPERTIES", value_of(ModelFlags::SHAPE_PROPERTIES)},
            {"MODEL_PROPERTIES", value_of(ModelFlags::MODEL_PROPERTIES)},
            {"ALL", value_of(ModelFlags::ALL)}});
}

void bind_sim(py::module_& m) {
  bind_model(m);
  bind_state(m);
  bind_control(m);
  bind_contacts(m);
}

}  // namespace novaphy::python
