// Reads tensor[...] with NumPy's basic indices and one table of rows, recorded on an active tape.
#include "nova_types.h"
#include "novaphy/nova/ops.h"

namespace novaphy::python {

using nova::Tensor;

namespace {

nova::Shape shape_of(py::handle array) { return array.attr("shape").cast<nova::Shape>(); }

bool is_table(py::handle key) {
  return py::isinstance<nova::TensorImpl>(key) || PyList_Check(key.ptr()) ||
         py::isinstance(key, py::module_::import("numpy").attr("ndarray"));
}

// Converts an index of rows to int32 row indices. The index is a Tensor, list or NumPy array of row
// numbers, or has one truth value for each row.
Tensor to_row_table(py::handle key, int64_t rows, const Device& device) {
  if (py::isinstance<nova::TensorImpl>(key)) return key.cast<Tensor>();
  const py::module_ np = py::module_::import("numpy");
  py::object entries = np.attr("asarray")(key);
  const std::string kind = py::str(entries.attr("dtype").attr("kind"));
  const bool empty = entries.attr("size").cast<int64_t>() == 0;
  require(kind == "i" || kind == "u" || kind == "b" || empty, ErrorKind::Type,
          "index: expected integers or truth values, got ",
          std::string(py::str(entries.attr("dtype"))));
  if (kind == "b") {
    require(shape_of(entries) == nova::Shape{rows}, ErrorKind::Index,
            "index: expected one truth value for each of ", rows, " rows, got shape ",
            shape_text(shape_of(entries)));
    entries = np.attr("flatnonzero")(entries);
  }
  const py::object outside = np.attr("flatnonzero")(np.attr("logical_or")(
      np.attr("less")(entries, -rows), np.attr("greater_equal")(entries, rows)));
  if (py::len(outside) != 0)
    fail(ErrorKind::Index, "index: expected ", -rows, " to ", rows - 1, " along axis 0, got ",
         std::string(py::str(entries.attr("flat")[outside[py::int_(0)]])), " at entry ",
         std::string(py::str(outside[py::int_(0)])));
  entries = entries.attr("astype")("int64");
  entries = np.attr("where")(np.attr("less")(entries, 0), np.attr("add")(entries, rows), entries);
  const Tensor table(shape_of(entries), nova::DType::I32, device);
  if (table.size() != 0) assign_host_values(view_of(table), entries, "index");
  return table;
}

// Returns the number of dimensions that the parts of an index refer to, without "...". A table of
// rows refers to one.
size_t count_dimensions(const py::tuple& parts, size_t ndim) {
  size_t count = 0, ellipses = 0;
  for (const py::handle part : parts) (part.is(py::ellipsis()) ? ellipses : count) += 1;
  require(ellipses <= 1, ErrorKind::Index, "index: expected one ... at most, got ", ellipses);
  require(count <= ndim, ErrorKind::Index, "index: expected at most ", ndim, " indices, got ",
          count);
  return count;
}

// Applies the parts of an index to one dimension after the other. A dimension with an integer index
// keeps the size 1, and is removed at the end.
class Indexing {
 public:
  explicit Indexing(const Tensor& x) : now_(x), dropped_(x.ndim(), false) {}

  void skip(size_t dimensions) { axis_ += dimensions; }
  void table(py::handle key) {
    require(axis_ == 0, ErrorKind::Index, "index: a table of rows comes first, and there is one");
    const Tensor table = to_row_table(key, now_.dim(0), now_.device());
    const ReleasedGil release;
    now_ = nova::gather(now_, table);
    axis_ = table.ndim();
    dropped_.assign(now_.ndim(), false);
  }
  void range(py::handle key) {
    py::ssize_t start = 0, stop = 0, step = 0;
    if (PySlice_Unpack(key.ptr(), &start, &stop, &step) < 0) throw py::error_already_set();
    const py::ssize_t count = PySlice_AdjustIndices(now_.dim(axis_), &start, &stop, step);
    if (!(start == 0 && step == 1 && count == now_.dim(axis_))) read(start, count, step);
    ++axis_;
  }
  void entry(py::handle key) {
    const bool is_integer = PyIndex_Check(key.ptr()) && !PyBool_Check(key.ptr());
    require(is_integer, ErrorKind::Type,
            "index: expected integers, slices, ... or a table of rows, got ", type_name(key));
    const py::ssize_t given = PyNumber_AsSsize_t(key.ptr(), PyExc_IndexError);
    if (given == -1 && PyErr_Occurred()) throw py::error_already_set();
    const int64_t entries = now_.dim(axis_);
    require(given >= -entries && given < entries, ErrorKind::Index, "index: expected ", -entries,
            " to ", entries - 1, " along axis ", axis_, ", got ", given);
    read(given < 0 ? given + entries : given, 1, 1);
    dropped_[axis_++] = true;
  }
  Tensor result(const Tensor& x) const {
    if (now_.range() == x.range()) return x.clone();
    nova::Shape shape;
    for (size_t d = 0; d < now_.ndim(); ++d)
      if (!dropped_[d]) shape.push_back(now_.dim(d));
    if (shape.empty()) shape.push_back(1);  // a single value
    return now_.reshape(shape);
  }

 private:
  void read(int64_t start, int64_t count, int64_t step) {
    const ReleasedGil release;
    now_ = nova::slice(now_, static_cast<int64_t>(axis_), start, count, step);
  }

  Tensor now_;
  std::vector<bool> dropped_;
  size_t axis_ = 0;
};

}  // namespace

Tensor get_item(const Tensor& x, py::handle key) {
  const py::tuple parts =
      PyTuple_Check(key.ptr()) ? py::reinterpret_borrow<py::tuple>(key) : py::make_tuple(key);
  const size_t given = count_dimensions(parts, x.ndim());
  Indexing indexing(x);
  for (const py::handle part : parts) {
    if (part.is(py::ellipsis())) {
      indexing.skip(x.ndim() - given);
    } else if (is_table(part)) {
      indexing.table(part);
    } else if (PySlice_Check(part.ptr())) {
      indexing.range(part);
    } else {
      indexing.entry(part);
    }
  }
  return indexing.result(x);
}

}  // namespace novaphy::python
