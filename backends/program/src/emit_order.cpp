#include "emit_order.h"

#include <algorithm>
#include <utility>

namespace nova::ir {
namespace {

size_t at(int32_t k) { return static_cast<size_t>(k); }

// The largest distance that a line may move forward. Longer moves would keep too many values in
// registers.
constexpr size_t kReach = 110;

// The units of a processor model that starts two operations per cycle, at most one product and one
// sum, as processors with vectors of 16 lanes do.
enum class Unit { None, Product, Sum, Any };
Unit unit_of(Op op) {
  switch (op) {
    case Op::MUL:
    case Op::DIV:
    case Op::SQRT:
    case Op::FMA:
      return Unit::Product;
    case Op::ADD:
    case Op::SUB:
      return Unit::Sum;
    case Op::LOAD_F:
    case Op::LOAD_I:
      return Unit::None;
    default:
      return Unit::Any;
  }
}
// Returns the cycles until the result of an operation is available.
int32_t latency(Op op) {
  switch (op) {
    case Op::MUL:
    case Op::ADD:
    case Op::SUB:
      return 3;
    case Op::FMA:
      return 4;
    case Op::DIV:
      return 13;
    case Op::SQRT:
      return 20;
    case Op::LOAD_F:
    case Op::LOAD_I:
      return 6;
    case Op::LT:
    case Op::LE:
    case Op::EQ:
    case Op::MIN:
    case Op::MAX:
      return 4;
    default:
      return 1;
  }
}
constexpr int32_t kRegionLatency = 15;

// An item that is moved as a whole: a value, or a printed region with its contents.
struct Item {
  Step step;  // computes the value, or opens the region
  std::vector<Item> inside;
  int32_t region = -1;
  bool is_region() const { return region >= 0; }
};

class Orderer {
 public:
  Orderer(const Program& p, EmitPlan& plan) : p_(p), plan_(plan), maker_(p.instrs.size(), -1) {}

  void run() {
    size_t s = 0;
    const std::vector<Item> items = order(items_until(s, plan_.steps.size()));
    std::vector<Step> steps;
    std::vector<int32_t> regions;
    write(items, steps, regions);
    plan_.steps = std::move(steps);
    plan_.region_of_step = std::move(regions);
  }

 private:
  std::vector<Item> items_until(size_t& s, size_t end) const {
    std::vector<Item> items;
    while (s < end) {
      const Step& step = plan_.steps[s];
      const int32_t region = plan_.region_of_step[s++];
      if (step.kind == Step::Kind::Compute) {
        items.push_back({step, {}, -1});
      } else if (plan_.regions[at(region)].printed) {
        items.push_back({step, items_until(s, at(step.target)), region});
      }  // values that are not printed need no step
    }
    return items;
  }
  static void write(const std::vector<Item>& items, std::vector<Step>& steps,
                    std::vector<int32_t>& regions) {
    for (const Item& item : items) {
      const size_t first = steps.size();
      steps.push_back(item.step);
      regions.push_back(item.region);
      if (!item.is_region()) continue;
      write(item.inside, steps, regions);
      steps[first].target = static_cast<int32_t>(steps.size());
    }
  }

  // Calls f for the values that a line reads: its operands, the comparison before a conditional
  // square root, the load of its columns, and the conditions of a load's lanes.
  template <class F>
  void for_each_read(Value v, const F& f) const {
    const Instr& in = p_.instrs[at(v)];
    for_each_operand(in, [&](Value o) {
      f(o);
      const bool root = p_.instrs[at(o)].op == Op::SQRT && plan_.root[at(o)] != kNone;
      if (root && plan_.root[at(o)] != v) f(plan_.root[at(o)]);
    });
    if (!is_load(in.op)) return;
    for (const LoadGroup& group : plan_.groups)
      if (group.source == in.a && group.row == in.b)
        for (const Value column : group.columns)
          if (column != kNone && plan_.group[at(column)] >= 0 && column != v) f(column);
    for (int32_t r = plan_.region[at(v)]; r >= 0; r = plan_.regions[at(r)].parent)
      f(plan_.regions[at(r)].cond);
  }
  template <class F>
  void for_each_value(const Item& item, const F& f) const {
    if (!item.is_region()) return f(item.step.value);
    for (const Item& inner : item.inside) for_each_value(inner, f);
  }

  std::vector<Item> order(std::vector<Item> items) {
    for (Item& item : items) item.inside = order(std::move(item.inside));
    const size_t count = items.size();
    // Each value is computed only once, so an operand needs only the item that defines it.
    for (size_t k = 0; k < count; ++k)
      for_each_value(items[k], [&](Value v) { maker_[at(v)] = static_cast<int32_t>(k); });
    std::vector<std::vector<size_t>> before(count), after(count);
    for (size_t k = 0; k < count; ++k) {
      const auto read = [&](Value v) {
        const int32_t maker = maker_[at(v)];
        if (maker < 0 || at(maker) >= k) return;
        before[k].push_back(at(maker));
        after[at(maker)].push_back(k);
      };
      if (items[k].is_region()) read(plan_.regions[at(items[k].region)].cond);
      for_each_value(items[k], [&](Value v) { for_each_read(v, read); });
    }
    for (const Item& item : items) for_each_value(item, [&](Value v) { maker_[at(v)] = -1; });
    return taken_in_turn(std::move(items), before, after);
  }

  bool is_line(const Item& item) const {
    return !item.is_region() && plan_.is_line(at(item.step.value), op_of(item));
  }
  Op op_of(const Item& item) const { return p_.instrs[at(item.step.value)].op; }
  int32_t latency_of(const Item& item) const {
    return item.is_region() ? kRegionLatency : is_line(item) ? latency(op_of(item)) : 0;
  }
  Unit unit_of_item(const Item& item) const {
    return is_line(item) ? unit_of(op_of(item)) : Unit::None;
  }

  // Orders items by list scheduling: each cycle takes the ready items with the longest remaining
  // chain.
  std::vector<Item> taken_in_turn(std::vector<Item> items,
                                  const std::vector<std::vector<size_t>>& before,
                                  const std::vector<std::vector<size_t>>& after) const {
    const size_t count = items.size();
    std::vector<int32_t> height(count, 0), ready(count, 0);
    std::vector<size_t> waits(count);
    for (size_t k = count; k-- > 0;) {
      for (const size_t next : after[k]) height[k] = std::max(height[k], height[next]);
      height[k] += latency_of(items[k]);
      waits[k] = before[k].size();
    }
    std::vector<char> taken(count, 0);
    std::vector<Item> result;
    size_t first = 0;  // first item that is not taken yet
    for (int32_t cycle = 0; result.size() < count; ++cycle) {
      int32_t any = 2, products = 1, sums = 1;
      for (bool found = true; found;) {
        found = false;
        while (first < count && taken[first]) ++first;
        size_t best = 0;
        for (size_t k = first; k < std::min(count, first + kReach); ++k) {
          if (taken[k] || waits[k] != 0 || ready[k] > cycle) continue;
          const Unit unit = unit_of_item(items[k]);
          if ((unit != Unit::None && any == 0) || (unit == Unit::Product && products == 0) ||
              (unit == Unit::Sum && sums == 0))
            continue;
          if (!found || height[k] > height[best]) best = k;
          found = true;
        }
        if (!found) break;
        const Unit unit = unit_of_item(items[best]);
        any -= unit != Unit::None, products -= unit == Unit::Product, sums -= unit == Unit::Sum;
        taken[best] = 1;
        for (const size_t next : after[best]) {
          --waits[next];
          ready[next] = std::max(ready[next], cycle + latency_of(items[best]));
        }
        result.push_back(std::move(items[best]));
      }
    }
    return result;
  }

  const Program& p_;
  EmitPlan& plan_;
  std::vector<int32_t> maker_;  // per value: the item that defines it
};

}  // namespace

EmitPlan ordered(const Program& program, EmitPlan plan) {
  Orderer(program, plan).run();
  return plan;
}

}  // namespace nova::ir
