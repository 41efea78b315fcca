// Compiled once for each instruction set (dynamics/CMakeLists.txt).
#include "lane_islands.h"

#include "lane_step.h"
#include "lanes.h"
#include "novaphy/dynamics/articulation/rubbing.h"

namespace novaphy::articulation::NOVAPHY_LEVEL {

int64_t islands_memory(const LaneIslands& a);
void sweep_islands(const LaneIslands& a);

namespace {

constexpr int32_t kNumbers = sizeof(PgsNumbers<float>) / sizeof(float);
static_assert(sizeof(PgsNumbers<Lanes>) == kNumbers * sizeof(Lanes));

// Reads n numbers of each island. Lanes without an island repeat the last one.
template <class Row>
void gather(int32_t count, int32_t n, const Row& row, Lanes* to) {
  auto* const out = reinterpret_cast<float*>(to);
  for (int32_t l = 0; l < LANES; ++l) {
    const float* const from = row(l < count ? l : count - 1);
    for (int32_t i = 0; i < n; ++i) out[i * LANES + l] = from[i];
  }
}

// Points to the rates of each tree, and to the contacts.
struct Islands {
  const LaneIslands& a;
  PgsContact<Lanes>* contacts;
  Lanes* next;  // free memory
  Mask in_use;

  explicit Islands(const LaneIslands& of)
      : a(of),
        contacts(static_cast<PgsContact<Lanes>*>(of.memory)),
        next(reinterpret_cast<Lanes*>(contacts + of.rows)) {
    Lanes lane;
    for (int32_t l = 0; l < LANES; ++l) lane.v[l] = static_cast<float>(l);
    in_use = lane < Lanes(static_cast<float>(a.count));
    Lanes* const rates = next;
    for (int32_t t = 0; t < a.trees; ++t) {
      gather(
          a.count, a.widths[t], [&](int32_t l) { return a.rates[l * a.trees + t]; }, next);
      next += a.widths[t];
    }
    for (int32_t n = 0; n < a.rows; ++n) add_contact(n, rates);
  }

  void add_contact(int32_t n, Lanes* rates) {
    const PgsContact<float>& first = a.contacts[0][n].solver;
    PgsContact<Lanes>& to = contacts[n];
    gather(
        a.count, kNumbers,
        [&](int32_t l) { return reinterpret_cast<const float*>(&a.contacts[l][n].solver.bias); },
        &to.bias);
    for (int side = 0; side < 2; ++side) {
      const RowSide<float>& of = first.sides[side];
      RowSide<Lanes>& mine = to.sides[side];
      mine.width = of.width;
      mine.rates = nullptr;
      mine.jacobian = mine.response = nullptr;
      if (of.width == 0) continue;
      mine.rates = rates;
      for (int32_t t = 0; a.rates[t] != of.rates; ++t) mine.rates += a.widths[t];
      const auto copy = [&](const float* RowSide<float>::*rows) {
        Lanes* const mine_here = next;
        gather(
            a.count, 3 * of.width,
            [&](int32_t l) { return a.contacts[l][n].solver.sides[side].*rows; }, next);
        next += 3 * of.width;
        return mine_here;
      };
      mine.jacobian = copy(&RowSide<float>::jacobian);
      if (of.response != nullptr) mine.response = copy(&RowSide<float>::response);
    }
  }

  void scatter(Lanes* rates) const {
    for (int32_t t = 0; t < a.trees; rates += a.widths[t++])
      for (int32_t l = 0; a.moves[t] != 0 && l < a.count; ++l)
        for (int32_t i = 0; i < a.widths[t]; ++i) a.rates[l * a.trees + t][i] = rates[i].v[l];
    for (int32_t n = 0; n < a.rows; ++n)
      for (int32_t l = 0; l < a.count; ++l) {
        PgsContact<float>& to = a.contacts[l][n].solver;
        to.normal_step = contacts[n].normal_step.v[l];
        for (int32_t r = 0; r < 3; ++r) to.impulse[r] = contacts[n].impulse[r].v[l];
      }
  }
};

// Applies an impulse. A lane without one keeps its bits: -0 + 0 would be 0.
void push_lanes(const PgsContact<Lanes>& c, int32_t row, Lanes impulse) {
  const Mask still = impulse == Lanes(0.0f);
  for (const RowSide<Lanes>& s : c.sides) {
    if (s.response == nullptr) continue;
    const Lanes* const y = s.response + row * s.width;
    for (int32_t k = 0; k < s.width; ++k)
      s.rates[k] = select(still, s.rates[k], s.rates[k] + y[k] * impulse);
  }
}

[[gnu::flatten]] void run(const Islands& s) {
  const LaneIslands& a = s.a;
  const Lanes o = Lanes(0.0f);
  int32_t sweeps = a.results[0]->sweeps;
  Mask active = s.in_use;
  Lanes count = o, residual = o;
  do {
    Lanes worst = o;
    for (int32_t k = 0; k < a.rows; ++k) {
      PgsContact<Lanes>& c = s.contacts[sweeps % 2 != 0 ? a.rows - 1 - k : k];
      const Lanes moved = sweep_contact<Lanes>(
          c, a.cone, active, [&](int32_t row) { return slip(c, row); },
          [&](int32_t row, const Lanes& impulse) { push_lanes(c, row, impulse); });
      worst = select(moved > worst, moved, worst);
    }
    for (int32_t n = 0; renews_rubbing(sweeps + 1) && n < a.rows; ++n) {
      PgsContact<Lanes>& c = s.contacts[n];
      const Lanes step = rubbing_step<Lanes>(c, row_product(c, 0, 1), row_product(c, 0, 2));
      c.normal_step = select(active, step, c.normal_step);
    }
    count = select(active, Lanes(static_cast<float>(++sweeps)), count);
    residual = select(active, worst, residual);
    active = both(active, negate(worst < Lanes(a.tolerance)));
  } while (sweeps < a.most_sweeps && any(active));
  for (int32_t l = 0; l < a.count; ++l) {
    a.results[l]->sweeps = static_cast<int32_t>(count.v[l]);
    a.results[l]->residual = residual.v[l];
  }
}

}  // namespace

int64_t islands_memory(const LaneIslands& a) {
  int64_t lanes = 0;
  for (int32_t t = 0; t < a.trees; ++t) lanes += a.widths[t];
  for (int32_t n = 0; n < a.rows; ++n)
    for (const RowSide<float>& s : a.contacts[0][n].solver.sides) lanes += 6 * s.width;
  return lanes * static_cast<int64_t>(sizeof(Lanes)) +
         a.rows * static_cast<int64_t>(sizeof(PgsContact<Lanes>));
}

void sweep_islands(const LaneIslands& a) {
  const Islands s(a);
  run(s);
  s.scatter(reinterpret_cast<Lanes*>(s.contacts + a.rows));
#if defined(__AVX__)
  _mm256_zeroupper();  // avoids the AVX-SSE transition penalty in later code
#endif
}

}  // namespace novaphy::articulation::NOVAPHY_LEVEL
