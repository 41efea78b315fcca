#include "cluster/blocks.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "cluster/parts.h"
#include "persistent_memory.h"

namespace novaphy::gpu {
namespace {

constexpr int32_t kItemWords = 4;      // words of an item in the memory of a block
constexpr int32_t kMostOutput = 24;    // largest row of items that a maker computes, in words
constexpr int32_t kLongSum = 256;      // most items of a sum that is computed from block memory
constexpr uint32_t kRowsOfWarp = 8;    // rows per warp of sums; few lanes wait for few lines
constexpr uint32_t kMostSumWarps = 2;  // warps of sums per block, unless more are needed
constexpr size_t kMostLayouts = 8;
// At most 8 computed rows for 5 rows. More redundant work would cost more than an exchange.
constexpr size_t kMostComputed = 8, kOfRows = 5;

struct Table {
  std::vector<int32_t> offsets, items;
};
// A sum whose items an operation of the previous phase (the maker) computes.
struct Link {
  size_t sum, maker;  // indices of operations
  size_t output;      // output of the maker
  int32_t width, corners;
  const Table* table;
};

class Planner {
 public:
  Planner(std::span<const novaphy_persistent_op> ops, uint32_t blocks, uint32_t most_warps,
          const ReadWords& read)
      : ops_(ops), blocks_(blocks), most_warps_(most_warps), read_(read), phases_(phases_of(ops)) {}

  std::optional<BlockPlan> run() {
    links_.resize(phases_.size());
    std::optional<int64_t> rows;  // number of rows, the same for all sums
    for (size_t k = 0; k + 1 < phases_.size(); ++k) {
      if (k > 0 && !links_[k - 1].empty()) continue;
      links_[k] = links_between(phases_[k], phases_[k + 1]);
      if (links_[k].empty()) continue;
      const int64_t here = ops_[links_[k][0].sum].rows;
      if (rows.value_or(here) != here) return std::nullopt;
      rows = here;
    }
    if (!rows || !nobody_else_needs_items()) return std::nullopt;
    make_parts(static_cast<size_t>(*rows));
    plan_.operations.resize(ops_.size());
    plan_.phases.resize(phases_.size());
    for (size_t k = 0; k < phases_.size(); ++k)
      if (!links_[k].empty() && !lay_out_makers(k)) return std::nullopt;
    if (!place_warps()) return std::nullopt;
    for (size_t k = 0; k < phases_.size(); ++k) {
      if (!fill_layout(k)) return std::nullopt;
      if (!links_[k].empty()) link_operations(k);
    }
    if (!items_have_one_place()) return std::nullopt;
    keep_last_items();
    return std::move(plan_);
  }

 private:
  using Shares = std::vector<std::vector<RowList>>;  // the rows of a chain in each block
  using Key = std::vector<uint64_t>;

  uint32_t chains_of(const PhaseSpan& phase) const { return ops_[phase.last - 1].chain + 1; }

  std::vector<Link> links_between(const PhaseSpan& makers, const PhaseSpan& sums) {
    struct Made {
      size_t op, output;
    };
    std::map<uint64_t, Made> made;
    Pieces written;
    for (size_t k = makers.first; k < makers.last; ++k)
      for_each_written(ops_[k], [&](uint64_t begin, uint64_t bytes, size_t output) {
        made[begin] = {k, output};
        written.add(begin, bytes);
      });
    // A row that two blocks compute must not read its own result.
    bool fits = true;
    for (size_t k = makers.first; k < makers.last; ++k)
      for_each_read(ops_[k], [&](uint64_t begin, uint64_t bytes, int32_t) {
        fits = fits && !written.touch(begin, bytes);
      });
    std::vector<Link> links;
    for (size_t k = sums.first; k < sums.last && fits; ++k) {
      const novaphy_persistent_op& o = ops_[k];
      const CsrSum sum = csr_sum(o);
      const auto from = sum.is_there() ? made.find(o.op.arguments[sum.source]) : made.end();
      for_each_read(o, [&](uint64_t begin, uint64_t bytes, int32_t word) {
        const bool is_items = from != made.end() && word == sum.source;
        fits = fits && (is_items || !written.touch(begin, bytes));
      });
      if (from == made.end() || !fits) continue;
      const auto& [maker, output] = from->second;
      fits = add_link(links, {k, maker, output, sum.width, 0, nullptr}, sum);
    }
    if (!fits || !alone_on_tables(sums, links)) links.clear();
    return links;
  }
  // A chain loads the items of a table once, so all its sums need the same items.
  bool alone_on_tables(const PhaseSpan& sums, const std::vector<Link>& links) const {
    std::map<uint64_t, size_t> linked, all;  // uses, by the address of the offsets
    std::map<uint64_t, std::pair<uint32_t, int32_t>> makers;
    for (const Link& link : links) {
      const novaphy_persistent_op& o = ops_[link.sum];
      const uint64_t offsets = o.op.arguments[csr_sum(o).offsets];
      ++linked[offsets];
      // The position of an item depends on the thread that computes the item.
      const std::pair maker{ops_[link.maker].chain, link.corners};
      if (makers.try_emplace(offsets, maker).first->second != maker) return false;
    }
    for (size_t k = sums.first; k < sums.last; ++k)
      for_each_table(ops_[k], [&](uint64_t offsets) { ++all[offsets]; });
    return std::all_of(linked.begin(), linked.end(),
                       [&](const auto& table) { return all[table.first] == table.second; });
  }
  bool add_link(std::vector<Link>& links, Link link, const CsrSum& sum) {
    const novaphy_persistent_op &o = ops_[link.sum], &maker = ops_[link.maker];
    if (maker.op.kernel == nullptr || is_builtin(maker)) return false;
    const auto words =
        static_cast<int32_t>(maker.op.kernel->program.outputs[link.output].values.size());
    if (link.width > kItemWords || words % link.width != 0 || words > kMostOutput ||
        maker.n != maker.rows || o.n != o.rows)
      return false;
    if (!links.empty() && ops_[links[0].sum].rows != o.rows) return false;
    link.corners = words / link.width;
    for (const Link& other : links)
      if (other.maker == link.maker && other.output == link.output && other.width != link.width)
        return false;
    link.table = table_of(o, sum, maker.n * link.corners);
    links.push_back(link);
    return link.table != nullptr;
  }

  // Returns null if an item is missing or a sum is longer than kLongSum.
  const Table* table_of(const novaphy_persistent_op& o, const CsrSum& sum, int64_t item_count) {
    const uint64_t offsets = o.op.arguments[sum.offsets], items = o.op.arguments[sum.offsets + 1];
    const auto [known, fresh] = tables_.try_emplace({offsets, items, o.n});
    Table& table = known->second;
    if (fresh) {
      table.offsets = read_(offsets, static_cast<size_t>(o.n) + 1);
      if (!are_short(table.offsets)) return nullptr;
      const auto count = static_cast<size_t>(table.offsets.back());
      if (items != 0) {
        table.items = read_(items, count);
      } else {
        table.items.resize(count);
        std::iota(table.items.begin(), table.items.end(), 0);
      }
      if (table.items.size() != count) table.offsets.clear();
    }
    if (!are_short(table.offsets)) return nullptr;
    const auto is_item = [&](int32_t k) { return k >= 0 && k < item_count; };
    return std::all_of(table.items.begin(), table.items.end(), is_item) ? &table : nullptr;
  }

  static bool are_short(const std::vector<int32_t>& offsets) {
    if (offsets.empty() || offsets[0] != 0) return false;
    for (size_t r = 0; r + 1 < offsets.size(); ++r)
      if (offsets[r + 1] < offsets[r] || offsets[r + 1] - offsets[r] > kLongSum) return false;
    return true;
  }

  // Returns whether only makers and sums access the items of a phase.
  bool nobody_else_needs_items() {
    Pieces items;
    std::vector<std::vector<size_t>> made(ops_.size());
    std::vector<char> sums(ops_.size(), 0);
    for (const std::vector<Link>& links : links_)
      for (const Link& link : links) {
        sums[link.sum] = 1;
        made[link.maker].push_back(link.output);
        for_each_written(ops_[link.maker], [&](uint64_t begin, uint64_t bytes, size_t output) {
          if (output == link.output) items.add(begin, bytes);
        });
      }
    bool alone = true;
    for (size_t k = 0; k < ops_.size() && alone; ++k) {
      const CsrSum sum = sums[k] != 0 ? csr_sum(ops_[k]) : CsrSum{};
      for_each_read(ops_[k], [&](uint64_t begin, uint64_t bytes, int32_t word) {
        alone = alone && ((sum.is_there() && word == sum.source) || !items.touch(begin, bytes));
      });
      for_each_written(ops_[k], [&](uint64_t begin, uint64_t bytes, size_t output) {
        const bool is_made = std::find(made[k].begin(), made[k].end(), output) != made[k].end();
        alone = alone && (is_made || !items.touch(begin, bytes));
      });
    }
    return alone;
  }

  // Assigns the rows of sums to blocks.
  void make_parts(size_t n) {
    const auto pair = std::find_if(links_.begin(), links_.end(),
                                   [](const std::vector<Link>& links) { return !links.empty(); });
    std::map<uint32_t, uint32_t> first_of_chain;  // the first index of each chain among all makers
    uint32_t makers = 0;
    std::vector<RowList> needs(n);
    for (const Link& link : *pair) {
      const novaphy_persistent_op& maker = ops_[link.maker];
      const auto [chain, fresh] = first_of_chain.try_emplace(maker.chain, makers);
      if (fresh) makers += static_cast<uint32_t>(maker.n);
      for_each_item(link, [&](size_t row, int32_t, uint32_t of_maker, uint32_t) {
        needs[row].push_back(chain->second + of_maker);
      });
    }
    part_ = parts_of(std::move(needs), makers, blocks_);
  }

  // Calls f(row, position in the table, row of the maker, corner) for each item.
  template <class F>
  static void for_each_item(const Link& link, const F& f) {
    const auto corners = static_cast<uint32_t>(link.corners);
    for (size_t row = 0; row + 1 < link.table->offsets.size(); ++row)
      for (int32_t k = link.table->offsets[row]; k < link.table->offsets[row + 1]; ++k) {
        const auto item = static_cast<uint32_t>(link.table->items[static_cast<size_t>(k)]);
        f(row, k, item / corners, item % corners);
      }
  }

  Key makers_key(size_t k) const {
    Key key = {0};
    for (size_t o = phases_[k].first; o < phases_[k].last; ++o)
      key.insert(key.end(), {ops_[o].chain, static_cast<uint64_t>(ops_[o].rows)});
    for (const Link& link : links_[k])
      key.insert(key.end(), {ops_[link.maker].chain, address(link.table),
                             static_cast<uint64_t>(link.corners)});
    return key;
  }
  // Returns false if too many rows would be computed more than once.
  bool lay_out_makers(size_t k) {
    const auto [known, fresh] = shares_.try_emplace(makers_key(k));
    if (!fresh) return true;
    Shares& shares = known->second;
    shares.resize(chains_of(phases_[k]), std::vector<RowList>(blocks_));
    for (const Link& link : links_[k]) {
      corners_ = std::max(corners_, static_cast<uint32_t>(link.corners));
      auto& rows = shares[ops_[link.maker].chain];
      for_each_item(link, [&](size_t row, int32_t, uint32_t of_maker, uint32_t) {
        rows[part_[row]].push_back(of_maker);
      });
    }
    for (size_t o = phases_[k].first; o < phases_[k].last; ++o) {
      auto& rows = shares[ops_[o].chain];
      std::vector<char> there(static_cast<size_t>(ops_[o].rows), 0);
      for (RowList& of_block : rows) {
        std::sort(of_block.begin(), of_block.end());
        of_block.erase(std::unique(of_block.begin(), of_block.end()), of_block.end());
        for (const uint32_t row : of_block) there[row] = 1;
      }
      // Rows whose items no sum needs are computed too.
      for (uint32_t row = 0; row < there.size(); ++row)
        if (there[row] == 0) rows[uint64_t{row} * blocks_ / there.size()].push_back(row);
    }
    const std::vector<char> makes = makers(k);
    uint32_t warps = 0;
    size_t computed = 0, rows = 0;
    for (size_t c = 0; c < shares.size(); ++c) {
      if (makes[c] != 0) warps += rounded_up(most(shares[c]), kWarp);
      for (const RowList& of_block : shares[c]) computed += of_block.size();
    }
    for (size_t o = phases_[k].first; o < phases_[k].last; ++o)
      if (o == phases_[k].first || ops_[o].chain != ops_[o - 1].chain)
        rows += static_cast<size_t>(ops_[o].rows);
    maker_warps_ = std::max(maker_warps_, warps);
    return kOfRows * computed <= kMostComputed * rows;
  }

  // Returns which chains of a phase make items.
  std::vector<char> makers(size_t k) const {
    std::vector<char> makes(chains_of(phases_[k]), 0);
    for (const Link& link : links_[k]) makes[ops_[link.maker].chain] = 1;
    return makes;
  }

  static uint32_t rounded_up(uint32_t a, uint32_t b) { return (a + b - 1) / b; }
  static uint32_t most(const std::vector<RowList>& rows) {
    size_t most = 0;
    for (const RowList& of_block : rows) most = std::max(most, of_block.size());
    return static_cast<uint32_t>(most);
  }

  // The first warps of a block are makers, the others sum. The two work at different times.
  bool place_warps() {
    std::vector<uint32_t> of_part(blocks_, 0);
    for (const uint32_t part : part_) ++of_part[part];
    const uint32_t rows = *std::max_element(of_part.begin(), of_part.end());
    sum_warps_ =
        std::max(rounded_up(rows, kWarp), std::min(rounded_up(rows, kRowsOfWarp), kMostSumWarps));
    for (size_t k = 1; k < phases_.size(); ++k)
      if (!links_[k - 1].empty())
        sum_warps_ = std::max(sum_warps_, chains_of(phases_[k]) * rounded_up(rows, kWarp));
    plan_.corners = corners_;
    if (maker_warps_ + sum_warps_ > most_warps_) return false;
    plan_.maker_warps = maker_warps_;
    plan_.threads = (maker_warps_ + sum_warps_) * kWarp;
    return true;
  }

  // Distributes rows that any block may compute.
  Shares spread(const PhaseSpan& phase) const {
    Shares shares(chains_of(phase), std::vector<RowList>(blocks_));
    for (size_t o = phase.first; o < phase.last; ++o) {
      auto& rows = shares[ops_[o].chain];
      if (o > phase.first && ops_[o].chain == ops_[o - 1].chain) continue;
      const auto n = static_cast<uint32_t>(ops_[o].rows);
      for (uint32_t row = 0; row < n; ++row)
        rows[n == part_.size() ? part_[row] : uint64_t{row} * blocks_ / n].push_back(row);
    }
    return shares;
  }

  // Assigns warps and rows to the chains of a phase.
  bool fill_layout(size_t k) {
    const bool makes = !links_[k].empty();
    const bool adds = k > 0 && !links_[k - 1].empty();
    plan_.phases[k].makes_items = makes;
    plan_.phases[k].sums_items = adds;
    Key key = makes ? makers_key(k) : Key{adds ? uint64_t{2} : uint64_t{1}};
    if (!makes)
      for (size_t o = phases_[k].first; o < phases_[k].last; ++o)
        key.insert(key.end(), {ops_[o].chain, static_cast<uint64_t>(ops_[o].rows)});
    const auto [known, fresh] = layout_of_.try_emplace(std::move(key));
    if (fresh) {
      const Shares spread_rows = makes ? Shares{} : spread(phases_[k]);
      const Shares& rows = makes ? shares_.at(makers_key(k)) : spread_rows;
      if (!make_layout(rows, makers(k), adds, known->second)) return false;
    }
    plan_.phases[k].layout = known->second.layout;
    plan_.phases[k].chains = known->second.chains;
    return true;
  }
  struct Layout {
    uint32_t layout = 0;
    std::vector<BlockPlan::Chain> chains;
  };
  bool make_layout(const Shares& rows, const std::vector<char>& makes, bool adds, Layout& made) {
    std::vector<uint32_t> warps;
    for (const std::vector<RowList>& of_chain : rows)
      warps.push_back(rounded_up(most(of_chain), kWarp));
    // Counts the warps of the chains that make no items.
    const auto others = [&] {
      uint32_t sum = 0;
      for (size_t c = 0; c < warps.size(); ++c) sum += makes[c] == 0 ? warps[c] : 0;
      return sum;
    };
    uint32_t maker = 0, other = maker_warps_, room = sum_warps_;
    const bool any_warp = !adds && others() == std::accumulate(warps.begin(), warps.end(), 0u);
    if (others() > room && any_warp) {
      other = 0;
      room += maker_warps_;
    }
    if (others() > room || plan_.layouts.size() == kMostLayouts) return false;
    // Warps that are left over are distributed, so that each warp takes fewer rows.
    for (bool more = true; more;) {
      more = false;
      for (size_t c = 0; c < warps.size(); ++c)
        if (makes[c] == 0 && others() < room && warps[c] < most(rows[c])) {
          ++warps[c];
          more = true;
        }
    }
    std::vector<uint32_t>& words = plan_.layouts.emplace_back(size_t{blocks_} * plan_.threads, 0);
    made.layout = static_cast<uint32_t>(plan_.layouts.size() - 1);
    for (size_t c = 0; c < rows.size(); ++c) {
      uint32_t& next = makes[c] != 0 ? maker : other;
      const uint32_t first = std::exchange(next, next + warps[c]);
      made.chains.push_back({first, warps[c], true});
      std::vector<char> owned;
      for (uint32_t block = 0; block < blocks_; ++block) {
        const RowList& own = rows[c][block];
        for (size_t at = 0; at < own.size(); ++at) {
          if (own[at] >= owned.size()) owned.resize(own[at] + 1, 0);
          const uint32_t owns = owned[own[at]] == 0 ? BlockPlan::kOwns : 0;
          owned[own[at]] = 1;
          words[thread_of(block, first, warps[c], own.size(), at)] =
              own[at] | BlockPlan::kOn | owns;
        }
        for (uint32_t w = first; w < first + warps[c]; ++w)
          go_along(words.data() + size_t{block} * plan_.threads + size_t{w} * kWarp);
      }
    }
    return true;
  }
  // Returns the thread of row `at` among the rows of a block. The warps share the rows evenly.
  size_t thread_of(uint32_t block, uint32_t first, uint32_t warps, size_t rows, size_t at) const {
    const size_t each = (rows + warps - 1) / warps;
    return size_t{block} * plan_.threads + (first + at / each) * kWarp + at % each;
  }
  // A lane without a row repeats a row of its warp.
  static void go_along(uint32_t* words) {
    for (uint32_t k = 0; k < kWarp; ++k)
      if (words[k] == 0) words[k] = words[0] & ~(BlockPlan::kOn | BlockPlan::kOwns);
  }

  // Finds where the makers of a phase store items, and where the sums find the items.
  void link_operations(size_t k) {
    const BlockPlan::Phase& phase = plan_.phases[k];
    const uint32_t rows_of_array = plan_.threads * corners_ + 1;  // plus one row of zeros
    std::map<uint32_t, uint32_t> arrays;                          // number of arrays per chain
    std::map<std::pair<size_t, size_t>, uint32_t> base;
    for (const Link& link : links_[k]) {
      const auto [at, fresh] = base.try_emplace({link.maker, link.output});
      if (fresh) at->second = arrays[ops_[link.maker].chain]++ * rows_of_array;
      plan_.item_rows = std::max(plan_.item_rows, at->second + rows_of_array);
      plan_.operations[link.maker].outputs[link.output] = {at->second, link.width};
      plan_.operations[link.sum].sum =
          BlockPlan::Sum{at->second, items_of(link, phase), longest(*link.table)};
    }
    for (BlockPlan::Chain& chain : plan_.phases[k].chains) chain.stores = false;
    for (size_t o = phases_[k].first; o < phases_[k].last; ++o)
      for_each_written(ops_[o], [&](uint64_t, uint64_t, size_t output) {
        if (!plan_.operations[o].outputs.contains(output))
          plan_.phases[k].chains[ops_[o].chain].stores = true;
      });
  }
  static int32_t longest(const Table& table) {
    int32_t most = 0;
    for (size_t row = 0; row + 1 < table.offsets.size(); ++row)
      most = std::max(most, table.offsets[row + 1] - table.offsets[row]);
    return most;
  }
  uint32_t items_of(const Link& link, const BlockPlan::Phase& makers) {
    const uint32_t chain = ops_[link.maker].chain, layout = makers.layout;
    const auto [known, fresh] = items_.try_emplace(
        {address(link.table), layout, chain, static_cast<uint64_t>(link.corners)},
        static_cast<uint32_t>(plan_.items.size()));
    if (!fresh) return known->second;
    const BlockPlan::Chain& warps = makers.chains[chain];
    // The thread of each row, in each block that computes the row.
    std::vector<std::map<uint32_t, uint32_t>> thread(blocks_);
    for (uint32_t block = 0; block < blocks_; ++block)
      for (uint32_t k = 0; k < warps.warps * kWarp; ++k) {
        const uint32_t t = warps.first_warp * kWarp + k;
        const uint32_t word = plan_.layouts[layout][size_t{block} * plan_.threads + t];
        if ((word & BlockPlan::kOn) != 0)
          thread[block][word & ~(BlockPlan::kOn | BlockPlan::kOwns)] = t;
      }
    std::vector<int32_t>& items = plan_.items.emplace_back(link.table->items.size(), 0);
    for_each_item(link, [&](size_t row, int32_t k, uint32_t of_maker, uint32_t corner) {
      items[static_cast<size_t>(k)] =
          static_cast<int32_t>(thread[part_[row]].at(of_maker) * corners_ + corner);
    });
    return known->second;
  }

  // Returns whether an item is always stored by the same thread, so that stores stay in order.
  bool items_have_one_place() {
    struct Place {
      BlockPlan::Chain warps;
      uint32_t layout;
      uint64_t bytes;
    };
    std::map<uint64_t, Place> places;
    bool one = true;
    for (size_t k = 0; k < phases_.size(); ++k)
      for (size_t o = phases_[k].first; o < phases_[k].last; ++o)
        for_each_written(ops_[o], [&](uint64_t begin, uint64_t bytes, size_t output) {
          if (!plan_.operations[o].outputs.contains(output)) return;
          const BlockPlan::Phase& phase = plan_.phases[k];
          const Place here{phase.chains[ops_[o].chain], phase.layout, bytes};
          const Place& known = places.try_emplace(begin, here).first->second;
          one = one && known.bytes == bytes &&
                same_rows(known.layout, known.warps, here.layout, here.warps);
        });
    uint64_t end = 0;
    for (const auto& [begin, place] : places) {
      one = one && begin >= end;
      end = begin + place.bytes;
    }
    return one;
  }
  // Only the last maker of an item stores it to global memory. Sums read items from block memory.
  void keep_last_items() {
    std::map<uint64_t, size_t> last;
    const auto each = [&](const auto& f) {
      for (size_t k = 0; k < phases_.size(); ++k)
        for (size_t o = phases_[k].first; o < phases_[k].last; ++o)
          for_each_written(ops_[o], [&](uint64_t begin, uint64_t, size_t output) {
            if (plan_.operations[o].outputs.contains(output)) f(k, o, begin);
          });
    };
    each([&](size_t, size_t o, uint64_t begin) { last[begin] = o; });
    each([&](size_t k, size_t o, uint64_t begin) {
      if (last[begin] == o) plan_.phases[k].chains[ops_[o].chain].keeps = true;
    });
  }
  bool same_rows(uint32_t a, const BlockPlan::Chain& a_warps, uint32_t b,
                 const BlockPlan::Chain& b_warps) {
    if (a_warps.first_warp != b_warps.first_warp || a_warps.warps != b_warps.warps) return false;
    if (a == b) return true;
    const auto [known, fresh] = same_.try_emplace({a, b, a_warps.first_warp}, true);
    for (uint32_t k = 0; fresh && k < blocks_ * a_warps.warps; ++k) {
      const uint32_t warp = a_warps.first_warp + k % a_warps.warps;
      const size_t first = size_t{k / a_warps.warps} * plan_.threads + size_t{warp} * kWarp;
      const auto of_a = plan_.layouts[a].begin() + static_cast<std::ptrdiff_t>(first);
      known->second = known->second &&
                      std::equal(of_a, of_a + kWarp,
                                 plan_.layouts[b].begin() + static_cast<std::ptrdiff_t>(first));
    }
    return known->second;
  }

  const std::span<const novaphy_persistent_op> ops_;
  const uint32_t blocks_, most_warps_;
  const ReadWords& read_;
  const std::vector<PhaseSpan> phases_;
  std::vector<std::vector<Link>> links_;  // from the items of a phase to the sums of the next phase
  std::map<std::tuple<uint64_t, uint64_t, int64_t>, Table> tables_;
  std::vector<uint32_t> part_;  // the block of each row of the sums
  std::map<Key, Shares> shares_;
  std::map<Key, Layout> layout_of_;
  std::map<std::tuple<uint64_t, uint32_t, uint32_t, uint64_t>, uint32_t> items_;
  std::map<std::tuple<uint32_t, uint32_t, uint32_t>, bool> same_;  // keyed by layouts and chain
  uint32_t maker_warps_ = 0, sum_warps_ = 0, corners_ = 0;
  BlockPlan plan_;
};

}  // namespace

std::optional<BlockPlan> plan_blocks(std::span<const novaphy_persistent_op> ops, uint32_t blocks,
                                     uint32_t most_warps, const ReadWords& read) {
  return Planner(ops, blocks, most_warps, read).run();
}

}  // namespace novaphy::gpu
