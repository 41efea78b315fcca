/* The interface between compiled kernels and the backend, in C because the generated files are C.
 */
#ifndef NOVAPHY_CPU_NATIVE_H
#define NOVAPHY_CPU_NATIVE_H

#include <stdint.h>

/* Collects the out-of-range read of the smallest row, so that the message does not depend on
 * timing. */
typedef struct novaphy_error_sink {
  int64_t index; /* INT64_MAX: no read failed */
  int64_t row;
  int32_t source;
  int32_t lock;
} novaphy_error_sink;

/* Runs the rows [begin, end) in whole groups of lanes, and returns the first row that it did not
 * run. It stops at a group that is not whole, or where a source ends that is read at the own row.
 */
typedef int64_t (*novaphy_native_fn)(const uint64_t* args, int64_t begin, int64_t end,
                                     novaphy_error_sink* sink);

/* The launches of a scan (<novaphy/program/scan.h>): launches of one kernel, one after the other.
 */
typedef struct novaphy_native_launches {
  const uint64_t* args;  /* the argument words of the first launch */
  const uint64_t* table; /* per launch a row of words, see novaphy_native_scan_fn */
  int64_t count;
  /* Null, or one byte for each group of rows and each launch: whether a contact touched or a limit
   * was reached in the group. The first group begins at row `first`. The scan of a primal writes
   * the notes, and the scan of its adjoint reads them. */
  char* notes;
  int64_t note_row_bytes, first;
  /* Whether stores of outputs bypass the caches, because the outputs are larger than the caches.
   * Memory then does not read the lines that are overwritten. */
  int32_t streams;
  /* Null, or memory where the primal keeps rows for its adjoint: the rows that a launch read in a
   * group in which a contact touched or a limit was reached. */
  char* scratch;
  int64_t scratch_row_bytes;
} novaphy_native_launches;

/* Runs the rows [begin, end) of all launches in whole groups of lanes, and returns the first row
 * that it did not run. It also stops at rows that it does not support. A row of the table has the
 * arrays of the varying sources, the arrays of the outputs (null if nothing has to be written), and
 * the number of the launch in notes and scratch. The arrays of the launch that follows
 * PREFETCH_LAUNCHES later are prefetched, so the table ends with as many extra rows of any arrays.
 */
#define PREFETCH_LAUNCHES 8
typedef int64_t (*novaphy_native_scan_fn)(const novaphy_native_launches* launches, int64_t begin,
                                          int64_t end, novaphy_error_sink* sink);
typedef struct novaphy_native_scan {
  novaphy_native_scan_fn run;
  int32_t outputs, varying;
  const int32_t* sources; /* the carried source of each output, then the varying sources */
  uint64_t primal;        /* hash of the Program whose notes it reads; 0: it writes notes */
} novaphy_native_scan;

typedef struct novaphy_native_kernel {
  uint64_t hash;         /* hash of the Program, the key of sorted tables */
  uint32_t instructions; /* two facts about the Program, in case two Programs have the same hash */
  uint32_t arguments;
  novaphy_native_fn run;
  const novaphy_native_scan* scan; /* null: no scan */
} novaphy_native_kernel;

typedef struct novaphy_native_table {
  const novaphy_native_kernel* kernels;
  int32_t count;
  int32_t lanes;
} novaphy_native_table;

/* The name of the table of one generated file, compiled for one instruction set (level). */
#define NOVAPHY_NATIVE_NAME_(level, part) novaphy_native_##level##_##part
#define NOVAPHY_NATIVE_NAME(level, part) NOVAPHY_NATIVE_NAME_(level, part)
#define NOVAPHY_NATIVE_TABLE(part) NOVAPHY_NATIVE_NAME(NOVAPHY_NATIVE_LEVEL, part)

#endif
