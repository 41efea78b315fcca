// Writes the adjoints of VBD's laws as straight-line code over SIMD lanes or floats.
//
//   novaphy_vbd_adjoints FOLDER
//
// The program writes two files. slot_adjoints.inc has the derivatives of the blocks of slots and
// contacts. number_adjoints.inc maps the adjoints of the numbers of slots to the adjoints of
// materials and rest shapes. For each file, a second file _source.inc has the same code as string
// literals, for device compilers (cmake/NovaPhyDeviceModule.cmake). docs/glossary.md explains slot
// and role.
//
// The laws run once with scalars that are symbolic expressions (symbol.h). A block has the force f
// and the stiffness H, with the adjoints u and B. The program writes the derivatives of u.f + B:H
// with respect to positions and numbers. Each operation is written once, and operations that no
// derivative needs are left out.
//
// Each role and the contacts have variants with and without H, and with and without damping. At a
// solution ("at_solution") the adjoints of H are 0. The stiffness of coarse steps has derivatives
// of the same kind.
#include <algorithm>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <sstream>

#include "novaphy/math/types.h"
#include "symbol.h"

namespace novaphy::vbd::adjoints {
using math::cross;
using math::dot;
}  // namespace novaphy::vbd::adjoints

#include "novaphy/vbd/elements/list.h"
#include "novaphy/vbd/particle_contact_law.h"

namespace novaphy::vbd::adjoints {
namespace {

// The symbolic inputs, each with the text that reads it in the generated code.
class Inputs {
 public:
  Symbol add(const std::string& text) {
    texts_.push_back(text);
    return Symbol::input(static_cast<int32_t>(texts_.size()) - 1);
  }
  Vec3<Symbol> add_vector(const std::string& text) {
    const Symbol x = add(text + ".x"), y = add(text + ".y"), z = add(text + ".z");
    return {x, y, z};
  }
  const std::string& text(int32_t k) const { return texts_[static_cast<size_t>(k)]; }

 private:
  std::vector<std::string> texts_;
};

struct Result {
  std::string text;
  Symbol value;
};
void add_vector(std::vector<Result>& results, const std::string& text, const Vec3<Symbol>& v) {
  results.push_back({text + ".x", v.x});
  results.push_back({text + ".y", v.y});
  results.push_back({text + ".z", v.z});
}

class Writer {
 public:
  Writer(std::ostream& out, const Inputs& inputs) : out_(out), inputs_(inputs) {}

  void write(const std::vector<Result>& results) {
    const Graph& graph = Graph::get();
    std::vector<bool> needed(static_cast<size_t>(graph.size()));
    for (const Result& r : results) needed[static_cast<size_t>(r.value.node)] = true;
    for (int32_t k = graph.size(); k-- > 0;)
      if (needed[static_cast<size_t>(k)])
        for (const int32_t o : graph.node(k).operands)
          if (o >= 0) needed[static_cast<size_t>(o)] = true;
    // A node comes before the nodes that use it. All parts of an atan2 are written with the first
    // part.
    for (int32_t k = 0; k < graph.size(); ++k)
      if (needed[static_cast<size_t>(k)]) write_node(k, graph.node(k));
    for (const Result& r : results) out_ << "  " << r.text << " = " << name(r.value.node) << ";\n";
  }

 private:
  static std::string name(int32_t k) {
    const Node& n = Graph::get().node(k);
    if (n.op == Op::Constant) {
      std::ostringstream text;
      text << "S(" << std::hexfloat << n.value << "f)";
      return text.str();
    }
    if (n.op == Op::Atan2) return angle(n) + ".value";
    if (n.op == Op::Atan2Dy) return angle(n) + ".dy";
    if (n.op == Op::Atan2Dx) return angle(n) + ".dx";
    return "v" + std::to_string(k);
  }
  static std::string angle(const Node& n) {
    return "a" + std::to_string(n.operands[0]) + "_" + std::to_string(n.operands[1]);
  }
  void write_node(int32_t k, const Node& n) {
    if (n.op == Op::Constant) return;
    const auto operand = [&](size_t i) { return name(n.operands[i]); };
    if (n.op == Op::Atan2 || n.op == Op::Atan2Dy || n.op == Op::Atan2Dx) {
      const std::string text = angle(n);
      if (std::find(angles_.begin(), angles_.end(), text) != angles_.end()) return;
      angles_.push_back(text);
      out_ << "  const auto " << text << " = math::functions_detail::atan2_value(" << operand(0)
           << ", " << operand(1) << ");\n";
      return;
    }
    static const std::map<Op, const char*> kInfix = {
        {Op::Add, " + "},  {Op::Sub, " - "},     {Op::Mul, " * "},     {Op::Div, " / "},
        {Op::Less, " < "}, {Op::Greater, " > "}, {Op::AtLeast, " >= "}};
    out_ << "  const auto " << name(k) << " = ";
    if (const auto infix = kInfix.find(n.op); infix != kInfix.end()) {
      out_ << operand(0) << infix->second << operand(1);
    } else if (n.op == Op::Input) {
      out_ << inputs_.text(n.input);
    } else if (n.op == Op::Neg) {
      out_ << "-" << operand(0);
    } else if (n.op == Op::Sqrt) {
      out_ << "sqrt(" << operand(0) << ")";
    } else if (n.op == Op::Select) {
      out_ << "select(" << operand(0) << ", " << operand(1) << ", " << operand(2) << ")";
    } else {
      out_ << "both(" << operand(0) << ", " << operand(1) << ")";
    }
    out_ << ";\n";
  }

  std::ostream& out_;
  const Inputs& inputs_;
  std::vector<std::string> angles_;
};

// Returns the adjoints for the outputs of a block: of f, and of H unless at_solution.
Adjoints adjoints_of(const Block<Symbol>& b, Inputs& inputs, bool at_solution) {
  std::vector<Symbol> values = {b.f.x, b.f.y, b.f.z};
  const Vec3<Symbol> u = inputs.add_vector("adjoint.f");
  std::vector<Symbol> adjoints = {u.x, u.y, u.z};
  if (!at_solution) {
    values.insert(values.end(), {b.h00, b.h11, b.h22, b.h01, b.h02, b.h12});
    for (const char* entry : {"h00", "h11", "h22", "h01", "h02", "h12"})
      adjoints.push_back(inputs.add(std::string("adjoint.") + entry));
  }
  return {values, adjoints};
}

template <Role role>
Condition is_defined(const SlotInputs<role, Symbol>& in) {
  if constexpr (SlotOf<role>::kMayBeUndefined) return SlotOf<role>::is_defined(in);
  return {};
}

// Writes the function of the adjoints with respect to the points and the numbers before `last`.
template <Role role>
void write_adjoints(std::ostream& out, const SlotInputs<role, Symbol>& in, const Adjoints& adjoints,
                    const Inputs& inputs, int last, const std::string& name,
                    const std::string& argument) {
  std::vector<Result> results;
  const auto result = [&](const std::string& text, const Symbol& input) {
    Symbol value = adjoints.of(input);
    // If the law of an element is not defined, its derivatives are 0, even if their factors are not
    // finite.
    if (const Condition c = is_defined(in); c.node >= 0) value = select(c, value, Symbol());
    results.push_back({text, value});
  };
  const auto vector = [&](const std::string& text, const Vec3<Symbol>& v) {
    result(text + ".x", v.x);
    result(text + ".y", v.y);
    result(text + ".z", v.z);
  };
  vector("to.own", in.own);
  for (int k = 0; k < kOthers[role]; ++k)
    vector("to.others[" + std::to_string(k) + "]", in.others[k]);
  for (int k = 0; k < last; ++k) result("to.numbers[" + std::to_string(k) + "]", in.numbers[k]);
  const std::string of = "<static_cast<Role>(" + std::to_string(role) + "), S";
  out << "template <class S, class N>\nNOVAPHY_LANE_FN void " << name << ", const SlotInputs" << of
      << ", N>& x, const " << argument << ", SlotAdjoints" << of
      << ">& to) {\n  using namespace math;\n";
  Writer(out, inputs).write(results);
  out << "}\n";
}

template <Role role>
SlotInputs<role, Symbol> slot_inputs(Inputs& inputs) {
  SlotInputs<role, Symbol> in;
  in.own = inputs.add_vector("x.own");
  for (int k = 0; k < kOthers[role]; ++k)
    in.others[k] = inputs.add_vector("x.others[" + std::to_string(k) + "]");
  for (int k = 0; k < kFloats[role]; ++k)
    in.numbers[k] = inputs.add("x.numbers[" + std::to_string(k) + "]");
  return in;
}

template <Role role>
void write_slot(std::ostream& out, bool at_solution, bool damped) {
  Graph::get().clear();
  Inputs inputs;
  const SlotInputs<role, Symbol> in = slot_inputs<role>(inputs);
  const Adjoints adjoints = adjoints_of(block_of(in, damped), inputs, at_solution);
  std::ostringstream name;
  name << std::boolalpha << "slot_adjoint(SlotCase<" << at_solution << ", " << damped << ">";
  write_adjoints(out, in, adjoints, inputs, kFloats[role], name.str(), "Block<S>& adjoint");
}

// Writes the adjoints of the inputs of u.(sum_k H_k d_k). H_k is the stiffness between the own
// corner and corner k.
template <Role role>
void write_stiffness(std::ostream& out) {
  Graph::get().clear();
  Inputs inputs;
  const SlotInputs<role, Symbol> in = slot_inputs<role>(inputs);
  Vec3<Symbol> d[kOthers[role] + 1];
  for (int k = 0; k <= kOthers[role]; ++k) d[k] = inputs.add_vector("d[" + std::to_string(k) + "]");
  const Vec3<Symbol> u = inputs.add_vector("u"), sum = stiffness(in, true)(d);
  write_adjoints(out, in, Adjoints({sum.x, sum.y, sum.z}, {u.x, u.y, u.z}), inputs, kFloats[role],
                 "stiffness_adjoint(const Vec3<S>& u", "Vec3<S>* d");
}

// Writes the adjoints of the inputs of a slot's values at the start of the step.
template <Role role>
void write_start(std::ostream& out) {
  Graph::get().clear();
  Inputs inputs;
  const SlotInputs<role, Symbol> in = slot_inputs<role>(inputs);
  std::vector<Symbol> values, of_values;
  SlotOf<role>::put_start(in, [&](int k, const Symbol& value) {
    values.push_back(value);
    of_values.push_back(inputs.add("adjoint[" + std::to_string(k) + "]"));
  });
  write_adjoints(out, in, Adjoints(values, of_values), inputs, law_begin(role),
                 "start_adjoint(StartCase",
                 "S (&adjoint)[kStartFloats[" + std::to_string(role) + "]]");
}

void write_contact(std::ostream& out, bool at_solution) {
  Graph::get().clear();
  Inputs inputs;
  const Vec3<Symbol> x = inputs.add_vector("x"), start = inputs.add_vector("start");
  ParticleContact<Symbol> c;
  c.point = inputs.add_vector("c.point");
  c.normal = inputs.add_vector("c.normal");
  c.travel = inputs.add_vector("c.travel");
  c.radius = inputs.add("c.radius");
  c.ke = inputs.add("c.ke");
  c.kd_by_h = inputs.add("c.kd_by_h");
  c.mu = inputs.add("c.mu");
  c.slip = inputs.add("c.slip");
  c.inside = inputs.add("c.inside");
  c.reach = inputs.add("c.reach");
  const Adjoints adjoints = adjoints_of(particle_contact_block(x, start, c), inputs, at_solution);
  std::vector<Result> results;
  const auto of = [&](const Vec3<Symbol>& v) {
    return Vec3<Symbol>{adjoints.of(v.x), adjoints.of(v.y), adjoints.of(v.z)};
  };
  add_vector(results, "to.x", of(x));
  add_vector(results, "to.start", of(start));
  results.push_back({"to.law[0]", adjoints.of(c.radius)});
  results.push_back({"to.law[1]", adjoints.of(c.ke)});
  results.push_back({"to.law[2]", adjoints.of(c.kd_by_h)});
  results.push_back({"to.law[3]", adjoints.of(c.mu)});
  out << "template <class S>\nNOVAPHY_LANE_FN void contact_adjoint(ContactCase<" << at_solution
      << ">, const Vec3<S>& x, const Vec3<S>& start, const ParticleContact<S>& c, const "
         "Block<S>& adjoint, ContactAdjoints<S>& to) {\n  using namespace math;\n";
  Writer(out, inputs).write(results);
  out << "}\n";
}

constexpr const char* kHead = "// Written by tools/vbd_adjoints from the laws (vbd/elements/).\n";

// Declarations for the adjoints of u.f + B:H. `adjoint` has u in f, and each entry of B once in
// h_ij. The scalar S is a float or SIMD lanes. The file that includes the code defines
// NOVAPHY_LANE_FN.
constexpr const char* kDeclarations = R"(
template <Role role, class S>
struct SlotAdjoints {
  Vec3<S> own, others[kOthers[role]];
  S numbers[kFloats[role]];
};
template <class S>
struct ContactAdjoints {
  Vec3<S> x, start;
  S law[kContactLawFloats];
};

// `at_solution`: B is 0.
template <bool at_solution, bool damped>
struct SlotCase {};
template <bool at_solution>
struct ContactCase {};
// The derivatives of the slot's numbers of the start.
struct StartCase {};

)";

void write_blocks(std::ostream& out, bool at_solution) {
  write_contact(out, at_solution);
  for_roles([&](auto is) {
    constexpr Role role = decltype(is)::role;
    write_slot<role>(out, at_solution, true);
    if (law_begin(role) > 0) write_slot<role>(out, at_solution, false);
  });
}

// Writes the adjoints of the parameters of an element, from the adjoints of the weights of its
// corners and of its coefficients.
template <Role role>
void write_numbers(std::ostream& out) {
  using Element = SlotOf<role>;
  constexpr int kParameters = Element::kParameters;
  Graph::get().clear();
  Inputs inputs;
  Symbol p[kParameters];
  for (int k = 0; k < kParameters; ++k) p[k] = inputs.add("p[" + std::to_string(k) + "]");
  const Symbol h = inputs.add("h");
  std::vector<Symbol> values, adjoints;
  for (int corner = 0; corner < Element::kCorners; ++corner)
    Element::put_numbers(corner, p, h, [&](int k, const Symbol& value) {
      const bool is_law = k >= law_begin(role);
      if (is_law && corner > 0) return;  // all corners share the coefficients
      values.push_back(value);
      adjoints.push_back(inputs.add(
          is_law ? "adjoint.law(" + std::to_string(k - law_begin(role)) + ")"
                 : "adjoint.weight(" + std::to_string(corner) + ", " + std::to_string(k) + ")"));
    });
  const Adjoints of(values, adjoints);
  std::vector<Result> results;
  for (int k = 0; k < kParameters; ++k)
    results.push_back({"to[" + std::to_string(k) + "]", of.of(p[k])});
  out << "template <class S, class N>\ninline void numbers_adjoint(RoleIs<static_cast<Role>("
      << role
      << ")>, [[maybe_unused]] const S* p, [[maybe_unused]] S h, const N& adjoint, S* to) {\n  "
         "using "
         "namespace math;\n";
  Writer(out, inputs).write(results);
  out << "}\n";
}

void write_all_numbers(std::ostream& out) {
  out << kHead;
  for_each_kind([&out](auto is) { write_numbers<decltype(is)::role>(out); });
}

void write_all(std::ostream& out) {
  out << kHead << kDeclarations;
  for (const bool at_solution : {false, true}) write_blocks(out, at_solution);
  for_roles([&out](auto is) {
    constexpr Role role = decltype(is)::role;
    write_stiffness<role>(out);
    write_start<role>(out);
  });
}

// Writes the code, and the same code as string literals of some lines each.
bool write_file(const std::string& folder, const std::string& name,
                void (*write)(std::ostream& out)) {
  constexpr size_t kPiece = 8000;
  std::ostringstream all;
  write(all);
  const std::string code = all.str();
  std::ofstream text(folder + "/" + name + "_source.inc");
  for (size_t begin = 0; begin < code.size();) {
    const size_t end =
        std::min(code.find('\n', std::min(begin + kPiece, code.size() - 1)) + 1, code.size());
    text << "R\"==(" << code.substr(begin, end - begin) << ")==\"\n";
    begin = end;
  }
  std::ofstream out(folder + "/" + name + ".inc");
  out << code;
  return text.flush() && out.flush();
}

}  // namespace
}  // namespace novaphy::vbd::adjoints

int main(int argc, char** argv) {
  using namespace novaphy::vbd::adjoints;
  if (argc != 2) {
    std::cerr << "usage: novaphy_vbd_adjoints FOLDER\n";
    return 2;
  }
  return write_file(argv[1], "slot_adjoints", write_all) &&
                 write_file(argv[1], "number_adjoints", write_all_numbers)
             ? 0
             : 1;
}
