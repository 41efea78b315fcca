// From operations to records and forms of chains.
#include <algorithm>
#include <map>

#include "row_use.h"
#include "sequence_source.h"

namespace novaphy::gpu {
namespace {

using Operation = ChainForm::Operation;

constexpr int64_t kWarp = 32;
constexpr int32_t kMaxRegisters = 24;  // words of an output that stays in registers

uint64_t address(const void* p) { return reinterpret_cast<uint64_t>(p); }

// The memory that an operation of a chain touches at its own row.
struct Touch {
  uint64_t where = 0;
  int32_t words = 0;  // for each row of the chain
  int32_t slot = 0;   // which source or output; of a row_sum source 0 is `init`
};

class Writer {
 public:
  SequenceTable run(std::span<const novaphy_sequence_op> ops) {
    uint64_t before = 0;  // where the header of the record before lies
    for (size_t first = 0, last = 0; first < ops.size(); first = last) {
      while (last < ops.size() && ops[last].phase == ops[first].phase) ++last;
      const uint64_t start = out_.words.size();
      add_record(ops.subspan(first, last - first));
      const uint64_t size = out_.words.size() - start;
      out_.most_words = std::max(out_.most_words, size);
      if (first == 0) {
        out_.first_words = size;
      } else {
        out_.words[before] = size << 32 | start;
      }
      before = start;
    }
    out_.counters = out_.words.size();
    out_.words.push_back(0);
    for (const auto& [form, number] : forms_) out_.forms.push_back(form);
    for (const auto& [form, number] : forms_) out_.forms[number] = form;
    out_.fits = out_.words.size() < UINT32_MAX;
    return std::move(out_);
  }

 private:
  void add_record(std::span<const novaphy_sequence_op> ops) {
    std::vector<uint64_t> chains, body;
    const uint64_t number = ops.back().chain + uint64_t{1};
    uint64_t warps = 0;
    for (size_t first = 0, last = 0; first < ops.size(); first = last) {
      while (last < ops.size() && ops[last].chain == ops[first].chain) ++last;
      const std::span<const novaphy_sequence_op> chain = ops.subspan(first, last - first);
      const int64_t rows = chain[0].rows;
      chains.push_back(warps << 32 | static_cast<uint64_t>(rows));
      const uint64_t at = 2 + 2 * number + body.size();
      chains.push_back(uint64_t{add_chain(chain, body)} << 32 | at);
      warps += static_cast<uint64_t>((rows + kWarp - 1) / kWarp);
    }
    out_.most_warps = std::max(out_.most_warps, static_cast<uint32_t>(warps));
    out_.words.push_back(0);
    out_.words.push_back(warps << 32 | number);
    out_.words.insert(out_.words.end(), chains.begin(), chains.end());
    out_.words.insert(out_.words.end(), body.begin(), body.end());
  }

  // Adds the arguments to the record; which form the chain has.
  uint32_t add_chain(std::span<const novaphy_sequence_op> chain, std::vector<uint64_t>& body) {
    ChainForm form;
    const size_t start = body.size();
    for (const novaphy_sequence_op& o : chain) {
      Operation& op = form.operations.emplace_back(operation(o));
      if (op.kind == Operation::Program) body.push_back(o.op.kernel->number);
      op.first_word = static_cast<int32_t>(body.size() - start);
      if (o.op.kernel == nullptr) {
        body.push_back(address(o.op.target));
        body.push_back(o.op.source ? address(o.op.source) : o.op.pattern);
      } else {
        body.insert(body.end(), o.op.arguments, o.op.arguments + o.op.argument_count);
      }
    }
    find_tables(chain, form);
    link(chain, form);
    const auto next = static_cast<uint32_t>(forms_.size());
    return forms_.emplace(std::move(form), next).first->second;
  }

  Operation operation(const novaphy_sequence_op& o) {
    Operation op;
    op.each = static_cast<int32_t>(o.n / o.rows);
    const novaphy_kernel* kernel = o.op.kernel;
    if (kernel == nullptr) {
      op.kind = o.op.source ? Operation::Copy : Operation::Fill;
      if (o.op.source) op.sources.push_back({Operation::Source::There});
      op.outputs.resize(1);
    } else if (kernel->run != nullptr) {
      op.kind = Operation::RowSum;
      op.width = static_cast<int32_t>(o.op.arguments[5]);
      op.offsets = o.op.arguments[1] != 0;
      op.init = o.op.arguments[3] != 0;
      if (op.init) op.sources.push_back({Operation::Source::There});
      op.outputs.resize(1);
      op.outputs[0].width = op.width;
    } else {
      const nova::ir::Program& p = kernel->program;
      const auto [known, fresh] =
          programs_.emplace(kernel, static_cast<int32_t>(out_.programs.size()));
      if (fresh) out_.programs.push_back(&p);
      op.program = known->second;
      for (size_t s = 0; s < p.sources.size(); ++s)
        op.sources.push_back(
            {is_there(p, s, o.op.arguments[p.source_argument(s) + 1], static_cast<uint64_t>(o.n))
                 ? Operation::Source::There
                 : Operation::Source::Memory});
      for (const nova::ir::Output& output : p.outputs)
        op.outputs.push_back({Operation::Output::Now, static_cast<int32_t>(output.values.size())});
    }
    return op;
  }

  static void touches(const novaphy_sequence_op& o, const Operation& op, std::vector<Touch>& reads,
                      std::vector<Touch>& writes) {
    reads.clear();
    writes.clear();
    const uint64_t* words = o.op.arguments;
    switch (op.kind) {
      case Operation::Copy:
        reads.push_back({address(o.op.source), op.each, 0});
        [[fallthrough]];
      case Operation::Fill:
        writes.push_back({address(o.op.target), op.each, 0});
        return;
      case Operation::RowSum:
        if (op.init) reads.push_back({words[3], op.each * op.width, 0});
        writes.push_back({words[4], op.each * op.width, 0});
        return;
      case Operation::Program:
        break;
    }
    const nova::ir::Program& p = o.op.kernel->program;
    for (size_t s = 0; s < p.sources.size(); ++s)
      if (rows_read(p, s) == Rows::Own)
        reads.push_back(
            {words[p.source_argument(s)], op.each * p.sources[s].width, static_cast<int32_t>(s)});
    for (size_t k = 0; k < p.outputs.size(); ++k)
      writes.push_back(
          {words[p.output_argument(k)], op.each * op.outputs[k].width, static_cast<int32_t>(k)});
  }

  static void find_tables(std::span<const novaphy_sequence_op> chain, ChainForm& form) {
    std::vector<uint64_t> known;
    for (size_t k = 0; k < chain.size(); ++k) {
      Operation& op = form.operations[k];
      const uint64_t* words = chain[k].op.arguments;
      const auto add = [&](uint32_t word) {
        if (std::find(known.begin(), known.end(), words[word]) != known.end()) return;
        known.push_back(words[word]);
        op.tables.push_back(static_cast<int32_t>(word));
      };
      if (op.each != 1) continue;
      if (op.kind == Operation::RowSum && op.offsets) {
        add(1);
        if (k == 0) continue;
        const Operation& before = form.operations[k - 1];
        const uint64_t* other = chain[k - 1].op.arguments;
        op.joins = before.kind == Operation::RowSum && before.offsets && before.each == 1 &&
                   !before.joins && before.width == op.width && words[1] == other[1] &&
                   words[2] == other[2] && words[3] != other[4];
      } else if (op.kind == Operation::Program) {
        const nova::ir::Program& p = chain[k].op.kernel->program;
        for (size_t l = 0; l < p.loops.size(); ++l)
          if (p.loops[l].kind == nova::ir::LoopKind::Csr) add(p.loop_argument(l));
      }
    }
  }

  // What one operation leaves for a later one goes through registers, and is stored at the end, so
  // that no store stands between the loads of the chain.
  static void link(std::span<const novaphy_sequence_op> chain, ChainForm& form) {
    struct Place {
      int32_t words = 0, op = -1, output = 0;
      bool fits = true;
    };
    std::map<uint64_t, Place> places;
    std::vector<Touch> reads, writes;
    for (size_t k = 0; k < chain.size(); ++k) {
      touches(chain[k], form.operations[k], reads, writes);
      for (const auto* list : {&reads, &writes})
        for (const Touch& t : *list) {
          Place& place = places[t.where];
          if (place.words == 0) place.words = t.words;
          place.fits = place.fits && place.words == t.words && t.words <= kMaxRegisters;
        }
    }
    for (size_t k = 0; k < chain.size(); ++k) {
      Operation& op = form.operations[k];
      touches(chain[k], op, reads, writes);
      for (const Touch& t : reads) {
        const Place& place = places[t.where];
        if (place.fits && place.op >= 0)
          op.sources[static_cast<size_t>(t.slot)] = {Operation::Source::Registers, place.op,
                                                     place.output};
      }
      for (const Touch& t : writes) {
        Place& place = places[t.where];
        if (!place.fits) continue;
        if (place.op >= 0)
          form.operations[static_cast<size_t>(place.op)]
              .outputs[static_cast<size_t>(place.output)]
              .store = Operation::Output::Never;
        op.outputs[static_cast<size_t>(t.slot)].store = Operation::Output::Later;
        place.op = static_cast<int32_t>(k);
        place.output = t.slot;
      }
    }
  }

  SequenceTable out_;
  std::map<const novaphy_kernel*, int32_t> programs_;
  std::map<ChainForm, uint32_t> forms_;
};

}  // namespace

SequenceTable sequence_table(std::span<const novaphy_sequence_op> ops) { return Writer().run(ops); }

}  // namespace novaphy::gpu
