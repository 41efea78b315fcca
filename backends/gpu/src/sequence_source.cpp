// The text of a sequence: a function for each form of a chain, and the choice among them.
#include "sequence_source.h"

#include "novaphy/program/emit.h"

namespace novaphy::gpu {
namespace {

using Operation = ChainForm::Operation;

std::string str(int64_t k) { return std::to_string(k); }
std::string registers(int32_t op, int32_t output) { return "r" + str(op) + "_" + str(output); }

class ChainText {
 public:
  ChainText(const SequenceTable& table, const ChainForm& form) : table_(table), form_(form) {}

  std::string run(size_t number) {
    loads();
    code_ += "  row_failure failure = begin_row(sink);\n";
    for (size_t k = 0; k < form_.operations.size(); ++k) operation(static_cast<int32_t>(k));
    for (size_t k = 0; k < form_.operations.size(); ++k) stores(static_cast<int32_t>(k));
    report();
    return "LANE_FN void chain" + str(static_cast<int64_t>(number)) +
           "(const uint64_t* words, const int64_t i, device_sink sink) {\n" + code_ + "}\n";
  }

 private:
  const Operation& at(int32_t k) const { return form_.operations[static_cast<size_t>(k)]; }
  static std::string table(int32_t t) { return "table" + str(t); }
  static std::string own(int32_t op, size_t source) {
    return "own" + str(op) + "_" + str(static_cast<int64_t>(source));
  }
  // What the chain reads at its own row, and the first items of its sums, are loaded at once when
  // it begins: a thread then waits once, and not for each operation anew. What nothing in the
  // sequence writes a thread keeps for the next time.
  void loads() {
    std::string fixed, filled, kept;
    const auto keep = [&](const std::string& words) {
      filled += "    fill_kept(at, " + words + ");\n";
      kept += "    take_kept(at, " + words + ");\n";
    };
    for (int32_t k = 0; k < static_cast<int32_t>(form_.operations.size()); ++k)
      for (size_t s = 0; s < at(k).sources.size(); ++s) {
        const Operation::Source& source = at(k).sources[s];
        const int32_t words = table_.loaded_words(at(k), s);
        if (words == 0) continue;
        const std::string name = own(k, s), width = str(words);
        const char* const row = source.from == Operation::Source::First ? "0" : "i";
        const std::string load = "own_words<" + width + (source.aligned ? ", true" : ", false") +
                                 ">(words[" + str(word(at(k), s)) + "], " + row + ", " + name +
                                 ");\n";
        code_ += "  int32_t " + name + "[" + width + "];\n";
        (source.fixed ? fixed : code_) += (source.fixed ? "    " : "  ") + load;
        if (source.fixed) keep(name);
      }
    std::string items;
    for (size_t t = 0; t < form_.tables.size(); ++t) {
      const std::string name = table(static_cast<int32_t>(t));
      const auto pointer = [&](int32_t word) {
        return "(const int32_t*)words[" + str(form_.tables[t] + word) + "]";
      };
      code_ += "  csr_batch " + name + ";\n";
      fixed += "    " + name + " = csr_begin_batch(" + pointer(0) + ", i);\n";
      items += "    csr_load(&" + name + ", " + pointer(1) + ", 0);\n";
      keep(name + ".start");
      keep(name + ".longest");
      keep(name + ".slots");
    }
    if (fixed.empty()) return;
    code_ += "  const uint32_t kept = (uint32_t)words[0];\n  if (is_kept(kept)) {\n" +
             begin_kept() + kept + "  } else {\n" + fixed + items + "    if (kept != 0) {\n" +
             begin_kept() + filled + "    }\n  }\n";
  }
  static std::string begin_kept() { return "    int32_t* at = begin_kept(kept);\n"; }
  int64_t word(const Operation& op, size_t source) const {
    return op.first_word + table_.source_word(op, source);
  }
  const nova::ir::Program& program(const Operation& op) const {
    return *table_.programs[static_cast<size_t>(op.program)];
  }

  void operation(int32_t k) {
    const Operation& op = at(k);
    for (size_t o = 0; o < op.outputs.size(); ++o)
      if (op.outputs[o].store != Operation::Output::Now)
        code_ += "  int32_t " + registers(k, static_cast<int32_t>(o)) + "[" +
                 str(op.each * op.outputs[o].width) + "];\n";
    const bool is_joined = static_cast<size_t>(k) + 1 < form_.operations.size() && at(k + 1).joins;
    if (is_joined) return;  // with the next one
    code_ += "  {\n    const uint64_t* const w = words + " + str(op.first_word) + ";\n";
    const bool loop = op.each > 1;
    if (loop) code_ += "#pragma unroll\n    for (int32_t j = 0; j < " + str(op.each) + "; ++j) {\n";
    code_ += "    const int64_t row = i";
    if (loop) code_ += " * " + str(op.each) + " + j";
    code_ += ";\n" + call(k, loop) + (loop ? "    }\n" : "") + "  }\n";
  }

  // Words of row j of an operation among those of the chain's row.
  static std::string of_row(const std::string& name, int32_t width, bool loop) {
    return loop ? name + " + j * " + str(width) : name;
  }
  std::string source(int32_t k, size_t number, bool loop) const {
    const Operation& op = at(k);
    const Operation::Source& s = op.sources[number];
    const std::string p = "(const char*)words[" + str(word(op, number)) + "]";
    switch (s.from) {
      case Operation::Source::Registers:
        return "source_registers{" +
               of_row(registers(s.op, s.output), table_.source_width(op, number), loop) + "}";
      case Operation::Source::Own:
        return "source_registers{" + of_row(own(k, number), table_.source_width(op, number), loop) +
               "}";
      case Operation::Source::First:
        return "source_item{" + own(k, number) + "}";
      case Operation::Source::There:
        return "trusted_rows{" + p + "}";
      case Operation::Source::Memory:
        break;
    }
    return "source_rows{" + p + ", (int64_t)words[" + str(word(op, number) + 1) + "]}";
  }
  std::string output(int32_t k, int32_t o, bool loop, const std::string& p) const {
    const Operation::Output& out = at(k).outputs[static_cast<size_t>(o)];
    return out.store == Operation::Output::Now
               ? "output_rows{(char*)" + p + "}"
               : "output_registers{" + of_row(registers(k, o), out.width, loop) + "}";
  }

  std::string call(int32_t k, bool loop) const {
    const Operation& op = at(k);
    const std::string out0 = output(k, 0, loop, op.kind == Operation::RowSum ? "w[4]" : "w[0]");
    switch (op.kind) {
      case Operation::Copy:
        return "    copy_word(" + source(k, 0, loop) + ", " + out0 + ", row);\n";
      case Operation::Fill:
        return "    put_columni(" + out0 + ", 1, 0, row, (int32_t)w[1]);\n";
      case Operation::RowSum:
        return row_sum(k, loop, out0);
      case Operation::Program:
        break;
    }
    const nova::ir::Program& p = program(op);
    std::string text = "    failure.operation = " + str(first_row(k)) + (loop ? " + j" : "") +
                       ";\n    row" + str(op.program) + "(" + arguments(op);
    for (size_t s = 0; s < p.sources.size(); ++s) text += ", " + source(k, s, loop);
    for (size_t o = 0; o < p.outputs.size(); ++o)
      text +=
          ", " + output(k, static_cast<int32_t>(o), loop, "w[" + str(p.output_argument(o)) + "]");
    return text + ", row, failure);\n";
  }
  // Its words, with its tables where the chain has loaded them all.
  std::string arguments(const Operation& op) const {
    std::string tables;
    for (const int32_t t : op.tables) {
      if (t < 0) return "w";
      tables += (tables.empty() ? "&" : ", &") + table(t);
    }
    if (tables.empty()) return "w";
    return "words_and_tables<" + str(static_cast<int64_t>(op.tables.size())) + ">{w, {" + tables +
           "}}";
  }
  std::string row_sum(int32_t k, bool loop, const std::string& out) const {
    const Operation& op = at(k);
    const auto init = [&](int32_t sum) {
      return at(sum).init ? source(sum, 0, loop) : std::string("no_init{}");
    };
    const std::string width = "<" + str(op.width) + ">(";
    if (!op.offsets) return "    sum_even_row" + width + "w, " + init(k) + ", " + out + ", row);\n";
    const std::string csr = op.tables[0] < 0 ? "csr_first(w, 1, 0, row)" : table(op.tables[0]);
    if (!op.joins)
      return "    sum_row" + width + csr + ", w, " + init(k) + ", " + out + ", row);\n";
    const std::string words = "words + " + str(at(k - 1).first_word);
    return "    sum_two_rows" + width + csr + ", " + words + ", " + init(k - 1) + ", " +
           output(k - 1, 0, loop, "(" + words + ")[4]") + ", w, " + init(k) + ", " + out +
           ", row);\n";
  }

  // Rows of the operations before, for one of the chain: so a failure names operation and row.
  int64_t first_row(int32_t k) const {
    int64_t rows = 0;
    for (int32_t before = 0; before < k; ++before) rows += at(before).each;
    return rows;
  }
  // Once per chain: a branch after each row would keep the next one's loads waiting.
  void report() {
    code_ +=
        "  if (failure.source >= 0) {\n    const int32_t at = failure.source / kSources;\n"
        "    int64_t row = i;\n";
    for (size_t k = 0; k < form_.operations.size(); ++k) {
      const Operation& op = form_.operations[k];
      if (op.kind != Operation::Program) continue;
      const std::string first = str(first_row(static_cast<int32_t>(k)));
      code_ += "    if (at >= " + first + ") {\n      sink.kernel = (uint32_t)words[" +
               str(op.first_word - 1) + "];\n      row = i * " + str(op.each) + " + (at - " +
               first + ");\n    }\n";
    }
    code_ += "    end_row(failure, sink, row);\n  }\n";
  }

  void stores(int32_t k) {
    const Operation& op = at(k);
    for (size_t o = 0; o < op.outputs.size(); ++o) {
      if (op.outputs[o].store != Operation::Output::Later) continue;
      const int64_t word =
          op.kind == Operation::RowSum ? 4
          : op.kind == Operation::Program
              ? table_.programs[static_cast<size_t>(op.program)]->output_argument(o)
              : 0;
      code_ += "  store_row<" + str(op.each * op.outputs[o].width) +
               (op.outputs[o].aligned ? ", true" : "") + ">((char*)words[" +
               str(op.first_word + word) + "], i, " + registers(k, static_cast<int32_t>(o)) +
               ");\n";
    }
  }

  const SequenceTable& table_;
  const ChainForm& form_;
  std::string code_;
};

}  // namespace

std::string sequence_source(const SequenceTable& table, const SequenceShape& shape) {
  constexpr uint64_t kStep = 64;  // tables of about one size share their code
  std::string text = "#define NOVAPHY_SEQUENCE\n";
  const auto define = [&](const char* name, uint64_t value) {
    text += std::string("#define ") + name + " " + std::to_string(value) + "\n";
  };
  define("SEQUENCE_WORDS", (table.most_words + kStep - 1) / kStep * kStep);
  define("SEQUENCE_THREADS", shape.threads);
  define("SEQUENCE_FORM", static_cast<uint64_t>(shape.form));
  if (shape.form == SequenceShape::Form::Cluster) define("SEQUENCE_BLOCKS", shape.blocks);
  if (shape.form != SequenceShape::Form::Grid) define("CSR_BATCH", kBatch);
  define("SEQUENCE_KEPT", table.kept_words);
  define("SEQUENCE_TASKS", table.tasks != 0 ? 1 : 0);
  text += prelude_text();
  text += sequence_text();
  for (size_t k = 0; k < table.programs.size(); ++k)
    text += nova::ir::emit_device(without_names(*table.programs[k]), "row" + std::to_string(k));
  std::string cases;
  for (size_t k = 0; k < table.forms.size(); ++k) {
    text += ChainText(table, table.forms[k]).run(k);
    const std::string number = std::to_string(k);
    cases += "    case " + number + ":\n      chain" + number + "(words, i, sink);\n      break;\n";
  }
  return text +
         "LANE_FN void run_chain(uint32_t form, const uint64_t* words, const int64_t i,\n"
         "                       const device_sink sink) {\n  switch (form) {\n" +
         cases + "  }\n}\n";
}

}  // namespace novaphy::gpu
