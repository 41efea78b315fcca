#include "adjoint_launch.h"

#include <algorithm>

namespace nova::detail {

using novaphy::Storage;
using Kind = AdjointBinding::Kind;

Operand temporary(int64_t rows, int32_t width, const novaphy::Device& device) {
  const auto bytes = static_cast<size_t>(rows) * static_cast<size_t>(width) * sizeof(float);
  Operand o{Storage::allocate(bytes, device, false)->range(), rows, width};
  hold_in_capture(o.range, bytes);
  return o;
}

namespace {

// The memory that all stages of one adjoint call share.
struct Scratch {
  std::vector<Operand> contributions;  // one per row sum of the plan
  Operand loop_gradient;
  // Replacements for gradients that the plan uses and the call lacks: zeros per output, and scratch
  // memory per source.
  std::vector<Operand> zeros, unwanted;
};

bool is_wanted(const CompiledPlan& plan, const AdjointCall& call, const AdjointBinding& output) {
  const int32_t source = output.kind == Kind::Contribution
                             ? plan.plan.row_sums[static_cast<size_t>(output.index)].source
                             : output.index;
  return output.kind != Kind::LoopGradient && (call.wanted.wrt >> source & 1) != 0;
}
bool is_wanted(const CompiledPlan& plan, const AdjointCall& call, const AdjointStage& stage) {
  return std::ranges::any_of(
      stage.outputs, [&](const AdjointBinding& output) { return is_wanted(plan, call, output); });
}

uint32_t gate(const AdjointKey& wanted, int32_t source) {
  return (wanted.wrt >> source & 1 ? kGateWanted : 0u) |
         (wanted.accumulate >> source & 1 ? kGateAdd : 0u) |
         (wanted.narrowed != source ? kGateColumns : 0u);
}

void run_stage(const KernelImpl& kernel, const AdjointStage& stage, Executable& code, int64_t n,
               const AdjointCall& call, const Scratch& scratch,
               const novaphy::DeviceContext& context) {
  auto target = [&](const AdjointBinding& b) -> const std::shared_ptr<Range>& {
    if (b.kind == Kind::Contribution) return scratch.contributions[b.index].range;
    if (b.kind == Kind::LoopGradient) return scratch.loop_gradient.range;
    return call.wanted.wrt >> b.index & 1 ? *call.input_gradients[b.index]
                                          : scratch.unwanted[b.index].range;
  };
  Words words(code.argument_count);
  auto source = [&](const std::shared_ptr<Range>& range, int64_t rows) {
    words.pointer(range->data());
    words.word(static_cast<uint64_t>(rows));
    hold_in_capture(range);
  };
  for (const AdjointBinding& b : stage.sources) {
    switch (b.kind) {
      case Kind::PrimalSource:
        source(call.inputs[b.index]->range, call.inputs[b.index]->rows);
        break;
      case Kind::OutputGradient:
        source(call.output_gradients[b.index] ? *call.output_gradients[b.index]
                                              : scratch.zeros[b.index].range,
               call.output_gradient_rows);
        break;
      case Kind::SourceGradient:
        source(target(b), call.inputs[b.index]->rows);
        break;
      case Kind::LoopGradient:
        source(scratch.loop_gradient.range, scratch.loop_gradient.rows);
        break;
      case Kind::RowOfItem:
        source((*call.csr)->table.range, (*call.csr)->table.rows);
        break;
      case Kind::Contribution:
        break;  // not read by any stage
    }
  }
  for (const AdjointBinding& b : stage.outputs) words.pointer(target(b)->data());
  ExtraReads reads;
  for (const ir::Loop& loop : code.program.loops)
    if (loop.kind == ir::LoopKind::Csr) {
      words.pointer((*call.csr)->offsets->data());
      words.pointer((*call.csr)->items->data());
      if (reads.span().empty()) reads.add(**call.csr);  // once for all loops
    }
  for (const Param& p : call.params) words.word(p.bits);
  if (kernel.has_fixed_loop) words.word(static_cast<uint32_t>(call.extent));
  if (stage.takes_row_count) words.word(static_cast<uint32_t>(call.dim));
  for (const int32_t s : stage.gates) words.word(gate(call.wanted, s));
  reads.add(active_count(call.active));
  // Rows that were not computed contribute zero.
  if (call.active)
    for (const AdjointBinding& b : stage.outputs)
      if (b.kind == Kind::Contribution || !(call.wanted.accumulate >> b.index & 1))
        submit_fill(target(b), 0.0f);
  submit_launch(context, code.get(context), code.program.name.c_str(), n, words.span(),
                &code.layout, reads.span(), active_count(call.active));
  if (call.active) hold_in_capture(call.active->range);
  for (const AdjointBinding& b : stage.outputs) {
    note_write(target(b));
    hold_in_capture(target(b));
  }
}

void run_row_sums(const CompiledPlan& plan, const AdjointCall& call, const Scratch& scratch,
                  int64_t items) {
  const std::vector<AdjointRowSum>& sums = plan.plan.row_sums;
  const auto wanted = [&](const AdjointRowSum& r) {
    return (call.wanted.wrt >> r.source & 1) != 0;
  };
  uint64_t stored = call.wanted.accumulate;  // bits of sources whose gradient already has a
                                             // value to add to
  const auto target = [&](const AdjointRowSum& r) {
    Operand out = *call.inputs[r.source];
    out.range = *call.input_gradients[r.source];
    return out;
  };
  // Returns whether the sum adds to the present gradient. If not, rows after those of the sum are
  // set to zero.
  const auto adds = [&](const AdjointRowSum& r, const Operand& out, int64_t rows) {
    const uint64_t bit = uint64_t{1} << r.source;
    const bool add = stored & bit, partly = !add && rows < out.rows;
    if (partly) submit_fill(out.range, 0.0f);
    stored |= bit;
    return add || partly;
  };
  for (size_t k = 0; k < sums.size(); ++k) {
    const AdjointRowSum& r = sums[k];
    if (!wanted(r)) continue;
    const Operand out = target(r);
    if (r.kind == AdjointRowSum::Kind::Table) {
      const Operand* init = adds(r, out, out.rows) ? &out : nullptr;
      const Incidence incidence = cached_incidence(*call.inputs[r.table], out.rows);
      hold_in_capture(incidence);
      // Two sums over the same table run as one launch, for example those of position and velocity.
      if (k + 1 < sums.size() && wanted(sums[k + 1]) && sums[k + 1].kind == r.kind &&
          sums[k + 1].table == r.table && sums[k + 1].source != r.source &&
          sums[k + 1].per_item == r.per_item && sums[k + 1].width == r.width &&
          call.inputs[sums[k + 1].source]->rows == out.rows) {
        const Operand second = target(sums[k + 1]);
        const bool add = adds(sums[k + 1], second, second.rows);
        row_sums({&scratch.contributions[k], init, &out},
                 {&scratch.contributions[k + 1], add ? &second : nullptr, &second}, *incidence);
        ++k;
        continue;
      }
      row_sum(scratch.contributions[k], *incidence, init, out);
      continue;
    }
    const int64_t domain = r.per_item ? items : call.dim;
    const int64_t rows = r.kind == AdjointRowSum::Kind::Uniform   ? 1
                         : r.kind == AdjointRowSum::Kind::Reduced ? call.extent
                                                                  : std::min(domain, out.rows);
    const int64_t stride = r.kind == AdjointRowSum::Kind::Row       ? 1
                           : r.kind == AdjointRowSum::Kind::Reduced ? call.dim
                                                                    : domain;
    row_sum(scratch.contributions[k], rows, stride, adds(r, out, rows) ? &out : nullptr, out);
  }
}

// Provides memory for gradients that the call lacks: zeros for outputs, scratch for sources.
template <class Memory>
void make_up(const KernelImpl& kernel, const CompiledPlan& plan, const AdjointCall& call,
             const Memory& memory, Scratch& scratch) {
  for (size_t o = 0; o < kernel.outputs.size(); ++o) {
    if (!(plan.key.seeded >> o & 1) || call.output_gradients[o]) continue;
    scratch.zeros.resize(kernel.outputs.size());
    scratch.zeros[o] = memory(call.output_gradient_rows, kernel.outputs[o].width);
    submit_fill(scratch.zeros[o].range, 0.0f);
  }
  if ((plan.key.wrt & ~call.wanted.wrt) == 0) return;
  scratch.unwanted.resize(call.inputs.size());
  for (const auto* stages : {&plan.plan.rows, &plan.plan.items})
    for (const AdjointStage& stage : *stages)
      for (const AdjointBinding& b : stage.outputs)
        if (b.kind == Kind::SourceGradient && !(call.wanted.wrt >> b.index & 1))
          scratch.unwanted[b.index] =
              memory(call.inputs[b.index]->rows, call.inputs[b.index]->width);
}

}  // namespace

void run_adjoint(KernelImpl& kernel, const CompiledPlan& plan, const AdjointCall& call) {
  const novaphy::Device device = call.inputs[0]->range->storage().device();
  const novaphy::DeviceContext& context = novaphy::device_context(device);
  if (call.csr) hold_in_capture(*call.csr);
  const int64_t items = call.csr ? (*call.csr)->table.rows : call.dim * call.extent;
  Scratch scratch;
  // Adjoints run one after the other on the CPU and share one scratch buffer. A device may run
  // several at once, and each needs its own buffer.
  size_t number = 0;
  OpList* capture = current_capture();
  ScratchMemory& shared = capture ? capture->scratch() : *call.scratch;
  const auto memory = [&](int64_t rows, int32_t width, size_t turns = 1) {
    if (!context.host_accessible) return temporary(rows, width, device);
    const auto bytes = static_cast<size_t>(rows) * static_cast<size_t>(width) * sizeof(float);
    return Operand{shared.take(number++, bytes, turns, device), rows, width};
  };
  for (const AdjointRowSum& r : plan.plan.row_sums) {
    const int32_t table_width = r.table < 0 ? 1 : call.inputs[r.table]->width;
    scratch.contributions.push_back(memory((r.per_item ? items : call.dim) * table_width, r.width));
  }
  // Number of scratch buffers on a device, because the adjoints of up to four kinds of elements may
  // run at the same time.
  constexpr size_t kKinds = 4;
  if (plan.items)
    scratch.loop_gradient =
        memory(call.dim, static_cast<int32_t>(kernel.traced.loops[0].sums.size()), kKinds);

  const bool with_items = plan.items && is_wanted(plan, call, plan.plan.items[0]);
  make_up(kernel, plan, call, memory, scratch);
  if (plan.rows && (with_items || is_wanted(plan, call, plan.plan.rows[0])))
    run_stage(kernel, plan.plan.rows[0], *plan.rows, call.dim, call, scratch, context);
  if (with_items) run_stage(kernel, plan.plan.items[0], *plan.items, items, call, scratch, context);
  run_row_sums(plan, call, scratch, items);

  const uint64_t unreached = call.wanted.wrt & ~call.wanted.accumulate & ~plan.reached;
  for (size_t s = 0; s < call.inputs.size(); ++s)
    if (unreached >> s & 1) submit_fill(*call.input_gradients[s], 0.0f);
}

}  // namespace nova::detail
