// Symbol: a scalar that is a symbolic expression. A formula that runs with Symbol builds a graph of
// operations. The derivatives of the formula are added to the same graph.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <tuple>
#include <vector>

namespace novaphy::vbd::adjoints {

enum class Op : uint8_t {
  Constant,
  Input,
  Add,
  Sub,
  Mul,
  Div,
  Neg,
  Sqrt,
  Atan2,  // the value; the next two are its partial derivatives
  Atan2Dy,
  Atan2Dx,
  Select,  // by a condition
  Less,    // this and the next operations give conditions
  Greater,
  AtLeast,
  Both,
};

struct Node {
  Op op;
  std::array<int32_t, 3> operands;  // -1: no operand
  float value;                      // of a Constant
  int32_t input;                    // of an Input: its index
  auto key() const { return std::tuple(op, operands, value, input); }
};

// The graph of the current expressions. Equal operations are one node.
class Graph {
 public:
  static Graph& get() {
    static Graph graph;
    return graph;
  }
  void clear() {
    nodes_.clear();
    known_.clear();
  }
  int32_t add(Op op, int32_t a = -1, int32_t b = -1, int32_t c = -1, float value = 0.0f,
              int32_t input = -1) {
    const Node node{op, {a, b, c}, value, input};
    const auto [at, is_new] = known_.try_emplace(node.key(), static_cast<int32_t>(nodes_.size()));
    if (is_new) nodes_.push_back(node);
    return at->second;
  }
  const Node& node(int32_t k) const { return nodes_[static_cast<size_t>(k)]; }
  int32_t size() const { return static_cast<int32_t>(nodes_.size()); }

 private:
  std::vector<Node> nodes_;
  std::map<decltype(Node{}.key()), int32_t> known_;
};

struct Condition {
  int32_t node = -1;
};
inline Condition both(Condition a, Condition b) {
  return {Graph::get().add(Op::Both, a.node, b.node)};
}

struct Symbol {
  int32_t node = Graph::get().add(Op::Constant);

  Symbol() = default;
  explicit Symbol(float value) : node(Graph::get().add(Op::Constant, -1, -1, -1, value)) {}
  static Symbol input(int32_t number) { return of(Op::Input, -1, -1, -1, number); }
  static Symbol of(Op op, int32_t a, int32_t b = -1, int32_t c = -1, int32_t input = -1) {
    Symbol s;
    s.node = Graph::get().add(op, a, b, c, 0.0f, input);
    return s;
  }
  static Symbol at(int32_t node) {
    Symbol s;
    s.node = node;
    return s;
  }
  bool is(float value) const {
    const Node& n = Graph::get().node(node);
    return n.op == Op::Constant && n.value == value;
  }
  bool is_negated() const { return Graph::get().node(node).op == Op::Neg; }
  Symbol negated() const { return at(Graph::get().node(node).operands[0]); }

  friend Symbol operator-(const Symbol& a) {
    const Node& n = Graph::get().node(a.node);
    if (n.op == Op::Constant) return Symbol(n.value == 0.0f ? 0.0f : -n.value);
    return n.op == Op::Neg ? a.negated() : of(Op::Neg, a.node);
  }
  friend Symbol operator+(const Symbol& a, const Symbol& b) {
    if (a.is(0.0f)) return b;
    if (b.is(0.0f)) return a;
    if (b.is_negated()) return a - b.negated();
    if (a.is_negated()) return b - a.negated();
    return of(Op::Add, a.node, b.node);
  }
  friend Symbol operator-(const Symbol& a, const Symbol& b) {
    if (b.is(0.0f)) return a;
    if (a.is(0.0f)) return -b;
    if (b.is_negated()) return a + b.negated();
    return of(Op::Sub, a.node, b.node);
  }
  friend Symbol operator*(const Symbol& a, const Symbol& b) {
    if (a.is(0.0f) || b.is(0.0f)) return Symbol();
    if (a.is(1.0f)) return b;
    if (b.is(1.0f)) return a;
    if (a.is(-1.0f)) return -b;
    if (b.is(-1.0f)) return -a;
    if (a.is_negated()) return -(a.negated() * b);
    if (b.is_negated()) return -(a * b.negated());
    return of(Op::Mul, std::min(a.node, b.node), std::max(a.node, b.node));
  }
  friend Symbol operator/(const Symbol& a, const Symbol& b) {
    if (a.is(0.0f)) return a;
    if (b.is(1.0f)) return a;
    return of(Op::Div, a.node, b.node);
  }
  friend Condition operator<(const Symbol& a, const Symbol& b) {
    return {of(Op::Less, a.node, b.node).node};
  }
  friend Condition operator>(const Symbol& a, const Symbol& b) {
    return {of(Op::Greater, a.node, b.node).node};
  }
  friend Condition operator>=(const Symbol& a, const Symbol& b) {
    return {of(Op::AtLeast, a.node, b.node).node};
  }
  friend Symbol select(Condition c, const Symbol& a, const Symbol& b) {
    return a.node == b.node ? a : of(Op::Select, c.node, a.node, b.node);
  }
  friend Symbol max(const Symbol& a, const Symbol& b) { return select(a >= b, a, b); }
  friend Symbol min(const Symbol& a, const Symbol& b) { return select(b >= a, a, b); }
  friend Symbol sqrt(const Symbol& a) { return of(Op::Sqrt, a.node); }
  friend Symbol atan2(const Symbol& y, const Symbol& x) { return of(Op::Atan2, y.node, x.node); }
};

// Computes the derivatives of sum_k adjoints[k] * values[k] with respect to every node of the
// graph.
class Adjoints {
 public:
  Adjoints(const std::vector<Symbol>& values, const std::vector<Symbol>& adjoints)
      : bars_(static_cast<size_t>(Graph::get().size())) {
    for (size_t k = 0; k < values.size(); ++k) add(values[k].node, adjoints[k]);
    for (auto k = static_cast<int32_t>(bars_.size()); k-- > 0;) pass(k);
  }
  Symbol of(const Symbol& a) const { return bars_[static_cast<size_t>(a.node)]; }

 private:
  void add(int32_t node, const Symbol& adjoint) {
    Symbol& to = bars_[static_cast<size_t>(node)];
    to = to + adjoint;
  }
  void pass(int32_t k) {
    const Symbol adjoint = bars_[static_cast<size_t>(k)];
    if (adjoint.is(0.0f)) return;
    const Node n = Graph::get().node(k);
    const auto [i, j, l] = n.operands;
    const auto at = [](int32_t node) { return Symbol::at(node); };
    switch (n.op) {
      case Op::Add:
        add(i, adjoint);
        add(j, adjoint);
        return;
      case Op::Sub:
        add(i, adjoint);
        add(j, -adjoint);
        return;
      case Op::Mul:
        add(i, adjoint * at(j));
        add(j, adjoint * at(i));
        return;
      case Op::Div: {
        const Symbol part = adjoint * (Symbol(1.0f) / at(j));
        add(i, part);
        add(j, -(part * at(k)));
        return;
      }
      case Op::Neg:
        add(i, -adjoint);
        return;
      case Op::Sqrt: {
        const Symbol root = at(k), zero;
        add(i, adjoint * select(root > zero, Symbol(0.5f) / root, zero));
        return;
      }
      case Op::Atan2:
        add(i, adjoint * Symbol::of(Op::Atan2Dy, i, j));
        add(j, adjoint * Symbol::of(Op::Atan2Dx, i, j));
        return;
      case Op::Select:
        add(j, select({i}, adjoint, Symbol()));
        add(l, select({i}, Symbol(), adjoint));
        return;
      default:
        return;
    }
  }
  std::vector<Symbol> bars_;
};

}  // namespace novaphy::vbd::adjoints
