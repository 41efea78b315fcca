// Converts the operations of a persistent kernel to records and forms of chains.
#include <algorithm>
#include <cstring>
#include <map>
#include <tuple>
#include <utility>

#include "cluster/blocks.h"
#include "persistent_memory.h"
#include "persistent_source.h"
#include "row_use.h"

namespace novaphy::gpu {
namespace {

using Operation = ChainForm::Operation;

constexpr int32_t kMaxRegisters = 24;  // largest output that stays in registers, in words
constexpr int32_t kMaxOwn = 12;        // largest source that is loaded when a chain begins
constexpr int32_t kMaxTables = 3;      // most CSR tables that are loaded when a chain begins
constexpr uint64_t kAlignment = 16;
constexpr uint32_t kMinUses = 4;  // uses from which keeping a value pays off
// The bits of a task if a plan assigns rows to threads, as in persistent.cuh.
constexpr uint64_t kWorks = 1, kStores = 2, kHandsOver = 4, kTakesOver = 8, kKeeps = 16,
                   kSends = 32, kFills = 256;
constexpr uint64_t kTurnShift = 6, kLayoutShift = 16;
constexpr uint64_t kHeader = 4;       // words of the header of a record, with a plan
constexpr uint64_t kJobWords = 4;     // as in persistent.cuh
constexpr size_t kFetchedBefore = 2;  // records between a prefetch and the load

// The memory that an operation of a chain accesses at its own row.
struct Touch {
  uint64_t where = 0;
  int32_t words = 0;  // words per row of the chain
  int32_t slot = 0;   // source or output; source 0 of a row_sum is `init`
};

using Warps = std::pair<uint64_t, uint64_t>;  // warps [first, last)

// The words in which threads keep data that chains would load again in every substep. Chains of
// different warps share the words.
class Kept {
 public:
  explicit Kept(uint32_t most) : most_(most) {}
  uint32_t words() const { return words_; }
  // Returns the position, counted from 1, or 0 if there is no capacity.
  uint32_t place(uint32_t words, Warps warps) {
    for (Region& region : regions_) {
      bool free = words <= region.words;
      for (const auto& [first, last] : region.users)
        free = free && (warps.second <= first || last <= warps.first);
      if (!free) continue;
      region.users.push_back(warps);
      return region.position;
    }
    if (words_ + words > most_) return 0;
    regions_.push_back({words_ + 1, words, {warps}});
    words_ += words;
    return regions_.back().position;
  }

 private:
  struct Region {
    uint32_t position, words;
    std::vector<Warps> users;
  };
  std::vector<Region> regions_;
  uint32_t words_ = 0;
  const uint32_t most_;
};

uint64_t warps_of(int64_t rows, int64_t lanes) {
  return static_cast<uint64_t>((rows + lanes - 1) / lanes);
}

// Returns the number of warps of a phase, with `lanes` rows per warp.
uint64_t warps_of(std::span<const novaphy_persistent_op> phase, int64_t lanes) {
  uint64_t warps = 0;
  for (size_t k = 0; k < phase.size(); ++k)
    if (k == 0 || phase[k].chain != phase[k - 1].chain) warps += warps_of(phase[k].rows, lanes);
  return warps;
}

class Writer {
 public:
  // Bytes per row of early results, by operation and output. Empty: not computed early.
  using EarlyWords = std::vector<std::vector<uint64_t>>;
  Writer(const PersistentCapacity& capacity, EarlyWords early)
      : kept_(capacity.kept_words), capacity_(capacity), early_halves_(std::move(early)) {}

  PersistentTable run(std::span<const novaphy_persistent_op> ops) {
    for (const novaphy_persistent_op& o : ops) {
      add_uses(o);
      add_written(written_, o);
    }
    std::span<const novaphy_persistent_op> phase_before;
    for (size_t first = 0; first < ops.size();) {
      std::span<const novaphy_persistent_op> phase = phase_at(ops, first);
      if (planned() != nullptr && planned()->joined)
        phase = ops.subspan(first, phase.size() + phase_at(ops, first + phase.size()).size());
      if (planned() != nullptr && !planned()->fills.empty()) {
        add_fills(*planned());
        end_record();
        phase_before = {};
      }
      first_op_ = first;
      phase_written_ = Pieces();
      for (const novaphy_persistent_op& o : phase_before) add_written(phase_written_, o);
      phase_before = phase_ops_ = phase;
      add_record(phase);
      end_record();
      ++phase_;
      first += phase.size();
    }
    if (!tasks_.empty()) {
      out_.tasks = out_.words.size();
      out_.words.insert(out_.words.end(), tasks_.begin(), tasks_.end());
    }
    if (capacity_.plan != nullptr) add_plan();
    out_.counters = out_.words.size();
    out_.words.push_back(0);
    out_.forms.resize(forms_.size());
    for (const auto& [form, number] : forms_) {
      out_.forms[number] = form;
      size_t at = 0;
      for (Operation& op : out_.forms[number].operations)
        for (Operation::Source& source : op.sources) {
          source.early = (early_[number][at] & kEarly) != 0;
          source.fixed_rows = (early_[number][at++] & kUnwritten) != 0;
        }
    }
    if (!jobs_.empty()) {
      out_.jobs = out_.words.size();
      out_.job_count = jobs_.size() / kJobWords;
      for (size_t job = 0; job < jobs_.size(); job += kJobWords)
        jobs_[job + 2] += out_.rows * sizeof(uint64_t);
      out_.words.insert(out_.words.end(), jobs_.begin(), jobs_.end());
    }
    for (size_t k = 0; k + kFetchedBefore < early_of_.size(); ++k) {
      const EarlyOf& later = early_of_[k + kFetchedBefore];
      if (later.bytes == 0) continue;
      out_.words[early_of_[k].header] = later.first;
      out_.words[early_of_[k].header + 1] = later.bytes;
      out_.early.push_back(early_of_[k].header);
    }
    place_kept();
    out_.kept_words = kept_.words();
    out_.fits = out_.fits && out_.words.size() < UINT32_MAX;
    return std::move(out_);
  }
  // For each operation, the index of its form and the index of the operation in the form.
  const std::vector<std::pair<uint32_t, uint32_t>>& form_of() const { return form_of_; }

 private:
  struct User {
    uint32_t words;
    Warps warps;
    std::vector<uint64_t> chains;  // positions of the words of each chain
  };
  // kernel, source, rows
  using SourceUse = std::tuple<const novaphy_kernel*, int32_t, uint64_t>;

  // Ends a record at the current word. Writes its size into the header of the previous record.
  void end_record() {
    const uint64_t size = out_.words.size() - record_;
    out_.most_words = std::max(out_.most_words, size);
    if (record_ == 0) {
      out_.first_words = size;
    } else {
      out_.words[record_before_] = size << 32 | record_;
    }
    record_before_ = std::exchange(record_, out_.words.size());
  }

  void add_record(std::span<const novaphy_persistent_op> ops) {
    std::vector<uint64_t> chains, body;
    const uint64_t first_early = out_.early_bytes;
    uint64_t number = 0;  // number of chains
    for (size_t k = 0; k < ops.size(); ++k) number += k == 0 || begins_chain(ops, k) ? 1 : 0;
    const int64_t lanes = lanes_of(ops);
    uint64_t warps = 0;
    const BlockPlan::Phase* planned = this->planned();
    if (planned != nullptr) {
      add_idle_tasks();
    } else if (capacity_.blocks != 0) {
      tasks_.resize(tasks_.size() + capacity_.warps * capacity_.groups, 0);
    }
    for (size_t first = 0, last = 0; first < ops.size(); first = last) {
      last = first + 1;
      while (last < ops.size() && !begins_chain(ops, last)) ++last;
      if (first > 0 && ops[first].phase != ops[first - 1].phase) {
        ++phase_;
        planned = this->planned();
      }
      const std::span<const novaphy_persistent_op> chain = ops.subspan(first, last - first);
      const int64_t rows = chain[0].rows;
      chains.push_back(warps << 32 | static_cast<uint64_t>(rows));
      const uint64_t at = (planned ? kHeader : 2 + 2 * number) + body.size();
      const uint64_t end = warps + warps_of(rows, lanes);
      const uint64_t group = capacity_.warps * (phase_ % capacity_.groups);
      const BlockPlan::Chain* mine = planned ? &planned->chains[chain[0].chain] : nullptr;
      const Warps of_chain = mine ? Warps{mine->first_warp, mine->first_warp + mine->warps}
                                  : Warps{group + warps, group + end};
      const uint64_t form = add_chain(chain, of_chain, out_.words.size() + at, body);
      chains.push_back(form << 32 | at);
      if (mine != nullptr) {
        add_planned_tasks(form << 48 | at << 32, *planned, *mine);
      } else if (capacity_.blocks != 0) {
        add_tasks(form << 48 | at << 32, rows, lanes, warps);
      }
      warps = end;
    }
    out_.words.push_back(0);
    out_.words.push_back(warps << 32 | static_cast<uint64_t>(lanes) << 16 | number);
    if (planned != nullptr) {
      out_.words.insert(out_.words.end(), kHeader - 2, 0);
      early_of_.push_back(
          {out_.words.size() - (kHeader - 2), first_early, out_.early_bytes - first_early});
    } else {
      out_.words.insert(out_.words.end(), chains.begin(), chains.end());
    }
    out_.words.insert(out_.words.end(), body.begin(), body.end());
  }
  static bool begins_chain(std::span<const novaphy_persistent_op> ops, size_t k) {
    return ops[k].chain != ops[k - 1].chain || ops[k].phase != ops[k - 1].phase;
  }
  // Assigns rows of a chain to the warps from `warp` on. Neighboring warps are in different blocks,
  // so that few warps use many units. In a large cluster that uses all blocks, neighboring warps
  // share a block: the code of few chains fits into its instruction cache.
  void add_tasks(uint64_t chain, int64_t rows, int64_t lanes, uint64_t warp) {
    const uint64_t of_block = capacity_.warps / capacity_.blocks, group = phase_ % capacity_.groups;
    uint64_t* const phase = tasks_.data() + tasks_.size() - capacity_.warps * capacity_.groups;
    const bool together = capacity_.blocks > kMostInCluster && lanes == kWarp;
    for (int64_t row = 0; row < rows; row += lanes, ++warp) {
      const uint64_t block = together ? warp / of_block : warp % capacity_.blocks;
      const uint64_t in_group = together ? warp % of_block : warp / capacity_.blocks;
      const auto count = static_cast<uint64_t>(std::min(lanes, rows - row));
      phase[(block * capacity_.groups + group) * of_block + in_group] =
          chain | count << 24 | static_cast<uint64_t>(row);
    }
  }

  const BlockPlan::Phase* planned() const {
    return capacity_.plan ? &capacity_.plan->phases[phase_] : nullptr;
  }
  // Returns the bits for all warps of a phase: kSends, and the last turn of the halo modulo four.
  static uint64_t halo_task(const BlockPlan::Phase& phase) {
    return (phase.sends ? kSends : 0) | uint64_t{(phase.turns + 3) % 4} << kTurnShift;
  }
  // Adds the tasks of warps without rows.
  void add_idle_tasks() {
    const uint64_t of_block = capacity_.warps / capacity_.blocks;
    for (uint64_t warp = 0; warp < capacity_.warps; ++warp) {
      const bool makes = warp % of_block < capacity_.plan->maker_warps;
      const BlockPlan::Phase& phase = planned()[planned()->joined && !makes ? 1 : 0];
      const uint64_t hands = makes && phase.makes_items   ? kHandsOver
                             : !makes && phase.sums_items ? kTakesOver
                                                          : 0;
      tasks_.push_back(hands | halo_task(phase));
    }
  }
  // Adds a phase in which all blocks load rows of the halo from memory.
  void add_fills(const BlockPlan::Phase& phase) {
    out_.words.insert(out_.words.end(), {0, phase.fills.size(), 0, 0});
    for (const BlockPlan::Fill& fill : phase.fills)
      out_.words.insert(out_.words.end(), {fill.from, uint64_t{fill.base} << 32 | fill.rows,
                                           static_cast<uint64_t>(fill.width)});
    tasks_.resize(tasks_.size() + capacity_.warps, kFills | halo_task(phase));
  }
  // Adds the tasks of a chain if a plan assigns rows to threads.
  void add_planned_tasks(uint64_t chain, const BlockPlan::Phase& phase,
                         const BlockPlan::Chain& warps) {
    const BlockPlan& plan = *capacity_.plan;
    const uint64_t of_block = capacity_.warps / capacity_.blocks;
    uint64_t* const tasks = tasks_.data() + tasks_.size() - capacity_.warps;
    for (uint64_t block = 0; block < capacity_.blocks; ++block)
      for (uint64_t warp = warps.first_warp; warp < warps.first_warp + warps.warps; ++warp) {
        const uint64_t at = block * of_block + warp;
        if ((plan.layouts[phase.layout][at * kWarp] & BlockPlan::kOn) == 0) continue;
        tasks[at] = chain | uint64_t{phase.layout} << kLayoutShift | kWorks | halo_task(phase) |
                    (warps.stores && phase.fences ? kStores : 0) |
                    (warps.keeps || !phase.fences ? kKeeps : 0);
      }
  }
  // Adds the rows of threads, and the items of sums, after the records.
  void add_plan() {
    const BlockPlan& plan = *capacity_.plan;
    out_.layouts = static_cast<uint32_t>(plan.layouts.size());
    out_.corners = plan.corners;
    out_.item_rows = plan.item_rows;
    out_.rows = out_.words.size();
    out_.halo_rows = plan.halo.rows;
    out_.halo_rounds = plan.halo.rounds;
    out_.halo_turns = plan.halo.turns;
    out_.maker_warps = plan.maker_warps;
    std::vector<int32_t> words;
    for (const auto& layout : plan.layouts) words.insert(words.end(), layout.begin(), layout.end());
    for (const auto* halo : {&plan.halo.sends, &plan.halo.bytes})
      words.insert(words.end(), halo->begin(), halo->end());
    std::vector<uint64_t> first;  // position of the items of each table
    for (const auto& items : plan.items) {
      first.push_back(out_.rows * sizeof(uint64_t) + words.size() * sizeof(int32_t));
      words.insert(words.end(), items.begin(), items.end());
    }
    words.resize((words.size() + 1) / 2 * 2, 0);
    out_.words.resize(out_.rows + words.size() / 2);
    std::memcpy(out_.words.data() + out_.rows, words.data(), words.size() * sizeof(int32_t));
    for (const uint64_t at : out_.relative) out_.words[at] = first[out_.words[at]];
  }

  // Returns the rows per warp. With few rows, more warps get fewer rows each, because a load waits
  // for all cache lines of its lanes.
  int64_t lanes_of(std::span<const novaphy_persistent_op> phase) const {
    int64_t lanes = kWarp;
    while (lanes > 1 && warps_of(phase, lanes / 2) <= capacity_.warps) lanes /= 2;
    return lanes;
  }

  // Adds the arguments, at position `at`, to the record. Returns the number of the chain's form.
  uint32_t add_chain(std::span<const novaphy_persistent_op> chain, Warps warps, uint64_t at,
                     std::vector<uint64_t>& body) {
    ChainForm form;
    const size_t start = body.size();
    body.push_back(0);
    for (const novaphy_persistent_op& o : chain) {
      Operation& op = form.operations.emplace_back(operation(o));
      if (op.kind == Operation::Program) body.push_back(o.op.kernel->number);
      op.first_word = static_cast<int32_t>(body.size() - start);
      if (o.op.kernel == nullptr) {
        body.push_back(address(o.op.target));
        body.push_back(o.op.source ? address(o.op.source) : o.op.pattern);
      } else {
        body.insert(body.end(), o.op.arguments, o.op.arguments + o.op.argument_count);
        if (op.kind == Operation::Program) add_early(o, op, warps, start, at, body);
      }
    }
    find_tables(chain, form);
    link(chain, form);
    if (capacity_.plan != nullptr) plan_items(chain, form, body.data() + start, at);
    const auto next = static_cast<uint32_t>(forms_.size());
    const uint32_t number = forms_.emplace(form, next).first->second;
    for (uint32_t k = 0; k < chain.size(); ++k) form_of_.push_back({number, k});
    const bool is_early = std::any_of(form.operations.begin(), form.operations.end(),
                                      [](const Operation& op) { return op.early_word >= 0; });
    if (is_early) {
      const Slots slots = slots_of(warps);
      const uint64_t layout = uint64_t{capacity_.plan->phases[phase_].layout} * capacity_.warps *
                              kWarp * sizeof(uint32_t);
      jobs_.insert(jobs_.end(),
                   {slots.all << 32 | number, at, layout, slots.first << 32 | slots.of_block});
      out_.job_slots = std::max(out_.job_slots, slots.all);
    }
    note_early(chain, form, number);
    note_kept(form, number, chain[0].rows, warps, body.data() + start, at);
    return number;
  }

  size_t number_of(const novaphy_persistent_op& o) const {
    return first_op_ + static_cast<size_t>(&o - phase_ops_.data());
  }

  // Numbers of threads of a chain: in all blocks, per block, and the first thread in a block.
  struct Slots {
    uint64_t all, of_block, first;
  };
  Slots slots_of(Warps warps) const {
    const uint64_t of_block = (warps.second - warps.first) * kWarp;
    return {of_block * capacity_.blocks, of_block, warps.first * kWarp};
  }
  // Sets the memory for the results of an early half.
  void add_early(const novaphy_persistent_op& o, Operation& op, Warps warps, size_t start,
                 uint64_t at, std::vector<uint64_t>& body) {
    const std::vector<uint64_t>* const row_bytes =
        early_halves_.empty() ? nullptr : &early_halves_[number_of(o)];
    if (row_bytes == nullptr || row_bytes->empty()) return;
    op.early_word = static_cast<int32_t>(body.size() - start);
    const Slots slots = slots_of(warps);
    for (const uint64_t bytes : *row_bytes) {
      out_.early.push_back(at + body.size() - start);
      body.push_back(out_.early_bytes);
      out_.early_bytes += bytes * slots.all;
    }
    body.push_back(slots.first << 48 | slots.of_block << 32 | slots.all);
  }

  // Sets which items of a chain are in the memory of its block.
  void plan_items(std::span<const novaphy_persistent_op> chain, ChainForm& form, uint64_t* words,
                  uint64_t at) {
    form.sums_items = capacity_.plan->phases[phase_].sums_items;
    for (size_t k = 0; k < chain.size(); ++k) {
      const BlockPlan::Operation& planned = capacity_.plan->operations[number_of(chain[k])];
      Operation& op = form.operations[k];
      // Rows are handed over or sent when the chain is done, so results must not be stored at once.
      if (!planned.outputs.empty() || !planned.sends.empty())
        for (const Operation& any : form.operations)
          for (const Operation::Output& stored : any.outputs)
            out_.fits = out_.fits && stored.store != Operation::Output::Now;
      for (const auto& [output, items] : planned.outputs) {
        out_.fits = out_.fits && op.outputs[output].store == Operation::Output::Later;
        op.outputs[output].items = static_cast<int32_t>(items.base);
        op.outputs[output].item_width = items.width;
      }
      const auto goes = [&](size_t output) {
        return op.each == 1 && op.outputs[output].store == Operation::Output::Later;
      };
      for (const auto& [output, base] : planned.sends) {
        out_.fits = out_.fits && goes(output);
        op.outputs[output].halo = static_cast<int32_t>(base);
      }
      for (const auto& [source, base] : planned.receives) {
        out_.fits = out_.fits && op.sources[source].from == Operation::Source::Memory;
        op.sources[source].halo = static_cast<int32_t>(base);
        const uint64_t rows = chain[k].op.arguments[out_.source_word(op, source) + 1];
        op.sources[source].halo_rows = static_cast<int32_t>(rows);
      }
      if (!planned.sum) continue;
      out_.fits = out_.fits && op.tables[0] >= 0;  // otherwise missing items would not be zeros
      op.sum.items = static_cast<int32_t>(planned.sum->base);
      op.sum.chunks = false;  // no row is long enough for the rule
      if (planned.sum->longest < kBatch) op.sum.batch = std::max(planned.sum->longest, 1);
      const int32_t word = op.first_word + op.sum.offsets_word + 1;
      const auto own = static_cast<uint64_t>(word);
      words[own] = planned.sum->items;
      out_.relative.push_back(at + own);
    }
  }

  // Records the sources that the chain may read before the previous phase is over.
  void note_early(std::span<const novaphy_persistent_op> chain, const ChainForm& form,
                  uint32_t number) {
    Pieces own;
    for (const novaphy_persistent_op& o : chain) add_written(own, o);
    std::vector<char> early;
    for (size_t k = 0; k < chain.size(); ++k)
      for (size_t s = 0; s < form.operations[k].sources.size(); ++s) {
        const auto [begin, bytes] = memory_of(chain[k], form.operations[k], s);
        const bool is_own = form.operations[k].sources[s].from == Operation::Source::Own;
        const bool is_early =
            capacity_.blocks != 0 && form.operations[k].sources[s].halo < 0 &&
            (is_mine(chain[k], form.operations[k], s) || !phase_written_.touch(begin, bytes)) &&
            (is_own || !own.touch(begin, bytes));
        const bool is_unwritten = is_early && !written_.touch(begin, bytes);
        early.push_back(
            static_cast<char>((is_early ? kEarly : 0) | (is_unwritten ? kUnwritten : 0)));
      }
    if (number == early_.size()) {
      early_.push_back(std::move(early));
    } else {
      for (size_t k = 0; k < early.size(); ++k) early_[number][k] &= early[k];
    }
  }
  // Returns whether the thread that reads the rows of the source also wrote them.
  bool is_mine(const novaphy_persistent_op& o, const Operation& op, size_t source) const {
    return capacity_.plan != nullptr && op.kind != Operation::Copy &&
           op.sources[source].from == Operation::Source::Own &&
           capacity_.plan->operations[number_of(o)].mine.contains(
               static_cast<int32_t>(out_.source_word(op, source)));
  }
  // Returns the memory that an operation may read through a source: its address and its bytes.
  std::pair<uint64_t, uint64_t> memory_of(const novaphy_persistent_op& o, const Operation& op,
                                          size_t source) const {
    const uint64_t row = static_cast<uint64_t>(out_.source_width(op, source)) * sizeof(int32_t);
    const auto n = static_cast<uint64_t>(o.n);
    if (op.kind == Operation::Copy) return {address(o.op.source), n * row};
    const int64_t word = out_.source_word(op, source);
    const uint64_t rows = op.kind == Operation::Program ? o.op.arguments[word + 1] : n;
    return {o.op.arguments[word], rows * row};
  }

  // Records the loads of a chain from memory that the persistent kernel only reads. A thread may
  // keep these words in registers from step to step. Chains that load the same words in the same
  // threads share the registers, and count once.
  void note_kept(const ChainForm& form, uint32_t number, int64_t rows, Warps warps,
                 const uint64_t* words, uint64_t at) {
    User user{0, warps, {at}};
    std::vector<uint64_t> key = {number, warps.first, warps.second, static_cast<uint64_t>(rows)};
    if (capacity_.plan != nullptr) key.push_back(capacity_.plan->phases[phase_].layout);
    for (const int32_t word : form.tables) {
      user.words += 2 + kBatch;
      key.insert(key.end(), {words[word], words[word + 1]});
    }
    for (const Operation& op : form.operations)
      for (size_t s = 0; s < op.sources.size(); ++s) {
        if (!op.sources[s].fixed) continue;
        user.words += static_cast<uint32_t>(out_.loaded_words(op, s));
        key.push_back(words[op.first_word + out_.source_word(op, s)]);
      }
    if (user.words == 0) return;
    const auto [known, fresh] = user_of_.emplace(std::move(key), users_.size());
    if (fresh) {
      users_.push_back(std::move(user));
    } else {
      users_[known->second].chains.push_back(at);
    }
  }
  // Writes into words of chains twice the position of kept data, plus one if the chain fills it.
  void place_kept() {
    std::stable_sort(users_.begin(), users_.end(),
                     [](const User& a, const User& b) { return a.words > b.words; });
    for (const User& user : users_) {
      if (user.chains.size() < kMinUses) continue;
      const uint64_t position = kept_.place(user.words, user.warps);
      out_.fits = out_.fits && (position != 0 || capacity_.plan == nullptr);
      for (const uint64_t at : user.chains)
        if (position != 0) out_.words[at] = 2 * position + (at == user.chains[0] ? 1 : 0);
    }
    if (capacity_.plan != nullptr) place_rare();
  }

  // With a plan all such loads are kept. Those that do not pay off share words, filled each time.
  void place_rare() {
    User all{0, {0, UINT64_MAX}, {}};
    for (const User& user : users_) {
      if (user.chains.size() >= kMinUses) continue;
      all.words = std::max(all.words, user.words);
      all.chains.insert(all.chains.end(), user.chains.begin(), user.chains.end());
    }
    if (all.chains.empty()) return;
    const uint64_t position = kept_.place(all.words, all.warps);
    out_.fits = out_.fits && position != 0;
    for (const uint64_t at : all.chains) out_.words[at] = 2 * position + 1;
  }

  Operation operation(const novaphy_persistent_op& o) {
    Operation op;
    op.each = static_cast<int32_t>(o.n / o.rows);
    const novaphy_kernel* kernel = o.op.kernel;
    if (kernel == nullptr) {
      op.kind = o.op.source ? Operation::Copy : Operation::Fill;
      if (o.op.source) op.sources.push_back({Operation::Source::There});
      op.outputs.resize(1);
    } else if (const CsrSum sum = csr_sum(o); sum.is_there() || is_builtin(o)) {
      op.kind = Operation::RowSum;
      op.sum.width = sum.is_there() ? sum.width : static_cast<int32_t>(o.op.arguments[5]);
      op.sum.offsets = sum.is_there();
      op.sum.init = sum.is_there() ? sum.has_init : o.op.arguments[3] != 0;
      op.sum.chunks = is_builtin(o);
      if (sum.is_there()) {
        op.sum.source_word = sum.source;
        op.sum.offsets_word = sum.offsets;
        op.sum.init_word = sum.init;
        op.sum.out_word = sum.out;
      }
      if (op.sum.init) op.sources.push_back({Operation::Source::There});
      op.outputs.resize(1);
      op.outputs[0].width = op.sum.width;
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

  static bool is_aligned(const Touch& t) { return t.where % kAlignment == 0 && t.words % 4 == 0; }

  static void touches(const novaphy_persistent_op& o, const Operation& op,
                      std::vector<Touch>& reads, std::vector<Touch>& writes) {
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
        if (op.sum.init) reads.push_back({words[op.sum.init_word], op.each * op.sum.width, 0});
        writes.push_back({words[op.sum.out_word], op.each * op.sum.width, 0});
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

  // Finds the CSR tables that have the same rows as the chain, without duplicates.
  static void find_tables(std::span<const novaphy_persistent_op> chain, ChainForm& form) {
    std::vector<const uint64_t*> known;
    for (size_t k = 0; k < chain.size(); ++k) {
      Operation& op = form.operations[k];
      const uint64_t* const words = chain[k].op.arguments;
      const auto add = [&](uint32_t word) {
        const auto same = [&](const uint64_t* table) {
          return table[0] == words[word] && table[1] == words[word + 1];
        };
        const auto found = std::find_if(known.begin(), known.end(), same);
        const auto number = static_cast<int32_t>(found - known.begin());
        op.tables.push_back(op.each == 1 && number < kMaxTables ? number : -1);
        if (op.tables.back() < 0 || found != known.end()) return;
        known.push_back(words + word);
        form.tables.push_back(op.first_word + static_cast<int32_t>(word));
      };
      if (op.kind == Operation::RowSum && op.sum.offsets) {
        Operation::Sum& sum = op.sum;
        add(static_cast<uint32_t>(sum.offsets_word));
        if (k == 0 || op.each != 1) continue;
        const Operation& before = form.operations[k - 1];
        const Operation::Sum& first = before.sum;
        const uint64_t* other = chain[k - 1].op.arguments;
        sum.joins = before.kind == Operation::RowSum && first.offsets && before.each == 1 &&
                    !first.joins && first.width == sum.width && first.chunks == sum.chunks &&
                    words[sum.offsets_word] == other[first.offsets_word] &&
                    words[sum.offsets_word + 1] == other[first.offsets_word + 1] &&
                    (!sum.init || words[sum.init_word] != other[first.out_word]);
      } else if (op.kind == Operation::Program) {
        const nova::ir::Program& p = chain[k].op.kernel->program;
        for (size_t l = 0; l < p.loops.size(); ++l) {
          if (p.loops[l].kind == nova::ir::LoopKind::Csr) {
            add(p.loop_argument(l));
          } else {
            op.tables.push_back(-1);
          }
        }
      }
    }
  }

  // Passes results to later operations of the chain through registers. Results are stored at the
  // end, so that no store comes between the chain's loads.
  void link(std::span<const novaphy_persistent_op> chain, ChainForm& form) const {
    struct Place {
      int32_t words = 0, op = -1, output = 0;
      bool fits = true, written = false;
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
        Operation::Source& source = op.sources[static_cast<size_t>(t.slot)];
        if (place.fits && place.op >= 0) {
          source = {Operation::Source::Registers, place.op, place.output};
        } else if (source.from == Operation::Source::There && t.words <= kMaxOwn &&
                   !place.written) {
          const uint64_t bytes = static_cast<uint64_t>(t.words) * chain[k].rows * sizeof(int32_t);
          source = {Operation::Source::Own, 0, 0, is_aligned(t),
                    comes_again(chain[k], t) && !written_.touch(t.where, bytes)};
        }
      }
      link_first_rows(chain[k], op);
      for (const Touch& t : writes) {
        Place& place = places[t.where];
        place.written = true;
        if (!place.fits) continue;
        if (place.op >= 0)
          form.operations[static_cast<size_t>(place.op)]
              .outputs[static_cast<size_t>(place.output)]
              .store = Operation::Output::Never;
        op.outputs[static_cast<size_t>(t.slot)].store = Operation::Output::Later;
        op.outputs[static_cast<size_t>(t.slot)].aligned = is_aligned(t);
        place.op = static_cast<int32_t>(k);
        place.output = t.slot;
      }
    }
  }

  void link_first_rows(const novaphy_persistent_op& o, Operation& op) const {
    if (op.kind != Operation::Program) return;
    const nova::ir::Program& p = o.op.kernel->program;
    for (size_t s = 0; s < p.sources.size(); ++s) {
      const Touch t{o.op.arguments[p.source_argument(s)], p.sources[s].width,
                    static_cast<int32_t>(s)};
      if (rows_read(p, s) != Rows::First || op.sources[s].from != Operation::Source::There ||
          t.words > kMaxOwn ||
          written_.touch(t.where, static_cast<uint64_t>(t.words) * sizeof(int32_t)))
        continue;
      op.sources[s] = {Operation::Source::First, 0, 0, is_aligned(t), comes_again(o, t)};
    }
  }
  bool comes_again(const novaphy_persistent_op& o, const Touch& t) const {
    const auto uses = uses_.find({o.op.kernel, t.slot, t.where});
    return uses != uses_.end() && uses->second >= kMinUses;
  }

  void add_uses(const novaphy_persistent_op& o) {
    if (o.op.kernel == nullptr) return;
    if (is_builtin(o)) {
      ++uses_[{o.op.kernel, 0, o.op.arguments[3]}];
      return;
    }
    const nova::ir::Program& p = o.op.kernel->program;
    for (size_t s = 0; s < p.sources.size(); ++s)
      ++uses_[{o.op.kernel, static_cast<int32_t>(s), o.op.arguments[p.source_argument(s)]}];
  }

  PersistentTable out_;
  Pieces written_, phase_written_;  // by the persistent kernel, by the previous phase
  uint64_t phase_ = 0;
  uint64_t record_ = 0, record_before_ = 0;  // positions of the first words of records
  size_t first_op_ = 0;                      // first operation of the phase
  std::span<const novaphy_persistent_op> phase_ops_;
  Kept kept_;
  const PersistentCapacity capacity_;
  std::vector<uint64_t> tasks_;
  std::map<SourceUse, uint32_t> uses_;
  std::vector<User> users_;
  std::map<std::vector<uint64_t>, size_t> user_of_;
  std::map<const novaphy_kernel*, int32_t> programs_;
  std::map<ChainForm, uint32_t> forms_;
  static constexpr char kEarly = 1, kUnwritten = 2;
  std::vector<std::vector<char>> early_;  // by form and source of its operations
  // by operation: its form, and its index in the form
  std::vector<std::pair<uint32_t, uint32_t>> form_of_;
  const EarlyWords early_halves_;
  // Early results that a record loads, and the position in a header with their address.
  struct EarlyOf {
    uint64_t header, first, bytes;
  };
  std::vector<EarlyOf> early_of_;
  std::vector<uint64_t> jobs_;
};

}  // namespace

int32_t PersistentTable::source_width(const Operation& op, size_t source) const {
  if (op.kind != Operation::Program) return op.sum.width;
  return programs[static_cast<size_t>(op.program)]->sources[source].width;
}
int32_t PersistentTable::loaded_words(const Operation& op, size_t source) const {
  switch (op.sources[source].from) {
    case Operation::Source::Own:
      return op.each * source_width(op, source);
    case Operation::Source::First:
      return source_width(op, source);
    default:
      return 0;
  }
}
int64_t PersistentTable::source_word(const Operation& op, size_t source) const {
  if (op.kind != Operation::Program) return op.kind == Operation::RowSum ? op.sum.init_word : 1;
  return programs[static_cast<size_t>(op.program)]->source_argument(source);
}

namespace {

// Returns the bytes per row of the results, or nothing unless the early half is worth a separate
// launch: no operation of the persistent kernel writes its sources, and the half computes much more
// than it stores.
std::vector<uint64_t> worth_early(const PersistentTable& table, Operation op) {
  constexpr size_t kInstructionsOfWord = 3;
  if (op.kind != Operation::Program) return {};
  for (const Operation::Source& source : op.sources)
    if (source.early && !source.fixed_rows) return {};
  const nova::ir::Program early = halves_of(table, op).early;
  uint64_t words = 0;
  for (const nova::ir::Output& output : early.outputs) words += crossing_words(output);
  if (early.instrs.size() <= kInstructionsOfWord * words) return {};
  op.early_word = 0;
  std::vector<uint64_t> bytes;
  for (const nova::ir::Output& output : halves_of(table, op).early.outputs)
    bytes.push_back(crossing_words(output) * sizeof(int32_t));
  return bytes;
}

}  // namespace

PersistentTable persistent_table(std::span<const novaphy_persistent_op> ops,
                                 const PersistentCapacity& capacity) {
  Writer plain(capacity, {});
  PersistentTable table = plain.run(ops);
  if (capacity.early_bytes == 0) return table;
  std::vector<std::vector<std::vector<uint64_t>>> of_forms;
  bool any = false;
  for (const ChainForm& form : table.forms) {
    of_forms.emplace_back();
    for (const Operation& op : form.operations) {
      of_forms.back().push_back(worth_early(table, op));
      any = any || !of_forms.back().back().empty();
    }
  }
  if (!any) return table;
  Writer::EarlyWords early;
  for (const auto& [form, number] : plain.form_of()) early.push_back(of_forms[form][number]);
  PersistentTable with = Writer(capacity, early).run(ops);
  return with.fits && with.early_bytes <= capacity.early_bytes ? with : table;
}

uint32_t most_warps(std::span<const novaphy_persistent_op> ops) {
  uint64_t most = 0;
  for (size_t first = 0; first < ops.size();) {
    const std::span<const novaphy_persistent_op> phase = phase_at(ops, first);
    most = std::max(most, warps_of(phase, kWarp));
    first += phase.size();
  }
  return static_cast<uint32_t>(most);
}

}  // namespace novaphy::gpu
