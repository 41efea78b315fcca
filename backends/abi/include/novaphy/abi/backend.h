/* The backend C ABI: the interface that a vendor implements to add a device to NovaPhy.
 *
 * A backend is a shared library `libnovaphy_backend_<name>.so` which exports exactly one symbol,
 * `novaphy_backend_query`. This function returns a static table of functions, or null and a reason.
 *
 * Rules of the interface:
 *   - C11, standard integer headers only. No C++ type, exception or ownership of host memory passes
 *     through the interface.
 *   - Every struct begins with `struct_size`. The major version must match; fields are only
 *     appended.
 *   - Every function that can fail returns a `novaphy_status` and fills the caller's
 *     `novaphy_error`.
 *   - Functions marked (optional) may be null; every other entry is required.
 *   - The minor version keeps counting when the major version changes. */
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
  NOVAPHY_INVALID_ARGUMENT = 1, /* the caller broke a rule of this header */
  NOVAPHY_OUT_OF_MEMORY = 2,
  NOVAPHY_NOT_SUPPORTED = 3,
  NOVAPHY_INDEX_OUT_OF_RANGE = 4, /* a kernel read a row at or past the end of a source */
  NOVAPHY_DEVICE_LOST = 5,
  NOVAPHY_INTERNAL = 6
} novaphy_status;

/* The caller owns the struct. The called function writes a null-terminated message if it returns a
 * status other than OK. */
typedef struct novaphy_error {
  uint64_t struct_size;
  int32_t status;
  char message[500];
} novaphy_error;

/* Functions of the host for a backend. `parallel_for` calls body(context, chunk) once for every
 * chunk in [0, chunks), possibly on several threads and in any order, and returns when all calls
 * have returned. `in_parallel` may be null. It returns nonzero if parallel_for would run all chunks
 * on the calling thread, as within a chunk. Small chunks have no use then. */
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
       NOVAPHY_CAP_HOST_ACCESSIBLE = 1u << 0, /* the host may dereference device memory */
       NOVAPHY_CAP_GRAPH_CAPTURE = 1u << 1,   /* the table has the capture functions */
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
  NOVAPHY_CODE_BINARY = 2, /* compiled ahead for this device (optional); on a CPU see below */
  NOVAPHY_CODE_BUILTIN = 3 /* data = the builtin's name, see program.h; mandatory */
} novaphy_code_format;

/* SOURCE modules: C++20 text without includes. A line "// kernel NAME WORDS" names each kernel and
 * its number of argument words. WORDS is 0 if the number varies from launch to launch. A kernel has
 * this form:
 *   NOVAPHY_KERNEL NAME(const novaphy_arguments<WORDS> args, const int64_t n, const device_sink) {
 *     const int64_t i = NOVAPHY_ROW; if (i >= n) return;
 *     ... args.word[0] ...
 *   }
 * A struct of WORDS members of 8 bytes may stand for novaphy_arguments<WORDS>. The backend supplies
 * these names and the sized integers of <stdint.h>. It also supplies usqrt, ufma, ufloor, ubits_f
 * and uf_bits for its compiler, with the rounding that program.h states. */

/* BINARY modules of a CPU backend, since minor version 10: `data` is this struct, and the module
 * has one kernel, `name`. `rows` computes the rows [begin, end) of n. The division of rows into
 * calls depends only on n and `chunk`, and calls for other rows may run at the same time. The
 * function and the objects to which the struct points outlive the module. */
typedef struct novaphy_row_function {
  uint64_t struct_size;
  const char* name;
  uint32_t argument_count; /* number of 8-byte words */
  uint32_t chunk; /* since minor version 12: rows that a thread takes at once; 0: backend chooses */
  void (*rows)(const uint64_t* arguments, int64_t n, int64_t begin, int64_t end);
} novaphy_row_function;

/* How a backend runs a kernel. */
typedef struct novaphy_kernel_info {
  uint64_t struct_size;
  uint64_t hash;  /* hash of the Program; 0: the kernel is no Program */
  int32_t native; /* 1: compiled code; 0: an interpreter of the Program; 2 (since minor version 8):
                   * compiled code with contraction to fused multiply-adds, also across the Programs
                   * of a list or persistent kernel, so that the bits depend on these Programs */
  int32_t lanes;  /* rows per SIMD vector of the processor; 1 on devices without such vectors */
  char isa[32];   /* the instruction set, as the backend names it */
} novaphy_kernel_info;

/* One operation of a list. A null `kernel` means a copy of row_bytes per row, or, if `source` is
 * null too, a fill with the 32-bit `pattern`. */
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

/* One operation of a persistent kernel. For a copy or fill, `op.row_bytes` is 4. */
typedef struct novaphy_persistent_op {
  uint64_t struct_size;
  novaphy_list_op op;
  int64_t n;      /* rows of the operation: a multiple of `rows` */
  int64_t rows;   /* rows of its chain */
  uint32_t phase; /* counted from 0 */
  uint32_t chain; /* counted from 0 within the phase */
  /* since minor version 9: bytes that a builtin may read through its first argument */
  uint64_t source_bytes;
} novaphy_persistent_op;

typedef struct novaphy_backend_api {
  uint64_t struct_size;
  uint32_t abi_major;
  uint32_t abi_minor;
  const char* name;    /* "cpu", "cuda", ... */
  const char* version; /* version of the backend library */
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
  /* In stream order. When the call returns, host memory that is not pinned has been read or filled.
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

  /* code: `data` is only read during the call */
  novaphy_status (*module_create)(novaphy_device* device, int32_t format, const void* data,
                                  uint64_t bytes, novaphy_module** module, novaphy_error* error);
  void (*module_destroy)(novaphy_module* module);
  novaphy_status (*kernel_get)(novaphy_module* module, const char* name, novaphy_kernel** kernel,
                               novaphy_error* error);

  /* Launches a kernel over the rows [0, n) with 8-byte argument words in the order that program.h
   * states. n = 0 does nothing; a wrong number of arguments is INVALID_ARGUMENT. `arguments` is
   * only read during the call. */
  novaphy_status (*launch)(novaphy_stream* stream, novaphy_kernel* kernel, int64_t n,
                           const uint64_t* arguments, uint32_t argument_count,
                           novaphy_error* error);

  /* capture (optional, all four functions or none): work issued to a stream between begin and end
   * becomes a graph */
  novaphy_status (*capture_begin)(novaphy_stream* stream, novaphy_error* error);
  novaphy_status (*capture_end)(novaphy_stream* stream, novaphy_graph** graph,
                                novaphy_error* error);
  novaphy_status (*graph_launch)(novaphy_graph* graph, novaphy_stream* stream,
                                 novaphy_error* error);
  void (*graph_destroy)(novaphy_graph* graph);

  /* since minor version 2 (optional; a table may end before this entry) */
  novaphy_status (*kernel_info)(novaphy_kernel* kernel, novaphy_kernel_info* info,
                                novaphy_error* error);

  /* since minor version 3 (optional, all three functions or none): runs operations over one domain
   * of n rows as one launch. Each operation accesses memory that the list writes only at its own
   * row, so row i of all operations may run before row i + 1 of the first operation. The caller
   * guarantees that every item of a CSR loop is a row of the sources that are read at SLOT. `ops`
   * is only read during the call; the kernels outlive the list. NOT_SUPPORTED: a list gains nothing
   * on this device, and the caller should launch the operations one by one. */
  novaphy_status (*list_create)(novaphy_device* device, int64_t n, const novaphy_list_op* ops,
                                uint32_t count, novaphy_list** list, novaphy_error* error);
  novaphy_status (*list_launch)(novaphy_list* list, novaphy_stream* stream, novaphy_error* error);
  void (*list_destroy)(novaphy_list* list);

  /* since minor version 4 (optional, all three functions or none; for devices whose memory the host
   * may dereference): a scan is `count` launches of one kernel over the same rows, one after the
   * other. `arguments` has the address of the argument words of each launch, which live as long as
   * the scan. Each launch accesses memory that the scan writes only at its own row, so row i of all
   * launches may run before row i + 1 of the first launch. scan_launch runs the rows [begin, end)
   * of all launches on the calling thread. NOT_SUPPORTED: a scan gains nothing here, and the caller
   * should launch the kernels one by one. `first` is null, or a scan that lives as long as this
   * scan and always runs just before it, on the same thread and rows; nothing in between writes the
   * memory that `first` wrote. `first` may keep data in the caches that this scan reads again. */
  novaphy_status (*scan_create)(novaphy_device* device, novaphy_kernel* kernel,
                                const uint64_t* const* arguments, uint32_t argument_count,
                                uint32_t count, novaphy_scan* first, novaphy_scan** scan,
                                novaphy_error* error);
  novaphy_status (*scan_launch)(novaphy_scan* scan, int64_t begin, int64_t end,
                                novaphy_error* error);
  void (*scan_destroy)(novaphy_scan* scan);

  /* since minor version 5 (optional, both functions or none): runs operations over several domains
   * as one launch, in order of phases and chains. A phase begins when the previous phase has ended.
   * The chains of a phase are independent. One thread does row i of a chain: for each operation, in
   * order, the rows [i * n / rows, (i + 1) * n / rows). persistent_takes returns whether an
   * operation may be part of a persistent kernel. The result of persistent_create is launched and
   * destroyed as a list. NOT_SUPPORTED and the caller's guarantees are those of list_create. In
   * addition, CSR tables, and indices of rows to which an operation adds, already have their
   * contents of every launch. */
  int32_t (*persistent_takes)(novaphy_device* device, const novaphy_list_op* op);
  novaphy_status (*persistent_create)(novaphy_device* device, const novaphy_persistent_op* ops,
                                      uint32_t count, novaphy_list** list, novaphy_error* error);

  /* since minor version 10 (optional): `launch` of a Program over the first *active of n rows: no
   * row if *active is negative, all rows if it is n or more. `active` is an i32 in the device's
   * memory, read when the launch runs. Memory of other rows is not accessed. */
  novaphy_status (*launch_active)(novaphy_stream* stream, novaphy_kernel* kernel, int64_t n,
                                  const int32_t* active, const uint64_t* arguments,
                                  uint32_t argument_count, novaphy_error* error);
} novaphy_backend_api;

/* The only exported symbol. Returns null and fills `error` if the host's major version differs from
 * the backend's, or if the backend cannot run on this machine. The table lives as long as the
 * process. */
typedef const novaphy_backend_api* (*novaphy_backend_query_fn)(uint32_t host_abi_major,
                                                               const novaphy_host_api* host,
                                                               novaphy_error* error);
#define NOVAPHY_BACKEND_QUERY_SYMBOL "novaphy_backend_query"

#ifdef __cplusplus
}
#endif
#endif
