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
  // Returns the function for a scan of launches. Its table has a row for each launch, with the
  // words that differ between launches: the varying sources, then the outputs. An output is null if
  // no one reads the result of this launch.
  std::string run_scan(const std::string& function, const Program* primal);
  // Returns hashes of the conditions under which a launch is not quiet (emit_fast_path.cpp).
  // Returns nothing if launches are never quiet.
  std::optional<std::set<uint64_t>> questions() const;
  std::string run_device(const std::string& function);

 private:
  void line(const std::string& s) { out_.append(2 * at(depth_), ' ').append(s).append("\n"); }
  void close();
  void head(const std::string& function);
  // Each source and output has a type that says where it is: in memory, or in registers of the
  // thread.
  void device_signature(const std::string& function);
  void head_comment();
  std::string extent_note(int32_t parameter) const;
  void arguments();
  void loops_and_parameters();
  void before_the_rows();
  // If the last group is not full, it begins at an earlier row. It computes some rows again without
  // writing them.
  void groups_begin();
  void groups_end();
  // Functions for prefetching. prefetch_begin declares and gathers the rows of the first group.
  // prefetch_group hands rows over to the group that begins. Between the lines of a group, the rows
  // of the next group are gathered.
  void prefetch_begin();
  void prefetch_group();
  void prefetch_line(Value v);
  void prefetch_end(int32_t scope);
  void prefetch_region(int32_t region);
  // Returns the region without which all columns of an output are 0, if the text knows in advance
  // whether a group takes the region. Returns -1 otherwise.
  int32_t zero_without(const Output& output) const;
  std::vector<int32_t> prefetch_regions() const;
  // Returns the first column of a group of loads among the prefetched columns, or -1.
  int32_t prefetch_column(const LoadGroup& group) const;
  std::string prefetch_gather(const PrefetchedGather& gather, int32_t column) const;
  void prefetch_load(Value v, const LoadGroup& group, int32_t first, const std::string& where);
  std::string output_bytes(size_t o) const;
  // Returns whether rows may be computed twice. An output may share the memory of a source, which
  // then has results of the first run. A row index read from there could be past the end of a
  // table.
  bool may_run_again() const;
  bool varies(int32_t source) const;
  // Returns the output that is carried to a source, or -1.
  int32_t carrier(int32_t source) const;
  static std::string state(int32_t source, int32_t column);
  // Writes the loads of data that all launches share: values that do not change, and the initial
  // state.
  void before_the_launches();
  void load_state(int32_t source);
  // Returns the text that prefetches array k of a later launch.
  std::string prefetch_rows(size_t k, int32_t width, const char* write) const;
  // Returns the text for the part of the scratch that a launch has, and the offset of a varying
  // source in the row of a launch, or -1.
  std::string launch_scratch(int32_t row_bytes) const;
  int32_t near_bytes(int32_t source) const;
  void launch_sources();  // writes the loads of a launch's varying addresses
  void put(size_t o);     // writes the store of an output of a launch
  void note();            // see emit_fast_path.cpp
  void quiet_launch();
  // The comparisons that need no square root far below a limit, and their bits in `acted`. A bit is
  // set if the limit is near or was not tested. The first bit says that an item of a loop acted.
  std::vector<Value> limits() const;
  std::string acted_bit(Value limit) const;
  size_t launch_words() const { return scan_->varying.size() + p_.outputs.size() + 1; }
  static std::string word(size_t w) { return std::to_string(w); }
  void hold(Value v);
  bool held(Value v) const { return scan_ && held_[at(v)]; }
  void hold_items(int32_t l);
  // Returns the held values of a loop that its launches read, including the item.
  std::vector<Value> held_items(int32_t l) const;
  void steps();
  bool in_csr_loop(int32_t l) const { return l >= 0 && p_.loops[at(l)].kind == LoopKind::Csr; }
  // Returns whether the function wrote an `if`, which ends with the region.
  bool region_begin(int32_t number);
  // On a device: writes the loads of existing rows at the start of a region, or of the row (-1). A
  // thread then waits for memory once, because compilers move no load across a branch.
  void loads_first(int32_t region);
  // On a device, quotients and roots contain a branch. When the text needs one of them, all others
  // that can be computed are added behind the same branch.
  void quotients_together(Value v);
  bool is_quotient(Value v) const;
  // can_be_there returns whether a value is computed, or can be computed without a load, a quotient
  // or a root. make_it_there writes the computation.
  bool can_be_there(Value v, int32_t region) const;
  void make_it_there(Value v);
  // Returns whether the constant terms of idle items change no sum. x + -0 is x. x + 0 is x unless
  // x is -0, and a sum is -0 only if it starts from -0.
  bool adds_nothing(const IdleItem& idle, size_t sum) const;
  bool adds_nothing(const IdleItem& idle) const;  // to all of its sums
  // Returns whether items that are inactive in the earlier loop are also inactive in the later
  // loop.
  bool follows(const KeptValues& kept) const;
  const IdleItem* idle_item(int32_t loop) const;
  std::string zero(Value v) const;
  // Returns whether all that the Program does is to add rows of CSR items to the own row of a
  // source. Lanes are then not needed.
  bool adds_rows_only() const;
  void sums_of_rows();
  void begin_sums(int32_t l);
  void loop_begin(int32_t l);
  void item_begin(int32_t l);
  bool is_slot(size_t v, int32_t l) const;
  void slot(int32_t l);
  // Writes the code that reads the start and length of the rows of a CSR loop.
  void csr_rows(int32_t l);
  // Writes the beginning of an item of a CSR loop on a device.
  void device_items(int32_t l);
  // Returns whether a sum adds items in batches. On a device, a sum with little arithmetic waits
  // for memory, so the loads of several items run together. Items past the end are loaded but not
  // added.
  bool in_batches(int32_t l) const;
  // Returns the text for the value when its region is skipped. If all users are SELECTs by the
  // region's condition, a device uses the other operand of the SELECT and needs no value.
  std::string without(Value v, const Region& region);
  // Returns whether a source is in registers for the current item.
  bool is_item(int32_t source) const { return in_items_ && items_[at(source)] != 0; }
  // Writes declarations of the values that a later loop reads.
  void kept_rows(int32_t l);
  // Writes the stores of values for a later loop. `acting`: later loops read the values only for
  // active items; otherwise only for the other items.
  void write_kept(int32_t l, bool acting);
  // Writes the code that reads the values that an earlier loop kept for the item, or computes them
  // again.
  void read_kept(const KeptValues& kept);
  void loop_end(int32_t l);
  void compute(Value v);
  // Writes a square root that groups skip below the limit. c < sqrt(x) is false wherever x <= 0.999
  // c c, so a group of such lanes needs no root.
  void limited_root(Value v, const Instr& in);
  std::string declaration(Value v) const;
  bool is_declared(Value v) const { return plan_.escapes[at(v)] || declared_[at(v)]; }
  // Returns the text for the lanes that need a load, because all its conditions hold.
  std::string need(Value v) const;
  void load(Value v, const Instr& in);
  static std::string own_column(const std::string& array, int32_t width, int32_t column);
  // Wide rows are read and written four columns at a time. Returns the first of four columns that
  // begin with `column`, or that end with the last column. Returns -1 if rows are too narrow, or if
  // only the last column remains.
  static int32_t four_columns(int32_t column, int32_t width);
  // Declares the columns [first, first + count) of a load, and lists their targets. Columns before
  // `fresh` are already known and have no target.
  std::string columns(Value v, const LoadGroup& group, int32_t fresh, int32_t first, int32_t count);
  // Returns the variable that describes how the rows of a load lie in memory: the variable in scope
  // if there is one, otherwise a new variable.
  std::string rows_of(Value row, int32_t region);
  Value column_owner(Value v, const Instr& in) const;
  void stores();
  void store(const Output& output, const std::string& array);

  const Program& original_;
  const Program p_;
  const EmitPlan plan_;
  const ValueText text_;
  const bool device_;
  const Scan* const scan_;        // null: the text is not a scan
  const std::vector<char> held_;  // in a scan, per value: whether it is the same in every launch
  std::vector<KeptValues> kept_;
  std::vector<IdleItem> idle_;
  std::vector<FollowedItem> followed_;
  PrefetchedGathers prefetch_;
  std::vector<std::string> prefetch_text_;  // the statements of the prefetch
  size_t prefetch_written_ = 0;             // number of statements written in this group
  int32_t prefetch_weight_ = 0;             // weight of the lines of the scope so far
  std::set<int32_t> followers_;             // loops that skip items that are inactive in an earlier
                                            // loop
  // Devices: per source, whether the first items of CSR loops are in registers. The loops are then
  // written twice: for these items, and for the other items.
  const std::vector<char> items_;
  bool in_items_ = false;
  int32_t items_done_ = -1;            // the loop that is already written for these items
  std::vector<char> declared_, done_;  // per value: declared early; computed before its step
  std::vector<char> computed_;         // per value: whether the text already computes it
  std::vector<Value> chosen_;          // per SELECT that is not needed: the operand that it equals
  std::string out_;
  int32_t depth_ = 0, loop_ = -1;
  // rows that are already described, as (row, region, loop)
  std::set<std::tuple<Value, int32_t, int32_t>> looked_, looked_before_;
  bool tail_ = false;  // whether this is the last group, which may begin earlier
  bool quiet_ = false;
  bool probes_ = false;              // whether rows are loaded speculatively before the launches
  const Program* primal_ = nullptr;  // the primal of a scan that reads notes
};

}  // namespace nova::ir
