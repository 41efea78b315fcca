// Internal to the emitter: the writer of one function.
#pragma once

#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "emit_idle.h"
#include "emit_kept.h"
#include "emit_plan.h"
#include "emit_prefetch.h"
#include "emit_values.h"
#include "novaphy/program/scan.h"

namespace nova::ir {

inline size_t at(int32_t k) { return static_cast<size_t>(k); }
inline std::string str(int64_t k) { return std::to_string(k); }
inline const char* letter(Type t) { return t == Type::F32 ? "f" : "i"; }

class Emitter {
 public:
  explicit Emitter(const Program& program, bool device = false, const Scan* scan = nullptr,
                   std::vector<char> items = {});
  std::string run(const std::string& function);
  // Words that differ from launch to launch come from a table, a row of it for each launch: the
  // varying sources, then the outputs, null where nobody reads what this launch would write.
  std::string run_scan(const std::string& function, const Program* primal);
  // What makes a launch more than a quiet one; none: it cannot be left out.
  std::optional<std::set<uint64_t>> questions() const;
  std::string run_device(const std::string& function);

 private:
  void line(const std::string& s) { out_.append(2 * at(depth_), ' ').append(s).append("\n"); }
  void close();
  void head(const std::string& function);
  // How sources and outputs are reached is a type: memory, or the registers of the thread.
  void device_signature(const std::string& function);
  void head_comment();
  std::string extent_note(int32_t parameter) const;
  void arguments();
  void loops_and_parameters();
  void before_the_rows();
  // The last group, when it is not whole, begins earlier: it computes rows once more, and does not
  // write them.
  void groups_begin();
  void groups_end();
  // What is prefetched by a group: declared and gathered for the first group, taken over by the
  // group that begins, gathered for the next between the lines of this one.
  void prefetch_begin();
  void prefetch_group();
  void prefetch_line(Value v);
  void prefetch_end(int32_t scope);
  void prefetch_region(int32_t region);
  // Where all columns of an output are 0 unless a group takes that region, whether it does being
  // known; -1: nowhere.
  int32_t zero_without(const Output& output) const;
  std::vector<int32_t> prefetch_regions() const;
  // Where a group of loads is among it, or -1.
  int32_t prefetch_column(const LoadGroup& group) const;
  std::string prefetch_gather(const PrefetchedGather& gather, int32_t column) const;
  void prefetch_load(Value v, const LoadGroup& group, int32_t first, const std::string& where);
  std::string output_bytes(size_t o) const;
  // An output may be the memory of a source, and then holds what the first time wrote: no row of a
  // table may be taken from there, because it could be past the table's end.
  bool may_run_again() const;
  bool varies(int32_t source) const;
  // The output that is carried to a source, or -1.
  int32_t carrier(int32_t source) const;
  static std::string state(int32_t source, int32_t column);
  // What all launches share: values that depend on nothing that changes, and the state at the
  // beginning.
  void before_the_launches();
  void load_state(int32_t source);
  // Fetches array k of a later launch.
  std::string prefetch_rows(size_t k, int32_t width, const char* write) const;
  // What a launch has in the room, and where a source that varies begins in a row there, or -1.
  std::string launch_room(int32_t row_bytes) const;
  int32_t near_bytes(int32_t source) const;
  void launch_sources();  // where a launch finds what varies
  void put(size_t o);     // writes an output of a launch
  void note();            // see emit_fast_path.cpp
  void quiet_launch();
  // The comparisons that need no root while a limit is far, and the bits of `acted` that say
  // whether it was not, or not asked. The first bit: whether an item of a loop acted.
  std::vector<Value> limits() const;
  std::string acted_bit(Value limit) const;
  size_t launch_words() const { return scan_->varying.size() + p_.outputs.size() + 1; }
  static std::string word(size_t w) { return std::to_string(w); }
  void hold(Value v);
  bool held(Value v) const { return scan_ && held_[at(v)]; }
  void hold_items(int32_t l);
  // The held values of a loop that its launches read, the item among them.
  std::vector<Value> held_items(int32_t l) const;
  void steps();
  bool in_csr_loop(int32_t l) const { return l >= 0 && p_.loops[at(l)].kind == LoopKind::Csr; }
  // Whether an `if` was written that ends with the region.
  bool region_begin(int32_t number);
  // On a device, where a region (-1: the row) begins: its loads of rows that are known there. So a
  // thread waits for memory once; compilers move no load across a branch.
  void loads_first(int32_t region);
  // Quotients and roots branch on a device. Those that can be computed where one is due come with
  // it, behind one branch for all.
  void quotients_together(Value v);
  bool is_quotient(Value v) const;
  // Whether a value is there, or can be computed now, without a load, a quotient or a root.
  bool can_be_there(Value v, int32_t region) const;
  void make_it_there(Value v);
  // x + -0 is x; so is x + 0 unless x is -0, which no sum becomes that did not begin with it.
  bool adds_nothing(const IdleItem& idle, size_t sum) const;
  bool adds_nothing(const IdleItem& idle) const;  // to any of its sums
  // Whether items that do not act in the earlier loop do nothing in the later one.
  bool follows(const KeptValues& kept) const;
  const IdleItem* idle_item(int32_t loop) const;
  std::string zero(Value v) const;
  // Whether every row is the own one of a source and the rows of CSR items: no lanes are needed.
  bool adds_rows_only() const;
  void sums_of_rows();
  void begin_sums(int32_t l);
  void loop_begin(int32_t l);
  void item_begin(int32_t l);
  bool is_slot(size_t v, int32_t l) const;
  void slot(int32_t l);
  // Where this loop begins.
  void csr_rows(int32_t l);
  // Begins an item of a CSR loop on a device.
  void device_items(int32_t l);
  // A sum of little more than what it loads waits for memory: on a device, the loads of several
  // items are under way at once. Items past the end are loaded, not added.
  bool in_batches(int32_t l) const;
  // What a value is where its region is jumped over. When all that reads it is a SELECT by the
  // region's condition, a device, which has one lane, takes what the SELECT would give, and needs
  // none.
  std::string without(Value v, const Region& region);
  // Whether a source is in registers for the item that we are at.
  bool is_item(int32_t source) const { return in_items_ && items_[at(source)] != 0; }
  // Whether a loop that follows reads what this one computes.
  void kept_rows(int32_t l);
  // `acting`: for the loops that follow only the items that act, else for the others.
  void write_kept(int32_t l, bool acting);
  // What an earlier loop has kept for the item, or else all of it once more.
  void read_kept(const KeptValues& kept);
  void loop_end(int32_t l);
  void compute(Value v);
  // c < sqrt(x) is false wherever x <= 0.999 c c: a group of such lanes needs no root.
  void limited_root(Value v, const Instr& in);
  std::string declaration(Value v) const;
  bool is_declared(Value v) const { return plan_.escapes[at(v)] || declared_[at(v)]; }
  // The lanes that need a load: those for which every condition around it holds.
  std::string need(Value v) const;
  void load(Value v, const Instr& in);
  static std::string own_column(const std::string& array, int32_t width, int32_t column);
  // Wide rows are read and written four columns at a time: the first of the four that begin with
  // `column`, or end with the last one. -1: rows are too narrow, or it is the last one alone.
  static int32_t four_columns(int32_t column, int32_t width);
  // Declares the columns [first, first + count) of a load, and lists where they go; those before
  // `fresh` are known already, and go nowhere.
  std::string columns(Value v, const LoadGroup& group, int32_t fresh, int32_t first, int32_t count);
  // The variable that says how the rows of a load lie: one that is in sight, else a new one.
  std::string rows_of(Value row, int32_t region);
  Value column_owner(Value v, const Instr& in) const;
  void stores();
  void store(const Output& output, const std::string& array);

  const Program& original_;
  const Program p_;
  const EmitPlan plan_;
  const ValueText text_;
  const bool device_;
  const Scan* const scan_;        // or null
  const std::vector<char> held_;  // in a scan, per value: the same in every launch
  std::vector<KeptValues> kept_;
  std::vector<IdleItem> idle_;
  std::vector<FollowedItem> followed_;
  PrefetchedGathers prefetch_;
  std::vector<std::string> prefetch_text_;  // its statements
  size_t prefetch_written_ = 0;             // of them, in this group
  int32_t prefetch_weight_ = 0;             // of its scope
  std::set<int32_t> followers_;             // loops that leave out what does not act
  // Devices: per source, whether the first items of CSR loops are in registers. The loops are then
  // written twice, for these items and for the others.
  const std::vector<char> items_;
  bool in_items_ = false;
  int32_t items_done_ = -1;            // the loop that was written for these
  std::vector<char> declared_, done_;  // per value: before its computation; it too
  std::vector<char> computed_;         // per value: written already
  std::vector<Value> chosen_;          // of a SELECT that is not needed: the operand that it equals
  std::string out_;
  int32_t depth_ = 0, loop_ = -1;
  std::set<std::tuple<Value, int32_t, int32_t>> looked_, looked_before_;  // row, region, loop
  bool tail_ = false;  // the last group may begin earlier
  bool quiet_ = false;
  bool probes_ = false;              // loads what launches may need, and not in vain
  const Program* primal_ = nullptr;  // of a scan that reads notes
};

}  // namespace nova::ir
