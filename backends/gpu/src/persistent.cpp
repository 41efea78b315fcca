// Persistent kernels: which operations they support, in which form they run, and their launch.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <utility>

#include "cluster/blocks.h"
#include "compiler.h"
#include "list.h"
#include "persistent_memory.h"
#include "persistent_source.h"
#include "vendor.h"

namespace novaphy::gpu {
namespace {

using Form = PersistentShape::Form;

// Warps of a block with rows of a phase, and the limit on all warps of a block. The limits leave
// enough registers for the adjoints of elements.
constexpr unsigned kFewWarps = 4, kMostWarps = 8, kMostWarpsAtAll = 12;
// The blocks of a large cluster, which is used if the driver finds enough units, and the number of
// warps up to which a large cluster does not pay off.
constexpr unsigned kMostInLargeCluster = 16, kFewForLarge = 32;
constexpr int32_t kClusters = 90;  // the first architecture with clusters
// Static shared memory of a block, and its part for values that threads keep between phases. The
// rest holds the records.
constexpr unsigned kSharedOfSource = 48 << 10, kKeptBytes = 38 << 10;
// Shared memory for kept values if there is a BlockPlan, whose launch requests more memory.
constexpr unsigned kKeptWithPlan = 100 << 10;
// Limits on the memory for results of early halves: bytes, and the divisor of the free memory.
constexpr uint64_t kEarlyBytes = uint64_t{4} << 30, kEarlyPart = 4;
// Rows from this size on are summed faster by the builtin, where a whole block works on a row.
constexpr uint64_t kLongRow = 1024, kWideRow = 16;

// Reads the shape in NOVAPHY_DEVICE_PHASES=BLOCKSxTHREADS, if there is one.
bool asked_for(unsigned& blocks, unsigned& threads) {
  const char* text = std::getenv("NOVAPHY_DEVICE_PHASES");
  unsigned b = 0, t = 0;
  if (text == nullptr || std::sscanf(text, "%ux%u", &b, &t) != 2) return false;
  if (b < 1 || t < kWarp || t > 1024 || t % kWarp != 0) return false;
  blocks = b;
  threads = t;
  return true;
}

unsigned rounded_up(unsigned a, unsigned b) { return (a + b - 1) / b; }

// Chooses the shape. Few rows stay on one unit, where a barrier costs almost nothing. More rows use
// a cluster with its hardware barrier, and many rows the whole device.
PersistentShape choose(const novaphy_device& device, unsigned warps, unsigned in_cluster) {
  const bool clusters = device.arch >= kClusters;
  PersistentShape shape;
  if (!asked_for(shape.blocks, shape.threads)) {
    unsigned each = 0;  // warps of each block
    if (warps <= kMostWarps) {
      shape.blocks = 1;
      each = std::max(warps, kFewWarps);
    } else if (clusters && warps <= kMostWarps * kMostInCluster) {
      shape.blocks = std::min(warps > kFewForLarge ? in_cluster : kMostInCluster, warps);
      each = rounded_up(warps, shape.blocks);
    } else {
      shape.blocks = std::min(warps, static_cast<unsigned>(device.units));
      each = std::min(rounded_up(warps, shape.blocks), kMostWarpsAtAll);
    }
    shape.threads = each * kWarp;
  }
  shape.form = shape.blocks == 1                        ? Form::Block
               : clusters && shape.blocks <= in_cluster ? Form::Cluster
                                                        : Form::Grid;
  if (shape.form != Form::Grid && 2 * shape.threads <= kMostWarpsAtAll * kWarp) {
    shape.groups = 2;
    shape.threads *= 2;
  }
  return shape;
}

// Returns whether the device has enough adjacent units for a large cluster.
bool runs_as_cluster(const novaphy_list& list) {
  const Use use(list.device);
  const Driver& d = driver();
  const LaunchShape launch{{static_cast<unsigned>(list.blocks), 1, 1},
                           {list.threads, 1, 1},
                           list.shared_bytes,
                           nullptr,
                           nullptr,
                           0};
  int clusters = 0;
  return d.function_set(list.function, kLargeClusters, 1) == kSuccess &&
         d.clusters_at_once(&clusters, list.function, &launch) == kSuccess && clusters > 0;
}

// Limits the number of blocks to those that can run at the same time.
novaphy_status fit_together(novaphy_list& list, novaphy_error* error) {
  int fit = 0;
  const Use use(list.device);
  const novaphy_status status = check(
      list.device, driver().blocks_per_unit(&fit, list.function, static_cast<int>(list.threads), 0),
      "persistent kernel", error);
  list.blocks = std::min<int64_t>(list.blocks, int64_t{fit} * list.device->units);
  return status;
}

// Reads device memory, after all work that was launched on the device.
std::vector<int32_t> words_at(const novaphy_device* device, uint64_t where, size_t count) {
  std::vector<int32_t> words(count);
  const Use use(device);
  const Driver& d = driver();
  const bool read =
      d.copy_to_host(words.data(), where, count * sizeof(int32_t), nullptr) == kSuccess &&
      d.stream_synchronize(nullptr) == kSuccess;
  return read ? words : std::vector<int32_t>();
}

uint64_t early_bytes(const novaphy_device* device) {
  const Use use(device);
  size_t free = 0, total = 0;
  if (driver().memory_info(&free, &total) != kSuccess) return 0;
  return std::min<uint64_t>(kEarlyBytes, free / kEarlyPart);
}

// Returns whether the compiler supports sends between blocks of a cluster.
bool knows_sends() {
  const Compiler& c = compiler(driver().version);
  return c.major > 12 || (c.major == 12 && c.minor >= 1);
}

// Returns the shared memory that a launch can request per block.
uint64_t most_shared_bytes(const novaphy_device* device) {
  int most = 0;
  const bool known = driver().device_attribute(&most, kMostSharedBytes, device->id) == kSuccess;
  return known && most > 0 ? static_cast<uint64_t>(most) : 0;
}

novaphy_status create(novaphy_device* device, std::span<const novaphy_persistent_op> ops,
                      novaphy_list** list, novaphy_error* error) {
  const auto refuse = [&](const char* why) {
    return fail(error, NOVAPHY_NOT_SUPPORTED, "persistent kernel: %s", why);
  };
  bool plain = false, contract = false;
  for (const novaphy_persistent_op& o : ops) {
    if (o.n < 1 || o.n > INT32_MAX || o.rows < 1 || o.n % o.rows != 0)
      return fail(error, NOVAPHY_INVALID_ARGUMENT,
                  "persistent_create: rows: expected a divisor of the %lld rows, got %lld",
                  static_cast<long long>(o.n), static_cast<long long>(o.rows));
    if (o.op.kernel == nullptr || is_builtin(o)) continue;
    const nova::ir::Program& p = o.op.kernel->program;
    (p.contract ? contract : plain) = true;
    for (size_t s = 0; s < p.sources.size(); ++s)
      if (o.op.arguments[p.source_argument(s) + 1] > INT32_MAX) return refuse("too many rows");
  }
  // All kernels of one text allow contraction, or none does.
  if (plain && contract) return refuse("kernels with and without contraction");
  const uint32_t warps = most_warps(ops);
  for (const unsigned in_cluster : {kMostInLargeCluster, kMostInCluster}) {
    PersistentShape shape = choose(*device, warps, in_cluster);
    PersistentCapacity capacity{shape.blocks * shape.threads / kWarp / shape.groups,
                                kKeptBytes / 4 / shape.threads, shape.blocks, shape.groups};
    const bool one_row = shape.form != Form::Grid && warps <= capacity.warps;
    if (!one_row) capacity = {};
    OwnList made(new novaphy_list);
    made->device = device;
    const auto fits = [&](const PersistentTable& of) {
      return of.fits && shared_bytes(of, shape) <= kSharedOfSource &&
             (launch_bytes(of, shape) == 0 ||
              shared_bytes(of, shape) + launch_bytes(of, shape) <= most_shared_bytes(device));
    };
    PersistentTable table;
    const auto runs_planned = [&](const BlockPlan& plan) {
      const unsigned threads = std::exchange(shape.threads, plan.threads);
      PersistentCapacity planned{shape.blocks * shape.threads / kWarp,
                                 kKeptWithPlan / 4 / shape.threads,
                                 shape.blocks,
                                 1,
                                 &plan,
                                 early_bytes(device)};
      table = persistent_table(ops, planned);
      if (fits(table) && table.early_bytes != 0) {
        const Use use(device);
        if (driver().alloc(&made->early_memory, table.early_bytes) != kSuccess) {
          planned.early_bytes = 0;
          table = persistent_table(ops, planned);
        }
      }
      if (!fits(table)) shape.threads = threads;
      return fits(table);
    };
    bool is_planned = false;
    if (one_row && shape.form == Form::Cluster) {
      const ReadWords read = [&](uint64_t where, size_t count) {
        return words_at(device, where, count);
      };
      if (const auto plan = plan_blocks(ops, shape.blocks, kMostWarpsAtAll, read)) {
        BlockPlan with_halo = *plan;
        is_planned = (knows_sends() && plan_halo(ops, shape.blocks, read, with_halo) &&
                      runs_planned(with_halo)) ||
                     runs_planned(*plan);
      }
    }
    if (!is_planned) table = persistent_table(ops, capacity);
    if (!fits(table)) {
      capacity.kept_words = 0;
      table = persistent_table(ops, capacity);
    }
    if (!fits(table)) return refuse("too large");
    made->words = {table.first_words, table.tasks, table.rows,
                   table.halo_turns,  table.jobs,  table.job_count};
    made->n = static_cast<int64_t>(table.counters);
    made->blocks = shape.blocks;
    made->threads = shape.threads;
    made->shared_bytes = static_cast<unsigned>(launch_bytes(table, shape));
    made->together = shape.form == Form::Grid;
    for (const uint64_t word : table.early) table.words[word] += made->early_memory;
    novaphy_status status = load_list(*made, persistent_source(table, shape), contract, table.words,
                                      table.relative, error);
    if (status == NOVAPHY_OK && table.job_count != 0) {
      const Use use(device);
      status = check(device, driver().module_function(&made->early, made->module, "novaphy_early"),
                     "persistent kernel", error);
      made->jobs = made->table + table.jobs * sizeof(uint64_t);
      made->job_count = static_cast<uint32_t>(table.job_count);
      made->blocks_of_job = rounded_up(static_cast<unsigned>(table.job_slots), made->kEarlyThreads);
    }
    if (status == NOVAPHY_OK && made->together) status = fit_together(*made, error);
    if (status == NOVAPHY_OK && made->shared_bytes != 0) {
      const Use use(device);
      status = check(
          device,
          driver().function_set(made->function, kSharedBytes, static_cast<int>(made->shared_bytes)),
          "persistent kernel", error);
    }
    if (status != NOVAPHY_OK) return status;
    if (made->blocks == 0) return refuse("the device does not hold a block of it");
    if (shape.is_large() && !runs_as_cluster(*made)) continue;
    *list = made.release();
    return NOVAPHY_OK;
  }
  return refuse("no room for it");
}

}  // namespace

int32_t persistent_takes(novaphy_device*, const novaphy_list_op* op) {
  if (op->kernel == nullptr) return 1;
  if (!op->kernel->program.instrs.empty()) return 1;
  if (op->kernel->name != "row_sum_f32" || op->argument_count != 7) return 0;
  const bool is_long = op->arguments[1] == 0 && op->arguments[6] > kLongRow;
  return !is_long && op->arguments[5] <= kWideRow ? 1 : 0;
}

novaphy_status persistent_create(novaphy_device* device, const novaphy_persistent_op* ops,
                                 uint32_t count, novaphy_list** list, novaphy_error* error) {
  if (const novaphy_status status = check_lost(device, "persistent_create", error);
      status != NOVAPHY_OK)
    return status;
  if (vendor().warp != kWarp)
    return fail(error, NOVAPHY_NOT_SUPPORTED,
                "persistent kernel: no persistent kernels on this device");
  if (count == 0)
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "persistent_create: expected operations, got none");
  if (ops[0].struct_size != sizeof(novaphy_persistent_op))
    return fail(error, NOVAPHY_NOT_SUPPORTED,
                "persistent kernel: the host's operations have other members");
  return guarded(error, [&] { return create(device, {ops, count}, list, error); });
}

}  // namespace novaphy::gpu
