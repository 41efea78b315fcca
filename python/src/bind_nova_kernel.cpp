// Bindings of kernels that are made from traced Python functions.
#include "doc_nova_kernel.h"
#include "nova_types.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::python {

using nova::Int;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

namespace {

// The TraceContext as a Python object. The pointer is set to null when the traced function returns,
// because a Python function may keep its argument for longer than the C++ object lives.
struct PyContext {
  TraceContext* context;
  TraceContext& get() const {
    require(context != nullptr, ErrorKind::Runtime,
            "TraceContext: the kernel is made, nothing more can be traced");
    return *context;
  }
};

// Calls fn(context, more...) and closes the context afterwards.
template <class... More>
py::object trace(const py::object& fn, TraceContext& c, More&&... more) {
  const auto shared = std::make_shared<PyContext>(PyContext{&c});
  struct Close {
    PyContext& context;
    ~Close() { context.context = nullptr; }
  } close{*shared};
  return fn(py::cast(shared), std::forward<More>(more)...);
}

// Returns the number of a source, given by its name ("particle_q") or by its number.
size_t source_number(const TraceContext& c, py::handle source) {
  if (PyUnicode_Check(source.ptr())) return c.source(source.cast<std::string>());
  const int32_t number = to_int32(source, "source");
  require(number >= 0, ErrorKind::Index, "source: expected a name or a number >= 0, got ", number);
  return static_cast<size_t>(number);
}

void bind_context(py::module_& m) {
  py::class_<PyContext, std::shared_ptr<PyContext>>(
      m, "TraceContext",
      "The argument of a traced function, through which the function reads its sources. A source "
      "is given by its name or index. A method without the argument `row` reads the row that the "
      "declared access gives, for example row i for \"direct\".")
      .def(
          "index", [](const PyContext& c) { return c.get().index(); }, "Returns the output row i.")
      .def(
          "reduce_index", [](const PyContext& c) { return c.get().reduce_index(); },
          "Returns the index r of the term of a sum. Only for the body of a sum.")
      .def(
          "slot", [](const PyContext& c) { return c.get().slot(); },
          "Returns the slot (entry of the index table) of the term. Only for the body of a sum "
          "over \"csr_row\" sources.")
      .def(
          "f32",
          [](const PyContext& c, py::handle source, int32_t column) {
            return c.get().f32(source_number(c.get(), source), column);
          },
          "source"_a, "column"_a = 0,
          "Returns the value of a float column, at the row that the declared access gives.")
      .def(
          "f32",
          [](const PyContext& c, py::handle source, const Int& row, int32_t column) {
            return c.get().f32(source_number(c.get(), source), row, column);
          },
          "source"_a, "row"_a, "column"_a,
          "Returns the value of a float column at a row, which the declared access must allow.")
      .def(
          "i32",
          [](const PyContext& c, py::handle source, int32_t column) {
            return c.get().i32(source_number(c.get(), source), column);
          },
          "source"_a, "column"_a = 0,
          "Returns the value of an integer column, at the row that the declared access gives.")
      .def(
          "i32",
          [](const PyContext& c, py::handle source, const Int& row, int32_t column) {
            return c.get().i32(source_number(c.get(), source), row, column);
          },
          "source"_a, "row"_a, "column"_a,
          "Returns the value of an integer column at a row, which the declared access must allow.")
      .def(
          "param", [](const PyContext& c, int32_t k) { return c.get().param(k); }, "k"_a,
          "Returns the launch parameter number k as a float.")
      .def(
          "param_i32", [](const PyContext& c, int32_t k) { return c.get().param_i32(k); }, "k"_a,
          "Returns the launch parameter number k as an int.");
}

std::vector<Real> reals(const py::object& result, const char* what) {
  std::vector<Real> values;
  const auto add = [&](py::handle value) {
    py::detail::make_caster<Real> real;  // converts plain numbers too
    require(!value.is_none() && real.load(value, true), ErrorKind::Type, what,
            ": expected Real values, got ", type_name(value));
    values.push_back(py::detail::cast_op<const Real&>(real));
  };
  if (py::isinstance<py::tuple>(result) || py::isinstance<py::list>(result)) {
    for (const py::handle value : result) add(value);
  } else {
    add(result);
  }
  return values;
}

nova::Access to_access(py::handle value) {
  constexpr std::pair<const char*, nova::Access> names[] = {{"direct", nova::Access::Direct},
                                                            {"uniform", nova::Access::Uniform},
                                                            {"indexed", nova::Access::Indexed},
                                                            {"csr_row", nova::Access::CsrRow},
                                                            {"reduced", nova::Access::Reduced}};
  require(PyUnicode_Check(value.ptr()) != 0, ErrorKind::Type, "access: expected a name, got ",
          type_name(value));
  const auto text = value.cast<std::string>();
  for (const auto& [name, access] : names)
    if (text == name) return access;
  fail(ErrorKind::Value,
       "access: expected \"direct\", \"uniform\", \"indexed\", \"csr_row\" or \"reduced\", got \"",
       text, "\"");
}

// Reads the sources of a kernel: tuples (name, dtype, width=1, access="direct").
std::vector<nova::SourceSpec> to_sources(const py::sequence& sources) {
  std::vector<nova::SourceSpec> specs;
  for (const py::handle item : sources) {
    require(py::isinstance<py::tuple>(item) || py::isinstance<py::list>(item), ErrorKind::Type,
            "sources: expected tuples (name, dtype, width, access), got ", type_name(item));
    const auto parts = py::reinterpret_borrow<py::sequence>(item);
    require(parts.size() >= 2 && parts.size() <= 4, ErrorKind::Value,
            "sources: expected (name, dtype, width, access), got ", parts.size(), " parts");
    nova::SourceSpec spec;
    spec.name = py::object(parts[0]).cast<std::string>();
    spec.dtype = to_nova_dtype(py::object(parts[1]));
    if (parts.size() > 2) spec.width = to_int32(py::object(parts[2]), "width");
    if (parts.size() > 3) spec.access = to_access(py::object(parts[3]));
    specs.push_back(std::move(spec));
  }
  return specs;
}

// Reads the outputs: the number of columns of a single output "out", or a list of (name, width).
std::vector<nova::OutputSpec> to_outputs(py::handle outputs) {
  if (PyIndex_Check(outputs.ptr())) return {{"out", to_int32(outputs, "outputs")}};
  std::vector<nova::OutputSpec> specs;
  for (const py::handle item : outputs.cast<py::sequence>()) {
    const auto [name, width] = item.cast<std::pair<std::string, int32_t>>();
    specs.push_back({name, width});
  }
  return specs;
}

// ---------------------------------------------------------------- kernels

struct PyKernel {
  nova::Kernel kernel;
  std::vector<bool> param_is_int;  // for each launch parameter: whether the function reads an int
};

PyKernel finish(nova::Kernel kernel) {
  PyKernel made{std::move(kernel), {}};
  for (const nova::ir::Instr& in : made.kernel.traced().instrs) {
    if (in.op != nova::ir::Op::PARAM_I) continue;
    const auto k = static_cast<size_t>(in.a);
    if (k >= made.param_is_int.size()) made.param_is_int.resize(k + 1);
    made.param_is_int[k] = true;
  }
  return made;
}

PyKernel make_indexed(const std::string& name, const py::sequence& sources, py::handle outputs,
                      const py::function& fn) {
  return finish(nova::make_kernel(name, to_sources(sources), to_outputs(outputs),
                                  [&fn](TraceContext& c) { return reals(trace(fn, c), "fn"); }));
}

PyKernel make_reduce(const std::string& name, const py::sequence& sources, py::handle outputs,
                     const py::function& body, const py::object& init, const py::object& epilogue) {
  nova::ReduceFns fns;
  fns.body = [&body](TraceContext& c) { return reals(trace(body, c), "body"); };
  if (!init.is_none())
    fns.init = [&init](TraceContext& c) { return reals(trace(init, c), "init"); };
  if (!epilogue.is_none())
    fns.epilogue = [&epilogue](TraceContext& c, std::span<const Real> sums) {
      py::tuple given(sums.size());
      for (size_t k = 0; k < sums.size(); ++k) given[k] = py::cast(sums[k]);
      return reals(trace(epilogue, c, given), "epilogue");
    };
  return finish(nova::make_reduce_kernel(name, to_sources(sources), to_outputs(outputs), fns));
}

std::vector<Tensor> call(const PyKernel& k, int64_t dim, const std::vector<Tensor>& inputs,
                         const py::sequence& params, std::optional<int32_t> extent,
                         const std::shared_ptr<nova::IncidenceData>& csr,
                         const std::optional<Tensor>& active) {
  std::vector<nova::Param> words;
  for (size_t p = 0; p < params.size(); ++p) {
    const py::object value = params[p];
    if (p < k.param_is_int.size() && k.param_is_int[p]) {
      words.emplace_back(to_int32(value, "params"));
    } else {
      words.emplace_back(to_float(value, "params"));
    }
  }
  const nova::Incidence incidence = csr;
  const nova::Operand count = active ? active->flat_operand() : nova::Operand();
  const ReleasedGil release;
  return k.kernel(dim, inputs,
                  {.params = words,
                   .extent = extent.value_or(nova::LaunchOptions().extent),
                   .csr = csr ? &incidence : nullptr,
                   .active = active ? &count : nullptr});
}

py::object items_to_numpy(const std::shared_ptr<Range>& range) {
  return copy_to_numpy(
      {range, Scalar::I32, {static_cast<int64_t>(range->bytes() / sizeof(int32_t))}});
}

}  // namespace

void bind_nova_kernel(py::module_& m) {
  bind_context(m);

  py::class_<nova::IncidenceData, std::shared_ptr<nova::IncidenceData>>(m, "Incidence",
                                                                        doc::kIncidence)
      .def_property_readonly(
          "rows", [](const nova::IncidenceData& i) { return i.rows; }, "The number of rows.")
      .def_property_readonly(
          "offsets", [](const nova::IncidenceData& i) { return items_to_numpy(i.offsets); },
          "int32 {rows + 1}: the slots of row i are items[offsets[i] : offsets[i + 1]].")
      .def_property_readonly(
          "items", [](const nova::IncidenceData& i) { return items_to_numpy(i.items); },
          "The slots of all rows, row by row: int32 {slots}.")
      .def(
          "rebuild", [](const nova::Incidence& i) { nova::rebuild(i); }, release_gil(),
          doc::kRebuild);
  m.def(
      "make_incidence",
      [](const Tensor& table, int64_t rows) {
        require(table.dtype() == nova::DType::I32, ErrorKind::Type,
                "make_incidence, table: expected int32, got ", nova::dtype_name(table.dtype()));
        return nova::make_incidence(table.flat_operand(), rows);
      },
      "table"_a, "rows"_a, release_gil(),
      "Returns the Incidence of an int32 table of row indices. Negative entries are ignored. "
      "IndexError: an entry is >= rows.");

  py::class_<PyKernel>(m, "IndexedKernel",
                       "A kernel that a Python function was traced to, with generated adjoints. "
                       "Call the object to run the kernel on tensors.")
      .def("__call__", &call, "dim"_a, "inputs"_a, "params"_a = py::tuple(),
           "extent"_a = py::none(), "csr"_a = py::none(), "active"_a = py::none(), doc::kLaunch)
      .def_property_readonly(
          "name", [](const PyKernel& k) { return k.kernel.name(); }, "The name of the kernel.")
      .def_property_readonly(
          "hash", [](const PyKernel& k) { return k.kernel.hash(); },
          "A 64-bit hash of the computation. Kernels with equal computations have equal hashes.")
      .def(
          "source",
          [](const PyKernel& k, const std::string& form) { return k.kernel.source(form); },
          "form"_a = "c",
          "Returns the kernel as text. form: \"c\": the generated C code. \"program\": the "
          "Program. ValueError: another form.")
      .def("__repr__",
           [](const PyKernel& k) { return "IndexedKernel('" + k.kernel.name() + "')"; });
  py::class_<nova::KernelInfo>(m, "KernelInfo", "How a Program (kernel) runs on a device.")
      .def_readonly("name", &nova::KernelInfo::name,
                    "The name of the kernel; adjoints end in \".adjoint\" or \".adjoint_items\".")
      .def_readonly("hash", &nova::KernelInfo::hash, "The hash of the Program.")
      .def_property_readonly(
          "device", [](const nova::KernelInfo& i) { return i.device.str(); },
          "The name of the device, such as \"cpu\".")
      .def_readonly("how", &nova::KernelInfo::how,
                    "\"native\" (compiled), \"interpreter\", or \"unknown\" if the backend does "
                    "not report it.")
      .def_readonly("isa", &nova::KernelInfo::isa, "The instruction set, such as \"avx2\".")
      .def_readonly("lanes", &nova::KernelInfo::lanes, "The number of rows per SIMD vector.")
      .def("__repr__", [](const nova::KernelInfo& i) {
        return "KernelInfo(name='" + i.name + "', device='" + i.device.str() + "', how='" + i.how +
               "', isa='" + i.isa + "', lanes=" + std::to_string(i.lanes) + ")";
      });
  m.def(
      "kernel_info", [] { return nova::kernel_info(); },
      "Returns a list with a KernelInfo for each kernel and adjoint that was prepared for a "
      "device, in the order of preparation.");
  m.def("make_indexed_kernel", &make_indexed, "name"_a, "sources"_a, "outputs"_a, "fn"_a,
        doc::kMap);
  m.def("make_reduce_kernel", &make_reduce, "name"_a, "sources"_a, "outputs"_a, "body"_a,
        py::kw_only(), "init"_a = py::none(), "epilogue"_a = py::none(), doc::kReduce);
}

}  // namespace novaphy::python
