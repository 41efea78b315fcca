#include "phases.h"

#include <algorithm>
#include <map>
#include <optional>
#include <utility>

#include "fusion.h"
#include "intervals.h"

namespace nova::detail {

namespace {

// Largest number of rows of an operation per row of its chain. More rows would leave threads idle.
constexpr int64_t kMaxRowsEach = 8;
// Limits of the argument words and chains that a device caches for a phase.
constexpr size_t kMaxWords = 448, kMaxChains = 24;

class PhasePlanner {
 public:
  PhasePlanner(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
               std::span<const MemoryAccess> accesses)
      : ops_(ops), words_(words), accesses_(accesses) {}

  std::vector<Phased> plan() {
    std::vector<uint32_t> chain_of;
    for (uint32_t k = 0; k < ops_.size(); ++k) chain_of.push_back(place(k));
    std::vector<Phased> placed;
    for (uint32_t k = 0; k < ops_.size(); ++k) {
      const uint32_t chain = root(chain_of[k]);
      placed.push_back({k, chains_[chain].phase, chain, chains_[chain].rows});
    }
    std::stable_sort(placed.begin(), placed.end(), [](const Phased& a, const Phased& b) {
      return std::pair(a.phase, a.chain) < std::pair(b.phase, b.chain);
    });
    uint32_t number = 0, phase = 0, chain = 0;
    for (size_t k = 0; k < placed.size(); ++k) {
      Phased& p = placed[k];
      number = k == 0 || p.phase != phase ? 0 : number + (p.chain != chain ? 1 : 0);
      phase = p.phase;
      chain = std::exchange(p.chain, number);
    }
    return placed;
  }

 private:
  struct Chain {
    uint32_t phase = 0, joined = 0;  // index of itself, or of the chain that absorbed it
    int64_t rows = 0, most = 0;      // largest number of rows of one operation
  };
  struct Phase {
    size_t words = 0, chains = 0;
  };
  struct User {
    uint32_t chain = 0;
    bool own = false;  // accesses only its own row
  };
  // Memory that operations accessed: the last write, and the reads in the last phase with reads.
  struct Interval {
    uint64_t end = 0;
    std::optional<User> writer;
    std::vector<User> readers;
  };
  // An operation that must run before the operation that is being placed.
  struct Before {
    uint32_t chain = 0;
    bool own = false;  // only row i of it must run before row i of the placed operation
  };

  uint32_t root(uint32_t chain) const {
    while (chains_[chain].joined != chain) chain = chains_[chain].joined;
    return chain;
  }
  uint32_t phase_of(uint32_t chain) const { return chains_[root(chain)].phase; }

  void find_before(const MemoryAccess& access, std::vector<Before>& before) {
    if (access.bytes == 0) return;
    const uint64_t end = access.begin + access.bytes;
    for (auto at = first_from(intervals_, access.begin); at != intervals_.end() && at->first < end;
         ++at) {
      const bool own = access.row_bytes != 0 && at->first == access.begin && at->second.end == end;
      if (at->second.writer)
        before.push_back({at->second.writer->chain, own && at->second.writer->own});
      if (!access.write) continue;
      for (const User& user : at->second.readers) before.push_back({user.chain, own && user.own});
    }
  }

  void add(const MemoryAccess& access, uint32_t chain) {
    if (access.bytes == 0) return;
    const uint64_t end = access.begin + access.bytes;
    const User user{chain, access.row_bytes != 0};
    auto at = first_from(intervals_, access.begin);
    if (at == intervals_.end() || at->first >= end) {
      at = intervals_.emplace(access.begin, Interval{end, {}, {}}).first;
    } else if (at->first != access.begin || at->second.end != end) {
      return merge(at, access, chain);
    }
    if (access.write) {
      at->second.writer = user;
      at->second.readers.clear();
    } else {
      add_reader(at->second, user);
    }
  }
  // Merges intervals for an access through another view of the same bytes. The next operation that
  // accesses the bytes then comes after all earlier operations that accessed them.
  void merge(std::map<uint64_t, Interval>::iterator at, const MemoryAccess& access,
             uint32_t chain) {
    uint64_t begin = access.begin, end = access.begin + access.bytes;
    User last{chain};
    const auto see = [&](const User& user) {
      if (phase_of(user.chain) > phase_of(last.chain)) last.chain = user.chain;
    };
    while (at != intervals_.end() && at->first < end) {
      begin = std::min(begin, at->first);
      end = std::max(end, at->second.end);
      if (at->second.writer) see(*at->second.writer);
      for (const User& reader : at->second.readers) see(reader);
      at = intervals_.erase(at);
    }
    intervals_[begin] = {.end = end, .writer = last, .readers = {}};
  }
  void add_reader(Interval& interval, const User& user) const {
    const uint32_t phase = phase_of(user.chain);
    if (!interval.readers.empty()) {
      const uint32_t known = phase_of(interval.readers.front().chain);
      if (phase < known) return;
      if (phase > known) interval.readers.clear();
    }
    for (User& other : interval.readers)
      if (root(other.chain) == root(user.chain)) {
        other.own = other.own && user.own;
        return;
      }
    interval.readers.push_back(user);
  }

  // If an operation accesses memory in two ways, the memory counts as accessed at any row.
  void forget_rows_of_mixed_access() {
    const auto mixed = [](const MemoryAccess& a, const MemoryAccess& b) {
      return share_bytes(a, b) && (b.row_bytes == 0 || a.begin != b.begin || a.bytes != b.bytes);
    };
    for (MemoryAccess& a : touched_)
      for (const MemoryAccess& b : touched_)
        if (mixed(a, b)) a.row_bytes = 0;
  }

  // Returns the chain for operation k, after the operations placed so far.
  uint32_t place(uint32_t k) {
    touched_.clear();
    before_.clear();
    touched_by(ops_[k], words_, accesses_, touched_);
    forget_rows_of_mixed_access();
    for (const MemoryAccess& access : touched_) find_before(access, before_);
    uint32_t phase = 0;
    for (const Before& b : before_) phase = std::max(phase, phase_of(b.chain));
    const int64_t rows = rows_of(ops_[k]);
    std::vector<uint32_t> with;
    bool joins = true;
    for (const Before& b : before_) {
      if (phase_of(b.chain) != phase) continue;
      joins = joins && b.own;
      if (std::find(with.begin(), with.end(), root(b.chain)) == with.end())
        with.push_back(root(b.chain));
    }
    const size_t words = 2 + ops_[k].word_count;
    if (joins && !with.empty() && fits(phase, words, false)) {
      if (const auto chain = join(with, rows)) return settle(phase, *chain, words);
    }
    if (!with.empty()) ++phase;
    while (!fits(phase, words, true)) ++phase;
    chains_.push_back({phase, static_cast<uint32_t>(chains_.size()), rows, rows});
    ++phases_[phase].chains;
    return settle(phase, static_cast<uint32_t>(chains_.size() - 1), words);
  }
  bool fits(uint32_t phase, size_t words, bool new_chain) {
    if (phases_.size() <= phase) phases_.resize(phase + 1);
    const Phase& p = phases_[phase];
    return p.words == 0 || (p.words + words <= kMaxWords && p.chains + new_chain <= kMaxChains);
  }
  uint32_t settle(uint32_t phase, uint32_t chain, size_t words) {
    phases_[phase].words += words;
    for (const MemoryAccess& access : touched_) add(access, chain);
    return chain;
  }
  // Merges several chains into one that also has an operation over `rows` rows.
  std::optional<uint32_t> join(const std::vector<uint32_t>& with, int64_t rows) {
    int64_t fewest = rows, most = rows;
    for (const uint32_t c : with) {
      fewest = std::min(fewest, chains_[c].rows);
      most = std::max(most, chains_[c].most);
    }
    if (fewest < 1 || rows % fewest != 0 || most / fewest > kMaxRowsEach) return std::nullopt;
    for (const uint32_t c : with)
      if (chains_[c].rows % fewest != 0) return std::nullopt;
    const uint32_t chain = *std::min_element(with.begin(), with.end());
    for (const uint32_t c : with) chains_[c].joined = chain;
    chains_[chain].rows = fewest;
    chains_[chain].most = most;
    return chain;
  }

  std::span<const OpList::Op> ops_;
  std::span<const uint64_t> words_;
  std::span<const MemoryAccess> accesses_;
  std::vector<Chain> chains_;
  std::vector<Phase> phases_;
  std::map<uint64_t, Interval> intervals_;
  std::vector<MemoryAccess> touched_;  // accesses of the operation under inspection
  std::vector<Before> before_;
};

}  // namespace

std::vector<Phased> plan_phases(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                                std::span<const MemoryAccess> accesses) {
  return PhasePlanner(ops, words, accesses).plan();
}

}  // namespace nova::detail
