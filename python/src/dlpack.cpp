// DLPack: exchange of arrays with NumPy, PyTorch, JAX, ... without a copy. The structs are those of
// the public DLPack ABI, in the old form without a version and in version 1.0
// (https://dmlc.github.io/dlpack).
#include <cstring>

#include "exchange.h"

namespace novaphy::python {
namespace {

struct DLDevice {
  int32_t type;
  int32_t id;
};
struct DLDataType {
  uint8_t code;
  uint8_t bits;
  uint16_t lanes;
};
struct DLTensor {
  void* data;
  DLDevice device;
  int32_t ndim;
  DLDataType dtype;
  int64_t* shape;
  int64_t* strides;  // in elements; null: row-major without gaps
  uint64_t byte_offset;
};
struct DLManagedTensor {
  DLTensor tensor;
  void* manager;
  void (*deleter)(DLManagedTensor*);
};
struct DLVersion {
  uint32_t major;
  uint32_t minor;
};
struct DLManagedTensorVersioned {
  DLVersion version;
  void* manager;
  void (*deleter)(DLManagedTensorVersioned*);
  uint64_t flags;
  DLTensor tensor;
};
constexpr uint64_t kReadOnly = 1, kIsCopied = 2;
constexpr int32_t kCpu = 1, kCuda = 2, kExtension = 12;
constexpr uint8_t kInt = 0, kUint = 1, kFloat = 2, kBool = 6;
constexpr const char* kName = "dltensor";
constexpr const char* kVersionedName = "dltensor_versioned";

[[noreturn]] void buffer_error(const std::string& message) {
  PyErr_SetString(PyExc_BufferError, message.c_str());
  throw py::error_already_set();
}

DLDevice dl_device_of(Device device) {
  const int32_t type = device.is_cpu()                   ? kCpu
                       : device.type == DeviceType::CUDA ? kCuda
                                                         : kExtension;
  return {type, device.ordinal};
}

DLDataType dl_type_of(Scalar scalar) {
  const auto bits = static_cast<uint8_t>(8 * scalar_bytes(scalar));
  return {scalar == Scalar::F32 ? kFloat : scalar == Scalar::I32 ? kInt : kUint, bits, 1};
}

// The memory that an exported tensor points to, and its owner.
struct Exported {
  std::shared_ptr<Range> range;
  std::shared_ptr<void> writable;  // marks the memory as writable by others: PyTorch ignores the
                                   // read-only flag of the protocol
  std::vector<int64_t> shape, strides;
};

DLTensor describe(const View& view, Exported& owner) {
  owner.range = view.range;
  owner.shape = view.shape;
  for (const int64_t bytes : view.strides())
    owner.strides.push_back(bytes / static_cast<int64_t>(scalar_bytes(view.scalar)));
  return {.data = view.range ? view.range->data() : nullptr,
          .device = dl_device_of(view.device()),
          .ndim = static_cast<int32_t>(view.shape.size()),
          .dtype = dl_type_of(view.scalar),
          .shape = owner.shape.data(),
          .strides = owner.strides.data(),
          .byte_offset = 0};
}

// The destructor of a capsule: frees the managed tensor if no consumer has taken it.
template <class Managed>
void destroy_capsule(PyObject* capsule) {
  const char* name = PyCapsule_GetName(capsule);
  if (name == nullptr || std::strncmp(name, "used_", 5) == 0) return;
  auto* managed = static_cast<Managed*>(PyCapsule_GetPointer(capsule, name));
  if (managed != nullptr && managed->deleter != nullptr) managed->deleter(managed);
}

template <class Managed>
Managed* make_managed(const View& view, bool shared) {
  auto owner = std::make_unique<Exported>();
  if (shared && view.bytes() != 0) owner->writable = view.range->writable_export_scope();
  auto managed = std::make_unique<Managed>();
  managed->tensor = describe(view, *owner);
  managed->manager = owner.release();
  managed->deleter = [](Managed* self) {
    delete static_cast<Exported*>(self->manager);
    delete self;
  };
  return managed.release();
}

py::object steal_capsule(void* managed, const char* name, PyCapsule_Destructor destructor) {
  PyObject* capsule = PyCapsule_New(managed, name, destructor);
  if (capsule == nullptr) throw py::error_already_set();
  return py::reinterpret_steal<py::object>(capsule);
}

Scalar scalar_of(const DLDataType& type) {
  if (type.lanes == 1) {
    if (type.code == kFloat && type.bits == 32) return Scalar::F32;
    if (type.code == kInt && type.bits == 32) return Scalar::I32;
    if (type.code == kUint && type.bits == 32) return Scalar::U32;
    if (type.code == kUint && type.bits == 64) return Scalar::U64;
    if ((type.code == kUint || type.code == kBool) && type.bits == 8) return Scalar::U8;
  }
  fail(ErrorKind::Type,
       "from_dlpack: expected float32, int32, uint32, uint64 or uint8, got type code ",
       static_cast<int>(type.code), " of ", static_cast<int>(type.bits), " bits");
}

Device device_of(const DLDevice& device) {
  if (device.type == kCpu) return Device::cpu();
  if (device.type == kCuda) return Device::cuda(device.id);
  if (device.type == kExtension) return {DeviceType::DLAN, device.id};
  fail(ErrorKind::Value, "from_dlpack: no device for DLPack device type ", device.type);
}

// Takes a managed tensor out of its capsule, as memory of the engine. When the memory is freed, the
// deleter of the managed tensor runs.
template <class Managed>
View adopt(PyObject* capsule, const char* name, const char* used_name, bool copy) {
  auto* managed = static_cast<Managed*>(PyCapsule_GetPointer(capsule, name));
  if (managed == nullptr) throw py::error_already_set();
  if constexpr (std::is_same_v<Managed, DLManagedTensorVersioned>) {
    require(managed->version.major == 1, ErrorKind::Value,
            "from_dlpack: expected DLPack version 1, got ", managed->version.major);
    if ((managed->flags & kReadOnly) && !copy)
      buffer_error("from_dlpack: the memory is read-only; pass copy=True");
  }
  const DLTensor& t = managed->tensor;
  View view;
  view.scalar = scalar_of(t.dtype);
  view.shape.assign(t.shape, t.shape + t.ndim);
  const std::vector<int64_t> packed = view.strides();
  const auto item = static_cast<int64_t>(scalar_bytes(view.scalar));
  for (int32_t k = 0; t.strides != nullptr && k < t.ndim; ++k)
    require(view.shape[static_cast<size_t>(k)] <= 1 || view.size() == 0 ||
                t.strides[k] * item == packed[static_cast<size_t>(k)],
            ErrorKind::Value, "from_dlpack: expected tightly packed rows; pass a contiguous copy");
  auto* data = static_cast<unsigned char*>(t.data) + t.byte_offset;
  if (view.bytes() == 0) data = nullptr;
  require(reinterpret_cast<uintptr_t>(data) % static_cast<uintptr_t>(item) == 0, ErrorKind::Value,
          "from_dlpack: the memory is not aligned to ", item, " bytes");
  const Device device = device_of(t.device);
  require_device(device);
  if (PyCapsule_SetName(capsule, used_name) != 0) throw py::error_already_set();
  std::shared_ptr<void> owner(managed, [](void* p) {
    if (!Py_IsInitialized()) return;
    const py::gil_scoped_acquire gil;
    auto* self = static_cast<Managed*>(p);
    if (self->deleter != nullptr) self->deleter(self);
  });
  view.range = Storage::external(data, view.bytes(), device, std::move(owner))->range();
  if (copy) {
    view.range = view.flat().clone().range();
  } else if (view.bytes() != 0) {
    view.range->mark_writable_export();
  }
  return view;
}

}  // namespace

py::tuple dlpack_device(const View& view) {
  const DLDevice device = dl_device_of(view.device());
  return py::make_tuple(device.type, device.id);
}

py::object export_dlpack(const View& view, py::handle stream, py::handle max_version,
                         py::handle dl_device, py::handle copy) {
  const DLDevice own = dl_device_of(view.device());
  if (!dl_device.is_none()) {
    const auto wanted = dl_device.cast<std::pair<int32_t, int32_t>>();
    if (wanted.first != own.type || wanted.second != own.id)
      buffer_error("__dlpack__: the array is on another device");
  }
  require(stream.is_none() || own.type != kCpu, ErrorKind::Value,
          "__dlpack__, stream: expected None on the cpu");
  if (ArrayObserver* observer = array_observer()) observer->host_read("__dlpack__");
  // Stream -1 of the protocol means that the consumer needs no synchronization. 0 is not allowed.
  // The host waits for the device here, so afterwards every stream may use the memory.
  const int64_t consumer = stream.is_none() ? 1 : stream.cast<int64_t>();
  require(consumer >= -1 && consumer != 0, ErrorKind::Value,
          "__dlpack__, stream: expected None, -1, 1, 2 or a stream's address, got ", consumer);
  if (consumer != -1) synchronize(view.device());

  const bool copied = !copy.is_none() && copy.cast<bool>();
  View exported = view;
  if (copied && view.range != nullptr) exported.range = view.flat().clone().range();
  bool versioned = false;
  if (!max_version.is_none()) versioned = max_version.cast<std::pair<int, int>>().first >= 1;
  if (versioned) {
    auto* managed = make_managed<DLManagedTensorVersioned>(exported, !copied);
    managed->version = {1, 0};
    managed->flags = copied ? kIsCopied : kReadOnly;
    return steal_capsule(managed, kVersionedName, &destroy_capsule<DLManagedTensorVersioned>);
  }
  return steal_capsule(make_managed<DLManagedTensor>(exported, !copied), kName,
                       &destroy_capsule<DLManagedTensor>);
}

View import_dlpack(py::handle source, bool copy) {
  require(PyObject_HasAttrString(source.ptr(), "__dlpack__") != 0, ErrorKind::Type,
          "from_dlpack: expected an object with __dlpack__, got ", type_name(source));
  // The engine uses the memory in the order of the device's default stream, which has the number 1
  // in the protocol. The producer makes this stream wait for the producer's pending work.
  py::dict stream;
  if (PyObject_HasAttrString(source.ptr(), "__dlpack_device__") != 0 &&
      source.attr("__dlpack_device__")().cast<std::pair<int32_t, int32_t>>().first == kCuda)
    stream["stream"] = 1;
  py::object capsule;
  bool knows_version_1 = true;
  try {
    capsule = source.attr("__dlpack__")("max_version"_a = py::make_tuple(1, 0), **stream);
  } catch (py::error_already_set& error) {
    if (!error.matches(PyExc_TypeError)) throw;
    // The producer has no argument max_version: it is older than DLPack 1.0, such as NumPy 1. Such
    // producers export only writable memory.
    capsule = source.attr("__dlpack__")(**stream);
    knows_version_1 = false;
  }
  if (PyCapsule_IsValid(capsule.ptr(), kVersionedName))
    return adopt<DLManagedTensorVersioned>(capsule.ptr(), kVersionedName, "used_dltensor_versioned",
                                           copy);
  require(PyCapsule_IsValid(capsule.ptr(), kName) != 0, ErrorKind::Type,
          "from_dlpack: __dlpack__ gave no DLPack capsule");
  // A producer that supports version 1.0 may still return a capsule without flags, as JAX does for
  // its immutable arrays. Such memory may be read-only. NumPy treats it as read-only, too.
  if (knows_version_1 && !copy)
    buffer_error(
        "from_dlpack: the producer does not say whether the memory may be written (a DLPack "
        "capsule without flags); pass copy=True");
  return adopt<DLManagedTensor>(capsule.ptr(), kName, "used_dltensor", copy);
}

}  // namespace novaphy::python
