// Bindings of ModelBuilder: worlds, bodies, particles, finalize.
#include "doc_builder.h"
#include "novaphy/core/sim/model_builder.h"
#include "pickle.h"

namespace novaphy::python {
namespace {

// ---------------------------------------------------------------- lists of the builder

// The type of builder.particle_q, builder.body_q, ...: a list of fixed length, which refers to the
// values in the builder.
template <class T>
struct BuilderList {
  py::object owner;
  std::vector<T> ModelBuilder::*member;
  const char* name;

  std::vector<T>& values() const { return owner.cast<ModelBuilder&>().*member; }
};

py::object to_python(const Vec3f& value) { return to_tuple(value); }
py::object to_python(float value) { return py::float_(static_cast<double>(value)); }
py::object to_python(int32_t value) { return py::int_(value); }

py::object to_python(const Transformf& x) {
  return py::make_tuple(x.p.x, x.p.y, x.p.z, x.q.x, x.q.y, x.q.z, x.q.w);
}
py::object to_python(const SpatialVectorf& v) {
  return py::make_tuple(v.linear.x, v.linear.y, v.linear.z, v.angular.x, v.angular.y, v.angular.z);
}

template <class T>
T element_from(py::handle value, const char* name) {
  if constexpr (std::is_same_v<T, Vec3f>) {
    return to_vec3(value, name);
  } else if constexpr (std::is_same_v<T, float>) {
    return to_float(value, name);
  } else if constexpr (std::is_same_v<T, Transformf>) {
    return to_transform(value, name);
  } else if constexpr (std::is_same_v<T, SpatialVectorf>) {
    float v[6];
    to_floats(value, name, v);
    return {{v[0], v[1], v[2]}, {v[3], v[4], v[5]}};
  } else {
    return to_int32(value, name);
  }
}
template <class T>
std::vector<T> list_from(py::handle value, const char* name) {
  if constexpr (std::is_same_v<T, Vec3f>) {
    return to_vec3_list(value, name);
  } else if constexpr (std::is_same_v<T, float>) {
    return to_float_list(value, name);
  } else if constexpr (!std::is_same_v<T, int32_t>) {
    std::vector<T> rows;
    for (const py::handle row : py::iter(value)) rows.push_back(element_from<T>(row, name));
    return rows;
  } else {
    return to_int_list(value, name);
  }
}

template <class T>
size_t list_row(const BuilderList<T>& list, py::ssize_t index) {
  const auto size = static_cast<py::ssize_t>(list.values().size());
  require(index >= -size && index < size, ErrorKind::Index, list.name, ": expected an index of ",
          size, ", got ", index);
  return static_cast<size_t>(index < 0 ? index + size : index);
}

struct Slice {
  size_t start = 0, step = 0, count = 0;  // `step` wraps for negative steps
};
Slice resolve(const py::slice& slice, size_t size) {
  Slice s;
  py::ssize_t start = 0, stop = 0, step = 0, count = 0;
  if (!slice.compute(static_cast<py::ssize_t>(size), &start, &stop, &step, &count))
    throw py::error_already_set();
  s.start = static_cast<size_t>(start);
  s.step = static_cast<size_t>(step);
  s.count = static_cast<size_t>(count);
  return s;
}

template <class T>
py::list copy_of(const BuilderList<T>& list) {
  py::list values;
  for (const T& value : list.values()) values.append(to_python(value));
  return values;
}

template <class T>
void bind_list(py::module_& m, const char* class_name) {
  using List = BuilderList<T>;
  py::class_<List>(m, class_name,
                   "Values of a ModelBuilder: a list of fixed length, writable before finalize.")
      .def("__len__", [](const List& list) { return list.values().size(); })
      .def(
          "__getitem__",
          [](const List& list, py::ssize_t index) {
            return to_python(list.values()[list_row(list, index)]);
          },
          "index"_a)
      .def(
          "__getitem__",
          [](const List& list, const py::slice& slice) {
            const auto& values = list.values();
            const Slice s = resolve(slice, values.size());
            py::list result;
            for (size_t k = 0; k < s.count; ++k)
              result.append(to_python(values[s.start + k * s.step]));
            return result;
          },
          "index"_a)
      .def(
          "__setitem__",
          [](const List& list, py::ssize_t index, py::handle value) {
            const size_t row = list_row(list, index);
            list.values()[row] = element_from<T>(value, list.name);
          },
          "index"_a, "value"_a)
      .def(
          "__setitem__",
          [](const List& list, const py::slice& slice, py::handle value) {
            auto& values = list.values();
            const Slice s = resolve(slice, values.size());
            const std::vector<T> given = list_from<T>(value, list.name);
            require(given.size() == s.count, ErrorKind::Value, list.name, ": expected ", s.count,
                    " values, got ", given.size());
            for (size_t k = 0; k < s.count; ++k) values[s.start + k * s.step] = given[k];
          },
          "index"_a, "value"_a)
      .def("__iter__", [](const List& list) { return py::iter(copy_of(list)); })
      .def("__eq__",
           [](const List& list, const py::object& other) {
             return copy_of(list).equal(py::isinstance<List>(other) ? py::list(other) : other);
           })
      .def("__repr__", [](const List& list) { return py::repr(copy_of(list)); });
}

template <class T>
void bind_builder_list(py::class_<ModelBuilder>& c, const char* name,
                       std::vector<T> ModelBuilder::*member, const char* doc) {
  c.def_property(
      name,
      [name, member](const py::object& self) {
        return BuilderList<T>{self, member, name};
      },
      [name, member](ModelBuilder& self, py::handle values) {
        std::vector<T> given = list_from<T>(values, name);
        require(given.size() == (self.*member).size(), ErrorKind::Value, name, ": expected ",
                (self.*member).size(), " values, got ", given.size());
        self.*member = std::move(given);
      },
      doc);
}

// ---------------------------------------------------------------- shapes

// add_shape_* options that may be None.
std::string text(const std::optional<std::string>& label) { return label.value_or(std::string()); }

void bind_worlds(py::class_<ModelBuilder>& c) {
  c.def_property_readonly("world_count", &ModelBuilder::world_count,
                          "The number of worlds. A model without worlds has one.")
      .def_property_readonly("current_world", &ModelBuilder::current_world,
                             "The open world; -1 outside of begin_world and end_world.")
      .def(
          "begin_world",
          [](ModelBuilder& b, py::handle gravity) {
            return gravity.is_none() ? b.begin_world() : b.begin_world(to_vec3(gravity, "gravity"));
          },
          py::kw_only(), "gravity"_a = py::none(), doc::kBeginWorld)
      .def(
          "set_fluid",
          [](ModelBuilder& b, float density, float viscosity, py::handle wind) {
            b.fluid = {density, viscosity, to_vec3(wind, "wind")};
          },
          py::kw_only(), "density"_a = 0.0f, "viscosity"_a = 0.0f,
          "wind"_a = py::make_tuple(0.0, 0.0, 0.0), doc::kSetFluid)
      .def("end_world", &ModelBuilder::end_world,
           "Closes the open world. novaphy.Error: no world is open.")
      .def(
          "add_builder",
          [](ModelBuilder& b, const ModelBuilder& builder, py::handle xform) {
            b.add_builder(builder, to_transform(xform, "xform"));
          },
          "builder"_a, "xform"_a = py::none(),
          "Adds copies of all objects of another builder to the current world, moved by `xform` "
          "(m, quaternion xyzw). The world gets the gravity of the other builder. Outside of "
          "worlds, this builder gets the gravity. ValueError: the up axes differ, `builder` is "
          "this builder, or the pose is not valid.")
      .def(
          "add_world",
          [](ModelBuilder& b, const ModelBuilder& builder, py::handle xform) {
            return b.add_world(builder, to_transform(xform, "xform"));
          },
          "builder"_a, "xform"_a = py::none(),
          "Adds a copy of a builder as a new world, moved by `xform` (m, quaternion xyzw). The "
          "same as begin_world, add_builder and end_world. Returns the index of the world.")
      .def(
          "replicate",
          [](ModelBuilder& b, const ModelBuilder& builder, int32_t world_count,
             py::handle spacing) {
            b.replicate(builder, world_count, to_vec3(spacing, "spacing"));
          },
          "builder"_a, "world_count"_a, "spacing"_a = py::make_tuple(0.0, 0.0, 0.0),
          "Adds `world_count` copies of a builder as new worlds, placed on a grid. `spacing` is "
          "the distance of neighboring worlds along x, y and z (m). The grid has one row along an "
          "axis whose spacing is 0. The grid is centered at the origin, except along the up axis, "
          "where it starts at 0.");
}

std::optional<Mat33f> to_inertia(py::handle value) {
  if (value.is_none()) return std::nullopt;
  Mat33f inertia;
  size_t count = 0;
  for (const py::handle row : py::iter(value)) {
    if (count < 3) to_floats(row, "inertia", inertia.m[count]);
    ++count;
  }
  require(count == 3, ErrorKind::Value, "inertia: expected 3 rows of 3 numbers, got ", count,
          " rows");
  return inertia;
}

void bind_bodies(py::class_<ModelBuilder>& c) {
  bind_builder_list(c, "body_q", &ModelBuilder::body_q,
                    "The initial poses of the bodies' origins (m, quaternion xyzw, world frame).");
  bind_builder_list(c, "body_qd", &ModelBuilder::body_qd,
                    "The initial velocities of the bodies, in the world frame: the velocity of the "
                    "center of mass (m/s), then the angular velocity (rad/s).");
  const auto bind = [&](const char* name, int32_t (ModelBuilder::*add)(const BodyArgs&),
                        const char* doc) {
    c.def(
        name,
        [add](ModelBuilder& b, py::handle xform, py::handle com, py::handle inertia, float mass,
              bool lock_inertia, bool is_kinematic, float gravcomp,
              const std::optional<std::string>& label) {
          BodyArgs args{.xform = to_transform(xform, "xform"),
                        .mass = mass,
                        .inertia = to_inertia(inertia),
                        .lock_inertia = lock_inertia,
                        .is_kinematic = is_kinematic,
                        .gravcomp = gravcomp,
                        .label = text(label)};
          if (!com.is_none()) args.com = to_vec3(com, "com");
          return (b.*add)(args);
        },
        py::kw_only(), "xform"_a = py::none(), "com"_a = py::none(), "inertia"_a = py::none(),
        "mass"_a = 0.0f, "lock_inertia"_a = false, "is_kinematic"_a = false, "gravcomp"_a = 0.0f,
        "label"_a = py::none(), doc);
  };
  bind("add_body", &ModelBuilder::add_body, doc::kAddBody);
  bind("add_link", &ModelBuilder::add_link,
       "Adds a body without a joint and returns its index. For the arguments see add_body. The "
       "mass may be 0. finalize raises ValueError if the link is not the child of a joint.");
}

}  // namespace

void bind_builder(py::module_& m) {
  bind_shape_config(m);
  bind_joint_dof_config(m);
  bind_list<Vec3f>(m, "_Vec3List");
  bind_list<float>(m, "_FloatList");
  bind_list<int32_t>(m, "_IntList");
  bind_list<Transformf>(m, "_TransformList");
  bind_list<SpatialVectorf>(m, "_SpatialVectorList");

  py::class_<ModelBuilder> c(m, "ModelBuilder", doc::kBuilder);
  c.def(py::init([](py::handle up_axis, py::handle gravity) {
          return ModelBuilder(to_axis(up_axis), to_gravity(gravity));
        }),
        "up_axis"_a = 2, "gravity"_a = py::none(),
        "Makes an empty builder. up_axis: an Axis, \"x\", \"y\" or \"z\". gravity (m/s^2): a "
        "vector in the world frame, or a number along the up axis. None: -9.81 along the up axis.");
  c.attr("ShapeConfig") = m.attr("ShapeConfig");
  c.def_property(
       "gravity", [](const ModelBuilder& b) { return to_tuple(b.gravity); },
       [](ModelBuilder& b, py::handle value) {
         if (PySequence_Check(value.ptr())) {
           b.gravity = to_vec3(value, "gravity");
         } else {
           b.gravity = b.up_vector() * to_float(value, "gravity");
         }
       },
       "The gravity (m/s^2, world frame). A number is set along the up axis.")
      .def_property_readonly(
          "up_axis", [](const ModelBuilder& b) { return static_cast<int>(b.up_axis()); },
          "The index of the up axis: 0, 1 or 2.")
      .def_property_readonly(
          "up_vector", [](const ModelBuilder& b) { return to_tuple(b.up_vector()); },
          "The unit vector of the up axis.")
      .def_readwrite("default_particle_radius", &ModelBuilder::default_particle_radius,
                     "The radius (m) of particles that are added without a radius.")
      .def_readwrite("default_shape_cfg", &ModelBuilder::default_shape_cfg,
                     "The ShapeConfig of shapes that are added without a cfg.")
      .def_readwrite("rigid_gap", &ModelBuilder::rigid_gap,
                     "The gap (m) of shapes whose ShapeConfig has the gap None.")
      .def_readwrite("balance_inertia", &ModelBuilder::balance_inertia, doc::kBalanceInertia)
      .def_readwrite("bound_mass", &ModelBuilder::bound_mass, doc::kBoundMass)
      .def_readwrite("bound_inertia", &ModelBuilder::bound_inertia, doc::kBoundInertia)
      .def("__repr__",
           [](const py::object& self) {
             std::string text = "ModelBuilder(", between;
#define NOVAPHY_COUNT_SO_FAR(name, doc)                                                    \
  if (const py::object n = py::getattr(self, #name, py::int_(0)); !n.equal(py::int_(0))) { \
    text += between + #name "=" + std::string(py::str(n));                                 \
    between = ", ";                                                                        \
  }
             NOVAPHY_MODEL_COUNTS(NOVAPHY_COUNT_SO_FAR)
#undef NOVAPHY_COUNT_SO_FAR
             return text + ")";
           })
      .def_property_readonly("particle_count", &ModelBuilder::particle_count,
                             "The number of particles.")
      .def_property_readonly("body_count", &ModelBuilder::body_count, "The number of bodies.")
      .def_property_readonly("shape_count", &ModelBuilder::shape_count, "The number of shapes.");
  bind_builder_list(c, "particle_q", &ModelBuilder::particle_q,
                    "The initial positions of the particles (m, world frame).");
  bind_builder_list(c, "particle_qd", &ModelBuilder::particle_qd,
                    "The initial velocities of the particles (m/s, world frame).");
  bind_builder_list(c, "particle_mass", &ModelBuilder::particle_mass,
                    "The masses of the particles (kg); 0: kinematic.");
  bind_builder_list(c, "particle_radius", &ModelBuilder::particle_radius,
                    "The radii of the particles (m).");
  bind_builder_list(c, "particle_flags", &ModelBuilder::particle_flags,
                    "The ParticleFlags of each particle.");
  bind_builder_list(c, "particle_world", &ModelBuilder::particle_world,
                    "The world of each particle; -1: all worlds.");

  c.def(
       "add_particle",
       [](ModelBuilder& b, py::handle pos, py::handle vel, float mass, std::optional<float> radius,
          int32_t flags) {
         return b.add_particle(to_vec3(pos, "pos"), to_vec3(vel, "vel"), mass, radius, flags);
       },
       "pos"_a, "vel"_a, "mass"_a, "radius"_a = py::none(),
       "flags"_a = static_cast<int32_t>(ParticleFlags::ACTIVE), doc::kAddParticle)
      .def(
          "add_particles",
          [](ModelBuilder& b, py::handle pos, py::handle vel, py::handle mass, py::handle radius,
             py::handle flags) {
            const std::vector<Vec3f> q = to_vec3_list(pos, "pos"), qd = to_vec3_list(vel, "vel");
            const std::vector<float> m_list = to_float_list(mass, "mass");
            std::vector<float> r;
            std::vector<int32_t> f;
            if (!radius.is_none()) r = to_float_list(radius, "radius");
            if (!flags.is_none()) f = to_int_list(flags, "flags");
            b.add_particles(q, qd, m_list, r, f);
          },
          "pos"_a, "vel"_a, "mass"_a, "radius"_a = py::none(), "flags"_a = py::none(),
          doc::kAddParticles);
  bind_builder_elements(c);
  bind_bodies(c);
  bind_builder_joints(c);
  bind_builder_list(c, "joint_q", &ModelBuilder::joint_q, doc::kBuilderJointQ);
  bind_builder_list(c, "joint_target_q", &ModelBuilder::joint_target_q,
                    "The position targets of the drives (m or rad).");
  bind_builder_list(c, "joint_target_mode", &ModelBuilder::joint_target_mode,
                    "The JointTargetMode of each dof.");
#define NOVAPHY_JOINT_LIST(name, type, width, count, unit, frame, doc) \
  bind_builder_list(c, #name, &ModelBuilder::name, "For each dof: " doc " (" unit ").");
  NOVAPHY_MODEL_JOINT_DOF_FIELDS(NOVAPHY_JOINT_LIST)
#undef NOVAPHY_JOINT_LIST
  bind_builder_shapes(c);
  bind_worlds(c);
  c.def(
      "finalize",
      [](const ModelBuilder& b, py::handle device, bool requires_grad, bool skip_validation) {
        return b.finalize(to_device(device),
                          {.requires_grad = requires_grad, .skip_validation = skip_validation});
      },
      "device"_a = py::none(), py::kw_only(), "requires_grad"_a = false,
      "skip_validation"_a = false, doc::kFinalize);
}

}  // namespace novaphy::python
