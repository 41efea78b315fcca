/* The backend C ABI: everything that a vendor needs to add a device to NovaPhy.
 *
 * A backend is a shared library `libnovaphy_backend_<name>.so` which exports exactly one symbol,
 * `novaphy_backend_query`. It returns a static table of functions (or null and a reason).
 *
 * Rules that keep the boundary narrow and safe:
 *  - C11, standard integer headers only. No C++ type, no exception, no ownership of host memory
 * crosses.
 *  - Every struct begins with `struct_size`. The major version must match; fields are only
 * appended.
 *  - Every function that can fail returns a `novaphy_status` and fills the caller's
 * `novaphy_error`.
 *  - Functions marked (optional) may be null; every other entry is required.
 *  - The minor version counts on when the major one changes.
 */
#ifndef NOVAPHY_ABI_BACKEND_H
#define NOVAPHY_ABI_BACKEND_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define NOVAPHY_ABI_MAJOR 1u
#define NOVAPHY_ABI_MINOR 12u

typedef enum novaphy_status {
  NOVAPHY_OK = 0,
  NOVAPHY_INVALID_ARGUMENT = 1, /* the caller broke a rule that this header states */
  NOVAPHY_OUT_OF_MEMORY = 2,
  NOVAPHY_NOT_SUPPORTED = 3,
  NOVAPHY_INDEX_OUT_OF_RANGE = 4, /* a kernel read a row at or past the end of a source */
  NOVAPHY_DEVICE_LOST = 5,
  NOVAPHY_INTERNAL = 6
} novaphy_status;

/* Owned by the caller; the callee writes a null-terminated message when it returns non-zero. */
typedef struct novaphy_error {
  uint64_t struct_size;
  int32_t status;
  char message[500];
} novaphy_error;

/* What the host lends to a backend. `parallel_for` calls body(context, chunk) once for every chunk
 * in [0, chunks), possibly on several threads and in any order, and returns when all have finished.
 * `in_parallel`, which may be null: whether that would be on the calling thread alone, as from
 * within a chunk. There is no use in small chunks then. */
typedef struct novaphy_host_api {
  uint64_t struct_size;
  uint32_t abi_major;
  uint32_t abi_minor;
  void (*parallel_for)(int64_t chunks, void (*body)(void* context, int64_t chunk), void* context);
  int32_t (*in_parallel)(void);
} novaphy_host_api;

typedef struct novaphy_device novaphy_device;
typedef struct novaphy_stream novaphy_stream;
typedef struct novaphy_event novaphy_event;
typedef struct novaphy_module novaphy_module;
typedef struct novaphy_kernel novaphy_kernel;
typedef struct novaphy_graph novaphy_graph;

typedef enum novaphy_device_type {
  NOVAPHY_DEVICE_CPU = 0,
  NOVAPHY_DEVICE_CUDA = 1,
  NOVAPHY_DEVICE_DLAN = 2
} novaphy_device_type;

enum {                                        /* capability bits */
       NOVAPHY_CAP_HOST_ACCESSIBLE = 1u << 0, /* device memory may be dereferenced by the host */
       NOVAPHY_CAP_GRAPH_CAPTURE = 1u << 1,   /* the capture group is there */
       NOVAPHY_CAP_SOURCE_MODULES = 1u << 2,
       NOVAPHY_CAP_BINARY_MODULES = 1u << 3
};

typedef struct novaphy_device_info {
  uint64_t struct_size;
  char name[128];
  int32_t arch;  /* 90 for sm_90; 0 on a CPU */
  int32_t units; /* multiprocessors or hardware threads */
  uint64_t total_memory;
  uint64_t free_memory;
  uint64_t capabilities; /* NOVAPHY_CAP_* */
} novaphy_device_info;

typedef enum novaphy_memory_kind {
  NOVAPHY_MEMORY_DEVICE = 0,
  NOVAPHY_MEMORY_PINNED_HOST = 1
} novaphy_memory_kind;

typedef enum novaphy_copy_kind {
  NOVAPHY_COPY_DEVICE_TO_DEVICE = 0,
  NOVAPHY_COPY_HOST_TO_DEVICE = 1,
  NOVAPHY_COPY_DEVICE_TO_HOST = 2
} novaphy_copy_kind;

typedef enum novaphy_code_format {
  NOVAPHY_CODE_PROGRAM = 0, /* serialized SSA, see program.h; mandatory; one kernel named "main" */
  NOVAPHY_CODE_SOURCE = 1, /* freestanding C++ text (optional, see the capability bits and below) */
  NOVAPHY_CODE_BINARY = 2, /* built ahead for this device (optional); on a CPU see below */
  NOVAPHY_CODE_BUILTIN = 3 /* data = the builtin's name, see program.h; mandatory */
} novaphy_code_format;

/* SOURCE modules: C++20 text without includes. A line "// kernel NAME WORDS" names each kernel and
 * its number of argument words, or 0 for as many as a launch gives; it is written
 *   NOVAPHY_KERNEL NAME(const novaphy_arguments<WORDS> args, const int64_t n, const device_sink) {
 *     const int64_t i = NOVAPHY_ROW; if (i >= n) return;
 *     ... args.word[0] ...
 *   }
 * A struct of WORDS members of 8 bytes may stand for novaphy_arguments<WORDS>.
 * The backend supplies these names, the sized integers of <stdint.h>, and for its own compiler
 * usqrt, ufma, ufloor, ubits_f and uf_bits, with the rounding that program.h states. */

/* BINARY modules of a CPU backend, since minor version 10: `data` is one of these, and the module
 * has the one kernel `name`. `rows` does the rows [begin, end) of n; which rows one call gets
 * depends on nothing but n and `chunk`, and calls for other rows may run at the same time. The function and
 * what the struct points to outlive the module. */
typedef struct novaphy_row_function {
  uint64_t struct_size;
  const char* name;
  uint32_t argument_count; /* 8-byte words */
  uint32_t chunk; /* since minor version 12: rows that a thread takes at a time; 0: the backend's */
  void (*rows)(const uint64_t* arguments, int64_t n, int64_t begin, int64_t end);
} novaphy_row_function;

/* How a kernel runs. */
typedef struct novaphy_kernel_info {
  uint64_t struct_size;
  uint64_t hash;  /* of the Program; 0: the kernel is no Program */
  int32_t native; /* 1: compiled code; 0: an interpreter of the Program; 2 (since minor version 8):
                     compiled code that is contracted, across the Programs of a list or persistent
                     kernel too, so that its bits depend on what they are */
  int32_t lanes;  /* rows that one vector of the processor holds; 1 where that has no meaning */
  char isa[32];   /* the instruction set, as the backend names it */
} novaphy_kernel_info;

/* One operation of a list. `kernel` null: a copy of row_bytes per row, or without `source` a fill
 * with the 32-bit `pattern`. */
typedef struct novaphy_list_op {
  uint64_t struct_size;
  novaphy_kernel* kernel;
  const uint64_t* arguments;
  uint32_t argument_count;
  uint32_t pattern;
  void* target;
  const void* source;
  uint64_t row_bytes;
} novaphy_list_op;
typedef struct novaphy_list novaphy_list;
typedef struct novaphy_scan novaphy_scan;

/* One operation of a persistent kernel. `op.row_bytes` of a copy or fill is 4. */
typedef struct novaphy_persistent_op {
  uint64_t struct_size;
  novaphy_list_op op;
  int64_t n;      /* its rows: a multiple of `rows` */
  int64_t rows;   /* of its chain */
  uint32_t phase; /* counted from 0 */
  uint32_t chain; /* counted from 0 within the phase */
  /* since minor version 9: of a builtin, the bytes that it may read from its first argument on */
  uint64_t source_bytes;
} novaphy_persistent_op;

typedef struct novaphy_backend_api {
  uint64_t struct_size;
  uint32_t abi_major;
  uint32_t abi_minor;
  const char* name;    /* "cpu", "cuda", ... */
  const char* version; /* of the backend library */
  int32_t device_type; /* novaphy_device_type */

  /* devices: a machine without a device gives count 0 and a reason in `error` with status OK */
  novaphy_status (*device_count)(int32_t* count, novaphy_error* error);
  novaphy_status (*device_info)(int32_t ordinal, novaphy_device_info* info, novaphy_error* error);
  novaphy_status (*device_open)(int32_t ordinal, novaphy_device** device, novaphy_error* error);
  void (*device_close)(novaphy_device* device);

  /* memory: 256-byte aligned; zero bytes are legal and give a pointer that may be freed */
  novaphy_status (*memory_alloc)(novaphy_device* device, int32_t kind, uint64_t bytes,
                                 void** pointer, novaphy_error* error);
  void (*memory_free)(novaphy_device* device, int32_t kind, void* pointer);
  /* in stream order; host memory that is not pinned is consumed or filled before the call returns
   */
  novaphy_status (*memory_copy)(novaphy_stream* stream, int32_t kind, void* target,
                                const void* source, uint64_t bytes, novaphy_error* error);
  /* repeats the pattern of 1, 2, 4 or 8 bytes; bytes is a multiple of pattern_bytes */
  novaphy_status (*memory_fill)(novaphy_stream* stream, void* target, uint64_t pattern,
                                uint32_t pattern_bytes, uint64_t bytes, novaphy_error* error);

  /* streams are in order; events mark a point in a stream */
  novaphy_status (*stream_create)(novaphy_device* device, novaphy_stream** stream,
                                  novaphy_error* error);
  void (*stream_destroy)(novaphy_stream* stream);
  novaphy_status (*stream_synchronize)(novaphy_stream* stream, novaphy_error* error);
  novaphy_status (*stream_wait)(novaphy_stream* stream, novaphy_event* event, novaphy_error* error);
  novaphy_status (*event_create)(novaphy_device* device, novaphy_event** event,
                                 novaphy_error* error);
  void (*event_destroy)(novaphy_event* event);
  novaphy_status (*event_record)(novaphy_event* event, novaphy_stream* stream,
                                 novaphy_error* error);
  novaphy_status (*event_synchronize)(novaphy_event* event, novaphy_error* error);
  novaphy_status (*event_elapsed)(novaphy_event* start, novaphy_event* stop, double* seconds,
                                  novaphy_error* error);

  /* code: `data` is read during the call only */
  novaphy_status (*module_create)(novaphy_device* device, int32_t format, const void* data,
                                  uint64_t bytes, novaphy_module** module, novaphy_error* error);
  void (*module_destroy)(novaphy_module* module);
  novaphy_status (*kernel_get)(novaphy_module* module, const char* name, novaphy_kernel** kernel,
                               novaphy_error* error);

  /* launch over the 1-D domain [0, n) with 8-byte argument words in the order that program.h
   * states; n = 0 does nothing; a wrong argument count is INVALID_ARGUMENT. `arguments` is read
   * during the call. */
  novaphy_status (*launch)(novaphy_stream* stream, novaphy_kernel* kernel, int64_t n,
                           const uint64_t* arguments, uint32_t argument_count,
                           novaphy_error* error);

  /* capture (optional, all four or none): work issued to a stream between begin and end becomes a
   * graph */
  novaphy_status (*capture_begin)(novaphy_stream* stream, novaphy_error* error);
  novaphy_status (*capture_end)(novaphy_stream* stream, novaphy_graph** graph,
                                novaphy_error* error);
  novaphy_status (*graph_launch)(novaphy_graph* graph, novaphy_stream* stream,
                                 novaphy_error* error);
  void (*graph_destroy)(novaphy_graph* graph);

  /* since minor version 2 (optional; a table that ends before it is legal) */
  novaphy_status (*kernel_info)(novaphy_kernel* kernel, novaphy_kernel_info* info,
                                novaphy_error* error);

  /* since minor version 3 (optional, all three or none): operations over one domain of n rows, of
   * which each touches memory that the list writes at its own row only, run as one launch. Row i of
   * all operations may so run before row i + 1 of the first. The caller vouches that every item of
   * a CSR loop is a row of the sources that are read at SLOT. `ops` is read during the call; the
   * kernels outlive the list. NOT_SUPPORTED: it would gain nothing here, launch them one by one. */
  novaphy_status (*list_create)(novaphy_device* device, int64_t n, const novaphy_list_op* ops,
                                uint32_t count, novaphy_list** list, novaphy_error* error);
  novaphy_status (*list_launch)(novaphy_list* list, novaphy_stream* stream, novaphy_error* error);
  void (*list_destroy)(novaphy_list* list);

  /* since minor version 4 (optional, all three or none; for devices whose memory the host may
   * dereference): `count` launches of one kernel over the same rows, one after the other;
   * `arguments` has the address of the words of each, and these live as long as the scan. Each
   * launch touches memory that the scan writes at its own row only, so row i of all launches may
   * run before row i + 1 of the first. scan_launch runs the rows [begin, end) of all of them on
   * the calling thread. NOT_SUPPORTED: it would gain nothing here, launch them one by one.
   * `first`: null, or a scan that lives as long as this one and is always launched just before
   * it, by the same thread, on the same rows; nothing in between writes what it wrote. A backend
   * may let it keep near by what this one asks for again. */
  novaphy_status (*scan_create)(novaphy_device* device, novaphy_kernel* kernel,
                                const uint64_t* const* arguments, uint32_t argument_count,
                                uint32_t count, novaphy_scan* first, novaphy_scan** scan,
                                novaphy_error* error);
  novaphy_status (*scan_launch)(novaphy_scan* scan, int64_t begin, int64_t end,
                                novaphy_error* error);
  void (*scan_destroy)(novaphy_scan* scan);

  /* since minor version 5 (optional, both or none): operations over several domains, in order of
   * phases and chains, as one launch. A phase begins when the one before has ended. Its chains are
   * independent; row i of a chain is done by one thread: of each of its operations, in order, the
   * rows [i * n / rows, (i + 1) * n / rows). persistent_takes: whether an operation may be part of
   * one. What persistent_create makes is launched and destroyed as a list; NOT_SUPPORTED, and what
   * the caller vouches for, as there. Besides, CSR tables hold what they will hold at every launch,
   * and so do indices of the rows to which they add. */
  int32_t (*persistent_takes)(novaphy_device* device, const novaphy_list_op* op);
  novaphy_status (*persistent_create)(novaphy_device* device, const novaphy_persistent_op* ops,
                                      uint32_t count, novaphy_list** list, novaphy_error* error);

  /* since minor version 10 (optional): `launch` of a Program over the first *active of n rows: none
   * when that is negative, all when it is n or more. `active` is an i32 in the device's memory,
   * read when the launch runs; what lies beyond is not touched. */
  novaphy_status (*launch_active)(novaphy_stream* stream, novaphy_kernel* kernel, int64_t n,
                                  const int32_t* active, const uint64_t* arguments,
                                  uint32_t argument_count, novaphy_error* error);
} novaphy_backend_api;

/* The one exported symbol. Returns null and fills `error` when the host's major version is not the
 * backend's, or when the backend cannot run here at all. The table lives as long as the process. */
typedef const novaphy_backend_api* (*novaphy_backend_query_fn)(uint32_t host_abi_major,
                                                               const novaphy_host_api* host,
                                                               novaphy_error* error);
#define NOVAPHY_BACKEND_QUERY_SYMBOL "novaphy_backend_query"

#ifdef __cplusplus
}
#endif
#endif
