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
    for (const Operation& op : form_.operations)
      for (const int32_t word : op.tables)
        code_ += "  touch_items(words[" + str(op.first_word + word) + "], words[" +
                 str(op.first_word + word + 1) + "], i);\n";
    code_ += "  row_failure failure = begin_row(sink);\n";
    for (size_t k = 0; k < form_.operations.size(); ++k) operation(static_cast<int32_t>(k));
    for (size_t k = 0; k < form_.operations.size(); ++k) stores(static_cast<int32_t>(k));
    report();
    return "LANE_FN void chain" + str(static_cast<int64_t>(number)) +
           "(const uint64_t* words, const int64_t i, device_sink sink) {\n" + code_ + "}\n";
  }

 private:
  const Operation& at(int32_t k) const { return form_.operations[static_cast<size_t>(k)]; }

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
  std::string source(const Operation::Source& s, int32_t width, bool loop, const std::string& p,
                     const std::string& rows) const {
    if (s.from == Operation::Source::Registers)
      return "source_registers{" + of_row(registers(s.op, s.output), width, loop) + "}";
    return s.from == Operation::Source::There
               ? "trusted_rows{(const char*)" + p + "}"
               : "source_rows{(const char*)" + p + ", (int64_t)" + rows + "}";
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
    const std::string in0 = op.sources.empty()
                                ? ""
                                : source(op.sources[0], op.width, loop,
                                         op.kind == Operation::RowSum ? "w[3]" : "w[1]", {});
    switch (op.kind) {
      case Operation::Copy:
        return "    copy_word(" + in0 + ", " + out0 + ", row);\n";
      case Operation::Fill:
        return "    put_columni(" + out0 + ", 1, 0, row, (int32_t)w[1]);\n";
      case Operation::RowSum:
        if (op.joins) {
          const Operation& other = at(k - 1);
          const std::string words = "words + " + str(other.first_word);
          return "    sum_two_rows<" + str(op.width) + ">(" + words + ", " +
                 (other.init
                      ? source(other.sources[0], op.width, loop, "(" + words + ")[3]", {}) + ", "
                      : "no_init{}, ") +
                 output(k - 1, 0, loop, "(" + words + ")[4]") + ", w, " +
                 (op.init ? in0 : "no_init{}") + ", " + out0 + ", row);\n";
        }
        return "    sum_row<" + str(op.width) + ", " + (op.offsets ? "true" : "false") + ">(w, " +
               (op.init ? in0 : "no_init{}") + ", " + out0 + ", row);\n";
      case Operation::Program:
        break;
    }
    const nova::ir::Program& p = *table_.programs[static_cast<size_t>(op.program)];
    std::string text = "    failure.operation = " + str(first_row(k)) + (loop ? " + j" : "") +
                       ";\n    row" + str(op.program) + "(w";
    for (size_t s = 0; s < p.sources.size(); ++s) {
      const int64_t word = p.source_argument(s);
      text += ", " + source(op.sources[s], p.sources[s].width, loop, "w[" + str(word) + "]",
                            "w[" + str(word + 1) + "]");
    }
    for (size_t o = 0; o < p.outputs.size(); ++o)
      text +=
          ", " + output(k, static_cast<int32_t>(o), loop, "w[" + str(p.output_argument(o)) + "]");
    return text + ", row, failure);\n";
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
      code_ += "  store_row<" + str(op.each * op.outputs[o].width) + ">((char*)words[" +
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
  constexpr uint64_t kStep = 64;   // tables of about one size share their code
  constexpr uint64_t kBatch = 12;  // where a barrier waits for the thread with the most items
  std::string text = "#define NOVAPHY_SEQUENCE\n";
  const auto define = [&](const char* name, uint64_t value) {
    text += std::string("#define ") + name + " " + std::to_string(value) + "\n";
  };
  define("SEQUENCE_WORDS", (table.most_words + kStep - 1) / kStep * kStep);
  define("SEQUENCE_THREADS", shape.threads);
  define("SEQUENCE_FORM", static_cast<uint64_t>(shape.form));
  if (shape.form == SequenceShape::Form::Cluster) define("SEQUENCE_BLOCKS", shape.blocks);
  if (shape.form != SequenceShape::Form::Grid) define("CSR_BATCH", kBatch);
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
