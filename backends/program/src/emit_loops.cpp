// The text of loops and conditional regions.
#include <algorithm>
#include <bit>
#include <cmath>

#include "emit_simplify.h"
#include "emitter.h"

namespace nova::ir {

bool Emitter::region_begin(int32_t number) {
  const Region& region = plan_.regions[at(number)];
  if (!region.printed) return false;
  const IdleItem* const idle = idle_item(loop_);
  const bool to_loop_end = idle && idle->region == number;
  if (to_loop_end) write_kept(loop_, false);
  for (const Value v : region.escape)
    line(text_.c_type(v) + " " + text_.name(v) + " = " + without(v, region) + ";");
  std::string question = text_.name(region.cond);
  if (text_.uniform(region.cond)) {
    line("if (" + std::string(region.polarity ? "" : "!") + question + ") {");
  } else {
    if (!region.polarity) question = "vnot(" + question + ")";
    if (in_csr_loop(loop_)) question = "vand(" + question + ", on" + str(loop_) + ")";
    question = "any(" + question + ")";
    // The compiler expects rare conditions to be false. Most items of a CSR loop are inactive, and
    // limits are rarely reached.
    const bool rare = !device_ && (in_csr_loop(loop_) || plan_.root[at(region.cond)] != kNone);
    line("if (" + (rare ? "rarely(" + question + ")" : question) + ") {");
  }
  ++depth_;
  prefetch_region(number);
  if (to_loop_end && scan_) line("acted |= 1;");
  if (to_loop_end) write_kept(loop_, true);
  for (const FollowedItem& f : followed_)
    if (f.earlier_region == number)
      line("if (r" + str(loop_) + " < 32) acting" + str(f.idle.loop) + " |= 1u << r" + str(loop_) +
           ";");
  return !to_loop_end;
}

bool Emitter::adds_nothing(const IdleItem& idle, size_t sum) const {
  const float term = idle.terms[sum];
  return term == 0.0f &&
         (std::signbit(term) || is_no_negative_zero(p_, p_.loops[at(idle.loop)].sums[sum].init));
}

bool Emitter::adds_nothing(const IdleItem& idle) const {
  for (size_t s = 0; s < idle.terms.size(); ++s)
    if (!adds_nothing(idle, s)) return false;
  return true;
}

bool Emitter::follows(const KeptValues& kept) const {
  const IdleItem *const earlier = idle_item(kept.earlier), *const later = idle_item(kept.loop);
  if (!earlier || !later) return false;
  const Region &a = plan_.regions[at(earlier->region)], &b = plan_.regions[at(later->region)];
  const bool same = std::any_of(kept.equal.begin(), kept.equal.end(), [&](const auto& pair) {
    return pair.first == b.cond && pair.second == a.cond;
  });
  return same && a.polarity == b.polarity && adds_nothing(*later);
}

const IdleItem* Emitter::idle_item(int32_t loop) const {
  for (const IdleItem& idle : idle_)
    if (idle.loop == loop) return &idle;
  return nullptr;
}

bool Emitter::adds_rows_only() const {
  constexpr size_t kMaxColumns = 4;
  return added_rows(p_).source >= 0 && p_.loops[0].sums.size() <= kMaxColumns;
}

void Emitter::sums_of_rows() {
  const auto rows = [&](int32_t source) {
    const std::string k = str(source);
    return "narrow(s" + k + ", n" + k + ", " + str(p_.sources[at(source)].width) + ", " + k + ")";
  };
  const auto [init, source] = added_rows(p_);
  line("return csr_sums(" + rows(init) + ", " + rows(source) +
       ", offsets0, items0, i, last, sink, out0);");
}

void Emitter::begin_sums(int32_t l) {
  const std::vector<Sum>& sums = p_.loops[at(l)].sums;
  for (size_t s = 0; s < sums.size(); ++s)
    line("vf sum" + str(l) + "_" + str(static_cast<int64_t>(s)) + " = " +
         text_.lanes(sums[s].init) + ";");
}

void Emitter::loop_begin(int32_t l) {
  loop_ = l;
  const std::string k = str(l);
  const Loop& loop = p_.loops[at(l)];
  const bool csr = loop.kind == LoopKind::Csr;
  if (csr && items_done_ == l) return device_items(l);
  begin_sums(l);
  if (csr && device_) {
    device_items(l);
  } else if (csr) {
    if (!scan_) csr_rows(l);
    kept_rows(l);
    const bool follower = std::any_of(kept_.begin(), kept_.end(), [&](const KeptValues& kept) {
      return kept.loop == l && !kept.kept.empty() && follows(kept);
    });
    if (follower) {
      line("if (!keep" + k + " || acting" + k + " != 0)");
      ++depth_;
    }
    item_begin(l);
    if (follower) {
      line("if (keep" + k + " && (acting" + k + " >> r" + k + " & 1) == 0) continue;");
      followers_.insert(l);
    }
    if (scan_) {
      for (const Value v : held_items(l))
        line("const " + text_.c_type(v) + " " + text_.name(v) + " = held" + str(v) + "[r" + k +
             "];");
    } else {
      slot(l);
    }
    for (const KeptValues& kept : kept_)
      if (kept.loop == l) read_kept(kept);
  } else {
    for (const FollowedItem& f : followed_)
      if (f.earlier == l)
        line("uint32_t acting" + str(f.idle.loop) + " = 0;  // a bit for each step");
    line("for (int32_t r" + k + " = 0; r" + k + " < extent" + k + "; ++r" + k + ") {");
    ++depth_;
    for (const FollowedItem& f : followed_)
      if (f.idle.loop == l)
        line("if (r" + k + " < 32 && (acting" + k + " >> r" + k + " & 1u) == 0) continue;");
  }
}

void Emitter::item_begin(int32_t l) {
  const std::string k = str(l);
  line("for (int32_t r" + k + " = 0; r" + k + " < csr" + k + ".longest; ++r" + k + ") {");
  ++depth_;
  line("const vb on" + k + " = csr_on(&csr" + k + ", r" + k + ");");
}

bool Emitter::is_slot(size_t v, int32_t l) const {
  return plan_.used[v] && p_.instrs[v].op == Op::SLOT && p_.instrs[v].a == l;
}

void Emitter::slot(int32_t l) {
  const std::string k = str(l);
  for (size_t v = 0; v < p_.instrs.size(); ++v) {
    if (!is_slot(v, l)) continue;
    line("const vi slot" + k + " = csr_slot(&csr" + k + ", items" + k + ", r" + k + ", on" + k +
         ");");
    break;
  }
}

void Emitter::csr_rows(int32_t l) {
  const std::string k = str(l);
  std::string begin = items_.empty() ? "csr_begin(offsets" + k + ", i)" : "kept.csr";
  for (const KeptValues& kept : kept_)
    if (kept.loop == l) begin = "same" + k + " ? csr" + str(kept.earlier) + " : " + begin;
  line("const csr_rows csr" + k + " = " + begin + ";");
}

void Emitter::kept_rows(int32_t l) {
  const std::string k = str(l);
  for (const KeptValues& kept : kept_) {
    if (kept.earlier != l) continue;
    const std::string later = str(kept.loop);
    line("const int keep" + later + " = same" + later + " && CAN_KEEP(csr" + k + ");");
    if (follows(kept) && !kept.kept.empty()) line("int acting" + later + " = 0;");
    for (const auto& [value, equal] : kept.kept)
      line(text_.c_type(value) + " kept" + str(value) + "[KEPT_ITEMS];");
  }
}

void Emitter::write_kept(int32_t l, bool acting) {
  for (const KeptValues& kept : kept_) {
    if (kept.earlier != l || kept.kept.empty() || follows(kept) != acting) continue;
    line("if (keep" + str(kept.loop) + ") {");
    ++depth_;
    if (acting) line("acting" + str(kept.loop) + " |= 1 << r" + str(l) + ";");
    for (const auto& [value, equal] : kept.kept)
      line("kept" + str(value) + "[r" + str(l) + "] = " + text_.name(equal) + ";");
    close();
  }
}

void Emitter::read_kept(const KeptValues& kept) {
  for (const auto& [value, equal] : kept.kept) {
    line(text_.c_type(value) + " " + text_.name(value) + ";");
    declared_[at(value)] = 1;
  }
  line("if (keep" + str(kept.loop) + ") {");
  ++depth_;
  for (const auto& [value, equal] : kept.kept)
    line(text_.name(value) + " = kept" + str(value) + "[r" + str(kept.loop) + "];");
  --depth_;
  line("} else {");
  ++depth_;
  const auto in_sight = looked_;
  for (const auto& [value, equal] : kept.equal) {
    compute(value);
    done_[at(value)] = 1;
  }
  looked_ = in_sight;
  close();
}

void Emitter::loop_end(int32_t l) {
  const std::string k = str(l);
  const Loop& loop = p_.loops[at(l)];
  const IdleItem* const idle = idle_item(l);
  if (!idle) write_kept(l, false);
  const auto add = [&](size_t s, const std::string& term) {
    const std::string sum = "sum" + k + "_" + str(static_cast<int64_t>(s));
    const std::string added = sum + " + " + term;
    line(
        sum + " = " +
        (loop.kind == LoopKind::Csr ? "vselectf(on" + k + ", " + added + ", " + sum + ")" : added) +
        ";");
  };
  for (size_t s = 0; s < loop.sums.size(); ++s) add(s, text_.name(loop.sums[s].term));
  if (idle) {
    bool opened = false;
    for (size_t s = 0; s < loop.sums.size(); ++s) {
      if (adds_nothing(*idle, s)) continue;
      if (!opened) {
        --depth_;
        line("} else {");
        ++depth_;
        opened = true;
      }
      add(s,
          "splatf(" + text_.literal({Op::CONST_F, std::bit_cast<int32_t>(idle->terms[s])}) + ")");
    }
    close();
  }
  close();
  if (followers_.count(l) != 0) --depth_;
  if (loop.kind == LoopKind::Csr && in_batches(l)) close();
  loop_ = -1;
}

}  // namespace nova::ir
