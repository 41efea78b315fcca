// The text of a list as one kernel: a thread runs all operations of its row.
#include <map>

#include "list_plan.h"
#include "novaphy/program/emit.h"

namespace novaphy::gpu {
namespace {

constexpr size_t kMaxWords = 480;  // a kernel takes 4 KiB of arguments

std::string str(uint64_t k) { return std::to_string(k); }

class Writer {
 public:
  Writer(const ListPlan& plan, std::span<const novaphy_list_op> ops, int64_t n)
      : plan_(plan), ops_(ops), n_(static_cast<uint64_t>(n)) {}

  ListSource run() {
    std::string code;
    for (const ListPlan::Site& site : plan_.before) code += operation(site, false, "  ");
    if (plan_.period != 0) {
      code += registers() + constants();
      std::string body;
      for (const ListPlan::Site& site : plan_.body) body += operation(site, true, "    ");
      code += "  const int32_t repeats = (int32_t)a.word[" + str(word(plan_.repeats)) + "];\n";
      code += "#pragma unroll 1\n";
      code += "  for (int32_t k = 0; k < repeats; ++k) {\n" + body + "  }\n";
    }
    for (const ListPlan::Site& site : plan_.after) code += operation(site, false, "  ");
    assemble(code);
    fill_table();
    return std::move(out_);
  }

 private:
  uint64_t word(uint64_t value) {
    out_.words.push_back(value);
    return out_.words.size() - 1;
  }
  // Equal words that are the same in every iteration share a place, so that the compiler sees that
  // they are equal. Only numbers of rows: whether two addresses are equal depends on the list.
  uint64_t rows_word(uint64_t rows) {
    const auto [known, fresh] = rows_.emplace(rows, 0);
    if (fresh) known->second = word(rows);
    return known->second;
  }

  // Word w of an operation: fixed, growing evenly from iteration to iteration, or listed.
  std::string word_text(uint32_t op, uint32_t w, bool in_body) {
    const uint64_t value = ops_[op].arguments[w];
    const size_t sources = ops_[op].kernel->program.sources.size();
    if (w < 2 * sources && w % 2 == 1) {  // a number of rows
      bool fixed = true;
      for (uint32_t k = 1; in_body && k < plan_.repeats; ++k)
        fixed = fixed && ops_[op + k * plan_.period].arguments[w] == value;
      if (fixed) return "a.word[" + str(rows_word(value)) + "]";
    }
    return varying(value, in_body,
                   [&](uint32_t k) { return ops_[op + k * plan_.period].arguments[w]; });
  }
  template <class At>
  std::string varying(uint64_t value, bool in_body, const At& at) {
    if (!in_body) return "a.word[" + str(word(value)) + "]";
    const uint64_t step = plan_.repeats > 1 ? at(1) - value : 0;
    bool even = true;
    for (uint32_t k = 1; k < plan_.repeats; ++k) even = even && at(k) == value + k * step;
    if (even && step == 0) return "a.word[" + str(word(value)) + "]";
    if (even) {
      const uint64_t first = word(value);
      word(step);
      return "a.word[" + str(first) + "] + (uint64_t)k * a.word[" + str(first + 1) + "]";
    }
    std::vector<uint64_t>& column = columns_.emplace_back();
    for (uint32_t k = 0; k < plan_.repeats; ++k) column.push_back(at(k));
    return "__ldg(table + ((int64_t)k * TABLE_WIDTH + " + str(columns_.size() - 1) + "))";
  }

  static std::string register_name(uint32_t op, uint32_t output) {
    return "r" + str(op) + "_" + str(output);
  }
  bool is_read(uint32_t op, uint32_t output) const {
    for (const ListPlan::Site& site : plan_.body)
      for (const ListPlan::Source& s : site.sources)
        if (s.from == ListPlan::Source::From::Registers && s.op == op && s.output == output)
          return true;
    return false;
  }

  // Declares the registers of the body, and loads those that the first iteration finds filled.
  std::string registers() {
    std::string code;
    for (uint32_t j = 0; j < plan_.period; ++j) {
      const novaphy_list_op& op = ops_[plan_.first + j];
      if (op.kernel == nullptr) continue;
      for (uint32_t o = 0; o < op.kernel->program.outputs.size(); ++o) {
        if (!is_read(j, o)) continue;
        const uint64_t width = op.kernel->program.outputs[o].values.size();
        const std::string name = register_name(j, o);
        code += "  int32_t " + name + "[" + str(width) + "];\n";
        const std::string from = start_of(j, o);
        for (uint64_t c = 0; c < width; ++c)
          code += "  " + name + "[" + str(c) + "] = " +
                  (from.empty() ? "0"
                                : "((const int32_t*)" + from + ")[i * " + str(width) + " + " +
                                      str(c) + "]") +
                  ";\n";
      }
    }
    return code;
  }
  // A source that is the same rows in every iteration, which no operation writes, and of which only
  // the own row is read: it is loaded before the loop.
  bool is_loaded_once(const ListPlan::Site& site, size_t s) const {
    if (site.sources[s].from != ListPlan::Source::From::Constant) return false;
    const nova::ir::Program& p = ops_[site.op].kernel->program;
    for (uint32_t k = 0; k < plan_.repeats; ++k) {
      const uint64_t* words = ops_[site.op + k * plan_.period].arguments;
      if (words[2 * s] != ops_[site.op].arguments[2 * s] || words[2 * s + 1] < n_) return false;
    }
    return rows_read(p, s) == Rows::Own;
  }
  // Which rows of a source a Program reads.
  enum class Rows { None, Own, First, Slots, Others };
  static Rows rows_read(const nova::ir::Program& p, size_t s) {
    using nova::ir::Op;
    Rows rows = Rows::None;
    for (const nova::ir::Instr& in : p.instrs) {
      if ((in.op != Op::LOAD_F && in.op != Op::LOAD_I) || in.a != static_cast<int32_t>(s)) continue;
      const nova::ir::Instr& row = p.instrs[static_cast<size_t>(in.b)];
      const Rows here = row.op == Op::INDEX                   ? Rows::Own
                        : row.op == Op::SLOT                  ? Rows::Slots
                        : row.op == Op::CONST_I && row.a == 0 ? Rows::First
                                                              : Rows::Others;
      rows = rows == Rows::None || rows == here ? here : Rows::Others;
    }
    return rows;
  }
  // Whether the source has every row that is read, in all iterations. For the items of a CSR loop
  // the caller of list_create vouches.
  bool is_trusted(const ListPlan::Site& site, size_t s, bool in_body) const {
    const Rows rows = rows_read(ops_[site.op].kernel->program, s);
    if (rows == Rows::Slots) return true;
    if (rows != Rows::Own && rows != Rows::First) return false;
    for (uint32_t k = 0; k < (in_body ? plan_.repeats : 1); ++k)
      if (ops_[site.op + k * plan_.period].arguments[2 * s + 1] < (rows == Rows::Own ? n_ : 1))
        return false;
    return true;
  }
  static std::string constant_name(uint32_t op, size_t source) {
    return "c" + str(op) + "_" + str(source);
  }
  std::string constants() {
    std::string code;
    for (uint32_t j = 0; j < plan_.period; ++j) {
      const ListPlan::Site& site = plan_.body[j];
      for (size_t s = 0; s < site.sources.size(); ++s) {
        if (!is_loaded_once(site, s)) continue;
        const auto width = static_cast<uint64_t>(ops_[site.op].kernel->program.sources[s].width);
        const std::string name = constant_name(j, s), words = str(width);
        const std::string from = "a.word[" + str(word(ops_[site.op].arguments[2 * s])) + "]";
        code += "  int32_t " + name + "[" + words + "];\n";
        for (uint64_t c = 0; c < width; ++c)
          code += "  " + name + "[" + str(c) + "] = __ldg((const int32_t*)" + from + " + (i * " +
                  words + " + " + str(c) + "));\n";
      }
    }
    return code;
  }
  std::string start_of(uint32_t op, uint32_t output) {
    for (const ListPlan::Site& site : plan_.body)
      for (size_t s = 0; s < site.sources.size(); ++s) {
        const ListPlan::Source& source = site.sources[s];
        if (source.from == ListPlan::Source::From::Registers && source.carried && source.op == op &&
            source.output == output)
          return "a.word[" + str(word(ops_[site.op].arguments[2 * s])) + "]";
      }
    return {};
  }

  std::string operation(const ListPlan::Site& site, bool in_body, const std::string& indent) {
    const novaphy_list_op& op = ops_[site.op];
    if (op.kernel == nullptr) return move(site, in_body, indent);
    const nova::ir::Program& p = op.kernel->program;
    std::string code = indent + "{\n" + indent + "  const uint64_t w[] = {";
    for (uint32_t w = 0; w < op.argument_count; ++w)
      code += (w == 0 ? "" : ", ") + word_text(site.op, w, in_body);
    code += "};\n" + indent + "  row" + str(site.function) + "(w";
    for (size_t s = 0; s < p.sources.size(); ++s) {
      const ListPlan::Source& source = site.sources[s];
      const std::string memory =
          "{(const char*)w[" + str(2 * s) + "], (int64_t)w[" + str(2 * s + 1) + "]}";
      code += ", ";
      if (in_body && is_loaded_once(site, s)) {
        code += "source_registers{" + constant_name(site.op - plan_.first, s) + "}";
        continue;
      }
      if (source.from != ListPlan::Source::From::Registers && is_trusted(site, s, in_body)) {
        code +=
            source.from == ListPlan::Source::From::Constant ? "trusted_constants" : "trusted_rows";
        code += "{(const char*)w[" + str(2 * s) + "]}";
        continue;
      }
      code += source.from == ListPlan::Source::From::Registers
                  ? "source_registers{" + register_name(source.op, source.output) + "}"
              : source.from == ListPlan::Source::From::Constant ? "source_constants" + memory
                                                                : "source_rows" + memory;
    }
    for (uint32_t o = 0; o < p.outputs.size(); ++o) {
      const std::string pointer = "(char*)w[" + str(p.output_argument(o)) + "]";
      const uint32_t j = site.op - plan_.first;
      code += in_body && is_read(j, o)
                  ? ", output_registers{" + pointer + ", " + register_name(j, o) + "}"
                  : ", output_rows{" + pointer + "}";
    }
    return code + ", i, failure);\n" + indent + "  if (failure.source >= 0) {\n" + indent +
           "    end_row(failure, device_sink{sink.record, sink.flag, (uint32_t)a.word[" +
           str(word(op.kernel->number)) + "]}, i);\n" + indent + "    failure.source = -1;\n" +
           indent + "  }\n" + indent + "}\n";
  }

  // A copy or a fill of the own row.
  std::string move(const ListPlan::Site& site, bool in_body, const std::string& indent) {
    const auto address = [](const void* p) { return reinterpret_cast<uint64_t>(p); };
    const auto at = [&](uint32_t k) -> const novaphy_list_op& {
      return ops_[site.op + k * plan_.period];
    };
    const novaphy_list_op& op = ops_[site.op];
    const std::string words = str(op.row_bytes / 4);
    const std::string target =
        varying(address(op.target), in_body, [&](uint32_t k) { return address(at(k).target); });
    std::string code = indent + "{\n" + indent + "  int32_t* const t = (int32_t*)(" + target +
                       ") + i * " + words + ";\n";
    std::string value;
    if (op.source != nullptr) {
      const std::string source =
          varying(address(op.source), in_body, [&](uint32_t k) { return address(at(k).source); });
      code += indent + "  const int32_t* const s = (const int32_t*)(" + source + ") + i * " +
              words + ";\n";
      value = "s[c]";
    } else {
      value = "(int32_t)(" +
              varying(op.pattern, in_body, [&](uint32_t k) { return uint64_t{at(k).pattern}; }) +
              ")";
    }
    return code + indent + "  for (int32_t c = 0; c < " + words + "; ++c) t[c] = " + value + ";\n" +
           indent + "}\n";
  }

  void assemble(const std::string& code) {
    out_.text = prelude_text();
    for (size_t f = 0; f < plan_.programs.size(); ++f)
      out_.text += nova::ir::emit_device(without_names(*plan_.programs[f]), "row" + str(f));
    out_.fits = out_.words.size() <= kMaxWords;
    out_.table_width = static_cast<uint32_t>(columns_.size());
    out_.text += "#define TABLE_WIDTH " + str(columns_.size()) + "\n";
    out_.text += "struct list_arguments {\n  uint64_t word[" + str(out_.words.size()) + "];\n};\n";
    out_.text +=
        "extern \"C\" __global__ void __launch_bounds__(128) novaphy_main(\n"
        "    const __grid_constant__ list_arguments a, const uint64_t* table, const int64_t n,\n"
        "    const device_sink sink) {\n"
        "  const int64_t i = (int64_t)blockIdx.x * blockDim.x + threadIdx.x;\n"
        "  if (i >= n) return;\n"
        "  row_failure failure = begin_row(sink);\n" +
        code + "}\n";
  }

  void fill_table() {
    for (uint32_t k = 0; k < plan_.repeats && !columns_.empty(); ++k)
      for (const std::vector<uint64_t>& column : columns_) out_.table.push_back(column[k]);
  }

  const ListPlan& plan_;
  std::span<const novaphy_list_op> ops_;
  const uint64_t n_;
  ListSource out_;
  std::vector<std::vector<uint64_t>> columns_;
  std::map<uint64_t, uint64_t> rows_;
};

}  // namespace

ListSource list_source(const ListPlan& plan, std::span<const novaphy_list_op> ops, int64_t n) {
  return Writer(plan, ops, n).run();
}

}  // namespace novaphy::gpu
