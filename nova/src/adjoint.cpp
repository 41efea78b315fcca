#include "novaphy/nova/adjoint.h"

#include <algorithm>

#include "adjoint_sweep.h"
#include "novaphy/core/error.h"
#include "novaphy/program/ir.h"
#include "unread_columns.h"

namespace nova {
namespace {

using detail::Instr;
using detail::is_item;
using detail::Kind;
using detail::kNone;
using detail::Op;
using detail::Primal;
using detail::Sweep;
using detail::Value;

[[noreturn]] void refuse(const ir::Program& p, int32_t source, const char* why) {
  novaphy::fail(novaphy::ErrorKind::NotImplemented, "kernel '", p.name, "', source '",
                p.sources[source].name, "': no gradient, because it is read at ", why);
}

// Which row a load reads: the row or loop item itself, row 0, an entry of an index table at the row
// or item, or any other computed row.
struct RowPattern {
  enum class Kind : uint8_t { Row, Uniform, Item, TableAtRow, TableAtItem, Computed } kind;
  int32_t table = -1, column = 0;
};

bool is_zero(const Instr& in) { return in.op == Op::CONST_I && in.a == 0; }

RowPattern row_pattern(const ir::Program& p, const Instr& load) {
  const Instr& row = p.instrs[load.b];
  if (row.op == Op::INDEX) return {RowPattern::Kind::Row};
  if (is_zero(row)) return {RowPattern::Kind::Uniform};
  if (is_item(row)) return {RowPattern::Kind::Item};
  if (row.op == Op::LOAD_I) {  // a table has one row per row or item of the kernel
    const Instr& at = p.instrs[row.b];
    const ir::Access access = p.sources[row.a].access;
    if (at.op == Op::INDEX && access == ir::Access::Direct)
      return {RowPattern::Kind::TableAtRow, row.a, row.c};
    if (is_item(at) && access != ir::Access::Indexed)
      return {RowPattern::Kind::TableAtItem, row.a, row.c};
  }
  return {RowPattern::Kind::Computed};
}

// Collects the columns of the outputs of a stage. The values of a column are summed in order.
class Outputs {
 public:
  using Column = std::vector<Value>;
  explicit Outputs(Sweep& sweep) : sweep_(sweep) {}
  std::vector<Column>& columns(AdjointBinding binding, const std::string& name, int32_t width) {
    for (size_t k = 0; k < sweep_.stage.outputs.size(); ++k)
      if (sweep_.stage.outputs[k].kind == binding.kind &&
          sweep_.stage.outputs[k].index == binding.index)
        return columns_[k];
    sweep_.stage.outputs.push_back(binding);
    names_.push_back(name);
    columns_.emplace_back(static_cast<size_t>(width));
    return columns_.back();
  }
  // Writes the outputs into the Program. Missing columns are 0. Accumulated gradients start from
  // the present values.
  AdjointStage finish(const AdjointMask& mask, const AdjointPlan& plan) {
    Trace& t = sweep_.trace();
    for (size_t k = 0; k < columns_.size(); ++k) {
      const AdjointBinding binding = sweep_.stage.outputs[k];
      const bool at_its_row = binding.kind == Kind::SourceGradient;
      const bool gated = mask.gated && binding.kind != Kind::LoopGradient;
      const int32_t source =
          binding.kind == Kind::Contribution ? plan.row_sums[binding.index].source : binding.index;
      const auto width = static_cast<int32_t>(columns_[k].size());
      Value previous = kNone;
      if (at_its_row && (gated || mask.accumulate[source]))
        previous = sweep_.add_source(names_[k] + "_before", width, binding, ir::Access::Direct);
      // If a single source is requested, every call requests it. Only several sources need the
      // check.
      const bool may_be_unwanted = gated && std::ranges::count(mask.wrt, true) > 1;
      std::vector<Value> totals;
      for (int32_t c = 0; c < width; ++c) {
        Value total = previous == kNone ? kNone : sweep_.load(previous, sweep_.index(), c);
        if (gated && previous != kNone) {  // adding -0 keeps every x
          const Value none = t.constant(columns_[k][c].empty() ? 0.0f : -0.0f);
          total = t.emit({Op::SELECT_F, sweep_.gate(source, kGateAdd), total, none});
        }
        for (const Value value : columns_[k][c])
          total = total == kNone ? value : t.emit({Op::ADD, total, value});
        if (total == kNone) total = t.constant(0.0f);
        if (gated && source == mask.narrowed && (mask.unread >> c & 1) != 0)
          total =
              t.emit({Op::SELECT_F, sweep_.gate(source, kGateColumns), total, t.constant(0.0f)});
        if (may_be_unwanted)
          total = t.emit({Op::SELECT_F, sweep_.gate(source, kGateWanted), total, t.constant(0.0f)});
        totals.push_back(total);
      }
      t.program().outputs.push_back({names_[k], ir::Type::F32, std::move(totals)});
    }
    sweep_.stage.program = ir::canonicalise(t.program(), true);
    return std::move(sweep_.stage);
  }
  bool empty() const { return columns_.empty(); }

 private:
  Sweep& sweep_;
  std::vector<std::string> names_;
  std::vector<std::vector<Column>> columns_;
};

int32_t row_sum_entry(AdjointPlan& plan, const AdjointRowSum& wanted) {
  for (size_t k = 0; k < plan.row_sums.size(); ++k) {
    const AdjointRowSum& r = plan.row_sums[k];
    if (r.kind == wanted.kind && r.source == wanted.source && r.table == wanted.table &&
        r.per_item == wanted.per_item)
      return static_cast<int32_t>(k);
  }
  plan.row_sums.push_back(wanted);
  return static_cast<int32_t>(plan.row_sums.size()) - 1;
}

// Adds the adjoint `value` of one load to the output for the gradient of its source.
void route(const ir::Program& p, AdjointPlan& plan, Outputs& outputs, const Instr& load,
           Value value, bool at_item) {
  const int32_t s = load.a, width = p.sources[s].width;
  const std::string name = "grad_" + p.sources[s].name;
  const RowPattern pattern = row_pattern(p, load);
  auto add_to_sum = [&](AdjointRowSum::Kind kind) {
    const int32_t entry = row_sum_entry(plan, {kind, s, -1, at_item, width});
    outputs.columns({Kind::Contribution, entry}, name, width)[load.c].push_back(value);
  };
  auto add_to_row = [&] {
    if (p.sources[s].access == ir::Access::Indexed) return add_to_sum(AdjointRowSum::Kind::Row);
    outputs.columns({Kind::SourceGradient, s}, name, width)[load.c].push_back(value);
  };
  switch (pattern.kind) {
    case RowPattern::Kind::Row:
      add_to_row();
      break;
    case RowPattern::Kind::Uniform:
      add_to_sum(AdjointRowSum::Kind::Uniform);
      break;
    case RowPattern::Kind::Item:
      if (p.loops[0].kind == ir::LoopKind::Csr && p.instrs[load.b].op == Op::SLOT) {
        add_to_row();
      } else if (p.loops[0].kind == ir::LoopKind::Fixed) {
        add_to_sum(AdjointRowSum::Kind::Reduced);
      } else {
        refuse(p, s, "the position in a CSR row");
      }
      break;
    case RowPattern::Kind::TableAtRow:
    case RowPattern::Kind::TableAtItem: {
      if (pattern.kind == RowPattern::Kind::TableAtItem && p.loops[0].kind == ir::LoopKind::Fixed)
        refuse(p, s, "a table row inside a fixed loop");
      const int32_t table_width = p.sources[pattern.table].width;
      const int32_t entry =
          row_sum_entry(plan, {AdjointRowSum::Kind::Table, s, pattern.table, at_item, width});
      outputs
          .columns({Kind::Contribution, entry}, name,
                   table_width * width)[pattern.column * width + load.c]
          .push_back(value);
      break;
    }
    case RowPattern::Kind::Computed:
      refuse(p, s, "a computed row");
  }
}

bool wanted_at_item(const Primal& primal) {
  for (size_t v = 0; v < primal.p.instrs.size(); ++v)
    if (primal.active[v] && primal.section[v] == 1 && primal.p.instrs[v].op == Op::LOAD_F)
      return true;
  return false;
}

// `summed`, if not null, receives for each sum of the loop whether the sum has a gradient.
AdjointStage make_rows(const Primal& primal, AdjointPlan& plan, std::vector<bool>* summed) {
  const ir::Program& p = primal.p;
  Sweep sweep(primal, Sweep::Domain::Rows, ".adjoint");
  for (size_t o = 0; o < p.outputs.size(); ++o) {
    if (!primal.mask.seeded[o]) continue;
    const auto width = static_cast<int32_t>(p.outputs[o].values.size());
    const int32_t table = primal.mask.table, parts = table < 0 ? 1 : p.sources[table].width;
    const Value source = sweep.add_source("grad_" + p.outputs[o].name, width / parts,
                                          {Kind::OutputGradient, static_cast<int32_t>(o)},
                                          table < 0 ? ir::Access::Direct : ir::Access::Indexed);
    for (int32_t c = 0; c < width; ++c)
      if (p.outputs[o].type == ir::Type::F32) {
        const Value v = p.outputs[o].values[c];
        const int32_t part = c * parts / width;
        const Value row = table < 0 ? sweep.index() : sweep.load_row(table, part);
        if (primal.active[v])
          sweep.contribute(v, 0, sweep.load(source, row, c - part * (width / parts)));
      }
  }
  if (!p.loops.empty()) {
    sweep.sweep(2, 0);
    sweep.open_adjoint_loop(p.loops[0]);
    for (const auto& [key, value] : sweep.sum_adjoints)
      if (value != kNone) sweep.contribute_term(p.loops[key.first].sums[key.second].term, value);
    sweep.sweep(1, 1);
    sweep.close_adjoint_loop();
  }
  sweep.sweep(0, 0);

  Outputs outputs(sweep);
  for (const auto& [v, adjoint] : sweep.load_adjoints)
    for (const Value value : {adjoint.outside, adjoint.loop})
      if (value != kNone && primal.section[v] != 1)
        route(p, plan, outputs, p.instrs[v], value, false);
  if (summed) {
    const auto count = static_cast<int32_t>(p.loops[0].sums.size());
    summed->assign(p.loops[0].sums.size(), false);
    auto& columns = outputs.columns({Kind::LoopGradient, 0}, "grad_sums", count);
    for (const auto& [key, value] : sweep.sum_adjoints) {
      columns[key.second] = {value};
      (*summed)[key.second] = true;
    }
  }
  return outputs.empty() ? AdjointStage{} : outputs.finish(primal.mask, plan);
}

AdjointStage make_items(const Primal& primal, AdjointPlan& plan, const std::vector<bool>& summed) {
  const ir::Program& p = primal.p;
  const ir::Loop& loop = p.loops[0];
  const bool csr = loop.kind == ir::LoopKind::Csr;
  Sweep sweep(primal, csr ? Sweep::Domain::CsrItems : Sweep::Domain::FixedItems, ".adjoint_items");
  const auto count = static_cast<int32_t>(loop.sums.size());
  const Value source =
      sweep.add_source("grad_sums", count, {Kind::LoopGradient, 0}, ir::Access::Indexed);
  const Value row = sweep.primal_row();
  for (int32_t j = 0; j < count; ++j)
    if (summed[j]) sweep.contribute(loop.sums[j].term, 0, sweep.load(source, row, j));
  sweep.sweep(1, 0);

  Outputs outputs(sweep);
  Trace& t = sweep.trace();
  for (const auto& [v, adjoint] : sweep.load_adjoints) {
    Value value = adjoint.outside;
    if (csr) {  // an unused item belongs to no row
      const Value used = t.emit({Op::ILE, t.constant(int32_t{0}), row});
      value = t.emit({Op::SELECT_F, used, value, t.constant(0.0f)});
    }
    route(p, plan, outputs, p.instrs[v], value, true);
  }
  return outputs.empty() ? AdjointStage{} : outputs.finish(primal.mask, plan);
}

// A kernel may carry outputs to sources of the next launch (OutputSpec::carried_to). The launches
// of its adjoint then carry gradients in the opposite order: the gradient of a carried source is
// the output gradient of the next adjoint launch. The stage is marked only if all gradients are of
// this kind.
void carry_gradients(const ir::Program& p, AdjointStage& stage) {
  const auto gradient_of_output = [&](int32_t source) -> int32_t {
    for (size_t k = 0; k < stage.sources.size(); ++k)
      if (const AdjointBinding& b = stage.sources[k];
          b.kind == Kind::OutputGradient && p.outputs[b.index].carried == source)
        return static_cast<int32_t>(k);
    return kNone;
  };
  std::vector<int32_t> carried;
  for (const AdjointBinding& b : stage.outputs) {
    const int32_t to = b.kind == Kind::SourceGradient ? gradient_of_output(b.index) : kNone;
    if (to == kNone || std::ranges::count(carried, to) != 0 ||
        stage.program.sources[to].width != p.sources[b.index].width)
      return;
    carried.push_back(to);
  }
  const auto gradients = std::ranges::count_if(
      stage.sources, [](const AdjointBinding& b) { return b.kind != Kind::PrimalSource; });
  if (static_cast<size_t>(gradients) != carried.size()) return;
  for (size_t k = 0; k < carried.size(); ++k) {
    stage.program.outputs[k].carried = carried[k];
    stage.program.sources[stage.outputs[k].index].varies = true;
  }
  stage.program.primal = ir::hash(ir::canonicalise(p, true));
}

// Removes the gradient of the loop's sums, which only the items Program reads.
void drop_loop_gradient(AdjointStage& stage) {
  for (size_t k = 0; k < stage.outputs.size(); ++k) {
    if (stage.outputs[k].kind != Kind::LoopGradient) continue;
    stage.outputs.erase(stage.outputs.begin() + static_cast<std::ptrdiff_t>(k));
    stage.program.outputs.erase(stage.program.outputs.begin() + static_cast<std::ptrdiff_t>(k));
    stage.program = ir::canonicalise(stage.program, true);
    return;
  }
}

void note_loads(const AdjointStage& stage, std::vector<bool>& loads_value) {
  for (const Instr& in : stage.program.instrs)
    if (in.op == Op::LOAD_F || in.op == Op::LOAD_I) {
      const AdjointBinding& b = stage.sources[in.a];
      if (b.kind == Kind::PrimalSource) loads_value[b.index] = true;
    }
}

}  // namespace

AdjointPlan make_adjoint(const ir::Program& program, const AdjointMask& mask) {
  for (size_t s = 0; s < program.sources.size(); ++s)
    novaphy::require(!mask.wrt[s] || program.sources[s].type == ir::Type::F32,
                     novaphy::ErrorKind::Value, "kernel '", program.name, "', source '",
                     program.sources[s].name, "': integers have no gradient");
  const Primal primal(program, mask);
  AdjointPlan plan;
  plan.loads_value.assign(program.sources.size(), false);
  const bool items = !program.loops.empty() && wanted_at_item(primal);
  std::vector<bool> summed;
  AdjointStage rows = make_rows(primal, plan, items ? &summed : nullptr);
  if (items) {
    if (AdjointStage stage = make_items(primal, plan, summed); !stage.outputs.empty()) {
      plan.items.push_back(std::move(stage));
    } else {
      drop_loop_gradient(rows);
    }
  }
  carry_gradients(program, rows);
  if (!rows.outputs.empty()) plan.rows.push_back(std::move(rows));
  for (const auto* stages : {&plan.rows, &plan.items})
    for (const AdjointStage& stage : *stages) {
      if (const std::string why = ir::validate(stage.program); !why.empty())
        novaphy::fail(novaphy::ErrorKind::Runtime, "nova: adjoint of '", program.name,
                      "' is malformed: ", why);
      note_loads(stage, plan.loads_value);
    }
  for (const AdjointRowSum& r : plan.row_sums)
    if (r.kind == AdjointRowSum::Kind::Table) plan.loads_value[r.table] = true;
  return plan;
}

uint32_t unread_columns(const ir::Program& program, size_t output, const AdjointMask& mask) {
  const std::vector<Value>& values = program.outputs[output].values;
  constexpr size_t kMostColumns = 32;
  if (values.size() > kMostColumns) return 0;
  const Primal primal(program, mask);
  uint32_t unread = 0;
  for (size_t c = 0; c < values.size(); ++c)
    if (!primal.active[values[c]]) unread |= uint32_t{1} << c;
  return unread;
}

}  // namespace nova
