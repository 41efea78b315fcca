// The text of a list as one kernel, where a thread runs all operations for its row.
#include <map>
#include <set>

#include "kept_items.h"
#include "list_plan.h"
#include "novaphy/program/emit.h"
#include "row_use.h"

namespace novaphy::gpu {
namespace {

constexpr size_t kMaxWords = 480;       // a kernel takes 4 KiB of arguments
constexpr int32_t kMaxItemWords = 24;   // registers for an item of a CSR loop
constexpr uint64_t kManyRows = 4096;    // from here on, the registers of a thread are limited
constexpr uint64_t kBlocksPerUnit = 5;  // blocks of a unit at the same time, for many rows
constexpr uint64_t kMaxRegisters = 16;  // largest row to be stored after its operation, in words

std::string str(uint64_t k) { return std::to_string(k); }

class Writer {
 public:
  Writer(const ListPlan& plan, std::span<const novaphy_list_op> ops, int64_t n)
      : plan_(plan), ops_(ops), n_(static_cast<uint64_t>(n)) {}

  ListSource run() {
    std::string code;
    for (const ListPlan::Site& site : plan_.before) code += operation(site, false, "  ");
    if (plan_.period != 0) {
      find_first_stores();
      code += registers() + constants() + all_items();
      code += "  const int32_t repeats = (int32_t)a.word[" + str(word(plan_.repeats)) + "];\n";
      std::string body;
      for (const ListPlan::Site& site : plan_.body) body += prefetch(site, code);
      for (const ListPlan::Site& site : plan_.body) body += operation(site, true, "    ");
      code += starts_ + "  const uint64_t* entry = table;\n#pragma unroll 1\n";
      code += "  for (int32_t k = 0; k < repeats; ++k) {\n" + body + steps_ +
              "    entry += TABLE_WIDTH;\n  }\n";
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
  // Equal words that are constant over the iterations share a word, so that the compiler sees the
  // equality. Only row counts do this, because the equality of two addresses depends on the list.
  uint64_t rows_word(uint64_t rows) {
    const auto [known, fresh] = rows_.emplace(rows, 0);
    if (fresh) known->second = word(rows);
    return known->second;
  }

  // Returns the text for word w of an operation, in this iteration or `later` iterations after it.
  std::string word_text(uint32_t op, uint32_t w, bool in_body, uint32_t later = 0) {
    const uint64_t value = ops_[op].arguments[w];
    const size_t sources = ops_[op].kernel->program.sources.size();
    if (w < 2 * sources && w % 2 == 1) {  // a row count
      bool fixed = true;
      for (uint32_t k = 1; in_body && k < plan_.repeats; ++k)
        fixed = fixed && ops_[op + k * plan_.period].arguments[w] == value;
      if (fixed) return "a.word[" + str(rows_word(value)) + "]";
    }
    return varying(
        value, in_body, [&](uint32_t k) { return ops_[op + k * plan_.period].arguments[w]; },
        later);
  }
  template <class At>
  std::string varying(uint64_t value, bool in_body, const At& at, uint32_t later = 0) {
    if (!in_body) return "a.word[" + str(word(value)) + "]";
    const uint64_t step = plan_.repeats > 1 ? at(1) - value : 0;
    bool even = true;
    for (uint32_t k = 1; k < plan_.repeats; ++k) even = even && at(k) == value + k * step;
    if (even && step == 0) return "a.word[" + str(word(value)) + "]";
    if (even) {
      const std::string first = "a.word[" + str(word(value + later * step)) + "]";
      const std::string name = "at" + str(out_.words.size());
      starts_ += "  uint64_t " + name + " = " + first + ";\n";
      steps_ += "    " + name + " += a.word[" + str(word(step)) + "];\n";
      return name;
    }
    std::vector<uint64_t>& column = columns_.emplace_back();
    for (uint32_t k = 0; k < plan_.repeats; ++k) column.push_back(at(k));
    return "__ldg(entry + " + str(later) + " * TABLE_WIDTH + " + str(columns_.size() - 1) + ")";
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

  // Declares the registers of the body, and loads those that the first iteration reads.
  std::string registers() {
    std::string code;
    for (uint32_t j = 0; j < plan_.period; ++j) {
      const novaphy_list_op& op = ops_[plan_.first + j];
      if (op.kernel == nullptr) continue;
      for (uint32_t o = 0; o < op.kernel->program.outputs.size(); ++o) {
        const uint64_t width = op.kernel->program.outputs[o].values.size();
        if (width > kMaxRegisters && !is_read(j, o)) continue;
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
  // Returns whether a source is loaded before the loop. Its rows must be the same in every
  // iteration, and no operation may write them. Only one row may be read, the own row or row 0.
  bool is_loaded_once(const ListPlan::Site& site, size_t s) const {
    const nova::ir::Program& p = ops_[site.op].kernel->program;
    const Rows rows = rows_read(p, s);
    return site.sources[s].from == ListPlan::Source::From::Constant &&
           (rows == Rows::Own || rows == Rows::First) && p.sources[s].width <= kMaxItemWords &&
           is_fixed(site.op, static_cast<uint32_t>(2 * s)) && is_trusted(site, s, true);
  }
  // Returns whether the source has every row that is read, in all iterations.
  bool is_trusted(const ListPlan::Site& site, size_t s, bool in_body) const {
    for (uint32_t k = 0; k < (in_body ? plan_.repeats : 1); ++k) {
      const novaphy_list_op& op = ops_[site.op + k * plan_.period];
      if (!is_there(op.kernel->program, s, op.arguments[2 * s + 1], n_)) return false;
    }
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
        const bool own = rows_read(ops_[site.op].kernel->program, s) == Rows::Own;
        code += "  int32_t " + name + "[" + words + "];\n  load_row<" + words + ">((const char*)" +
                from + (own ? ", i, " : ", 0, ") + name + ");\n";
      }
    }
    return code;
  }
  // Returns whether a source is prefetched: no operation writes its own row, which differs in every
  // iteration. An iteration loads the row of the next iteration. If rows exceed caches, the row
  // after that is prefetched into the cache. Adds the row of the first iteration to `before`.
  bool is_prefetched(const ListPlan::Site& site, size_t s) const {
    return ops_[site.op].kernel != nullptr &&
           site.sources[s].from == ListPlan::Source::From::Constant && !is_loaded_once(site, s) &&
           rows_read(ops_[site.op].kernel->program, s) == Rows::Own && is_trusted(site, s, true);
  }
  static std::string prefetch_name(uint32_t op, size_t source) {
    return "x" + str(op) + "_" + str(source);
  }
  std::string prefetch(const ListPlan::Site& site, std::string& before) {
    std::string code;
    for (size_t s = 0; s < site.sources.size(); ++s) {
      if (!is_prefetched(site, s)) continue;
      const std::string width =
          str(static_cast<uint64_t>(ops_[site.op].kernel->program.sources[s].width));
      const std::string name = prefetch_name(site.op - plan_.first, s);
      const auto w = static_cast<uint32_t>(2 * s);
      const auto load = [&](const std::string& at) {
        return "load_row<" + width + ">((const char*)(" + at + "), i, next_" + name + ");\n";
      };
      before += "  int32_t next_" + name + "[" + width + "];\n  " +
                load("a.word[" + str(word(ops_[site.op].arguments[w])) + "]");
      code += "    int32_t " + name + "[" + width + "];\n    for (int c = 0; c < " + width +
              "; ++c) " + name + "[c] = next_" + name + "[c];\n    if (k + 1 < repeats) " +
              load(word_text(site.op, w, true, 1));
      if (n_ >= kManyRows)
        code += "    if (k + 2 < repeats) prefetch_row((const char*)(" +
                word_text(site.op, w, true, 2) + "), i, " + width + ");\n";
    }
    return code;
  }

  // Returns whether the word refers to the same memory in all iterations.
  bool is_fixed(uint32_t op, uint32_t w) const {
    for (uint32_t k = 1; k < plan_.repeats; ++k)
      if (ops_[op + k * plan_.period].arguments[w] != ops_[op].arguments[w]) return false;
    return true;
  }
  // Returns which sources of a body operation are kept in registers for the first items of its CSR
  // loops. All these loops must go over the same items.
  std::vector<char> items_to_keep(const ListPlan::Site& site) const {
    if (ops_[site.op].kernel == nullptr) return {};
    const nova::ir::Program& p = ops_[site.op].kernel->program;
    const uint64_t* words = ops_[site.op].arguments;
    const uint64_t* table = nullptr;
    for (size_t l = 0; l < p.loops.size(); ++l) {
      if (p.loops[l].kind != nova::ir::LoopKind::Csr) return {};
      const uint32_t w = p.loop_argument(l);
      if (!is_fixed(site.op, w) || !is_fixed(site.op, w + 1)) return {};
      if (table != nullptr && (table[0] != words[w] || table[1] != words[w + 1])) return {};
      table = words + w;
    }
    if (table == nullptr) return {};
    const std::vector<ItemSource> found = item_sources(p);
    std::vector<char> kept(p.sources.size(), 0);
    int32_t total = 0;
    for (const auto how : {ItemSource::AtSlot, ItemSource::AtIndex})
      for (size_t s = 0; s < found.size(); ++s) {
        const auto w = static_cast<uint32_t>(2 * s);
        if (found[s].how != how || site.sources[s].from != ListPlan::Source::From::Constant ||
            !is_fixed(site.op, w) || !is_fixed(site.op, w + 1))
          continue;
        if (how == ItemSource::AtIndex && kept[static_cast<size_t>(found[s].index)] == 0) continue;
        kept[s] = 1;
        total += p.sources[s].width;
      }
    return total == 0 || total > kMaxItemWords ? std::vector<char>{} : kept;
  }
  // Writes the loads of kept sources: item r if the CSR row has one and the indexed rows exist.
  std::string items(const ListPlan::Site& site) {
    const std::vector<char>& kept = kept_items_[site.op - plan_.first];
    if (kept.empty()) return {};
    const nova::ir::Program& p = ops_[site.op].kernel->program;
    const uint64_t* words = ops_[site.op].arguments;
    const std::vector<ItemSource> found = item_sources(p);
    const auto pointer = [&](uint32_t w) { return "a.word[" + str(word(words[w])) + "]"; };
    const std::string name = "kept" + str(site.op - plan_.first);
    std::string fields, at_slot, at_index;
    for (size_t s = 0; s < kept.size(); ++s) {
      if (kept[s] == 0) continue;
      const auto w = static_cast<uint32_t>(2 * s);
      const std::string width = str(static_cast<uint64_t>(p.sources[s].width));
      fields += "  int32_t s" + str(s) + "[KEPT_ITEMS * " + width + "];\n";
      const std::string to = name + ".s" + str(s) + " + r * " + width;
      const std::string load = "load_row<" + width + ">((const char*)" + pointer(w) + ", ";
      if (found[s].how == ItemSource::AtSlot) {
        at_slot += "      " + load + "slot, " + to + ");\n";
      } else {
        const auto index = static_cast<size_t>(found[s].index);
        const std::string row = name + ".s" + str(index) + "[r * " +
                                str(static_cast<uint64_t>(p.sources[index].width)) + " + " +
                                str(static_cast<uint64_t>(found[s].column)) + "]";
        at_index += "      fine = fine && " + row + " >= 0 && " + row + " < (int64_t)" +
                    pointer(w + 1) + ";\n      if (fine) " + load + row + ", " + to + ");\n";
      }
    }
    out_.text +=
        "struct items_of_" + name + " {\n  csr_rows csr;\n  int32_t count;\n" + fields + "};\n";
    uint32_t table = 0;
    for (size_t l = 0; l < p.loops.size(); ++l) table = p.loop_argument(l);
    return "  items_of_" + name + " " + name + " = {};\n  " + name +
           ".csr = csr_begin((const int32_t*)" + pointer(table) +
           ", i);\n#pragma unroll\n  for (int32_t r = 0; r < KEPT_ITEMS; ++r) {\n" +
           "    bool fine = r < " + name + ".csr.longest && r == " + name +
           ".count;\n    if (fine) {\n      const int32_t slot = csr_slot(&" + name +
           ".csr, (const int32_t*)" + pointer(table + 1) + ", r, 1);\n" + at_slot + at_index +
           "      if (fine) " + name + ".count = r + 1;\n    }\n  }\n";
  }
  // Operations of one Program share its function, so all of them keep the same sources.
  std::string all_items() {
    std::string code;
    for (const ListPlan::Site& site : plan_.body) {
      std::vector<char> kept = items_to_keep(site);
      if (!kept.empty() && with_items_.emplace(site.function, kept).first->second != kept)
        kept.clear();
      kept_items_.push_back(std::move(kept));
      code += items(site);
    }
    return code;
  }

  // Finds the first iteration from which each output of the body must be stored. Earlier results
  // are overwritten before they are read from memory. The search runs backward.
  void find_first_stores() {
    std::map<uint64_t, size_t> overwritten;  // address; words of a row
    const auto read = [&](uint64_t where) { overwritten.erase(where); };
    for (const ListPlan::Site& site : plan_.body)
      first_stores_.emplace_back(
          ops_[site.op].kernel == nullptr ? 0 : ops_[site.op].kernel->program.outputs.size(),
          plan_.repeats);
    for (uint32_t k = plan_.repeats; k-- > 0;)
      for (uint32_t j = plan_.period; j-- > 0;) {
        const ListPlan::Site& site = plan_.body[j];
        const novaphy_list_op& op = ops_[site.op + k * plan_.period];
        if (op.kernel == nullptr) {
          read(reinterpret_cast<uint64_t>(op.target));
          read(reinterpret_cast<uint64_t>(op.source));
          continue;
        }
        const nova::ir::Program& p = op.kernel->program;
        for (uint32_t o = 0; o < p.outputs.size(); ++o) {
          const size_t width = p.outputs[o].values.size();
          size_t& known = overwritten[op.arguments[p.output_argument(o)]];
          if (known != width) first_stores_[j][o] = k;
          known = width;
        }
        for (size_t s = 0; s < site.sources.size(); ++s)
          if (site.sources[s].from != ListPlan::Source::From::Registers) read(op.arguments[2 * s]);
      }
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
    const std::string number = str(kernels_.size());
    kernels_.push_back(word(op.kernel->number));
    std::string code = indent + "{\n" + indent + "  failure.operation = " + number + ";\n" +
                       indent + "  const uint64_t w[] = {";
    for (uint32_t w = 0; w < op.argument_count; ++w)
      code += (w == 0 ? "" : ", ") + word_text(site.op, w, in_body);
    const bool kept = in_body && !kept_items_[site.op - plan_.first].empty();
    code += "};\n" + indent + "  row" + str(site.function) + (kept ? "_kept" : "") + "(w";
    for (size_t s = 0; s < p.sources.size(); ++s) {
      const ListPlan::Source& source = site.sources[s];
      const std::string memory =
          "{(const char*)w[" + str(2 * s) + "], (int64_t)w[" + str(2 * s + 1) + "]}";
      code += ", ";
      if (in_body && is_loaded_once(site, s)) {
        code += (rows_read(p, s) == Rows::Own ? "source_registers{" : "source_item{") +
                constant_name(site.op - plan_.first, s) + "}";
        continue;
      }
      if (in_body && is_prefetched(site, s)) {
        code += "source_registers{" + prefetch_name(site.op - plan_.first, s) + "}";
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
    const uint32_t j = site.op - plan_.first;
    std::string stores;
    for (uint32_t o = 0; o < p.outputs.size(); ++o) {
      const std::string pointer = "(char*)w[" + str(p.output_argument(o)) + "]";
      const uint64_t width = p.outputs[o].values.size();
      const bool apart = in_body && (width <= kMaxRegisters || is_read(j, o));
      code += apart ? ", output_registers{" + register_name(j, o) + "}"
                    : ", output_rows{" + pointer + "}";
      if (!apart) continue;
      const uint32_t first = first_stores_[j][o];
      stores += indent + "  ";
      if (first > 0) stores += "if (k >= (int32_t)a.word[" + str(word(first)) + "]) ";
      stores += "store_row<" + str(width) + ">(" + pointer + ", i, " + register_name(j, o) + ");\n";
    }
    return code + (kept ? ", kept" + str(j) : "") + ", i, failure);\n" + stores + indent + "}\n";
  }

  // The report comes once per thread: a branch after each operation would delay the next loads.
  std::string report() const {
    std::string code = "  if (failure.source >= 0) {\n    uint64_t kernel = 0;\n";
    for (size_t k = 0; k < kernels_.size(); ++k)
      code += "    if (failure.source / kSources == " + str(k) + ") kernel = a.word[" +
              str(kernels_[k]) + "];\n";
    return code +
           "    end_row(failure, device_sink{sink.record, sink.flag, (uint32_t)kernel}, i);\n  }\n";
  }

  // Writes a copy or a fill of the own row.
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
    std::string text = prelude_text();
    text += "#define KEPT_ITEMS 2\n#define LIST_BLOCKS " +
            str(n_ >= kManyRows ? kBlocksPerUnit : 1) + "\n";
    for (uint32_t f = 0; f < plan_.programs.size(); ++f) {
      const nova::ir::Program program = without_names(*plan_.programs[f]);
      const std::string name = "row" + str(f);
      text += nova::ir::emit_device(program, name);
      const auto items = with_items_.find(f);
      if (items != with_items_.end())
        text += nova::ir::emit_device(program, name + "_kept", items->second);
    }
    out_.text = text + out_.text;  // the structures of the kept items come first
    out_.fits = out_.words.size() <= kMaxWords;
    out_.table_width = static_cast<uint32_t>(columns_.size());
    out_.text += "#define TABLE_WIDTH " + str(columns_.size()) + "\n";
    out_.text += "struct list_arguments {\n  uint64_t word[" + str(out_.words.size()) + "];\n};\n";
    out_.text +=
        "VENDOR_ENTRY __launch_bounds__(128, LIST_BLOCKS) novaphy_main(\n"
        "    const __grid_constant__ list_arguments a, const uint64_t* table, const int64_t n,\n"
        "    const device_sink sink) {\n"
        "  const int64_t i = blockIdx.x * blockDim.x + threadIdx.x;\n"
        "  if (i >= n) return;\n"
        "  row_failure failure = begin_row(sink);\n" +
        code + report() + "}\n";
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
  std::map<uint32_t, std::vector<char>> with_items_;  // kept sources of each function
  std::vector<std::vector<char>> kept_items_;         // by body operation and source
  std::vector<uint64_t> kernels_;                     // words with kernel numbers
  std::string starts_, steps_;                        // addresses that grow evenly
  std::vector<std::vector<uint32_t>> first_stores_;   // iteration, by {body operation, output}
};

}  // namespace

ListSource list_source(const ListPlan& plan, std::span<const novaphy_list_op> ops, int64_t n) {
  return Writer(plan, ops, n).run();
}

}  // namespace novaphy::gpu
