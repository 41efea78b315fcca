/* What compiled kernels and the backend agree on. C, because the generated files are C. */
#ifndef NOVAPHY_CPU_NATIVE_H
#define NOVAPHY_CPU_NATIVE_H

#include <stdint.h>

/* Collects the out-of-range read of the smallest row, so that the message does not depend on
 * timing. */
typedef struct novaphy_error_sink {
  int64_t index; /* INT64_MAX: none */
  int64_t row;
  int32_t source;
  int32_t lock;
} novaphy_error_sink;

/* Runs the rows [begin, end) in whole groups of lanes, and returns the first row that it left: it
 * stops where a group is not whole, or where a source that is read at the own row ends. */
typedef int64_t (*novaphy_native_fn)(const uint64_t* args, int64_t begin, int64_t end,
                                     novaphy_error_sink* sink);

/* Launches of one kernel, one after the other; see <novaphy/program/scan.h>. */
typedef struct novaphy_native_launches {
  const uint64_t* args;  /* the words of the first launch */
  const uint64_t* table; /* per launch: see novaphy_native_scan */
  int64_t count;
  /* Null, or for rows from `first` on and each launch, whether anything acted in its group: a
   * contact that touches, a limit that is met. Written by the scan of a primal, read by its
   * adjoint's. */
  char* notes;
  int64_t note_row_bytes, first;
  /* The outputs are more than caches hold: they are written past them, which spares the memory the
   * reading of lines that are overwritten whole. */
  int32_t streams;
  /* Null, or where the primal keeps for the adjoint the rows that launches read in which something
   * acted. */
  char* room;
  int64_t room_row_bytes;
} novaphy_native_launches;

/* Runs the rows [begin, end) of all launches in whole groups of lanes, and returns the first row
 * that it left: it also stops at rows that it cannot do. A row of the table has the arrays of the
 * varying sources, then those of the outputs, null where nothing has to be written, and the number
 * of the launch in notes and room. The arrays of the launch PREFETCH_LAUNCHES later are prefetched,
 * so as many rows follow the last, of any arrays. */
#define PREFETCH_LAUNCHES 8
typedef int64_t (*novaphy_native_scan_fn)(const novaphy_native_launches* launches, int64_t begin,
                                          int64_t end, novaphy_error_sink* sink);
typedef struct novaphy_native_scan {
  novaphy_native_scan_fn run;
  int32_t outputs, varying;
  const int32_t* sources; /* per output the carried one, then the varying ones */
  uint64_t primal;        /* the hash of the Program whose notes it reads; 0: it writes notes */
} novaphy_native_scan;

typedef struct novaphy_native_kernel {
  uint64_t hash;         /* of the Program; tables are sorted by it */
  uint32_t instructions; /* two more facts about the Program, in case two have one hash */
  uint32_t arguments;
  novaphy_native_fn run;
  const novaphy_native_scan* scan; /* or null */
} novaphy_native_kernel;

typedef struct novaphy_native_table {
  const novaphy_native_kernel* kernels;
  int32_t count;
  int32_t lanes;
} novaphy_native_table;

/* The name of the table of one generated file, compiled for one level. */
#define NOVAPHY_NATIVE_NAME_(level, part) novaphy_native_##level##_##part
#define NOVAPHY_NATIVE_NAME(level, part) NOVAPHY_NATIVE_NAME_(level, part)
#define NOVAPHY_NATIVE_TABLE(part) NOVAPHY_NATIVE_NAME(NOVAPHY_NATIVE_LEVEL, part)

#endif
