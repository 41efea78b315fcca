#include "emit_sink.h"

#include <algorithm>

namespace nova::ir {
namespace {

size_t at(int32_t k) { return static_cast<size_t>(k); }

// Regions with fewer steps may be written without a condition.
constexpr int32_t kMinSteps = 32;

bool is_cheap(Op op) {
  return op == Op::ADD || op == Op::SUB || op == Op::MUL || op == Op::NEG || op == Op::SELECT_F;
}

class Sinker {
 public:
  Sinker(const Program& program, std::vector<Step> steps) : p_(program), steps_(std::move(steps)) {}

  std::vector<Step> run() {
    locate();
    find_users();
    // Users come after their operands, so the loop runs backward.
    for (size_t v = p_.instrs.size(); v-- > 0;)
      if (can_sink(v)) region_[v] = user_[v];
    return rebuilt();
  }

 private:
  // Finds for each value the outermost region of a CSR loop that computes it, as the step of the
  // region.
  void locate() {
    region_.assign(p_.instrs.size(), kNone);
    before_loops_.assign(p_.instrs.size(), 0);
    bool csr = false, loop = false;
    int32_t region = kNone, end = -1;
    for (size_t s = 0; s < steps_.size(); ++s) {
      if (region != kNone && static_cast<int32_t>(s) >= end) region = kNone;
      const Step& step = steps_[s];
      if (step.kind == Step::Kind::LoopBegin) {
        loop = true;
        csr = p_.loops[at(step.value)].kind == LoopKind::Csr;
      } else if (step.kind == Step::Kind::LoopEnd) {
        loop = csr = false;
      } else if (step.kind == Step::Kind::SkipIfNone && csr && region == kNone &&
                 step.target - static_cast<int32_t>(s) >= kMinSteps) {
        region = static_cast<int32_t>(s);
        end = step.target;
      } else if (step.kind == Step::Kind::Compute) {
        region_[at(step.value)] = region;
        before_loops_[at(step.value)] = loop ? 0 : 1;
      }
      if (step.kind == Step::Kind::SkipIfNone) conditions_.push_back(step.value);
    }
  }

  enum : int32_t { kUnused = -2, kMany = -3 };
  void use(Value v, int32_t region) {
    int32_t& user = user_[at(v)];
    user = user == kUnused || user == region ? region : kMany;
  }
  void find_users() {
    user_.assign(p_.instrs.size(), kUnused);
    for (const Output& o : p_.outputs)
      for (const Value v : o.values) use(v, kNone);
    for (const Loop& l : p_.loops)
      for (const Sum& s : l.sums) use(s.init, kNone), use(s.term, kNone);
    for (const Value v : conditions_) use(v, kNone);
  }
  // Returns whether the value can move into the region. Then passes the region on to its operands.
  bool can_sink(size_t v) {
    const Instr& in = p_.instrs[v];
    const bool can = before_loops_[v] != 0 && is_cheap(in.op) && user_[v] >= 0;
    const int32_t region = can ? user_[v] : region_[v];
    if (user_[v] != kUnused) for_each_operand(in, [&](Value o) { use(o, region); });
    return can;
  }

  std::vector<Step> rebuilt() const {
    std::vector<Step> out;
    std::vector<int32_t> moved(steps_.size() + 1, 0);
    const auto sinks = [&](const Step& step) {
      return step.kind == Step::Kind::Compute && before_loops_[at(step.value)] != 0 &&
             region_[at(step.value)] != kNone;
    };
    for (size_t s = 0; s < steps_.size(); ++s) {
      moved[s] = static_cast<int32_t>(out.size());
      if (sinks(steps_[s])) continue;
      out.push_back(steps_[s]);
      if (steps_[s].kind != Step::Kind::SkipIfNone) continue;
      for (size_t k = 0; k < s; ++k)
        if (sinks(steps_[k]) && region_[at(steps_[k].value)] == static_cast<int32_t>(s))
          out.push_back(steps_[k]);
    }
    moved[steps_.size()] = static_cast<int32_t>(out.size());
    for (Step& step : out)
      if (step.kind == Step::Kind::SkipIfNone) step.target = moved[at(step.target)];
    return out;
  }

  const Program& p_;
  const std::vector<Step> steps_;
  std::vector<int32_t> region_, user_;
  std::vector<char> before_loops_;
  std::vector<Value> conditions_;
};

}  // namespace

std::vector<Step> sunk(const Program& program, std::vector<Step> steps) {
  return Sinker(program, std::move(steps)).run();
}

}  // namespace nova::ir
