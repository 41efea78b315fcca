#include "list_plan.h"

#include <algorithm>
#include <map>
#include <set>
#include <tuple>
#include <unordered_map>

namespace novaphy::gpu {
namespace {

constexpr uint32_t kMaxPeriod = 16, kMaxBefore = 32, kMinRepeats = 3, kMaxSites = 48;

bool same_kind(const novaphy_list_op& a, const novaphy_list_op& b) {
  if (a.kernel != b.kernel) return false;
  if (a.kernel != nullptr) return true;
  return a.row_bytes == b.row_bytes && (a.source == nullptr) == (b.source == nullptr);
}

// Finds the repeated sequence of operations that leaves the fewest operations outside of it.
void find_body(ListPlan& plan, std::span<const novaphy_list_op> ops) {
  const auto count = static_cast<uint32_t>(ops.size());
  uint32_t best = 0;
  for (uint32_t period = 1; period <= kMaxPeriod; ++period) {
    for (uint32_t first = 0; first < std::min(kMaxBefore, count); ++first) {
      uint32_t end = first + period;
      while (end < count && same_kind(ops[end], ops[end - period])) ++end;
      const uint32_t repeats = end > count ? 0 : (end - first) / period;
      if (repeats < kMinRepeats || repeats * period <= best) continue;
      best = repeats * period;
      plan.first = first;
      plan.period = period;
      plan.repeats = repeats;
    }
  }
}

// The operation that wrote the memory that another operation reads at its own row.
struct Producer {
  int64_t op = -1;  // -1: no earlier operation of the list
  uint32_t output = 0;
  bool kernel = false;
  bool operator==(const Producer&) const = default;
};

class Flow {
 public:
  explicit Flow(std::span<const novaphy_list_op> ops) : ops_(ops), producers_(ops.size()) {
    std::unordered_map<uint64_t, Producer> writer;
    for (size_t k = 0; k < ops.size(); ++k) {
      const novaphy_list_op& op = ops[k];
      if (op.kernel == nullptr) {
        const auto target = reinterpret_cast<uint64_t>(op.target);
        writer[target] = {static_cast<int64_t>(k), 0, false};
        written_.insert(target);
        continue;
      }
      const nova::ir::Program& p = op.kernel->program;
      for (size_t s = 0; s < p.sources.size(); ++s) {
        const auto found = writer.find(op.arguments[p.source_argument(s)]);
        producers_[k].push_back(found == writer.end() ? Producer{} : found->second);
      }
      for (size_t o = 0; o < p.outputs.size(); ++o) {
        const uint64_t target = op.arguments[p.output_argument(o)];
        writer[target] = {static_cast<int64_t>(k), static_cast<uint32_t>(o), true};
        written_.insert(target);
      }
    }
  }
  const Producer& producer(size_t op, size_t source) const { return producers_[op][source]; }
  bool is_written(size_t op, size_t source) const {
    return written_.count(ops_[op].arguments[2 * source]) != 0;
  }

 private:
  std::span<const novaphy_list_op> ops_;
  std::vector<std::vector<Producer>> producers_;
  std::set<uint64_t> written_;
};

class Planner {
 public:
  explicit Planner(std::span<const novaphy_list_op> ops) : ops_(ops), flow_(ops) {}

  ListPlan run() {
    find_body(plan_, ops_);
    // The start of the loop determines which results an iteration passes to the next iteration. The
    // rotation that keeps the most results in registers is chosen.
    const uint32_t first = plan_.first;
    uint32_t best = first;
    size_t most = 0;
    for (uint32_t turn = first; turn < first + plan_.period; ++turn) {
      begin_at(turn);
      const size_t kept = plan_.repeats < kMinRepeats ? 0 : kept_in_registers();
      if (kept <= most) continue;
      most = kept;
      best = turn;
    }
    if (plan_.period != 0) begin_at(best);
    return sites();
  }

 private:
  void begin_at(uint32_t first) {
    uint32_t end = first + plan_.period;
    while (end < ops_.size() && same_kind(ops_[end], ops_[end - plan_.period])) ++end;
    plan_.repeats = (end - first) / plan_.period;
    plan_.first = first;
  }
  size_t kept_in_registers() {
    make_body();
    size_t count = 0;
    for (const ListPlan::Site& s : plan_.body)
      for (const ListPlan::Source& source : s.sources)
        count += source.from == ListPlan::Source::From::Registers ? 1 : 0;
    return count;
  }
  void make_body() {
    plan_.body.clear();
    for (uint32_t j = 0; j < plan_.period; ++j) plan_.body.push_back(site(plan_.first + j, true));
    agree_on_starts();
  }

  ListPlan sites() {
    const auto count = static_cast<uint32_t>(ops_.size());
    const uint32_t end = plan_.first + plan_.period * plan_.repeats;
    const uint32_t number = plan_.first + plan_.period + (count - end);
    plan_.worth_it = count >= 2 && number <= kMaxSites;
    if (!plan_.worth_it) return std::move(plan_);
    for (uint32_t k = 0; k < plan_.first; ++k) plan_.before.push_back(site(k, false));
    make_body();
    for (uint32_t k = end; k < count; ++k) plan_.after.push_back(site(k, false));
    return std::move(plan_);
  }

  ListPlan::Site site(uint32_t op, bool in_body) {
    ListPlan::Site result;
    result.op = op;
    if (ops_[op].kernel == nullptr) return result;
    const nova::ir::Program& p = ops_[op].kernel->program;
    const auto [known, fresh] =
        functions_.emplace(ops_[op].kernel, static_cast<uint32_t>(plan_.programs.size()));
    if (fresh) plan_.programs.push_back(&p);
    result.function = known->second;
    for (size_t s = 0; s < p.sources.size(); ++s)
      result.sources.push_back(in_body ? body_source(op, s) : ListPlan::Source{});
    return result;
  }

  ListPlan::Source body_source(uint32_t op, size_t s) const {
    ListPlan::Source source;
    bool written = false;
    for (uint32_t k = 0; k < plan_.repeats; ++k)
      written = written || flow_.is_written(op + k * plan_.period, s);
    if (!written) {
      source.from = ListPlan::Source::From::Constant;
      return source;
    }
    // In every iteration but the first, the same operation must have written the value, at the same
    // distance.
    const auto place = [&](uint32_t k, int64_t& distance, uint32_t& j, uint32_t& output) {
      const Producer& made = flow_.producer(op + k * plan_.period, s);
      if (made.op < plan_.first || !made.kernel) return false;
      const auto at = static_cast<uint32_t>(made.op) - plan_.first;
      distance = static_cast<int64_t>(k) - at / plan_.period;
      j = at % plan_.period;
      output = made.output;
      return distance >= 0 && distance <= 1;
    };
    int64_t distance = 0, d = 0;
    uint32_t j = 0, output = 0, other_j = 0, other_output = 0;
    if (plan_.repeats < 2 || !place(1, distance, j, output)) return source;
    for (uint32_t k = distance == 0 ? 0 : 1; k < plan_.repeats; ++k)
      if (!place(k, d, other_j, other_output) || d != distance || other_j != j ||
          other_output != output)
        return source;
    // A register keeps the value of the previous iteration only until its operation runs again.
    if (distance == 1 && j < op - plan_.first) return source;
    const nova::ir::Program& p = ops_[op].kernel->program;
    const nova::ir::Program& maker = ops_[plan_.first + j].kernel->program;
    if (maker.outputs[output].values.size() != static_cast<size_t>(p.sources[s].width) ||
        maker.outputs[output].type != p.sources[s].type)
      return source;
    source.from = ListPlan::Source::From::Registers;
    source.op = j;
    source.output = output;
    source.carried = distance == 1;
    return source;
  }

  // Registers that the first iteration reads are loaded before the loop. All sources that read the
  // same register must therefore refer to the same memory.
  void agree_on_starts() {
    std::map<std::pair<uint32_t, uint32_t>, uint64_t> start;
    for (ListPlan::Site& s : plan_.body)
      for (size_t k = 0; k < s.sources.size(); ++k) {
        ListPlan::Source& source = s.sources[k];
        if (source.from != ListPlan::Source::From::Registers || !source.carried) continue;
        const uint64_t address = ops_[s.op].arguments[2 * k];
        const auto [known, fresh] = start.emplace(std::pair(source.op, source.output), address);
        if (!fresh && known->second != address) source = {};
      }
  }

  std::span<const novaphy_list_op> ops_;
  const Flow flow_;
  ListPlan plan_;
  std::map<const novaphy_kernel*, uint32_t> functions_;
};

}  // namespace

ListPlan plan_list(std::span<const novaphy_list_op> ops) { return Planner(ops).run(); }

}  // namespace novaphy::gpu
