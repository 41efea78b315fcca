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

/* The same for `count` launches, one after the other; see <novaphy/program/series.h>. `args` are the
 * words of the first launch. `launches` has a row for each launch: the arrays of the varying
 * sources, then those of the outputs, null where nothing has to be written. The arrays of the launch
 * LAUNCHES_AHEAD later are fetched early, so as many rows follow the last, of any arrays. It also
 * stops at rows that it cannot do. */
#define LAUNCHES_AHEAD 8
typedef int64_t (*novaphy_native_series_fn)(const uint64_t* args, const uint64_t* launches,
                                            int64_t count, int64_t begin, int64_t end,
                                            novaphy_error_sink* sink);
typedef struct novaphy_native_series {
  novaphy_native_series_fn run;
  int32_t outputs, varying;
  const int32_t* sources; /* per output the carried one, then the varying ones */
} novaphy_native_series;

typedef struct novaphy_native_kernel {
  uint64_t hash;         /* of the Program; tables are sorted by it */
  uint32_t instructions; /* two more facts about the Program, in case two have one hash */
  uint32_t arguments;
  novaphy_native_fn run;
  const novaphy_native_series* series; /* or null */
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
