#include "novaphy/program/ir.h"

#include <algorithm>
#include <cstring>
#include <sstream>

namespace nova::ir {
namespace {

Type type_of_letter(char letter) {
  return letter == 'f' ? Type::F32 : letter == 'i' ? Type::I32 : Type::Bool;
}

class Writer {
 public:
  void word(uint32_t w) { words.push_back(w); }
  void word(int32_t w) { words.push_back(static_cast<uint32_t>(w)); }
  void text(const std::string& s) {
    const size_t first = words.size();
    words.resize(first + (s.size() + 3) / 4, 0);
    if (!s.empty()) std::memcpy(words.data() + first, s.data(), s.size());
  }
  std::vector<uint32_t> words;
};

class Reader {
 public:
  explicit Reader(std::span<const uint32_t> words) : words_(words) {}
  bool ok() const { return ok_; }
  bool at_end() const { return next_ == words_.size(); }
  uint32_t word() {
    if (next_ >= words_.size()) {
      ok_ = false;
      return 0;
    }
    return words_[next_++];
  }
  int32_t signed_word() { return static_cast<int32_t>(word()); }
  // Reads a count. There must be at least `words_each` words for every item, so that corrupt data
  // cannot cause a large allocation.
  uint32_t count(uint32_t n, uint32_t words_each) {
    if (static_cast<uint64_t>(n) * words_each > words_.size() - next_) ok_ = false;
    return ok_ ? n : 0;
  }
  std::string text(uint32_t bytes) {
    const size_t n = (static_cast<size_t>(bytes) + 3) / 4;
    if (n > words_.size() - next_) {
      ok_ = false;
      return {};
    }
    std::string s(reinterpret_cast<const char*>(words_.data() + next_), bytes);
    next_ += n;
    return s;
  }

 private:
  std::span<const uint32_t> words_;
  size_t next_ = 0;
  bool ok_ = true;
};

template <class... Parts>
std::string message(const Parts&... parts) {
  std::ostringstream s;
  (s << ... << parts);
  return s.str();
}

const char* type_name(Type t) { return t == Type::F32 ? "f32" : t == Type::I32 ? "i32" : "bool"; }

std::string validate_immediates(const Program& p, const Instr& in, size_t v) {
  switch (in.op) {
    case Op::PARAM_F:
    case Op::PARAM_I:
      if (in.a < 0 || in.a >= p.param_count)
        return message("value ", v, ": parameter ", in.a, " of ", p.param_count);
      break;
    case Op::REDUCE_INDEX:
    case Op::SLOT:
    case Op::SUM:
      if (in.a < 0 || in.a >= static_cast<int32_t>(p.loops.size()))
        return message("value ", v, ": loop ", in.a, " of ", p.loops.size());
      if (in.op == Op::SLOT && p.loops[in.a].kind != LoopKind::Csr)
        return message("value ", v, ": SLOT of a loop that is not CSR");
      if (in.op == Op::SUM && (in.b < 0 || in.b >= static_cast<int32_t>(p.loops[in.a].sums.size())))
        return message("value ", v, ": sum ", in.b, " of ", p.loops[in.a].sums.size());
      break;
    case Op::LOAD_F:
    case Op::LOAD_I: {
      if (in.a < 0 || in.a >= static_cast<int32_t>(p.sources.size()))
        return message("value ", v, ": source ", in.a, " of ", p.sources.size());
      const Source& s = p.sources[in.a];
      if (in.c < 0 || in.c >= s.width)
        return message("value ", v, ": column ", in.c, " of ", s.width);
      if (s.type != result_type(in.op))
        return message("value ", v, ": loads ", type_name(s.type), " source as other");
      break;
    }
    case Op::CONST_B:
      if (in.a != 0 && in.a != 1) return message("value ", v, ": bool constant ", in.a);
      break;
    default:
      break;
  }
  return {};
}

}  // namespace

uint32_t Program::output_argument(size_t output) const {
  return static_cast<uint32_t>(2 * sources.size() + output);
}
uint32_t Program::loop_argument(size_t loop) const {
  uint32_t word = static_cast<uint32_t>(2 * sources.size() + outputs.size());
  for (size_t l = 0; l < loop; ++l) word += loops[l].kind == LoopKind::Csr ? 2 : 0;
  return word;
}
uint32_t Program::param_argument(size_t param) const {
  return loop_argument(loops.size()) + static_cast<uint32_t>(param);
}
uint32_t Program::argument_count() const {
  return param_argument(static_cast<size_t>(param_count));
}

Type result_type(Op op) { return type_of_letter(kOpSignatures[static_cast<int>(op)][0]); }

std::string validate(const Program& p, bool allow_trace_ops) {
  const auto count = static_cast<int32_t>(p.instrs.size());
  if (p.param_count < 0 || p.param_count > 4096) return message("parameter count ", p.param_count);
  for (const Source& s : p.sources) {
    if (s.width < 1 || s.width > 4096) return message("source '", s.name, "': width ", s.width);
    if (s.type != Type::F32 && s.type != Type::I32)
      return message("source '", s.name, "': neither f32 nor i32");
    if (static_cast<int>(s.access) > static_cast<int>(Access::Reduced))
      return message("source '", s.name, "': access");
  }
  for (int32_t v = 0; v < count; ++v) {
    const Instr& in = p.instrs[v];
    if (static_cast<int>(in.op) >= kOpCount)
      return message("value ", v, ": unknown op ", static_cast<int>(in.op));
    if (!allow_trace_ops && (in.op == Op::PARTIAL || in.op == Op::DETACH))
      return message("value ", v, ": ", kOpNames[static_cast<int>(in.op)], " outside of tracing");
    const char* signature = kOpSignatures[static_cast<int>(in.op)];
    const int32_t operands[3] = {in.a, in.b, in.c};
    for (int k = 0; k < 3; ++k) {
      const char letter = signature[k + 1];
      if (letter == '-' || letter == '#') continue;
      if (operands[k] < 0 || operands[k] >= v)
        return message("value ", v, ": operand ", operands[k]);
      if (result_type(p.instrs[operands[k]].op) != type_of_letter(letter))
        return message("value ", v, ": operand ", operands[k], " has the wrong type");
    }
    if (std::string reason = validate_immediates(p, in, static_cast<size_t>(v)); !reason.empty())
      return reason;
  }
  auto is_value = [&](Value v, Type t) {
    return v >= 0 && v < count && result_type(p.instrs[v].op) == t;
  };
  for (const Loop& l : p.loops) {
    if (static_cast<int>(l.kind) > 1) return "loop kind";
    if (l.kind == LoopKind::Fixed && (l.extent_param < 0 || l.extent_param >= p.param_count))
      return message("loop extent parameter ", l.extent_param);
    for (const Sum& s : l.sums)
      if (!is_value(s.init, Type::F32) || !is_value(s.term, Type::F32)) return "loop sum operand";
  }
  if (p.outputs.empty()) return "no outputs";
  for (const Output& o : p.outputs) {
    if (o.values.empty() || o.type == Type::Bool)
      return message("output '", o.name, "': no columns, or bool");
    for (Value v : o.values)
      if (!is_value(v, o.type)) return message("output '", o.name, "': value ", v);
  }
  std::vector<char> is_carried(p.sources.size(), 0);
  for (const Output& o : p.outputs) {
    if (o.carried == kNone) continue;
    if (o.carried < 0 || o.carried >= static_cast<int32_t>(p.sources.size()))
      return message("output '", o.name, "': carried to source ", o.carried, " of ",
                     p.sources.size());
    const Source& s = p.sources[o.carried];
    if (s.type != o.type || static_cast<size_t>(s.width) != o.values.size() || s.varies ||
        is_carried[o.carried]++ != 0)
      return message("output '", o.name, "': cannot be carried to source '", s.name, "'");
  }
  // An inner value of a loop stays inside, and a sum's initial value exists before its loop.
  const std::vector<int32_t> section = sections(p);
  for (int32_t v = 0; v < count; ++v)
    if (section[v] < 0) return message("value ", v, " leaves its loop");
  for (size_t l = 0; l < p.loops.size(); ++l) {
    const auto inside = static_cast<int32_t>(2 * l + 1);
    for (const Sum& s : p.loops[l].sums) {
      if (section[s.init] >= inside)
        return message("loop ", l, ": initial value computed inside or after");
      if (section[s.term] % 2 == 1 ? section[s.term] != inside : section[s.term] > inside)
        return message("loop ", l, ": term computed in another loop or after");
    }
  }
  for (const Output& o : p.outputs)
    for (Value v : o.values)
      if (section[v] % 2 == 1) return message("output '", o.name, "' reads a value inside a loop");
  return {};
}

namespace {

// Returns the source whose row gives the initial values (or the terms) of a loop's sums, with all
// its columns in order. `row` is the operation that gives the row index. -1: no such source.
int32_t row_source(const Program& p, const Loop& loop, Value Sum::*value, Op row) {
  if (loop.sums.empty()) return -1;
  const auto instr = [&](Value v) -> const Instr& { return p.instrs[static_cast<size_t>(v)]; };
  const int32_t source = instr(loop.sums[0].*value).a;
  int32_t column = 0;
  for (const Sum& sum : loop.sums) {
    const Instr& in = instr(sum.*value);
    if (in.op != Op::LOAD_F || in.a != source || in.c != column++ || instr(in.b).op != row)
      return -1;
  }
  return p.sources[static_cast<size_t>(source)].width == column ? source : -1;
}

}  // namespace

int32_t summed_source(const Program& p) {
  if (p.loops.size() != 1 || p.outputs.size() != 1) return -1;
  const std::vector<Value>& out = p.outputs[0].values;
  const size_t columns = p.loops[0].sums.size();
  if (p.loops[0].kind != LoopKind::Csr || out.size() != columns) return -1;
  const int32_t source = row_source(p, p.loops[0], &Sum::term, Op::SLOT);
  if (source < 0) return -1;
  for (size_t c = 0; c < columns; ++c) {
    const Instr& value = p.instrs[out[c]];
    if (value.op != Op::SUM || value.b != static_cast<int32_t>(c)) return -1;
  }
  // The Program has one slot, and a load and a sum for each column.
  const auto uses = std::count_if(p.instrs.begin(), p.instrs.end(), [&](const Instr& in) {
    return (in.op == Op::LOAD_F && in.a == source) || in.op == Op::SLOT || in.op == Op::SUM;
  });
  return uses == static_cast<std::ptrdiff_t>(2 * columns + 1) ? source : -1;
}

AddedRows added_rows(const Program& p) {
  const int32_t source = summed_source(p);
  if (source < 0) return {};
  const int32_t init = row_source(p, p.loops[0], &Sum::init, Op::INDEX);
  return init < 0 ? AddedRows{} : AddedRows{init, source};
}

std::vector<int32_t> sections(const Program& p) {
  std::vector<int32_t> section(p.instrs.size(), 0);
  for (size_t v = 0; v < p.instrs.size(); ++v) {
    const Instr& in = p.instrs[v];
    int32_t outer = 0, inner = -1;
    bool bad = false;
    if (in.op == Op::REDUCE_INDEX || in.op == Op::SLOT) inner = 2 * in.a + 1;
    if (in.op == Op::SUM) outer = 2 * in.a + 2;
    for_each_operand(in, [&](Value o) {
      const int32_t s = section[o];
      if (s < 0) {
        bad = true;
      } else if (s % 2 == 1) {
        if (inner >= 0 && inner != s) bad = true;
        inner = s;
      } else if (s > outer) {
        outer = s;
      }
    });
    if (inner >= 0 && outer > inner) bad = true;
    section[v] = bad ? -1 : inner >= 0 ? inner : outer;
  }
  return section;
}

std::vector<uint32_t> serialize(const Program& p) {
  Writer w;
  const uint32_t header[NOVAPHY_PROGRAM_HEADER_WORDS] = {NOVAPHY_PROGRAM_MAGIC,
                                                         NOVAPHY_PROGRAM_VERSION,
                                                         0,
                                                         static_cast<uint32_t>(p.name.size()),
                                                         static_cast<uint32_t>(p.sources.size()),
                                                         static_cast<uint32_t>(p.outputs.size()),
                                                         static_cast<uint32_t>(p.loops.size()),
                                                         static_cast<uint32_t>(p.param_count),
                                                         static_cast<uint32_t>(p.instrs.size()),
                                                         p.contract ? 1u : 0u,
                                                         static_cast<uint32_t>(p.primal),
                                                         static_cast<uint32_t>(p.primal >> 32)};
  for (uint32_t h : header) w.word(h);
  w.text(p.name);
  for (const Source& s : p.sources) {
    w.word(static_cast<uint32_t>(s.type));
    w.word(s.width);
    w.word(static_cast<uint32_t>(s.access));
    w.word(s.varies ? 1u : 0u);
    w.word(static_cast<uint32_t>(s.name.size()));
    w.text(s.name);
  }
  for (const Output& o : p.outputs) {
    w.word(static_cast<uint32_t>(o.type));
    w.word(static_cast<uint32_t>(o.values.size()));
    w.word(o.carried);
    w.word(static_cast<uint32_t>(o.name.size()));
    w.text(o.name);
    for (Value v : o.values) w.word(v);
  }
  for (const Loop& l : p.loops) {
    w.word(static_cast<uint32_t>(l.kind));
    w.word(l.extent_param);
    w.word(static_cast<uint32_t>(l.sums.size()));
    for (const Sum& s : l.sums) {
      w.word(s.init);
      w.word(s.term);
    }
  }
  for (const Instr& in : p.instrs) {
    w.word(static_cast<uint32_t>(in.op));
    w.word(in.a);
    w.word(in.b);
    w.word(in.c);
  }
  w.words[NOVAPHY_PROGRAM_HEADER_WORD_COUNT] = static_cast<uint32_t>(w.words.size());
  return w.words;
}

bool deserialize(std::span<const uint32_t> words, Program& program, std::string& reason) {
  auto refuse = [&](std::string why) {
    reason = "not a valid Program: " + std::move(why);
    return false;
  };
  if (words.size() < NOVAPHY_PROGRAM_HEADER_WORDS) return refuse("shorter than its header");
  if (words[NOVAPHY_PROGRAM_HEADER_MAGIC] != NOVAPHY_PROGRAM_MAGIC)
    return refuse("wrong magic number");
  if (words[NOVAPHY_PROGRAM_HEADER_VERSION] != NOVAPHY_PROGRAM_VERSION)
    return refuse(message("version ", words[NOVAPHY_PROGRAM_HEADER_VERSION], ", expected ",
                          NOVAPHY_PROGRAM_VERSION));
  if (words[NOVAPHY_PROGRAM_HEADER_WORD_COUNT] != words.size())
    return refuse(message(words[NOVAPHY_PROGRAM_HEADER_WORD_COUNT], " words announced, ",
                          words.size(), " given"));
  Program p;
  Reader r(words.subspan(NOVAPHY_PROGRAM_HEADER_WORDS));
  p.name = r.text(words[NOVAPHY_PROGRAM_HEADER_NAME_BYTES]);
  p.param_count = static_cast<int32_t>(words[NOVAPHY_PROGRAM_HEADER_PARAMETERS]);
  p.contract = words[NOVAPHY_PROGRAM_HEADER_FLAGS] & 1u;
  p.primal = words[NOVAPHY_PROGRAM_HEADER_PRIMAL_LOW] |
             static_cast<uint64_t>(words[NOVAPHY_PROGRAM_HEADER_PRIMAL_HIGH]) << 32;
  p.sources.resize(r.count(words[NOVAPHY_PROGRAM_HEADER_SOURCES], 5));
  for (Source& s : p.sources) {
    s.type = static_cast<Type>(std::min<uint32_t>(r.word(), 3));
    s.width = r.signed_word();
    s.access = static_cast<Access>(std::min<uint32_t>(r.word(), 255));
    s.varies = r.word() != 0;
    s.name = r.text(r.word());
  }
  p.outputs.resize(r.count(words[NOVAPHY_PROGRAM_HEADER_OUTPUTS], 4));
  for (Output& o : p.outputs) {
    o.type = static_cast<Type>(std::min<uint32_t>(r.word(), 3));
    const uint32_t width = r.word();
    o.carried = r.signed_word();
    o.name = r.text(r.word());
    o.values.resize(r.count(width, 1));
    for (Value& v : o.values) v = r.signed_word();
  }
  p.loops.resize(r.count(words[NOVAPHY_PROGRAM_HEADER_LOOPS], 3));
  for (Loop& l : p.loops) {
    l.kind = static_cast<LoopKind>(std::min<uint32_t>(r.word(), 255));
    l.extent_param = r.signed_word();
    l.sums.resize(r.count(r.word(), 2));
    for (Sum& s : l.sums) {
      s.init = r.signed_word();
      s.term = r.signed_word();
    }
  }
  p.instrs.resize(r.count(words[NOVAPHY_PROGRAM_HEADER_INSTRUCTIONS], 4));
  for (Instr& in : p.instrs) {
    in.op = static_cast<Op>(std::min<uint32_t>(r.word(), 255));
    in.a = r.signed_word();
    in.b = r.signed_word();
    in.c = r.signed_word();
  }
  if (!r.ok() || !r.at_end()) return refuse("the counts in it do not match its length");
  if (std::string why = validate(p); !why.empty()) return refuse(std::move(why));
  program = std::move(p);
  return true;
}

std::string to_string(const Program& p) {
  static constexpr const char* kAccess[] = {"direct", "uniform", "indexed", "csr_row", "reduced"};
  std::ostringstream s;
  s << "program " << p.name << (p.contract ? " (contract)" : "") << "\n";
  for (size_t k = 0; k < p.sources.size(); ++k)
    s << "  source " << k << " " << p.sources[k].name << ": " << type_name(p.sources[k].type) << "{"
      << p.sources[k].width << "} " << kAccess[static_cast<int>(p.sources[k].access)]
      << (p.sources[k].varies ? " varies" : "") << "\n";
  const std::vector<int32_t> section = sections(p);
  for (size_t v = 0; v < p.instrs.size(); ++v) {
    const Instr& in = p.instrs[v];
    s << (section[v] % 2 == 1 ? "    " : "  ") << "%" << v << " = "
      << kOpNames[static_cast<int>(in.op)];
    const char* signature = kOpSignatures[static_cast<int>(in.op)];
    const int32_t operands[3] = {in.a, in.b, in.c};
    for (int k = 0; k < 3; ++k) {
      if (signature[k + 1] == '-') continue;
      if (in.op == Op::CONST_F) {
        float value;
        std::memcpy(&value, &in.a, 4);
        s << " " << value;
      } else {
        s << (signature[k + 1] == '#' ? " " : " %") << operands[k];
      }
    }
    s << "\n";
  }
  for (size_t l = 0; l < p.loops.size(); ++l) {
    s << "  loop " << l << (p.loops[l].kind == LoopKind::Csr ? " csr" : " fixed");
    for (const Sum& sum : p.loops[l].sums) s << " [%" << sum.init << " + %" << sum.term << "]";
    s << "\n";
  }
  for (const Output& o : p.outputs) {
    s << "  output " << o.name << ": " << type_name(o.type) << " =";
    for (Value v : o.values) s << " %" << v;
    if (o.carried != kNone) s << " carried to " << o.carried;
    s << "\n";
  }
  return s.str();
}

uint64_t hash(const Program& p) {
  Program anonymous = p;
  anonymous.name.clear();
  for (Source& s : anonymous.sources) s.name.clear();
  for (Output& o : anonymous.outputs) o.name.clear();
  uint64_t h = 0x9E3779B97F4A7C15u;
  for (uint32_t w : serialize(anonymous)) {
    h ^= w;
    h *= 0xFF51AFD7ED558CCDu;
    h ^= h >> 32;
  }
  return h;
}

}  // namespace nova::ir
