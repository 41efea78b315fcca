// Friction that the contact law leaves open.
//
// The active rows J of an island are the normals of pushing contacts and the tangents of sticking
// contacts. If rows depend on each other, J^T z = 0 for some z. The law then determines the pushes
// only up to multiples of z. A sliding contact i pushes by mu_i times its normal impulse along the
// unit vector d_i, so z also changes the friction by
//   F = sum z_i mu_i J_t,i^T d_i     over the sliding contacts i
// The part of F that no active row takes up changes the motion. The solve chooses the pushes, but
// their derivative is not that of the equations of the active rows. All products are in the metric
// of the inverse mass matrix. Freestanding: shared by host and device kernels.
#pragma once

#include "novaphy/dynamics/articulation/active_rows.h"

namespace novaphy::articulation {

// A row of which other rows leave less than this fraction depends on them.
inline constexpr float kDependent = 0.1f;
// The largest part of F, relative to the sum of the sizes of its terms, for an exact gradient. For
// several z the squares of these parts add up.
inline constexpr float kOpenPart = 0.05f;
// m/s. A contact at the border of its cone may still stick: other contacts hold the body.
inline constexpr float kMoves = 1e-3f;
// A compliance above this part of the mobility of the row determines the push.
inline constexpr float kCompliant = 1e-3f;

class OpenFriction {
 public:
  static constexpr int32_t kMostRows = 24;  // independent rows

  OpenFriction(const IslandContact* contacts, int32_t count, bool cone)
      : contacts_(contacts), count_(count), cone_(cone) {}

  // Returns whether a contact slides. The friction is not open otherwise.
  bool has_slides() const {
    Slide none;
    for (int32_t n = 0; n < count_; ++n)
      if (contact(n).impulse[0] > 0.0f && slide_of(n, none)) return true;
    return false;
  }
  // Chooses independent rows. Returns false if more than kMostRows are independent.
  bool build() {
    for (int32_t n = 0; n < count_; ++n) {
      const ContactBranch branch = branch_of(contact(n), cone_);
      for (int32_t axis = 0; branch.active && axis < 3; ++axis) {
        if (axis > 0 && branch.slides[axis - 1]) continue;
        if (!add({n, axis})) return false;
      }
    }
    return true;
  }
  // Returns whether the friction is open, after build().
  bool is_open() const {
    int32_t next = 0;  // rows are in the order of build()
    float parts = 0.0f;
    for (int32_t n = 0; n < count_; ++n) {
      const ContactBranch branch = branch_of(contact(n), cone_);
      for (int32_t axis = 0; branch.active && axis < 3; ++axis) {
        if (axis > 0 && branch.slides[axis - 1]) continue;
        if (next < rank_ && rows_[next].contact == n && rows_[next].axis == axis) {
          ++next;
        } else {
          parts += square_of_open_part({n, axis});
        }
      }
    }
    return parts > kOpenPart * kOpenPart;
  }

 private:
  struct Row {
    int32_t contact = 0, axis = 0;  // axis: 0: normal, 1 and 2: tangents
  };
  // The friction of a sliding contact per unit of its normal impulse, along its tangents.
  struct Slide {
    float along[2] = {};
  };

  const PgsContact<float>& contact(int32_t n) const { return contacts_[n].solver; }
  float product(const Row& a, const Row& b) const {
    return static_cast<float>(coupling(contact(a.contact), a.axis, contact(b.contact), b.axis));
  }
  float& factor(int32_t i, int32_t j) { return factors_[i * (i + 1) / 2 + j]; }
  float factor(int32_t i, int32_t j) const { return factors_[i * (i + 1) / 2 + j]; }

  void solve_lower(float* b) const {
    for (int32_t i = 0; i < rank_; ++i) {
      for (int32_t j = 0; j < i; ++j) b[i] -= factor(i, j) * b[j];
      b[i] /= factor(i, i);
    }
  }
  void solve_upper(float* b) const {
    for (int32_t i = rank_; i-- > 0;) {
      for (int32_t j = i + 1; j < rank_; ++j) b[i] -= factor(j, i) * b[j];
      b[i] /= factor(i, i);
    }
  }
  float square_of(const float* b) const {
    float sum = 0.0f;
    for (int32_t i = 0; i < rank_; ++i) sum += b[i] * b[i];
    return sum;
  }

  bool add(const Row& row) {
    const float whole = product(row, row);
    float b[kMostRows];
    for (int32_t i = 0; i < rank_; ++i) b[i] = product(rows_[i], row);
    solve_lower(b);
    const float rest = whole - square_of(b);
    if (!(rest > kDependent * kDependent * whole)) return true;
    if (rank_ == kMostRows) return false;
    for (int32_t i = 0; i < rank_; ++i) factor(rank_, i) = b[i];
    factor(rank_, rank_) = math::sqrt(rest);
    rows_[rank_++] = row;
    return true;
  }

  // Returns false if the contact sticks, or hardly slides.
  bool slide_of(int32_t n, Slide& to) const {
    const PgsContact<float>& c = contact(n);
    const ContactBranch branch = branch_of(c, cone_);
    if (!(branch.slides[0] || branch.slides[1]) || !(c.friction > 0.0f)) return false;
    if (!(tangent_length(slip(c, 1), slip(c, 2)) > kMoves)) return false;
    for (int i = 0; i < 2; ++i)
      to.along[i] = branch.slides[i] ? c.impulse[i + 1] / c.impulse[0] : 0.0f;
    return true;
  }
  // Returns the product of the friction of a sliding contact with a row.
  float product(int32_t n, const Slide& of, const Row& row) const {
    return of.along[0] * product(Row{n, 1}, row) + of.along[1] * product(Row{n, 2}, row);
  }

  // Returns the square of the open part of F for the z of a dependent row. 0: compliance determines
  // the pushes.
  float square_of_open_part(const Row& dependent) const {
    float z[kMostRows], by_rows[kMostRows];
    for (int32_t i = 0; i < rank_; ++i) z[i] = product(rows_[i], dependent);
    solve_lower(z);
    solve_upper(z);
    for (int32_t i = 0; i < rank_; ++i) by_rows[i] = 0.0f;
    float square = 0.0f, size = 0.0f;
    // The entry behind the independent rows is the dependent row, whose z is -1.
    const auto row_at = [&](int32_t i) { return i < rank_ ? rows_[i] : dependent; };
    const auto z_at = [&](int32_t i) { return i < rank_ ? z[i] : -1.0f; };
    for (int32_t i = 0; i <= rank_; ++i) {
      Slide a;
      const int32_t n = row_at(i).contact;
      if (row_at(i).axis != 0) continue;
      const PgsContact<float>& c = contact(n);
      if (c.cfm > kCompliant * c.normal && math::abs(z_at(i)) > kDependent) return 0.0f;
      if (!slide_of(n, a)) continue;
      for (int32_t k = 0; k < rank_; ++k) by_rows[k] += z_at(i) * product(n, a, rows_[k]);
      for (int32_t j = 0; j <= rank_; ++j) {
        Slide b;
        const int32_t m = row_at(j).contact;
        if (row_at(j).axis != 0 || !slide_of(m, b)) continue;
        const float both =
            b.along[0] * product(n, a, Row{m, 1}) + b.along[1] * product(n, a, Row{m, 2});
        square += z_at(i) * z_at(j) * both;
        if (i == j) size += math::abs(z_at(i)) * math::sqrt(both);
      }
    }
    solve_lower(by_rows);
    const float open = square - square_of(by_rows);
    return open > 0.0f ? open / (size * size) : 0.0f;
  }

  const IslandContact* contacts_;
  int32_t count_, rank_ = 0;
  bool cone_;
  Row rows_[kMostRows];
  float factors_[kMostRows * (kMostRows + 1) / 2];  // L of the products of independent rows
};

// Returns whether two contacts have the same links.
inline bool same_links(const IslandContact& a, const IslandContact& b) {
  for (int side = 0; side < 2; ++side)
    if (a.sides[side].tree != b.sides[side].tree || a.sides[side].link != b.sides[side].link)
      return false;
  return true;
}

// Returns whether the law leaves the friction of an island open. In an island with many independent
// rows only contacts of the same links are compared.
inline bool has_open_friction(const IslandContact* rows, int32_t count, bool cone) {
  OpenFriction whole(rows, count, cone);
  if (!whole.has_slides()) return false;
  if (whole.build()) return whole.is_open();
  for (int32_t first = 0, end = 0; first < count; first = end) {
    while (end < count && same_links(rows[first], rows[end])) ++end;
    OpenFriction part(rows + first, end - first, cone);
    part.build();
    if (part.is_open()) return true;
  }
  return false;
}

}  // namespace novaphy::articulation
