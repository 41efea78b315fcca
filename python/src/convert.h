// Conversions of Python values to engine values. If a conversion fails, the error names the
// argument: TypeError for a wrong type, ValueError for a wrong count. float64 numbers are rounded
// to float32.
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "gil.h"
#include "novaphy/core/device.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/math/types.h"

namespace novaphy::python {

namespace py = pybind11;
using namespace pybind11::literals;

// The functions that bind the parts of the module novaphy._core.
void bind_core(py::module_& m);
void bind_array(py::module_& m);
void bind_enums(py::module_& m);
void bind_sim(py::module_& m);
void bind_builder(py::module_& m);
void bind_shape_config(py::module_& m);
void bind_builder_shapes(py::class_<ModelBuilder>& builder);
void bind_builder_elements(py::class_<ModelBuilder>& builder);
void bind_joint_dof_config(py::module_& m);
void bind_builder_joints(py::class_<ModelBuilder>& builder);
void bind_builder_actuators(py::class_<ModelBuilder>& builder);
void bind_builder_rods(py::class_<ModelBuilder>& builder);
void bind_collision(py::module_& m);
void bind_dynamics(py::module_& m, py::module_& solvers);
void bind_featherstone(py::module_& m, py::module_& solvers);
void bind_io(py::module_& io);
void bind_robots(py::class_<ModelBuilder>& builder, py::module_& io);
void bind_array_gradient(py::class_<Array>& array);  // requires_grad and grad of DeviceArray
void bind_nova_tensor(py::module_& nova);
void bind_nova(py::module_& nova);
void bind_nova_tape(py::module_& nova);
void bind_nova_optim(py::module_& nova);
void bind_nova_trace(py::module_& nova);
void bind_nova_kernel(py::module_& nova);
void bind_vbd(py::module_& solvers);
void bind_diff(py::module_& diff, py::module_& solvers);
void bind_diff_featherstone(py::module_& diff, py::module_& solvers);
void bind_event_times(py::module_& diff);

// Makes TypeErrors of all functions of the module name the wrong argument (argument_errors.cpp).
// Call the function after all bindings are made.
void explain_argument_errors(py::module_& m);

// Returns the name of a value's type, such as "str" or "numpy.ndarray".
std::string type_name(py::handle value);

float to_float(py::handle value, const char* name);
int32_t to_int32(py::handle value, const char* name);
// Reads exactly out.size() numbers from a tuple, list, array or other sequence.
void to_floats(py::handle value, const char* name, std::span<float> out);
Vec3f to_vec3(py::handle value, const char* name);
Vec4f to_vec4(py::handle value, const char* name);
// Reads (px, py, pz, qx, qy, qz, qw), or a pair (position, quaternion). None: the identity.
Transformf to_transform(py::handle value, const char* name);
// Returns cfg with another color. color None: the color of cfg. cfg null: the builder's default.
ShapeConfig shape_config(const ModelBuilder& builder, const ShapeConfig* cfg, py::handle color);
std::vector<Vec3f> to_vec3_list(py::handle value, const char* name);
std::vector<float> to_float_list(py::handle value, const char* name);
std::vector<int32_t> to_int_list(py::handle value, const char* name);

// Reads a Device or the name of a device. None: the default device.
Device to_device(py::handle value);
// Reads an axis: 0, 1, 2, "x", "y", "z" or a unit vector along an axis.
Axis to_axis(py::handle value);
// Reads a gravity (m/s^2): a vector, or a number along the up axis. None: -9.81 along the up axis.
GravitySpec to_gravity(py::handle value);

// An element type as a Python object, such as novaphy.vec3. Each type has a single object.
struct DTypeObject {
  DType dtype;
};
py::object dtype_object(DType dtype);
// Reads a dtype object, its name, or the NumPy dtype of a scalar.
DType to_dtype(py::handle value);

// Returns a vector as a tuple of three numbers.
py::tuple to_tuple(const Vec3f& value);

// Objects of the module numpy, which is imported at the first use.
struct NumPy {
  py::object asarray, empty, generic, dtype, iinfo;
  py::object scalars[5];  // NumPy dtypes, indexed by novaphy::Scalar
};
const NumPy& numpy();
const py::object& numpy_dtype(Scalar scalar);

// Access to the bytes of a contiguous NumPy array during the lifetime of the object.
class BufferView {
 public:
  BufferView(py::handle array, bool writable) {
    const int flags = PyBUF_C_CONTIGUOUS | (writable ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(array.ptr(), &buffer_, flags) != 0) throw py::error_already_set();
  }
  ~BufferView() { PyBuffer_Release(&buffer_); }
  BufferView(const BufferView&) = delete;
  BufferView& operator=(const BufferView&) = delete;
  void* data() const { return buffer_.buf; }
  size_t bytes() const { return static_cast<size_t>(buffer_.len); }

 private:
  Py_buffer buffer_{};
};

}  // namespace novaphy::python
