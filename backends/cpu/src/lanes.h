/* The definitions of the types and functions in emitted text (<novaphy/program/emit.h>), for LANES
 * rows at a time. The arithmetic is that of ops.h, to the bit.
 *
 * Types: vf, vi and vb have a float, an int32_t and a truth value per lane. Functions u... take
 * scalars, functions v... take lanes. LANES is 1, 4, 8 or 16; more than one lane needs the vector
 * extensions of GCC and Clang. Everything has internal linkage, because the same text is compiled
 * for several instruction sets. */
#ifndef NOVAPHY_CPU_LANES_H
#define NOVAPHY_CPU_LANES_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "native.h"

#define LANE_FN static inline __attribute__((always_inline, unused))
#define COLD_FN static __attribute__((noinline, cold, unused))

/* Only a hint for the compiler's layout of the code. */
#define rarely(a) __builtin_expect((a), 0)

/* A sum over rows of up to KEPT_ITEMS items keeps values that a later sum over the same rows needs
 * again. With one lane, recomputing the values costs less than this check. */
#define KEPT_ITEMS 4
#define CAN_KEEP(csr) (LANES > 1 && (csr).longest <= KEPT_ITEMS)

/* Prefetches the rows of an array that a later launch will read or write. The arrays of a scan lie
 * too far apart for the processor's own prefetching. */
LANE_FN void prefetch_rows(uint64_t array, int64_t row_bytes, int64_t i, int write) {
  for (int64_t byte = 0; byte < row_bytes * LANES; byte += 64) {
    const char* const p = (const char*)array + row_bytes * i + byte;
    if (write)
      __builtin_prefetch(p, 1);
    else
      __builtin_prefetch(p, 0);
  }
}

/* Returns the notes (novaphy_native_launches) on the group of rows that begins at i, or null. */
LANE_FN char* group_notes(const novaphy_native_launches* all, int64_t i) {
  return all->notes == NULL ? NULL : all->notes + (i - all->first) * all->note_row_bytes;
}
LANE_FN char* group_scratch(const novaphy_native_launches* all, int64_t i) {
  return all->scratch == NULL ? NULL : all->scratch + (i - all->first) * all->scratch_row_bytes;
}
/* Returns the part of a group's scratch for launch `number`, with `row_bytes` per row, or null. */
LANE_FN char* launch_scratch(char* scratch, uint64_t number, int64_t row_bytes) {
  return scratch == NULL ? NULL : scratch + (int64_t)number * row_bytes * LANES;
}

/* Functions of scalars. */

LANE_FN float ubits_f(int32_t a) {
  float f;
  memcpy(&f, &a, 4);
  return f;
}
LANE_FN int32_t uf_bits(float a) {
  int32_t i;
  memcpy(&i, &a, 4);
  return i;
}
#include "novaphy/program/scalars.h"

LANE_FN float uabs(float a) { return __builtin_fabsf(a); }
LANE_FN float usqrt(float a) { return __builtin_sqrtf(a); }
LANE_FN float ufma(float a, float b, float c) { /* rounds once on every processor */
  float d = __builtin_fmaf(a, b, c);
#if defined(__aarch64__)
  __asm__("" : "+w"(d)); /* stops GCC from computing -fma, whose zeros have another sign */
#endif
  return d;
}
LANE_FN float ufloor(float a) {
#if defined(__SSE4_1__) || defined(__aarch64__)
  return __builtin_floorf(a);
#else
  /* Floats of at least 2^23 (all are integers), infinities and NaN are returned unchanged. */
  const int small = __builtin_fabsf(a) < 8388608.0f;
  const float t = (float)(int32_t)(small ? a : 0.0f);
  const float down = t > a ? t - 1.0f : t;
  return small ? __builtin_copysignf(down, a) : a;
#endif
}
LANE_FN int32_t uf_to_i(float a) {
  const int fits = a >= -2147483648.0f && a < 2147483648.0f;
  int32_t inside = (int32_t)(fits ? a : 0.0f);
  /* Stops GCC from computing (float)(int)a as one rounding instruction, which gives -0 instead of
   * +0. */
  __asm__("" : "+r"(inside));
  const int32_t outside = a > 0.0f ? INT32_MAX : a < 0.0f ? INT32_MIN : 0;
  return fits ? inside : outside;
}
LANE_FN float ui_to_f(int32_t a) { return (float)a; }

/* Records a failing read. The read of the smallest row wins. Failures are rare, so a spin lock is
 * good enough. */
COLD_FN void report_row(novaphy_error_sink* sink, int64_t index, int32_t source, int64_t row) {
  while (__atomic_exchange_n(&sink->lock, 1, __ATOMIC_ACQUIRE) != 0) {
  }
  if (index < sink->index) {
    sink->index = index;
    sink->source = source;
    sink->row = row;
  }
  __atomic_store_n(&sink->lock, 0, __ATOMIC_RELEASE);
}

LANE_FN int32_t word_at(const char* source, int64_t word) {
  int32_t w;
  memcpy(&w, source + 4 * word, 4);
  return w;
}

#if LANES == 1
#include "lanes_one.h"
#else
#include "lanes_many.h"
#include "lanes_memory.h"
#endif

/* Records failing reads of a group of lanes, where lane 0 is row i. The first lane counts whose
 * read lies past the end and is needed. */
COLD_FN void report_lanes(vb need, int32_t source, int64_t row, int64_t i,
                          novaphy_error_sink* sink) {
  for (int l = 0; l < LANES; ++l) {
    if (!lane_of(need, l)) continue;
    report_row(sink, i + l, source, row);
    return;
  }
}
LANE_FN int32_t uloadi(const char* s, int64_t rows, int32_t row, int32_t width, int32_t column,
                       vb need, int32_t source, int64_t i, novaphy_error_sink* sink) {
  if (__builtin_expect(row >= 0 && row < rows, 1)) return word_at(s, (int64_t)row * width + column);
  if (row >= 0) report_lanes(need, source, row, i, sink);
  return 0;
}
LANE_FN float uloadf(const char* s, int64_t rows, int32_t row, int32_t width, int32_t column,
                     vb need, int32_t source, int64_t i, novaphy_error_sink* sink) {
  return ubits_f(uloadi(s, rows, row, width, column, need, source, i, sink));
}

#include "lanes_csr.h"

/* `scratch` has the rows [i, i + LANES). Copies those from row `done` on to `out`. */
LANE_FN void copy_tail(char* out, const char* scratch, int64_t bytes, int64_t i, int64_t done) {
  memcpy(out + bytes * done, scratch + bytes * (done - i), (size_t)(bytes * (i + LANES - done)));
}

#endif
