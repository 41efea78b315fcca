#include "kept_items.h"

namespace novaphy::gpu {

std::vector<ItemSource> item_sources(const nova::ir::Program& p) {
  using nova::ir::Op;
  const auto at = [&](int32_t v) -> const nova::ir::Instr& {
    return p.instrs[static_cast<size_t>(v)];
  };
  std::vector<ItemSource> sources(p.sources.size());
  std::vector<char> read(p.sources.size(), 0);
  for (const nova::ir::Instr& in : p.instrs) {
    if (in.op != Op::LOAD_F && in.op != Op::LOAD_I) continue;
    const nova::ir::Instr& row = at(in.b);
    ItemSource here;
    if (row.op == Op::SLOT) {
      here.how = ItemSource::AtSlot;
    } else if (row.op == Op::LOAD_I && at(row.b).op == Op::SLOT) {
      here = {ItemSource::AtIndex, row.a, row.c};
    }
    ItemSource& known = sources[static_cast<size_t>(in.a)];
    const bool same =
        known.how == here.how && known.index == here.index && known.column == here.column;
    if (read[static_cast<size_t>(in.a)] == 0) {
      known = here;
    } else if (!same) {
      known = {};
    }
    read[static_cast<size_t>(in.a)] = 1;
  }
  for (ItemSource& source : sources)
    if (source.how == ItemSource::AtIndex &&
        sources[static_cast<size_t>(source.index)].how != ItemSource::AtSlot)
      source = {};
  return sources;
}

}  // namespace novaphy::gpu
