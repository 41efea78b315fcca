#include "novaphy/nova/kernel.h"

#include <algorithm>

#include "kernel_impl.h"
#include "novaphy/core/error.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "novaphy/program/emit.h"
#include "optional_entry.h"
#include "unread_columns.h"

namespace nova {

using novaphy::fail;
using novaphy::require;

namespace detail {

Executable::~Executable() {
  forget_executable(this);
  for (const auto& c : all_) c->context->api->module_destroy(c->module);
}

novaphy_kernel* Executable::get(const novaphy::DeviceContext& context) {
  if (const Compiled* c = first_.load(std::memory_order_acquire); c && c->context == &context)
      [[likely]]
    return c->kernel;
  std::unique_lock lock(mutex_);
  for (const auto& c : all_)
    if (c->context == &context) return c->kernel;
  auto made = std::make_unique<Compiled>();
  made->context = &context;
  novaphy_error error = novaphy::make_error();
  const std::vector<uint32_t> words = ir::serialize(program);
  novaphy::check(context.api->module_create(context.device, NOVAPHY_CODE_PROGRAM, words.data(),
                                            words.size() * sizeof(uint32_t), &made->module, &error),
                 error, program.name.c_str());
  novaphy::check(context.api->kernel_get(made->module, "main", &made->kernel, &error), error,
                 program.name.c_str());
  novaphy_kernel* const kernel = made->kernel;
  const bool first = all_.empty();
  all_.push_back(std::move(made));
  if (first) first_.store(all_.back().get(), std::memory_order_release);
  lock.unlock();  // kernel_info takes the two locks in the other order
  if (first) remember_executable(this);
  return kernel;
}

AdjointMask KernelImpl::mask_of(const AdjointKey& key) const {
  AdjointMask mask;
  for (size_t s = 0; s < sources.size(); ++s) {
    mask.wrt.push_back(key.wrt >> s & 1);
    mask.accumulate.push_back(key.accumulate >> s & 1);
  }
  for (size_t o = 0; o < outputs.size(); ++o) mask.seeded.push_back(key.seeded >> o & 1);
  mask.table = key.table;
  mask.narrowed = key.narrowed;
  mask.unread = key.unread;
  mask.gated = key.gated;
  return mask;
}

uint32_t KernelImpl::unread_columns(uint32_t output, uint64_t wrt) {
  const std::lock_guard lock(mutex_);
  const auto [known, fresh] = unread_.try_emplace({wrt, output}, 0);
  if (fresh) known->second = nova::unread_columns(traced, output, mask_of({.wrt = wrt}));
  return known->second;
}

AdjointKey key_of(const AdjointMask& mask) {
  AdjointKey key;
  for (size_t s = 0; s < mask.wrt.size(); ++s) {
    key.wrt |= uint64_t{mask.wrt[s]} << s;
    key.accumulate |= uint64_t{mask.accumulate[s]} << s;
  }
  for (size_t o = 0; o < mask.seeded.size(); ++o) key.seeded |= uint32_t{mask.seeded[o]} << o;
  key.table = mask.table;
  key.narrowed = mask.narrowed;
  key.unread = mask.unread;
  key.gated = mask.gated;
  return key;
}

AdjointKey KernelImpl::declared_key(const AdjointKey& wanted) const {
  const AdjointKey* best = nullptr;
  uint64_t at_their_row = 0;  // bits of sources whose gradients the plan stores or adds itself
  for (size_t s = 0; s < sources.size(); ++s)
    if (sources[s].access == Access::Direct || sources[s].access == Access::CsrRow)
      at_their_row |= uint64_t{1} << s;
  const auto has_all = [&](const AdjointKey& key) {
    // Gradients that were not wanted may be stored or added, and may have any columns.
    const bool stores_so = ((key.accumulate ^ wanted.accumulate) & at_their_row & wanted.wrt) == 0;
    const bool has_columns = key.narrowed < 0 || !(wanted.wrt >> key.narrowed & 1) ||
                             (key.narrowed == wanted.narrowed && key.unread == wanted.unread);
    return (wanted.wrt & ~key.wrt) == 0 && (wanted.seeded & ~key.seeded) == 0 &&
           key.table == wanted.table && (key.gated || (stores_so && has_columns));
  };
  const auto size = [](const AdjointKey& key) {
    return std::popcount(key.wrt) + std::popcount(key.seeded);
  };
  for (const AdjointKey& key : gradient_keys)
    if (has_all(key) && (!best || size(key) < size(*best))) best = &key;
  return best ? *best : wanted;
}

const CompiledPlan& KernelImpl::declared_adjoint(const AdjointKey& wanted) {
  if (const Declared* last = last_.load(std::memory_order_acquire); last && last->wanted == wanted)
    return *last->plan;
  const CompiledPlan& plan = adjoint(declared_key(wanted));
  const std::lock_guard lock(mutex_);
  const auto known = declared_.try_emplace(wanted, Declared{wanted, &plan}).first;
  last_.store(&known->second, std::memory_order_release);
  return plan;
}

const CompiledPlan& KernelImpl::adjoint(const AdjointKey& key) {
  const std::lock_guard lock(mutex_);
  auto& slot = plans_[key];
  if (slot) return *slot;
  auto made = std::make_unique<CompiledPlan>();
  made->key = key;
  made->plan = make_adjoint(traced, mask_of(key));
  if (!made->plan.rows.empty())
    made->rows = std::make_unique<Executable>(made->plan.rows[0].program);
  if (!made->plan.items.empty())
    made->items = std::make_unique<Executable>(made->plan.items[0].program);
  for (const auto* stages : {&made->plan.rows, &made->plan.items})
    for (const AdjointStage& stage : *stages)
      for (const AdjointBinding& b : stage.outputs)
        if (b.kind == AdjointBinding::Kind::SourceGradient) made->reached |= uint64_t{1} << b.index;
  for (const AdjointRowSum& r : made->plan.row_sums) made->reached |= uint64_t{1} << r.source;
  slot = std::move(made);
  return *slot;
}

void run_forward(KernelImpl& kernel, int64_t dim, std::span<const Operand> inputs,
                 std::span<const Operand> outputs, std::span<const Param> params,
                 const IncidenceData* csr, int32_t extent, const Operand* active) {
  const novaphy::DeviceContext& context =
      novaphy::device_context(outputs[0].range->storage().device());
  Executable& code = *kernel.forward;
  novaphy_kernel* compiled = code.get(context);
  Words words(code.argument_count);
  for (const Operand& in : inputs) {
    words.pointer(in.range->data());
    words.word(static_cast<uint64_t>(in.rows));
  }
  for (const Operand& out : outputs) words.pointer(out.range->data());
  ExtraReads reads;
  if (kernel.has_csr_loop && !code.program.loops.empty()) {
    words.pointer(csr->offsets->data());
    words.pointer(csr->items->data());
    reads.add(*csr);
  }
  reads.add(active_count(active));
  for (const Param& p : params) words.word(p.bits);
  if (kernel.has_fixed_loop) words.word(static_cast<uint32_t>(extent));
  submit_launch(context, compiled, kernel.name.c_str(), dim, words.span(), &code.layout,
                reads.span(), active_count(active));
  if (active) hold_in_capture(active->range);
  for (const Operand& out : outputs) note_write(out.range);
}

}  // namespace detail

namespace {

bool is_copy(const ir::Program& p) {
  if (p.sources.size() != 1 || p.outputs.size() != 1 || p.sources[0].width != 1) return false;
  if (p.outputs[0].values.size() != 1) return false;
  const ir::Instr& value = p.instrs[static_cast<size_t>(p.outputs[0].values[0])];
  return value.op == ir::Op::LOAD_F && p.instrs[static_cast<size_t>(value.b)].op == ir::Op::INDEX;
}

ir::Type ir_type(DType dtype) { return dtype == DType::F32 ? ir::Type::F32 : ir::Type::I32; }

std::string expected(int64_t rows, int32_t width, DType dtype) {
  const std::string n = rows < 0 ? "n" : std::to_string(rows);
  return "{" + n + (width == 1 ? "" : ", " + std::to_string(width)) + "} tightly packed " +
         dtype_name(dtype);
}
std::string found(const Operand& o) {
  return "{" + std::to_string(o.rows) + (o.width == 1 ? "" : ", " + std::to_string(o.width)) +
         "} " + (o.type == ir::Type::F32 ? "float32" : "int32");
}

// `slots`: number of slots of the CSR sum.
void check_inputs(const detail::KernelImpl& k, int64_t dim, std::span<const Operand> inputs,
                  int32_t extent, int64_t slots) {
  require(inputs.size() == k.sources.size(), ErrorKind::Value, k.name, ": expected ",
          k.sources.size(), " inputs, got ", inputs.size());
  for (size_t s = 0; s < inputs.size(); ++s) {
    const SourceSpec& spec = k.sources[s];
    const Operand& in = inputs[s];
    require(in.range != nullptr, ErrorKind::Value, k.name, ", ", spec.name,
            ": the tensor is undefined");
    require(in.type == ir_type(spec.dtype), ErrorKind::Type, k.name, ", ", spec.name, ": expected ",
            dtype_name(spec.dtype), ", got ", in.type == ir::Type::F32 ? "float32" : "int32");
    const bool rows_ok = spec.access == Access::Direct    ? in.rows == dim
                         : spec.access == Access::Uniform ? in.rows >= 1
                         : spec.access == Access::Reduced ? in.rows >= extent
                         : spec.access == Access::CsrRow  ? in.rows == slots
                                                          : true;
    if (in.width != spec.width || !rows_ok) [[unlikely]] {
      const int64_t rows = spec.access == Access::Direct    ? dim
                           : spec.access == Access::Uniform ? 1
                           : spec.access == Access::Reduced ? extent
                           : spec.access == Access::CsrRow  ? slots
                                                            : -1;
      fail(ErrorKind::Value, k.name, ", ", spec.name, ": expected ",
           expected(rows, spec.width, spec.dtype), ", got ", found(in));
    }
  }
}

// A device that uses a pointer of another device fails permanently, so devices are compared here.
void check_devices(const detail::KernelImpl& k, std::span<const Operand> inputs,
                   std::span<const Operand> outputs) {
  const Device device = outputs[0].range->storage().device();
  const auto check = [&](const Operand& operand, const std::string& name) {
    const Device own = operand.range->storage().device();
    if (own != device) [[unlikely]]
      fail(ErrorKind::Value, k.name, ", ", name, ": expected memory of ", device.str(), ", got ",
           own.str());
  };
  for (size_t s = 0; s < inputs.size(); ++s) check(inputs[s], k.sources[s].name);
  for (size_t o = 1; o < outputs.size(); ++o) check(outputs[o], k.outputs[o].name);
}

void check_params(const detail::KernelImpl& k, const LaunchOptions& options) {
  require(options.params.size() == k.param_types.size(), ErrorKind::Value, k.name, ": expected ",
          k.param_types.size(), " parameters, got ", options.params.size());
  for (size_t p = 0; p < options.params.size(); ++p)
    require(k.param_types[p] == 0 || options.params[p].is_float == (k.param_types[p] == 1),
            ErrorKind::Type, k.name, ", parameter ", p, ": expected ",
            k.param_types[p] == 1 ? "float" : "int");
}

// Checks that the call gives items of a sum if and only if the kernel has a sum.
void check_sum(const detail::KernelImpl& k, int64_t dim, const LaunchOptions& options) {
  constexpr int32_t kNone = -1;
  const bool has_csr = options.csr && *options.csr, has_extent = options.extent != kNone;
  if (k.has_csr_loop) {
    if (!has_csr || (*options.csr)->rows != dim) [[unlikely]]
      fail(ErrorKind::Value, k.name, ", csr: expected an Incidence of ", dim, " rows, got ",
           has_csr ? std::to_string((*options.csr)->rows) : "none");
  } else if (options.csr) [[unlikely]] {
    fail(ErrorKind::Value, k.name, ", csr: expected none, because ",
         k.has_fixed_loop ? "no source of the sum has the access csr_row" : "the kernel has no sum",
         ", got one");
  }
  if (k.has_fixed_loop ? options.extent < 0 : options.extent > 0) [[unlikely]]
    fail(ErrorKind::Value, k.name, ", extent: expected ",
         k.has_fixed_loop ? "the number of items of the sum, >= 0"
         : k.has_csr_loop ? "none, because the sum is over the items of csr"
                          : "none, because the kernel has no sum",
         ", got ", has_extent ? std::to_string(options.extent) : "none");
}

void check_active(const detail::KernelImpl& k, const Operand& active,
                  std::span<const Operand> outputs) {
  const Device device = outputs[0].range->storage().device();
  require(active.range != nullptr && active.type == ir::Type::I32 && active.rows == 1 &&
              active.width == 1,
          ErrorKind::Value, k.name, ", active: expected {1} int32, got ", found(active));
  require(!k.has_csr_loop && !k.has_fixed_loop, ErrorKind::Value, k.name,
          ", active: expected a kernel without a sum");
  const Device own = active.range->storage().device();
  require(own == device, ErrorKind::Value, k.name, ", active: expected memory of ", device.str(),
          ", got ", own.str());
  for (size_t o = 0; o < outputs.size(); ++o)
    require(!active.range->overlaps(*outputs[o].range), ErrorKind::Value, k.name, ": output '",
            k.outputs[o].name, "' overlaps active");
  const novaphy::DeviceContext& context = novaphy::device_context(device);
  require(context.host_accessible ||
              detail::has_entry(*context.api, &novaphy_backend_api::launch_active),
          ErrorKind::NotImplemented, k.name, ", active: the backend of ", device.str(),
          " launches all rows only");
}

// Checks aliasing. An output may be an input only as the same view with Direct access. Every other
// overlap is refused.
void check_alias(const detail::KernelImpl& k, std::span<const Operand> inputs,
                 std::span<const Operand> outputs, bool recorded) {
  for (size_t o = 0; o < outputs.size(); ++o) {
    const Range& out = *outputs[o].range;
    for (size_t s = 0; s < inputs.size(); ++s) {
      const Range& in = *inputs[s].range;
      if (&in.storage() != &out.storage() || !in.overlaps(out)) [[likely]]
        continue;
      const bool same = &in == &out && k.sources[s].access == Access::Direct &&
                        inputs[s].width == outputs[o].width;
      require(same && !recorded, ErrorKind::Value, k.name, ": output '", k.outputs[o].name,
              "' overlaps input '", k.sources[s].name,
              same ? "', which a tape records; give it memory of its own"
                   : "'; only exactly the same rows, read direct, may be shared");
    }
    for (size_t other = 0; other < o; ++other)
      require(!outputs[other].range->overlaps(out), ErrorKind::Value, k.name, ": outputs '",
              k.outputs[other].name, "' and '", k.outputs[o].name, "' overlap");
  }
}

// Transformations walk a Program depth first by recursion. A chain of values must therefore fit on
// the stack.
void check_depth(const ir::Program& p, const std::string& name) {
  constexpr int32_t kDeepest = 10000;
  std::vector<int32_t> depth(p.instrs.size(), 1);
  for (size_t k = 0; k < p.instrs.size(); ++k) {
    const auto below = [&](ir::Value v) { depth[k] = std::max(depth[k], depth[v] + 1); };
    const ir::Instr& in = p.instrs[k];
    ir::for_each_operand(in, below);
    if (in.op == ir::Op::SUM) {
      below(p.loops[in.a].sums[in.b].init);
      below(p.loops[in.a].sums[in.b].term);
    }
    require(depth[k] <= kDeepest, ErrorKind::Value, "kernel '", name, "': a chain of more than ",
            kDeepest,
            " operations, each of which needs the one before; make it a sum, or several kernels");
  }
}

void check_values(const std::string& name, const char* what, const std::vector<Real>& values) {
  for (size_t j = 0; j < values.size(); ++j)
    require(values[j].value() != ir::kNone, ErrorKind::Value, "kernel '", name, "', ", what, " ", j,
            ": no value");
}

int32_t carried_to(const std::string& name, const std::vector<SourceSpec>& sources,
                   const OutputSpec& output) {
  const auto found = std::find_if(sources.begin(), sources.end(),
                                  [&](const SourceSpec& s) { return s.name == output.carried_to; });
  require(found != sources.end() && found->dtype == DType::F32 && found->width == output.width,
          ErrorKind::Value, "kernel '", name, "', output '", output.name, "': carried_to is '",
          output.carried_to, "', expected a float32 source of width ", output.width);
  return static_cast<int32_t>(found - sources.begin());
}

std::shared_ptr<detail::KernelImpl> finish(std::string name, std::vector<SourceSpec> sources,
                                           std::vector<OutputSpec> outputs,
                                           std::vector<int> param_types, Trace& trace,
                                           const std::vector<Real>& values) {
  auto impl = std::make_shared<detail::KernelImpl>();
  ir::Program& p = trace.program();
  size_t next = 0;
  for (const OutputSpec& o : outputs) {
    ir::Output out{o.name, ir::Type::F32, {}};
    for (int32_t c = 0; c < o.width; ++c) {
      require(next < values.size(), ErrorKind::Value, "kernel '", name, "': expected ", o.width,
              " columns for output '", o.name, "', the function returned fewer");
      out.values.push_back(values[next++].value());
      require(out.values.back() != ir::kNone, ErrorKind::Value, "kernel '", name, "', output '",
              o.name, "', column ", c, ": no value");
    }
    if (!o.carried_to.empty()) out.carried = carried_to(name, sources, o);
    p.outputs.push_back(std::move(out));
  }
  require(next == values.size(), ErrorKind::Value, "kernel '", name, "': the function returned ",
          values.size(), " values, expected ", next);
  for (const ir::Loop& l : p.loops) {
    impl->has_fixed_loop = l.kind == ir::LoopKind::Fixed;
    impl->has_csr_loop = l.kind == ir::LoopKind::Csr;
  }
  p.param_count = static_cast<int32_t>(param_types.size()) + (impl->has_fixed_loop ? 1 : 0);
  for (ir::Loop& l : p.loops)
    if (l.kind == ir::LoopKind::Fixed) l.extent_param = p.param_count - 1;
  check_depth(p, name);
  impl->traced = ir::canonicalise(p, false);
  impl->summed_source = ir::summed_source(impl->traced);
  impl->is_copy = is_copy(impl->traced);
  ir::Program forward = ir::canonicalise(p, true);
  if (const std::string why = ir::validate(forward); !why.empty())
    fail(ErrorKind::Value, "kernel '", name, "': ", why);
  impl->hash = ir::hash(forward);
  impl->forward = std::make_unique<detail::Executable>(std::move(forward));
  impl->name = std::move(name);
  impl->sources = std::move(sources);
  impl->outputs = std::move(outputs);
  impl->param_types = std::move(param_types);
  return impl;
}

void declare_sources(Trace& trace, const std::string& name, const std::vector<SourceSpec>& sources,
                     const std::vector<OutputSpec>& outputs) {
  require(sources.size() <= 64, ErrorKind::Value, "kernel '", name, "': more than 64 sources");
  require(outputs.size() <= 32, ErrorKind::Value, "kernel '", name, "': more than 32 outputs");
  for (const SourceSpec& s : sources) {
    require(s.width >= 1, ErrorKind::Value, "kernel '", name, "', source '", s.name, "': width ",
            s.width);
    require(s.dtype != DType::U8, ErrorKind::Type, "kernel '", name, "', source '", s.name,
            "': expected float32 or int32, got uint8");
    trace.program().sources.push_back({s.name, ir_type(s.dtype), s.width, s.access});
  }
}

}  // namespace

Int TraceContext::index() const { return Int::of(trace_.emit({ir::Op::INDEX})); }
Int TraceContext::reduce_index() const {
  require(loop_ >= 0, ErrorKind::Value,
          "kernel: reduce_index() is known only in the body of a sum");
  return Int::of(trace_.emit({ir::Op::REDUCE_INDEX, loop_}));
}
Int TraceContext::slot() const {
  require(loop_ >= 0 && trace_.program().loops[loop_].kind == ir::LoopKind::Csr, ErrorKind::Value,
          "kernel: slot() is known only in the body of a CSR sum");
  return Int::of(trace_.emit({ir::Op::SLOT, loop_}));
}
size_t TraceContext::source(const std::string& name) const {
  for (size_t s = 0; s < sources_.size(); ++s)
    if (sources_[s].name == name) return s;
  fail(ErrorKind::Value, "kernel: no source '", name, "'");
}
Int TraceContext::implied_row(size_t s) const {
  require(s < sources_.size(), ErrorKind::Index, "kernel: source ", s, " of ", sources_.size());
  switch (sources_[s].access) {
    case Access::Direct:
      return index();
    case Access::Uniform:
      return Int(0);
    case Access::Reduced:
      return reduce_index();
    case Access::CsrRow:
      return slot();
    case Access::Indexed:
      fail(ErrorKind::Value, "kernel: source '", sources_[s].name,
           "' is Indexed: say at which row it is read");
  }
  return {};
}
void TraceContext::check_row(size_t s, const Int& row) const {
  require(s < sources_.size(), ErrorKind::Index, "kernel: source ", s, " of ", sources_.size());
  if (sources_[s].access == Access::Indexed) return;
  require(row.value() == implied_row(s).value(), ErrorKind::Value, "kernel: source '",
          sources_[s].name, "' is read at a row that its declared access does not allow");
}
ir::Value TraceContext::load(ir::Op op, ir::Type type, size_t s, const Int& row,
                             int32_t column) const {
  const SourceSpec& spec = sources_[s];
  require(ir_type(spec.dtype) == type, ErrorKind::Type, "kernel: source '", spec.name, "' is ",
          dtype_name(spec.dtype));
  require(column >= 0 && column < spec.width, ErrorKind::Index, "kernel: source '", spec.name,
          "', column ", column, " of ", spec.width);
  return trace_.emit({op, static_cast<int32_t>(s), row.value(), column});
}
Real TraceContext::f32(size_t s, int32_t column) const {
  return Real::of(load(ir::Op::LOAD_F, ir::Type::F32, s, implied_row(s), column));
}
Int TraceContext::i32(size_t s, int32_t column) const {
  return Int::of(load(ir::Op::LOAD_I, ir::Type::I32, s, implied_row(s), column));
}
Real TraceContext::f32(size_t s, const Int& row, int32_t column) const {
  check_row(s, row);
  return Real::of(load(ir::Op::LOAD_F, ir::Type::F32, s, row, column));
}
Int TraceContext::i32(size_t s, const Int& row, int32_t column) const {
  check_row(s, row);
  return Int::of(load(ir::Op::LOAD_I, ir::Type::I32, s, row, column));
}
Real TraceContext::param(int32_t k) const {
  require(k >= 0 && k < 256, ErrorKind::Index, "kernel: parameter ", k);
  if (static_cast<size_t>(k) >= param_types_.size()) param_types_.resize(k + 1, 0);
  require(param_types_[k] != 2, ErrorKind::Type, "kernel: parameter ", k,
          " is read as float and as int");
  param_types_[k] = 1;
  return Real::of(trace_.emit({ir::Op::PARAM_F, k}));
}
Int TraceContext::param_i32(int32_t k) const {
  require(k >= 0 && k < 256, ErrorKind::Index, "kernel: parameter ", k);
  if (static_cast<size_t>(k) >= param_types_.size()) param_types_.resize(k + 1, 0);
  require(param_types_[k] != 1, ErrorKind::Type, "kernel: parameter ", k,
          " is read as float and as int");
  param_types_[k] = 2;
  return Int::of(trace_.emit({ir::Op::PARAM_I, k}));
}

Kernel make_kernel(std::string name, std::vector<SourceSpec> sources,
                   std::vector<OutputSpec> outputs, const TraceFn& fn) {
  for (const SourceSpec& s : sources)
    require(s.access != Access::Reduced && s.access != Access::CsrRow, ErrorKind::Value, "kernel '",
            name, "', source '", s.name, "': only a kernel with a sum reads at its items");
  require(static_cast<bool>(fn), ErrorKind::Value, "kernel '", name, "': expected a function");
  Trace trace(name);
  declare_sources(trace, name, sources, outputs);
  std::vector<int> param_types;
  TraceContext context(trace, sources, param_types, -1);
  const std::vector<Real> values = fn(context);
  return Kernel(finish(std::move(name), std::move(sources), std::move(outputs),
                       std::move(param_types), trace, values));
}

Kernel make_reduce_kernel(std::string name, std::vector<SourceSpec> sources,
                          std::vector<OutputSpec> outputs, const ReduceFns& fns) {
  bool csr = false, fixed = false;
  for (const SourceSpec& s : sources) {
    csr = csr || s.access == Access::CsrRow;
    fixed = fixed || s.access == Access::Reduced;
  }
  require(!(csr && fixed), ErrorKind::Value, "kernel '", name,
          "': sources are CsrRow or Reduced, not both");
  require(static_cast<bool>(fns.body), ErrorKind::Value, "kernel '", name,
          "', body: expected a function");
  Trace trace(name);
  declare_sources(trace, name, sources, outputs);
  std::vector<int> param_types;
  trace.program().loops.push_back({csr ? ir::LoopKind::Csr : ir::LoopKind::Fixed, 0, {}});
  TraceContext outer(trace, sources, param_types, -1);
  TraceContext inner(trace, sources, param_types, 0);
  const std::vector<Real> terms = fns.body(inner);
  std::vector<Real> inits;
  if (fns.init) {
    inits = fns.init(outer);
  } else {
    inits.assign(terms.size(), Real(0.0f));
  }
  require(inits.size() == terms.size(), ErrorKind::Value, "kernel '", name, "': ", terms.size(),
          " terms but ", inits.size(), " initial values");
  check_values(name, "term", terms);
  check_values(name, "initial value", inits);
  std::vector<Real> sums;
  for (size_t j = 0; j < terms.size(); ++j) {
    trace.program().loops[0].sums.push_back({inits[j].value(), terms[j].value()});
    sums.push_back(Real::of(trace.emit({ir::Op::SUM, 0, static_cast<int32_t>(j)})));
  }
  const std::vector<Real> values = fns.epilogue ? fns.epilogue(outer, sums) : sums;
  return Kernel(finish(std::move(name), std::move(sources), std::move(outputs),
                       std::move(param_types), trace, values));
}

Kernel make_indexed_expr_kernel_typed_access_n(std::string name, std::vector<SourceSpec> sources,
                                               int32_t n_out, const TraceFn& trace) {
  return make_kernel(std::move(name), std::move(sources), {{"out", n_out}}, trace);
}
Kernel make_indexed_fixed_reduce_expr_kernel_typed_access_n(std::string name,
                                                            std::vector<SourceSpec> sources,
                                                            int32_t n_out, const ReduceFns& fns) {
  return make_reduce_kernel(std::move(name), std::move(sources), {{"out", n_out}}, fns);
}

const std::string& Kernel::name() const { return impl_->name; }
const std::vector<SourceSpec>& Kernel::sources() const { return impl_->sources; }
const std::vector<AdjointMask>& Kernel::gradients() const { return impl_->gradients; }
const std::vector<OutputSpec>& Kernel::outputs() const { return impl_->outputs; }
const ir::Program& Kernel::program() const { return impl_->forward->program; }
const ir::Program& Kernel::traced() const { return impl_->traced; }
uint64_t Kernel::hash() const { return impl_->hash; }
std::string Kernel::source(const std::string& form) const {
  if (form == "c") return ir::emit_c(program());
  require(form == "program", ErrorKind::Value, "kernel '", name(),
          "', source: expected \"c\" or \"program\", got \"", form, "\"");
  return ir::to_string(program());
}

const AdjointPlan& Kernel::adjoint(const AdjointMask& mask) const {
  return impl_->adjoint(detail::key_of(mask)).plan;
}

std::vector<Tensor> Kernel::operator()(int64_t dim, std::span<const Tensor> inputs,
                                       const LaunchOptions& options) const {
  require(dim >= 0, ErrorKind::Value, name(), ", dim: expected >= 0, got ", dim);
  std::vector<Operand> in, out;
  Device device = novaphy::default_device();
  for (size_t s = 0; s < inputs.size(); ++s) {
    require(inputs[s].defined(), ErrorKind::Value, name(), ", input ", s,
            ": the tensor is undefined");
    in.push_back(inputs[s].operand());
    if (s < sources().size() && sources()[s].width == 1 && in.back().width != 1 &&
        inputs[s].ndim() == 1)
      in.back() = inputs[s].flat_operand();
    if (s == 0) device = inputs[s].device();
    if (inputs[s].device() != device)
      fail(ErrorKind::Value, name(), ", ", s < sources().size() ? sources()[s].name : "?",
           ": expected device ", device.str(), ", got ", inputs[s].device().str());
  }
  std::vector<Tensor> results;
  for (const OutputSpec& o : outputs()) {
    results.emplace_back(o.width == 1 ? Shape{dim} : Shape{dim, o.width}, DType::F32, device);
    out.push_back(results.back().operand());
  }
  launch(dim, in, out, options);
  return results;
}

void Kernel::launch(int64_t dim, Operands inputs, Operands outputs,
                    const LaunchOptions& options) const {
  detail::KernelImpl& k = *impl_;
  check_sum(k, dim, options);
  check_inputs(k, dim, inputs, options.extent, k.has_csr_loop ? (*options.csr)->table.rows : 0);
  check_params(k, options);
  require(outputs.size() == k.outputs.size(), ErrorKind::Value, k.name, ": expected ",
          k.outputs.size(), " outputs, got ", outputs.size());
  for (size_t o = 0; o < outputs.size(); ++o)
    if (outputs[o].rows != dim || outputs[o].width != k.outputs[o].width) [[unlikely]]
      fail(ErrorKind::Value, k.name, ", output ", k.outputs[o].name, ": expected ",
           expected(dim, k.outputs[o].width, DType::F32), ", got ", found(outputs[o]));
  check_devices(k, inputs, outputs);
  if (options.active) check_active(k, *options.active, outputs);
  Tape* tape = Tape::active();
  const bool recorded = tape != nullptr && tape->must_record(inputs);
  check_alias(k, inputs, outputs, recorded);
  const IncidenceData* csr = options.csr ? options.csr->get() : nullptr;
  if (tape) tape->check_launch(k, inputs, options.active ? outputs : std::span<const Operand>());
  detail::run_forward(k, dim, inputs, outputs, options.params, csr, options.extent, options.active);
  if (tape) tape->record_launch(impl_, dim, inputs, outputs, options, recorded);
  if (OpList* list = recording()) {
    list->hold(impl_);
    if (csr) list->hold(*options.csr);
    for (const auto* operands : {&inputs, &outputs})
      for (const Operand& operand : *operands) list->hold(operand.range);
  }
  if (csr && current_capture()) current_capture()->freeze(csr->table.range, csr->offsets);
}

}  // namespace nova
