// Quiet launches: launches of a scan in which, for a group of rows, no contact touches and no limit
// is reached. A primal notes the quiet launches of each group of rows. It also stores nearby the
// rows that the other launches read. Its adjoint has the same conditions on the same values, and
// therefore a short form for quiet launches.
#include <algorithm>

#include "emitter.h"

namespace nova::ir {
namespace {

// A hash of a value's formula. Values with equal hashes are computed in the same way from the same
// sources. An adjoint has the sources of its primal at the same positions. All CSR loops count as
// loops over the same rows.
class Alike {
 public:
  explicit Alike(const Program& program) : p_(program), known_(program.instrs.size(), 0) {}

  uint64_t operator()(Value v) {
    uint64_t& known = known_[static_cast<size_t>(v)];
    return known != 0 ? known : known = computed(p_.instrs[static_cast<size_t>(v)]);
  }

 private:
  static uint64_t mixed(uint64_t h, uint64_t with) {
    h = (h ^ with) * 0x9E3779B97F4A7C15u;
    return h ^ (h >> 29);
  }
  uint64_t computed(const Instr& in) {
    uint64_t h = mixed(1, static_cast<uint64_t>(in.op));
    if (in.op == Op::SLOT) return h;
    if (in.op == Op::SUM) {
      const Loop& loop = p_.loops[static_cast<size_t>(in.a)];
      const Sum& sum = loop.sums[static_cast<size_t>(in.b)];
      const bool csr = loop.kind == LoopKind::Csr;
      h = mixed(h, csr ? 0 : 1 + static_cast<uint64_t>(loop.extent_param));
      return mixed(mixed(h, (*this)(sum.init)), (*this)(sum.term));
    }
    if (is_load(in.op)) {
      h = mixed(mixed(h, static_cast<uint64_t>(in.a)), static_cast<uint64_t>(in.c));
      return mixed(h, (*this)(in.b));
    }
    if (is_leaf(in.op)) return mixed(h, static_cast<uint64_t>(static_cast<uint32_t>(in.a)));
    for_each_operand(in, [&](Value o) { h = mixed(h, (*this)(o)); });
    return h;
  }

  const Program& p_;
  std::vector<uint64_t> known_;
};

}  // namespace

std::optional<std::set<uint64_t>> Emitter::questions() const {
  Alike alike(p_);
  std::set<uint64_t> all;
  for (size_t l = 0; l < p_.loops.size(); ++l) {
    const auto loop = static_cast<int32_t>(l);
    const IdleItem* const idle = idle_item(loop);
    if (!idle) return std::nullopt;
    for (size_t s = 0; s < idle->terms.size(); ++s)
      if (!adds_nothing(*idle, s)) return std::nullopt;
    const Region& region = plan_.regions[at(idle->region)];
    all.insert(2 * alike(region.cond) + (region.polarity ? 1 : 0));
  }
  for (const Value v : limits()) all.insert(2 * alike(v));
  return limits().size() < 8 ? std::optional(all) : std::nullopt;
}

std::vector<Value> Emitter::limits() const {
  std::vector<Value> all;
  for (size_t v = 0; v < p_.instrs.size(); ++v)
    if (plan_.used[v] && plan_.root[v] != kNone && p_.instrs[v].op == Op::LT)
      all.push_back(static_cast<Value>(v));
  return all;
}

std::string Emitter::acted_bit(Value limit) const {
  const std::vector<Value> all = limits();
  return str(int64_t{2} << (std::find(all.begin(), all.end(), limit) - all.begin()));
}

void Emitter::quiet_launch() {
  line("if (noted != NULL && noted[launch[" + word(launch_words() - 1) + "]] == 0) {");
  ++depth_;
  Emitter quiet(*this);
  quiet.out_.clear();
  quiet.quiet_ = true;
  quiet.launch_sources();
  quiet.steps();
  quiet.stores();
  out_ += quiet.out_;
  line("continue;");
  close();
}

void Emitter::note() {
  line("if (noted != NULL) {");
  ++depth_;
  line("noted[launch[" + word(launch_words() - 1) + "]] = (char)acted;");
  line("char* const near = " + launch_scratch(scratch_bytes(p_, scan_->carried)) + ";");
  const std::span carried(scan_->carried);
  for (size_t k = 0; k < carried.size(); ++k) {
    const Source& source = p_.sources[at(carried[k])];
    if (!handed_over(source.type, source.width)) continue;
    line("if (acted && near != NULL) keep3f(near + " + str(scratch_bytes(p_, carried.first(k))) +
         " * LANES, " + state(carried[k], 0) + ", " + state(carried[k], 1) + ", " +
         state(carried[k], 2) + ");");
  }
  close();
}

std::string Emitter::launch_scratch(int32_t row_bytes) const {
  return "launch_scratch(scratch, launch[" + word(launch_words() - 1) + "], " + str(row_bytes) +
         ")";
}

int32_t Emitter::near_bytes(int32_t source) const {
  const Source& wanted = p_.sources[at(source)];
  if (!primal_ || !varies(source) || !handed_over(wanted.type, wanted.width)) return -1;
  const Scan kept = *find_scan(*primal_);
  const std::span carried(kept.carried);
  for (size_t k = 0; k < carried.size(); ++k)
    if (carried[k] == source) return scratch_bytes(*primal_, carried.first(k));
  return -1;
}

bool adjoint_of_scan(const Program& adjoint, const Program& primal) {
  if (adjoint.primal == 0 || adjoint.primal != hash(primal) || primal.loops.size() > 1)
    return false;
  const auto later = find_scan(adjoint), first = find_scan(primal);
  if (!later || !first) return false;
  const auto adjoint_questions = Emitter(adjoint, false, &*later).questions(),
             primal_questions = Emitter(primal, false, &*first).questions();
  return adjoint_questions && primal_questions &&
         std::includes(primal_questions->begin(), primal_questions->end(),
                       adjoint_questions->begin(), adjoint_questions->end());
}

}  // namespace nova::ir
