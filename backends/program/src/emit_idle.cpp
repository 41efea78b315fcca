#include "emit_idle.h"

#include <algorithm>
#include <bit>
#include <map>
#include <optional>

namespace nova::ir {
namespace {

size_t at(int32_t k) { return static_cast<size_t>(k); }

// Returns the steps that open the regions of a loop that lie in no other printed region.
std::vector<size_t> top_regions(const EmitPlan& plan, int32_t wanted) {
  std::vector<size_t> found;
  int32_t loop = -1;
  for (size_t s = 0; s < plan.steps.size(); ++s) {
    const Step& step = plan.steps[s];
    if (step.kind == Step::Kind::LoopBegin) loop = step.value;
    if (step.kind == Step::Kind::LoopEnd) loop = -1;
    if (step.kind != Step::Kind::SkipIfNone || loop != wanted) continue;
    const Region& region = plan.regions[at(plan.region_of_step[s])];
    if (region.printed && plan.printed_region(region.parent) < 0) found.push_back(s);
  }
  return found;
}

class Finder {
 public:
  Finder(const Program& program, const EmitPlan& plan, int32_t loop)
      : p_(program), plan_(plan), loop_(loop) {}

  std::optional<IdleItem> run(const std::vector<KeptValues>& kept) {
    return find_region() && kept_before(kept) ? in_region(region_) : std::nullopt;
  }
  std::optional<IdleItem> in_region(int32_t region) {
    region_ = region;
    IdleItem found{loop_, region_, {}};
    for (const Sum& sum : p_.loops[at(loop_)].sums) {
      const auto term = constant(sum.term);
      if (!term) return std::nullopt;
      found.terms.push_back(*term);
    }
    return found;
  }

 private:
  // Finds the single region of the loop that lies in no other region. Returns false for any other
  // number.
  bool find_region() {
    const std::vector<size_t> steps = top_regions(plan_, loop_);
    if (steps.size() != 1) return false;
    begin_ = steps[0];
    region_ = plan_.region_of_step[begin_];
    return !plan_.uniform[at(plan_.regions[at(region_)].cond)];
  }
  // Returns whether values for a later loop are computed even if the region is skipped.
  bool kept_before(const std::vector<KeptValues>& all) const {
    const auto before = [&](Value v) {
      return std::any_of(
          plan_.steps.begin(), plan_.steps.begin() + static_cast<ptrdiff_t>(begin_),
          [v](const Step& s) { return s.kind == Step::Kind::Compute && s.value == v; });
    };
    for (const KeptValues& kept : all)
      for (const auto& [value, equal] : kept.kept)
        if (kept.earlier == loop_ && !before(equal)) return false;
    return true;
  }

  // Returns the constant that the value has for every item if no lane takes the region, or nothing.
  std::optional<float> constant(Value v) {
    const auto known = known_.find(v);
    if (known != known_.end()) return known->second;
    return known_[v] = computed(v);
  }
  std::optional<float> computed(Value v) {
    const Instr& in = p_.instrs[at(v)];
    const auto both = [&](auto f) -> std::optional<float> {
      const auto a = constant(in.a), b = a ? constant(in.b) : std::nullopt;
      return b ? std::optional(f(*a, *b)) : std::nullopt;
    };
    switch (in.op) {
      case Op::CONST_F:
        return std::bit_cast<float>(in.a);
      case Op::SELECT_F:
        if (in.a != plan_.regions[at(region_)].cond) return std::nullopt;
        return constant(plan_.regions[at(region_)].polarity ? in.c : in.b);
      case Op::NEG: {
        const auto a = constant(in.a);
        return a ? std::optional(-*a) : std::nullopt;
      }
      case Op::ADD:
        return both([](float a, float b) { return a + b; });
      case Op::MUL:
        return both([](float a, float b) { return a * b; });
      default:
        return std::nullopt;
    }
  }

  const Program& p_;
  const EmitPlan& plan_;
  const int32_t loop_;
  int32_t region_ = -1;
  std::map<Value, std::optional<float>> known_;
  size_t begin_ = 0;  // step that opens the region
};

// Compares values of two loops: whether they are the same function of the iteration and of values
// outside of their loops.
class SameValue {
 public:
  SameValue(const Program& program, int32_t loop, int32_t earlier)
      : p_(program), loop_(loop), earlier_(earlier) {}

  bool operator()(Value a, Value b) {
    const Instr &x = p_.instrs[at(a)], &y = p_.instrs[at(b)];
    if (x.op == Op::REDUCE_INDEX && y.op == x.op && x.a == loop_ && y.a == earlier_) return true;
    if (a == b) return true;
    if (x.op != y.op || x.op == Op::SUM || x.op == Op::REDUCE_INDEX) return false;
    const auto known = known_.find({a, b});
    if (known != known_.end()) return known->second;
    const char* kinds = kOpSignatures[static_cast<int>(x.op)];
    const auto same = [&](char kind, int32_t c, int32_t d) {
      return kind == '#' || kind == '-' ? c == d : (*this)(c, d);
    };
    return known_[{a, b}] =
               same(kinds[1], x.a, y.a) && same(kinds[2], x.b, y.b) && same(kinds[3], x.c, y.c);
  }

 private:
  const Program& p_;
  const int32_t loop_, earlier_;
  std::map<std::pair<Value, Value>, bool> known_;
};

}  // namespace

std::vector<FollowedItem> find_followed_items(const Program& program, const EmitPlan& plan) {
  // per loop, the regions that lanes may skip
  std::vector<std::vector<int32_t>> regions(program.loops.size());
  for (size_t l = 0; l < regions.size(); ++l)
    for (const size_t s : top_regions(plan, static_cast<int32_t>(l)))
      if (const int32_t r = plan.region_of_step[s]; !plan.uniform[at(plan.regions[at(r)].cond)])
        regions[l].push_back(r);
  const auto fixed = [&](size_t l) { return program.loops[l].kind == LoopKind::Fixed; };
  std::vector<FollowedItem> all;
  for (size_t later = 1; later < program.loops.size(); ++later) {
    if (!fixed(later) || regions[later].size() != 1) continue;
    const Region& region = plan.regions[at(regions[later][0])];
    const auto idle =
        Finder(program, plan, static_cast<int32_t>(later)).in_region(regions[later][0]);
    for (size_t earlier = 0; idle && earlier < later; ++earlier) {
      if (!fixed(earlier) ||
          program.loops[earlier].extent_param != program.loops[later].extent_param)
        continue;
      SameValue same(program, static_cast<int32_t>(later), static_cast<int32_t>(earlier));
      const auto found =
          std::find_if(regions[earlier].begin(), regions[earlier].end(), [&](int32_t r) {
            const Region& before = plan.regions[at(r)];
            return before.polarity == region.polarity && same(region.cond, before.cond);
          });
      if (found == regions[earlier].end()) continue;
      all.push_back({*idle, static_cast<int32_t>(earlier), *found});
      break;
    }
  }
  return all;
}

std::vector<IdleItem> find_idle_items(const Program& program, const EmitPlan& plan,
                                      const std::vector<KeptValues>& kept) {
  std::vector<IdleItem> all;
  for (size_t l = 0; l < program.loops.size(); ++l) {
    if (program.loops[l].kind != LoopKind::Csr) continue;
    if (auto found = Finder(program, plan, static_cast<int32_t>(l)).run(kept))
      all.push_back(std::move(*found));
  }
  return all;
}

}  // namespace nova::ir
