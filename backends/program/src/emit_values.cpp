#include "emit_values.h"

#include <cmath>
#include <cstdio>
#include <cstring>

namespace nova::ir {
namespace {

// Returns the infix operator that C has for an operation on both scalars and vectors.
const char* infix(Op op) {
  switch (op) {
    case Op::ADD:
    case Op::IADD:
      return "+";
    case Op::SUB:
    case Op::ISUB:
      return "-";
    case Op::MUL:
    case Op::IMUL:
      return "*";
    case Op::DIV:
      return "/";
    case Op::IAND:
      return "&";
    case Op::IOR:
      return "|";
    case Op::IXOR:
      return "^";
    default:
      return nullptr;
  }
}

// Returns the prelude's function for an operation without infix operator, without its first letter:
// v for lanes, u for scalars.
const char* function(Op op) {
  switch (op) {
    case Op::IADD:
      return "iadd";
    case Op::ISUB:
      return "isub";
    case Op::IMUL:
      return "imul";
    case Op::DIV:
      return "div";
    case Op::ABS:
      return "abs";
    case Op::SIGN:
      return "sign";
    case Op::MIN:
      return "min";
    case Op::MAX:
      return "max";
    case Op::SQRT:
      return "sqrt";
    case Op::FMA:
      return "fma";
    case Op::FLOOR:
      return "floor";
    case Op::IDIV:
      return "idiv";
    case Op::IMOD:
      return "imod";
    case Op::IMIN:
      return "imin";
    case Op::IMAX:
      return "imax";
    case Op::ISHL:
      return "ishl";
    case Op::ISHR:
      return "ishr";
    case Op::IUSHR:
      return "iushr";
    case Op::LT:
      return "lt";
    case Op::LE:
      return "le";
    case Op::EQ:
      return "eq";
    case Op::NE:
      return "ne";
    case Op::ILT:
      return "ilt";
    case Op::ILE:
      return "ile";
    case Op::IEQ:
      return "ieq";
    case Op::INE:
      return "ine";
    case Op::AND:
      return "and";
    case Op::OR:
      return "or";
    case Op::NOT:
      return "not";
    case Op::SELECT_F:
      return "selectf";
    case Op::SELECT_I:
      return "selecti";
    case Op::SELECT_B:
      return "selectb";
    case Op::F_TO_I:
      return "f_to_i";
    case Op::I_TO_F:
      return "i_to_f";
    case Op::F_BITS:
      return "f_bits";
    case Op::BITS_F:
      return "bits_f";
    default:
      return "?";
  }
}

std::string float_literal(int32_t bits) {
  float value;
  std::memcpy(&value, &bits, sizeof(value));
  char text[40];
  if (!std::isfinite(value)) {
    std::snprintf(text, sizeof(text), "ubits_f((int32_t)0x%08Xu)", static_cast<uint32_t>(bits));
    return text;
  }
  // nine digits determine a float exactly
  std::snprintf(text, sizeof(text), "%.9g", static_cast<double>(value));
  std::string s = text;
  if (s.find_first_of(".e") == std::string::npos) s += ".0";
  s += 'f';
  return s[0] == '-' ? "(" + s + ")" : s;
}

std::string int_literal(int32_t value) {
  if (value == INT32_MIN) return "INT32_MIN";
  const std::string s = std::to_string(value);
  return value < 0 ? "(" + s + ")" : s;
}

}  // namespace

std::string ValueText::literal(const Instr& in) const {
  const std::string a = std::to_string(in.a);
  switch (in.op) {
    case Op::CONST_F:
      return float_literal(in.a);
    case Op::CONST_I:
      return int_literal(in.a);
    case Op::CONST_B:
      return in.a != 0 ? "1" : "0";
    case Op::PARAM_F:
      return "pf" + a;
    case Op::PARAM_I:
      return "pi" + a;
    case Op::REDUCE_INDEX:
      return "r" + a;
    case Op::SLOT:
      return "slot" + a;
    case Op::SUM:
      return "sum" + a + "_" + std::to_string(in.b);
    default:
      return {};
  }
}

std::string ValueText::name(Value v) const {
  const Instr& in = p_.instrs[static_cast<size_t>(v)];
  if (is_leaf(in.op)) return literal(in);
  return (uniform(v) ? "u" : "v") + std::to_string(v);
}

std::string ValueText::lanes(Value v) const {
  if (!uniform(v)) return name(v);
  const Type t = type(v);
  return (t == Type::F32 ? "splatf(" : t == Type::I32 ? "splati(" : "splatb(") + name(v) + ")";
}

std::string ValueText::c_type(Value v) const {
  const Type t = type(v);
  if (uniform(v)) return t == Type::F32 ? "float" : t == Type::I32 ? "int32_t" : "int";
  return t == Type::F32 ? "vf" : t == Type::I32 ? "vi" : "vb";
}

std::string ValueText::expression(Value v) const {
  const Instr& in = p_.instrs[static_cast<size_t>(v)];
  if (in.op == Op::INDEX) return "index_lanes(i)";
  if (in.op == Op::NEG) return "-" + name(in.a);
  const bool own =  // the prelude of a device has its own function
      in.op == Op::IADD || in.op == Op::ISUB || in.op == Op::IMUL || in.op == Op::DIV;
  if (const char* sign = infix(in.op); sign != nullptr && !(device_ && own))
    return name(in.a) + " " + sign + " " + name(in.b);
  const bool scalar = uniform(v);
  std::string text = (scalar ? "u" : "v") + std::string(function(in.op)) + "(";
  const char* separator = "";
  for_each_operand(in, [&](Value o) {
    text += separator + (scalar ? name(o) : lanes(o));
    separator = ", ";
  });
  return text + ")";
}

}  // namespace nova::ir
