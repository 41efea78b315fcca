// Writes the text of a persistent kernel: a function for each form of a chain, and their dispatch.
#include "persistent_source.h"

#include <algorithm>
#include <map>
#include <set>

#include "novaphy/program/cut.h"
#include "novaphy/program/emit.h"

namespace novaphy::gpu {
namespace {

using Operation = ChainForm::Operation;

constexpr int32_t kMostItemWords = 72;  // words of item rows that a thread holds before the sum

std::string str(int64_t k) { return std::to_string(k); }
std::string registers(int32_t op, int32_t output) { return "r" + str(op) + "_" + str(output); }

// If an operation has several rows for each row of the chain, no row is computed early.
std::vector<nova::ir::Available> available(const Operation& op) {
  using nova::ir::Available;
  std::vector<Available> sources;
  for (const Operation::Source& source : op.sources) {
    const bool early = source.early && op.each == 1;
    // The thread keeps such values, so both halves may read them without another load.
    const bool both = source.fixed && op.early_word >= 0;
    sources.push_back(!early ? Available::Late : both ? Available::Both : Available::Early);
  }
  return sources;
}

// Returns whether a Program computes more than loads of own rows, which the chain has already made.
bool is_work(const nova::ir::Program& p) {
  using nova::ir::Op;
  for (const nova::ir::Instr& in : p.instrs) {
    if (in.op == Op::CONST_F || in.op == Op::CONST_I || in.op == Op::INDEX) continue;
    const bool is_load = in.op == Op::LOAD_F || in.op == Op::LOAD_I;
    if (!is_load || p.instrs[static_cast<size_t>(in.b)].op != Op::INDEX) return true;
  }
  return false;
}

// The functions of the Programs of a persistent kernel, without duplicates. A Program is one
// function, or two: its early half and its late half.
class RowFunctions {
 public:
  explicit RowFunctions(const PersistentTable& table) : table_(table) {}

  struct Function {
    std::string name;
    nova::ir::Cut halves{};  // if `early` has no outputs, the Program is one function
    bool is_cut() const { return !halves.early.outputs.empty(); }
    // The number of words by which the arguments begin before those of the whole Program, because
    // the parameters must follow the words that differ.
    int64_t shift = 0, early_shift = 0;
  };
  const Function& of(const Operation& op) {
    const auto [known, fresh] = known_.try_emplace({op.program, available(op)});
    if (fresh) known->second = make(op);
    return known->second;
  }
  std::string text;

 private:
  Function make(const Operation& op) {
    const nova::ir::Program p = without_names(table_.program(op));
    Function f{"row" + str(static_cast<int64_t>(known_.size()) - 1)};
    f.halves = halves_of(table_, op);
    if (!f.is_cut()) {
      text += nova::ir::emit_device(p, f.name);
      return f;
    }
    const auto& [early, late] = f.halves;
    f.early_shift = int64_t{early.param_argument(0)} - p.param_argument(0);
    f.shift = int64_t{late.param_argument(0)} - p.param_argument(0);
    text += nova::ir::emit_device(early, "early_" + f.name);
    text += nova::ir::emit_device(late, f.name);
    return f;
  }

  const PersistentTable& table_;
  std::map<std::pair<int32_t, std::vector<nova::ir::Available>>, Function> known_;
};

class ChainText {
 public:
  ChainText(const PersistentTable& table, const ChainForm& form, RowFunctions& rows)
      : table_(table), form_(form), rows_(rows) {}

  std::string run(size_t number) {
    number_ = str(static_cast<int64_t>(number));
    const bool waits = table_.tasks != 0;
    const std::string leave = waits ? "  if (!on) return;\n" : "";
    const std::string wait = "  phase_wait();\n";
    const bool waits_late = waits && reads_halo_alone();
    loads(waits);
    kept_loads();
    code_ += "  row_failure failure = begin_row(sink);\n";
    if (waits) {
      for (size_t k = 0; k < form_.operations.size(); ++k) early(static_cast<int32_t>(k));
      if (sends_rows()) code_ += "  const halo_sends sends = begin_sends(memory);\n";
      code_ += form_.sums_items ? "  take_over();\n" : waits_late ? "" : wait;
      if (reads_halo()) code_ += "  wait_halo(memory.turn);\n";
      if (stores_at_once()) code_ += (form_.sums_items ? wait : "") + leave;
      loads(false);
    }
    const size_t sums = sums_of_block();
    if (sums > 0) {  // lanes without a row of their own would load rows too
      for (size_t k = 0; k < sums; ++k) declare_registers(static_cast<int32_t>(k), " = {}");
      code_ += "  if (on) {\n";
    }
    item_loads(0, sums);
    for (size_t k = 0; k < form_.operations.size(); ++k) {
      if (k == sums) {
        if (sums > 0) code_ += "  }\n";
        item_loads(sums, form_.operations.size());
      }
      operation(static_cast<int32_t>(k), k < sums);
    }
    if (sums == form_.operations.size()) code_ += "  }\n";
    // Stores wait for the end of the previous phase, because other blocks may still read its data.
    if (!stores_at_once()) {
      if (form_.sums_items || waits_late) code_ += wait;
      sends();
      hand_over();
      code_ += leave;
    }
    // With a plan, a row that no thread stores may also have a failing read.
    if (table_.layouts != 0) {
      report();
      code_ += "  if (!owns) return;\n";
    }
    for (size_t k = 0; k < form_.operations.size(); ++k) stores(static_cast<int32_t>(k));
    if (table_.layouts == 0) report();
    return filling_ + "LANE_FN void chain" + number_ +
           "(const uint64_t* words, const int64_t i, const bool on, const bool owns,\n"
           "                    const block_memory memory, device_sink sink) {\n" +
           code_ + "}\n";
  }

  // Returns the function of the early halves, which run before this kernel, or an empty text.
  std::string run_early(size_t number) {
    for (size_t k = 0; k < form_.operations.size(); ++k) early_half(static_cast<int32_t>(k));
    if (code_.empty()) return code_;
    return "LANE_FN void early" + str(static_cast<int64_t>(number)) +
           "(const uint64_t* words, const int64_t i, const uint32_t slot, device_sink sink) {\n" +
           code_ + "}\n";
  }

 private:
  bool stores_at_once() const {
    for (const Operation& op : form_.operations)
      for (const Operation::Output& output : op.outputs)
        if (output.store == Operation::Output::Now) return true;
    return false;
  }
  bool reads_halo() const {
    for (const Operation& op : form_.operations)
      for (const Operation::Source& source : op.sources)
        if (source.halo >= 0) return true;
    return false;
  }
  bool sends_rows() const {
    for (const Operation& op : form_.operations)
      for (const Operation::Output& output : op.outputs)
        if (output.halo >= 0) return true;
    return false;
  }
  // Returns whether the halo is all that the chain waits for of the previous phase.
  bool reads_halo_alone() const {
    if (!reads_halo() || form_.sums_items || stores_at_once()) return false;
    for (const Operation& op : form_.operations) {
      if (op.kind == Operation::RowSum) return false;
      for (const Operation::Source& source : op.sources)
        if (source.halo < 0 && !source.early && !source.fixed &&
            source.from != Operation::Source::Registers)
          return false;
    }
    return true;
  }
  const Operation& at(int32_t k) const { return form_.operations[static_cast<size_t>(k)]; }
  static std::string table(int32_t t) { return "table" + str(t); }
  static std::string own(int32_t op, size_t source) {
    return "own" + str(op) + "_" + str(static_cast<int64_t>(source));
  }
  static std::string crossing(int32_t op, size_t output) {
    return "early" + str(op) + "_" + str(static_cast<int64_t>(output));
  }
  static std::string own_words(int32_t op, size_t source, int32_t words) {
    return "  int32_t " + own(op, source) + "[" + str(words) + "];\n";
  }
  // Returns whether the items of a table are in the memory of the block.
  bool in_block(int32_t t) const {
    return std::any_of(form_.operations.begin(), form_.operations.end(),
                       [&](const Operation& op) { return op.sum.items >= 0 && op.tables[0] == t; });
  }
  static std::string crossing_count(const nova::ir::Output& output) {
    return str(static_cast<int64_t>(crossing_words(output)));
  }
  // A thread loads its rows and the first items of its sums together, when the chain begins or the
  // previous phase ends. The thread then waits once instead of once per operation.
  std::string own_load(int32_t k, size_t s, int32_t words) {
    const Operation::Source& source = at(k).sources[s];
    code_ += own_words(k, s, words);
    return "own_words<" + str(words) + (source.aligned ? ", true" : ", false") + ">(words[" +
           str(word(at(k), s)) + "], " + (source.from == Operation::Source::First ? "0" : "i") +
           ", " + own(k, s) + ");\n";
  }
  template <class F>
  void for_each_loaded(const F& f) const {
    for (int32_t k = 0; k < static_cast<int32_t>(form_.operations.size()); ++k)
      for (size_t s = 0; s < at(k).sources.size(); ++s)
        if (const int32_t words = table_.loaded_words(at(k), s); words != 0)
          f(k, s, words, at(k).sources[s]);
  }
  void loads(bool early) {
    for_each_loaded([&](int32_t k, size_t s, int32_t words, const Operation::Source& source) {
      if (!source.fixed && source.early == early) code_ += "  " + own_load(k, s, words);
    });
  }
  // Writes the loads of data that a thread keeps, because no operation of the kernel writes it.
  void kept_loads() {
    std::string declared, fixed, filled, kept;
    const auto keep = [&](const std::string& words) {
      filled += "    fill_kept(at, " + words + ");\n";
      kept += "    take_kept(at, " + words + ");\n";
    };
    for_each_loaded([&](int32_t k, size_t s, int32_t words, const Operation::Source& source) {
      if (!source.fixed) return;
      fixed += "    " + own_load(k, s, words);
      declared += own_words(k, s, words);
      keep(own(k, s));
    });
    std::string items;
    for (size_t t = 0; t < form_.tables.size(); ++t) {
      const std::string name = table(static_cast<int32_t>(t));
      const auto pointer = [&](int32_t word) {
        return "(const int32_t*)words[" + str(form_.tables[t] + word) + "]";
      };
      code_ += "  csr_batch " + name + ";\n";
      declared += "  csr_batch " + name + ";\n";
      fixed += "    " + name + " = csr_begin_batch(" + pointer(0) + ", i);\n";
      items += in_block(static_cast<int32_t>(t))
                   ? "    csr_load_items(&" + name + ", " + pointer(1) + ");\n"
                   : "    csr_load(&" + name + ", " + pointer(1) + ", 0);\n";
      keep(name + ".start");
      keep(name + ".longest");
      keep(name + ".slots");
    }
    if (fixed.empty()) return;
    code_ += "  const uint32_t kept = (uint32_t)words[0];\n";
    if (table_.layouts == 0) {
      code_ += "  if (is_kept(kept)) {\n" + begin_kept() + kept + "  } else {\n" + fixed + items +
               "    if (kept != 0) {\n" + begin_kept() + filled + "    }\n  }\n";
      return;
    }
    // With layouts all of this data is kept. A separate function fills the memory once.
    filling_ = "COLD_FN void fill" + number_ +
               "(const uint64_t* words, const int64_t i, int32_t* at) {\n" + declared + fixed +
               items + filled + "}\n";
    code_ += "  if (is_to_be_filled(kept)) fill" + number_ +
             "(words, i, begin_kept(memory, kept));\n  {\n" + begin_kept() + kept + "  }\n";
  }
  // Writes the loads of the first items of a chain's sums, as many as fit into registers.
  void item_loads(size_t first, size_t last) {
    int32_t words = 0;
    for (auto k = static_cast<int32_t>(first); k < static_cast<int32_t>(last); ++k) {
      const Operation& op = at(k);
      if (op.kind != Operation::RowSum || !op.sum.offsets || op.tables[0] < 0) continue;
      const bool joined = is_joined(k);
      if (op.sum.joins) continue;  // loaded with the previous operation, which has the same items
      words += (joined ? 2 : 1) * op.sum.width * (op.sum.batch != 0 ? op.sum.batch : kBatch);
      if (words > kMostItemWords) return;
      has_items_.insert(k);
      code_ += "  " + batch(op) + " " + items(k) + "[2];\n";
      for (int32_t sum = 0; sum < (joined ? 2 : 1); ++sum)
        code_ += "  load_first_rows(&" + items(k) + "[" + str(sum) + "], " + summed(at(k + sum)) +
                 ", " + table(op.tables[0]) + ", failure);\n";
    }
  }
  static std::string batch_size(const Operation& op) {
    return op.sum.batch != 0 ? str(op.sum.batch) : "CSR_BATCH";
  }
  static std::string batch(const Operation& op) {
    return "batch_rows<" + str(op.sum.width) + ", " + batch_size(op) + ">";
  }
  // Returns the text for the memory where the items of a sum are.
  static std::string summed(const Operation& op) {
    return op.sum.items >= 0
               ? "block_items{memory.rows + " + str(op.sum.items) + "}"
               : "memory_items{words[" + str(op.first_word + op.sum.source_word) + "]}";
  }
  // Writes the sends to the memory of other blocks. All lanes of a warp share this work.
  void sends() {
    for (int32_t k = 0; k < static_cast<int32_t>(form_.operations.size()); ++k)
      for (size_t o = 0; o < at(k).outputs.size(); ++o) {
        const Operation::Output& out = at(k).outputs[o];
        if (out.halo >= 0)
          code_ += "  send_rows<" + str(out.width) + ">(sends, " + str(out.halo) + ", " +
                   registers(k, static_cast<int32_t>(o)) + ");\n";
      }
  }
  // Writes the stores to the memory of the block, before the stores to global memory.
  void hand_over() {
    std::string puts;
    for (int32_t k = 0; k < static_cast<int32_t>(form_.operations.size()); ++k)
      for (size_t o = 0; o < at(k).outputs.size(); ++o) {
        const Operation::Output& out = at(k).outputs[o];
        if (out.items >= 0)
          puts += "    put_items<" + str(out.item_width) + ", " + str(out.width / out.item_width) +
                  ">(memory, " + str(out.items) + ", " + registers(k, static_cast<int32_t>(o)) +
                  ");\n";
      }
    if (!puts.empty()) code_ += "  if (on) {\n" + puts + "  }\n  hand_over();\n";
  }
  static std::string items(int32_t op) { return "items" + str(op); }
  // Returns whether the operation is computed together with the next operation.
  bool is_joined(int32_t k) const {
    return static_cast<size_t>(k) + 1 < form_.operations.size() && at(k + 1).sum.joins;
  }
  static std::string begin_kept() { return "    int32_t* at = begin_kept(memory, kept);\n"; }
  int64_t word(const Operation& op, size_t source) const {
    return op.first_word + table_.source_word(op, source);
  }

  // Writes the part of an operation that may run in the previous phase. Results stay in registers.
  void early(int32_t k) {
    const Operation& op = at(k);
    if (op.kind != Operation::Program || !rows_.of(op).is_cut()) return;
    const RowFunctions::Function& f = rows_.of(op);
    const nova::ir::Program& p = f.halves.early;
    const std::string slots = op.early_word >= 0 ? early_slots(op, p) : std::string();
    for (size_t o = 0; o < p.outputs.size(); ++o) {
      const std::string words = crossing_count(p.outputs[o]);
      code_ += "  int32_t " + crossing(k, o) + "[" + words + "];\n";
      if (op.early_word >= 0)
        code_ += "  load_early<" + words + ">" + early_memory(op, p, o, "own_slot(" + slots + ")") +
                 crossing(k, o) + ");\n";
    }
    if (op.early_word >= 0) return;
    code_ += "  {\n    const uint64_t* const w = words + " + str(op.first_word - f.early_shift) +
             ";\n    failure.operation = " + str(first_row(k)) + ";\n    early_" + f.name + "(w";
    for (size_t s = 0; s < op.sources.size(); ++s)
      code_ += ", " + (op.sources[s].early ? source(k, s, false) : std::string("no_source{}"));
    for (size_t o = 0; o < p.outputs.size(); ++o)
      code_ += ", output_registers{" + crossing(k, o) + "}";
    code_ += ", i, failure);\n  }\n";
  }

  static std::string early_slots(const Operation& op, const nova::ir::Program& early) {
    return "words[" + str(op.early_word + static_cast<int64_t>(early.outputs.size())) + "]";
  }
  static std::string early_memory(const Operation& op, const nova::ir::Program& early, size_t o,
                                  const std::string& slot) {
    return "(words[" + str(op.early_word + static_cast<int64_t>(o)) + "], " +
           early_slots(op, early) + ", " + slot + ", ";
  }
  void early_half(int32_t k) {
    const Operation& op = at(k);
    if (op.early_word < 0) return;
    const RowFunctions::Function& f = rows_.of(op);
    const std::vector<nova::ir::Output>& outputs = f.halves.early.outputs;
    code_ += "  {\n  row_failure failure = begin_row(sink);\n";
    for (size_t s = 0; s < op.sources.size(); ++s)
      if (const int32_t words = table_.loaded_words(op, s); words != 0 && op.sources[s].early)
        code_ += "  " + own_load(k, s, words);
    for (size_t o = 0; o < outputs.size(); ++o)
      code_ += "  int32_t " + crossing(k, o) + "[" + crossing_count(outputs[o]) + "] = {};\n";
    code_ += "  const uint64_t* const w = words + " + str(op.first_word - f.early_shift) +
             ";\n  early_" + f.name + "(w";
    for (size_t s = 0; s < op.sources.size(); ++s)
      code_ += ", " + (op.sources[s].early ? source(k, s, false) : std::string("no_source{}"));
    for (size_t o = 0; o < outputs.size(); ++o)
      code_ += ", output_registers{" + crossing(k, o) + "}";
    code_ += ", i, failure);\n";
    for (size_t o = 0; o < outputs.size(); ++o)
      code_ += "  store_early<" + crossing_count(outputs[o]) + ">" +
               early_memory(op, f.halves.early, o, "slot") + crossing(k, o) + ");\n";
    code_ += "  if (failure.source >= 0) {\n    sink.kernel = (uint32_t)words[" +
             str(op.first_word - 1) + "];\n    end_row(failure, sink, i);\n  }\n  }\n";
  }

  // Returns the number of leading operations that add items in the memory of the block.
  size_t sums_of_block() const {
    size_t k = 0;
    while (k < form_.operations.size() && form_.operations[k].sum.items >= 0 &&
           form_.operations[k].outputs[0].store != Operation::Output::Now)
      ++k;
    if (k > 0 && is_joined(static_cast<int32_t>(k) - 1)) --k;  // both sums or none
    return k;
  }
  void declare_registers(int32_t k, const std::string& value = "") {
    const Operation& op = at(k);
    for (size_t o = 0; o < op.outputs.size(); ++o)
      if (op.outputs[o].store != Operation::Output::Now)
        code_ += "  int32_t " + registers(k, static_cast<int32_t>(o)) + "[" +
                 str(op.each * op.outputs[o].width) + "]" + value + ";\n";
  }
  void operation(int32_t k, bool is_declared) {
    const Operation& op = at(k);
    if (!is_declared) declare_registers(k);
    if (is_joined(k)) return;
    code_ += "  {\n    const uint64_t* const w = words + " + str(op.first_word) + ";\n";
    const bool loop = op.each > 1;
    if (loop) code_ += "#pragma unroll\n    for (int32_t j = 0; j < " + str(op.each) + "; ++j) {\n";
    code_ += "    const int64_t row = i";
    if (loop) code_ += " * " + str(op.each) + " + j";
    code_ += ";\n" + call(k, loop) + (loop ? "    }\n" : "") + "  }\n";
  }

  // Returns the text for the words of row j of an operation, within the row of the chain.
  static std::string of_row(const std::string& name, int32_t width, bool loop) {
    return loop ? name + " + j * " + str(width) : name;
  }
  std::string source(int32_t k, size_t number, bool loop) const {
    const Operation& op = at(k);
    const Operation::Source& s = op.sources[number];
    if (s.halo >= 0)
      return "halo_rows{halo_of(memory, memory.turn) + " + str(s.halo) + ", " + str(s.halo_rows) +
             "}";
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
    const std::string out0 =
        output(k, 0, loop, "w[" + str(op.kind == Operation::RowSum ? op.sum.out_word : 0) + "]");
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
    const nova::ir::Program& p = table_.program(op);
    const RowFunctions::Function& f = rows_.of(op);
    std::string text = "    failure.operation = " + str(first_row(k)) + (loop ? " + j" : "") +
                       ";\n    " + f.name + "(" + arguments(op, f.shift);
    for (size_t s = 0; s < p.sources.size(); ++s) text += ", " + source(k, s, loop);
    if (f.is_cut())
      for (size_t o = 0; o < f.halves.early.outputs.size(); ++o)
        text += ", source_registers{" + crossing(k, o) + "}";
    for (size_t o = 0; o < p.outputs.size(); ++o)
      text +=
          ", " + output(k, static_cast<int32_t>(o), loop, "w[" + str(p.output_argument(o)) + "]");
    return text + ", row, failure);\n";
  }
  // Returns the text of the arguments, with the CSR tables if the chain has loaded all of them.
  std::string arguments(const Operation& op, int64_t shift) const {
    const std::string words = shift == 0 ? "w" : "w - " + str(shift);
    std::string tables;
    for (const int32_t t : op.tables) {
      if (t < 0) return words;
      tables += (tables.empty() ? "&" : ", &") + table(t);
    }
    if (tables.empty()) return words;
    return "words_and_tables<" + str(static_cast<int64_t>(op.tables.size())) + ">{" + words +
           ", {" + tables + "}}";
  }
  std::string row_sum(int32_t k, bool loop, const std::string& out) const {
    const Operation& op = at(k);
    const std::string width = str(op.sum.width);
    const auto init = [&](int32_t sum) {
      return at(sum).sum.init ? source(sum, 0, loop) : std::string("no_init{}");
    };
    if (!op.sum.offsets)
      return "    sum_even_row<" + width + ">(w, " + init(k) + ", " + out + ", row);\n";
    const auto argument = [&](int32_t sum, int32_t number) {
      return "words[" + str(at(sum).first_word + number) + "]";
    };
    const int32_t first = op.sum.joins ? k - 1 : k;
    const bool loaded = has_items_.contains(first);
    std::string text = loaded ? "" : "    " + batch(op) + " " + items(first) + "[2];\n";
    text += op.sum.joins ? "    sum_two_rows<" : "    sum_row<";
    text += std::string(loaded ? "true, " : "false, ") + (op.sum.chunks ? "true, " : "false, ") +
            width + ", " + batch_size(op) + ">(" +
            (op.tables[0] < 0 ? "csr_first(w, " + str(op.sum.offsets_word) + ", 0, row)"
                              : table(op.tables[0])) +
            ", " + argument(k, op.sum.offsets_word + 1) + ", " + items(first);
    for (int32_t sum = first; sum <= k; ++sum)
      text += ", " + summed(at(sum)) + ", " + init(sum) + ", " +
              (sum == k ? out : output(sum, 0, loop, argument(sum, at(sum).sum.out_word)));
    return text + ", row);\n";
  }

  // The number of rows of earlier operations for one row of the chain. With this number a failure
  // identifies the operation and the row.
  int64_t first_row(int32_t k) const {
    int64_t rows = 0;
    for (int32_t before = 0; before < k; ++before) rows += at(before).each;
    return rows;
  }
  // The report comes once per chain: a branch after each row would delay the loads of the next row.
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
          op.kind == Operation::RowSum ? op.sum.out_word
          : op.kind == Operation::Program
              ? table_.programs[static_cast<size_t>(op.program)]->output_argument(o)
              : 0;
      code_ += "  store_row<" + str(op.each * op.outputs[o].width) +
               (op.outputs[o].aligned ? ", true" : "") + ">((char*)words[" +
               str(op.first_word + word) + "], i, " + registers(k, static_cast<int32_t>(o)) +
               ");\n";
    }
  }

  const PersistentTable& table_;
  const ChainForm& form_;
  RowFunctions& rows_;
  std::string number_, code_;
  std::string filling_;          // text of the function that fills kept data
  std::set<int32_t> has_items_;  // sums whose first items are loaded before any item is added
};

// Returns the text of the kernel that runs the early halves of all Programs.
std::string early_source(const PersistentTable& table, RowFunctions& rows) {
  std::string functions, cases;
  for (size_t k = 0; k < table.forms.size(); ++k) {
    const std::string one = ChainText(table, table.forms[k], rows).run_early(k);
    if (one.empty()) continue;
    functions += one;
    const std::string number = std::to_string(k);
    cases += "    case " + number + ":\n      early" + number +
             "(words, i, slot, sink);\n      break;\n";
  }
  return functions +
         "LANE_FN void run_early(uint32_t form, const uint64_t* words, const int64_t i,\n"
         "                       const uint32_t slot, const device_sink sink) {\n  switch (form) "
         "{\n" +
         cases + "  }\n}\n";
}

uint64_t record_words(const PersistentTable& table) {
  constexpr uint64_t kStep = 64;  // rounded up, so that tables of similar size share their code
  return (table.most_words + kStep - 1) / kStep * kStep;
}

}  // namespace

nova::ir::Cut halves_of(const PersistentTable& table, const Operation& op) {
  const nova::ir::Program p = without_names(table.program(op));
  if (p.contract) return {};
  nova::ir::Cut halves = nova::ir::cut(p, available(op));
  return is_work(halves.early) ? halves : nova::ir::Cut{};
}

uint64_t shared_bytes(const PersistentTable& table, const PersistentShape& shape) {
  constexpr uint64_t kRecords = 3;
  const uint64_t words = table.layouts != 0 ? table.layouts : table.kept_words;
  constexpr uint64_t kHaloBytes = 24;  // the barriers, and the byte count for which they wait
  return kRecords * record_words(table) * sizeof(uint64_t) +
         words * shape.threads * sizeof(int32_t) +
         uint64_t{table.halo_rounds} * shape.threads * sizeof(int32_t) + kHaloBytes;
}

uint64_t launch_bytes(const PersistentTable& table, const PersistentShape& shape) {
  if (table.layouts == 0) return 0;
  constexpr uint64_t kItemBytes = 16;
  return (table.item_rows + 2 * table.halo_rows) * kItemBytes +
         uint64_t{table.kept_words} * shape.threads * sizeof(int32_t);
}

std::string persistent_source(const PersistentTable& table, const PersistentShape& shape) {
  std::string text = "#define NOVAPHY_PERSISTENT\n";
  const auto define = [&](const char* name, uint64_t value) {
    text += std::string("#define ") + name + " " + std::to_string(value) + "\n";
  };
  define("PERSISTENT_WORDS", record_words(table));
  define("PERSISTENT_THREADS", shape.threads);
  define("PERSISTENT_FORM", static_cast<uint64_t>(shape.form));
  if (shape.form == PersistentShape::Form::Cluster) define("PERSISTENT_BLOCKS", shape.blocks);
  if (shape.form != PersistentShape::Form::Grid) define("CSR_BATCH", kBatch);
  define("PERSISTENT_KEPT", table.kept_words);
  define("PERSISTENT_TASKS", table.tasks != 0 ? 1 : 0);
  define("PERSISTENT_LAYOUTS", table.layouts);
  if (table.layouts != 0) {
    define("PERSISTENT_CORNERS", table.corners);
    define("PERSISTENT_ITEMS", table.item_rows);
  }
  define("PERSISTENT_HALO", table.halo_rows);
  if (table.halo_rows != 0) {
    define("PERSISTENT_MAKERS", table.maker_warps);
    define("PERSISTENT_ROUNDS", table.halo_rounds);
  }
  define("PERSISTENT_EARLY", table.job_count != 0 ? 1 : 0);
  text += prelude_text();
  text += persistent_text();
  RowFunctions rows(table);
  std::string chains, cases;
  for (size_t k = 0; k < table.forms.size(); ++k) {
    chains += ChainText(table, table.forms[k], rows).run(k);
    const std::string number = std::to_string(k);
    cases += "    case " + number + ":\n      chain" + number +
             "(words, i, on, owns, memory, sink);\n      break;\n";
  }
  if (table.job_count != 0) chains += early_source(table, rows);
  return text + rows.text + chains +
         "LANE_FN void run_chain(uint32_t form, const uint64_t* words, const int64_t i,\n"
         "                       const bool on, const bool owns, const block_memory memory,\n"
         "                       const device_sink sink) {\n"
         "  switch (form) {\n" +
         cases + "  }\n}\n";
}

}  // namespace novaphy::gpu
