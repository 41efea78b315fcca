#include "lowering.h"
#include "module.h"

namespace novaphy::cpu {
namespace {

class BlockBuilder {
 public:
  BlockBuilder(const nova::ir::Program& program, const Lowered& lowered, const IsaTable& isa)
      : p_(program), l_(lowered), isa_(isa) {}

  BlockForm run() {
    out_.constants = l_.constants;
    for (const int32_t parameter : l_.parameters) {
      out_.parameter_words.push_back(p_.param_argument(static_cast<size_t>(parameter)));
    }
    out_.register_count = l_.register_count;
    out_.scalar_count = l_.scalar_count;
    make_loops();

    std::vector<char> early(l_.items.size(), 0);
    for (const int32_t k : l_.prologue) {
      early[static_cast<size_t>(k)] = 1;
      emit(l_.items[static_cast<size_t>(k)], out_.prologue);
    }
    out_.prologue.push_back({isa_.end, 0, 0, 0, 0});

    if (l_.index_used) out_.code.push_back({isa_.index, place(l_.index_value).slot, 0, 0, 0});
    std::vector<int32_t> at(l_.items.size() + 1);
    for (size_t k = 0; k < l_.items.size(); ++k) {
      at[k] = static_cast<int32_t>(out_.code.size());
      if (early[k] == 0) emit(l_.items[k], out_.code);
    }
    at[l_.items.size()] = static_cast<int32_t>(out_.code.size());
    set_jumps(at);
    emit_stores();
    out_.code.push_back({isa_.end, 0, 0, 0, 0});
    return std::move(out_);
  }

 private:
  const Operand& place(ValueId v) const { return l_.place[static_cast<size_t>(v)]; }
  int32_t slot_or_none(ValueId v) const { return v == kNoValue ? -1 : place(v).slot; }
  bool is_csr(int32_t loop) const {
    return loop >= 0 && p_.loops[static_cast<size_t>(loop)].kind == nova::ir::LoopKind::Csr;
  }

  void make_loops() {
    for (size_t k = 0; k < l_.loops.size(); ++k) {
      const LoopValues& values = l_.loops[k];
      LoopCode loop{};
      loop.csr = is_csr(static_cast<int32_t>(k)) ? 1 : 0;
      loop.word = static_cast<int32_t>(
          loop.csr != 0 ? p_.loop_argument(k)
                        : p_.param_argument(static_cast<size_t>(p_.loops[k].extent_param)));
      loop.reduce = slot_or_none(values.reduce);
      loop.slot = slot_or_none(values.slot);
      loop.start = slot_or_none(values.start);
      loop.length = slot_or_none(values.length);
      loop.active = slot_or_none(values.active);
      loop.sums_begin = static_cast<int32_t>(out_.sums.size());
      for (size_t s = 0; s < values.accumulators.size(); ++s) {
        out_.sums.push_back(
            {place(values.accumulators[s]), place(values.inits[s]), place(values.terms[s])});
      }
      loop.sums_end = static_cast<int32_t>(out_.sums.size());
      out_.loops.push_back(loop);
    }
  }

  void emit(const Item& item, std::vector<BlockInstr>& code) {
    switch (item.kind) {
      case Item::Kind::Op:
        emit_op(item, code);
        break;
      case Item::Kind::Load:
        emit_load(item, code);
        break;
      case Item::Kind::Skip: {
        const Operand& condition = place(item.a);
        const int32_t active =
            is_csr(item.loop) ? out_.loops[static_cast<size_t>(item.loop)].active : -1;
        code.push_back(
            {isa_.skip[condition.uniform], item.polarity ? 1 : 0, condition.slot, active, 0});
        break;
      }
      case Item::Kind::LoopBegin:
        code.push_back({isa_.loop_begin, 0, item.loop, 0, 0});
        break;
      case Item::Kind::LoopEnd:
        code.push_back({isa_.loop_end, 0, item.loop, 0, 0});
        break;
    }
  }

  void emit_op(const Item& item, std::vector<BlockInstr>& code) {
    BlockInstr in{nullptr, place(item.d).slot, place(item.a).slot, 0, 0};
    size_t mask = place(item.a).uniform != 0 ? 1 : 0;
    if (item.b != kNoValue) {
      in.b = place(item.b).slot;
      if (place(item.b).uniform != 0) mask |= 2;
    }
    if (item.c != kNoValue) {
      in.c = place(item.c).slot;
      if (place(item.c).uniform != 0) mask |= 4;
    }
    in.run = isa_.ops[item.op][mask];
    code.push_back(in);
  }

  void emit_load(const Item& item, std::vector<BlockInstr>& code) {
    const LoadGroup& group = l_.groups[static_cast<size_t>(item.group)];
    LoadCode load{};
    load.source = group.source;
    load.width = p_.sources[static_cast<size_t>(group.source)].width;
    load.column = group.column;
    load.count = static_cast<int32_t>(group.targets.size());
    const bool own_row = group.row == l_.index_value;
    load.row = own_row ? -1 : place(group.row).slot;
    for (size_t k = 0; k < group.targets.size(); ++k) load.target[k] = place(group.targets[k]).slot;
    load.guards_begin = static_cast<int32_t>(out_.guards.size());
    for (int32_t region = item.region; region >= 0;
         region = l_.items[static_cast<size_t>(region)].region) {
      const Item& skip = l_.items[static_cast<size_t>(region)];
      out_.guards.push_back({place(skip.a), skip.polarity ? 1 : 0});
    }
    if (is_csr(item.loop))
      out_.guards.push_back({{out_.loops[static_cast<size_t>(item.loop)].active, 0}, 1});
    load.guards_end = static_cast<int32_t>(out_.guards.size());
    const BlockFn function = own_row        ? isa_.load_row
                             : item.uniform ? isa_.load_scalar
                                            : isa_.load_at;
    code.push_back({function, 0, static_cast<int32_t>(out_.loads.size()), 0, 0});
    out_.loads.push_back(load);
  }

  // Sets the relative jumps. A skip jumps past its region. The begin of a loop jumps past the
  // loop's end, and the end jumps back to the body.
  void set_jumps(const std::vector<int32_t>& at) {
    for (size_t k = 0; k < l_.items.size(); ++k) {
      const Item& item = l_.items[k];
      int32_t to = -1;
      if (item.kind == Item::Kind::Skip) to = at[static_cast<size_t>(item.target)];
      if (item.kind == Item::Kind::LoopBegin)
        to = at[static_cast<size_t>(l_.loops[static_cast<size_t>(item.loop)].end)] + 1;
      if (item.kind == Item::Kind::LoopEnd)
        to = at[static_cast<size_t>(l_.loops[static_cast<size_t>(item.loop)].begin)] + 1;
      if (to >= 0) out_.code[static_cast<size_t>(at[k])].c = to - at[k];
    }
  }

  void emit_stores() {
    for (size_t o = 0; o < l_.outputs.size(); ++o) {
      out_.code.push_back({isa_.store, 0, static_cast<int32_t>(out_.stores.size()), 0, 0});
      out_.stores.push_back({static_cast<int32_t>(p_.output_argument(o)),
                             static_cast<int32_t>(l_.outputs[o].size()),
                             static_cast<int32_t>(out_.store_values.size())});
      for (const ValueId v : l_.outputs[o]) out_.store_values.push_back(place(v));
    }
  }

  const nova::ir::Program& p_;
  const Lowered& l_;
  const IsaTable& isa_;
  BlockForm out_;
};

}  // namespace

BlockForm make_block_form(const nova::ir::Program& program,
                          const std::vector<nova::ir::Step>& steps, const IsaTable& isa) {
  const Lowered lowered = lower(program, steps, false);
  return BlockBuilder(program, lowered, isa).run();
}

}  // namespace novaphy::cpu
