// Kernels from traced functions, with generated adjoints.
//
//   auto scale = nova::make_indexed_expr_kernel_typed_access_n(
//       "scale", {{"x", DType::F32, 3, Access::Direct}, {"s", DType::F32, 1, Access::Uniform}}, 3,
//       [](nova::TraceContext& c) { ... return std::vector<nova::Real>{...}; });
//   std::vector<nova::Tensor> y = scale(n, {x, s});
//
// An active Tape records a call if an input carries a gradient, and Tape::backward runs the
// adjoint.
#pragma once

#include <bit>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "novaphy/core/backend.h"
#include "novaphy/nova/adjoint.h"
#include "novaphy/nova/incidence.h"
#include "novaphy/nova/tensor.h"
#include "novaphy/nova/trace.h"

namespace nova {

using ir::Access;

// How a kernel reads a source at output row i.
//   Direct   row i                          Uniform  row 0
//   Indexed  row = an entry of an i32 source (a computed row is legal, but has no gradient)
//   CsrRow   the slots of row i of an Incidence, one per step of the sum
//   Reduced  row r of a sum over r < extent
struct SourceSpec {
  std::string name;
  DType dtype = DType::F32;
  int32_t width = 1;
  Access access = Access::Direct;
};
struct OutputSpec {
  std::string name;
  int32_t width = 1;
  // The source of the next launch that reads this output, when launches follow each other: the
  // state of a step. Compiled kernels may then run many steps of a row in one call.
  std::string carried_to = {};
};

// A launch parameter: 32 bits, float or int.
struct Param {
  uint32_t bits = 0;
  bool is_float = true;
  Param(float v) : bits(std::bit_cast<uint32_t>(v)) {}
  Param(int32_t v) : bits(static_cast<uint32_t>(v)), is_float(false) {}
};

// The interface of a traced function to its sources, parameters and indices.
class NOVAPHY_NOVA_API TraceContext {
 public:
  TraceContext(Trace& trace, const std::vector<SourceSpec>& sources, std::vector<int>& param_types,
               int loop)
      : trace_(trace), sources_(sources), param_types_(param_types), loop_(loop) {}

  Int index() const;         // the output row i
  Int reduce_index() const;  // position r in the sum, inside the body of a sum
  Int slot() const;          // CSR slot, inside the body of a CSR sum

  // Returns a column of a source, by its number or name, at the row that the source's access
  // declares.
  Real f32(size_t source, int32_t column = 0) const;
  Int i32(size_t source, int32_t column = 0) const;
  // Returns a column at an explicit row. The row must fit the declared access, for example index()
  // for Direct and an i32() value for Indexed.
  Real f32(size_t source, const Int& row, int32_t column) const;
  Int i32(size_t source, const Int& row, int32_t column) const;
  size_t source(const std::string& name) const;  // the number of a source

  Real param(int32_t k) const;     // launch parameter k as a float
  Int param_i32(int32_t k) const;  // launch parameter k as an int

 private:
  Int implied_row(size_t source) const;
  void check_row(size_t source, const Int& row) const;
  ir::Value load(ir::Op op, ir::Type type, size_t source, const Int& row, int32_t column) const;
  Trace& trace_;
  const std::vector<SourceSpec>& sources_;
  std::vector<int>& param_types_;  // per parameter: 0 unknown, 1 float, 2 int
  int loop_;                       // the loop whose body is traced, or -1
};

using TraceFn = std::function<std::vector<Real>(TraceContext&)>;
// The last stage of a sum: epilogue(context, sums) returns the outputs.
using EpilogueFn = std::function<std::vector<Real>(TraceContext&, std::span<const Real>)>;

struct ReduceFns {
  TraceFn init;         // initial values of the sums; empty: +0
  TraceFn body;         // the terms at (i, r)
  EpilogueFn epilogue;  // empty: the sums are the outputs
};

class Kernel;
namespace detail {
struct KernelImpl;
}

// The options of one call.
struct LaunchOptions {
  std::span<const Param> params = {};
  int32_t extent = -1;             // number of items of a fixed sum; -1: not given
  const Incidence* csr = nullptr;  // rows of a CSR sum, one per output row
  // int32 {1}: the number of leading rows to compute, which a device reads when the launch runs.
  // The other rows stay unchanged. Only for kernels without a sum. On a tape, outputs must be
  // memory that the tape has not written yet.
  const Operand* active = nullptr;
};

// The arguments of one call, in the order of the kernel: a list of operands, or a single operand.
class Operands : public std::span<const Operand> {
 public:
  using span::span;
  Operands(std::span<const Operand> several) : span(several) {}
  Operands(const Operand& single) : span(&single, 1) {}
};

// A Program with its adjoints and compiled modules. Copies are cheap.
class NOVAPHY_NOVA_API Kernel {
 public:
  Kernel() = default;
  // Runs the kernel and allocates the outputs; each is {dim, width}.
  std::vector<Tensor> operator()(int64_t dim, std::span<const Tensor> inputs,
                                 const LaunchOptions& options = {}) const;
  std::vector<Tensor> operator()(int64_t dim, std::initializer_list<Tensor> inputs,
                                 const LaunchOptions& options = {}) const {
    return (*this)(dim, std::span<const Tensor>(inputs.begin(), inputs.size()), options);
  }
  // Runs the kernel into given memory, as the engine's own operators do. The launch is recorded
  // like that of operator().
  void launch(int64_t dim, Operands inputs, Operands outputs,
              const LaunchOptions& options = {}) const;

  const std::string& name() const;
  const std::vector<SourceSpec>& sources() const;
  const std::vector<OutputSpec>& outputs() const;
  const ir::Program& program() const;  // the Program that runs: canonical, without tracing marks
  const ir::Program& traced() const;   // the Program with tracing marks
  uint64_t hash() const;
  // Returns the kernel as text: for form "c" its C source, for form "program" a listing of the
  // Program. ErrorKind::Value: another form.
  std::string source(const std::string& form = "c") const;
  // Returns the plan for a set of gradients. Plans are cached.
  const AdjointPlan& adjoint(const AdjointMask& mask) const;
  // Returns the sets of gradients whose adjoints are compiled ahead of time (see with_gradients).
  const std::vector<AdjointMask>& gradients() const;
  const std::shared_ptr<detail::KernelImpl>& impl() const { return impl_; }
  explicit Kernel(std::shared_ptr<detail::KernelImpl> impl) : impl_(std::move(impl)) {}

 private:
  std::shared_ptr<detail::KernelImpl> impl_;
};
using IndexedKernel = Kernel;

// Makes a kernel with one output of n_out columns: out[i, 0..n_out) = f(i).
NOVAPHY_NOVA_API Kernel make_indexed_expr_kernel_typed_access_n(std::string name,
                                                                std::vector<SourceSpec> sources,
                                                                int32_t n_out,
                                                                const TraceFn& trace);
// Makes a kernel with a sum over r: out[i, 0..n_out) = epilogue(i, init(i) + body(i, 0) + body(i,
// 1) + ...), added in this order. If a source is CsrRow, r runs over a CSR row, otherwise over
// `extent` items.
NOVAPHY_NOVA_API Kernel make_indexed_fixed_reduce_expr_kernel_typed_access_n(
    std::string name, std::vector<SourceSpec> sources, int32_t n_out, const ReduceFns& fns);
// Makes a kernel, or a kernel with a sum, with several named outputs. The functions return the
// columns of all outputs, one output after the other.
NOVAPHY_NOVA_API Kernel make_kernel(std::string name, std::vector<SourceSpec> sources,
                                    std::vector<OutputSpec> outputs, const TraceFn& trace);
NOVAPHY_NOVA_API Kernel make_reduce_kernel(std::string name, std::vector<SourceSpec> sources,
                                           std::vector<OutputSpec> outputs, const ReduceFns& fns);

// How a Program runs on a device.
struct KernelInfo {
  std::string name;   // kernel name; adjoints end in ".adjoint" or ".adjoint_items"
  uint64_t hash = 0;  // hash of the Program
  novaphy::Device device;
  std::string how;  // "native": compiled code; "interpreter"; "unknown": the backend does not
                    // report it
  std::string isa;  // instruction set, such as "avx2"
  int32_t lanes = 1;  // rows per SIMD vector
};
// Returns an entry for every Program that was prepared for a device and still exists, in order of
// preparation: kernels and adjoints of the engine and of users.
NOVAPHY_NOVA_API std::vector<KernelInfo> kernel_info();
// Prepares one Program for a device and returns its entry.
NOVAPHY_NOVA_API KernelInfo kernel_info(const ir::Program& program,
                                        const novaphy::Device& device = novaphy::default_device());

}  // namespace nova
