// Lists of operations that run as one kernel; see list_plan.h.
#include "list.h"

#include "list_plan.h"

namespace novaphy::gpu {
namespace {

novaphy_status create(novaphy_device* device, int64_t n, std::span<const novaphy_list_op> ops,
                      novaphy_list** list, novaphy_error* error) {
  const auto refuse = [&](const char* why) {
    return fail(error, NOVAPHY_NOT_SUPPORTED, "list: %s", why);
  };
  bool contract = false;
  for (const novaphy_list_op& op : ops) {
    if (op.kernel == nullptr) {
      if (op.row_bytes % 4 != 0) return refuse("a row of no whole words");
      continue;
    }
    if (op.kernel->program.instrs.empty()) return refuse("a kernel that is no Program");
    contract = contract || op.kernel->program.contract;
    if (op.argument_count != op.kernel->argument_count)
      return fail(error, NOVAPHY_INVALID_ARGUMENT,
                  "kernel '%s': expected %u argument words, got %u", op.kernel->name.c_str(),
                  op.kernel->argument_count, op.argument_count);
  }
  // All kernels of one text allow contraction, or none does.
  for (const novaphy_list_op& op : ops)
    if (op.kernel != nullptr && op.kernel->program.contract != contract)
      return refuse("kernels with and without contraction");
  const ListPlan plan = plan_list(ops);
  if (!plan.worth_it) return refuse("no structure that repeats");
  ListSource source = list_source(plan, ops, n);
  if (!source.fits) return refuse("too many arguments");
  OwnList made(new novaphy_list);
  made->device = device;
  made->n = n;
  made->words = std::move(source.words);
  made->threads = threads_of_block(n, device->units);
  made->blocks = (n + made->threads - 1) / made->threads;
  const novaphy_status status = load_list(*made, source.text, contract, source.table, {}, error);
  if (status == NOVAPHY_OK) *list = made.release();
  return status;
}

}  // namespace

novaphy_status load_list(novaphy_list& list, const std::string& text, bool contract,
                         std::vector<uint64_t>& table, std::span<const uint64_t> relative,
                         novaphy_error* error) {
  const Use use(list.device);
  const Driver& d = driver();
  novaphy_status status =
      load_code(list.device, text, "list", contract ? Dialect::Contracted : Dialect::Program,
                &list.module, error);
  if (status == NOVAPHY_OK)
    status =
        check(list.device, d.module_function(&list.function, list.module, kEntry), "list", error);
  if (status != NOVAPHY_OK || table.empty()) return status;
  const size_t bytes = table.size() * sizeof(uint64_t);
  status = check(list.device, d.alloc(&list.table, bytes), "list", error);
  for (const uint64_t word : relative) table[word] += list.table;
  if (status == NOVAPHY_OK)
    status = check(list.device, d.copy_to_device(list.table, table.data(), bytes, nullptr), "list",
                   error);
  if (status == NOVAPHY_OK)
    status = check(list.device, d.stream_synchronize(nullptr), "list", error);
  return status;
}

novaphy_status list_create(novaphy_device* device, int64_t n, const novaphy_list_op* ops,
                           uint32_t count, novaphy_list** list, novaphy_error* error) {
  if (const novaphy_status status = check_lost(device, "list_create", error); status != NOVAPHY_OK)
    return status;
  if (n < 1 || n > INT32_MAX || count == 0)
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "list_create: expected rows and operations, got %lld and %u",
                static_cast<long long>(n), count);
  return guarded(error, [&] { return create(device, n, {ops, count}, list, error); });
}

novaphy_status list_launch(novaphy_list* list, novaphy_stream* stream, novaphy_error* error) {
  if (const novaphy_status status = check_lost(stream->device, "list_launch", error);
      status != NOVAPHY_OK)
    return status;
  const Use use(stream->device);
  SinkArgument sink = sink_of(stream->device, 0);
  void* pointers[] = {list->words.data(), &list->table, &list->n, &sink};
  const Driver& d = driver();
  if (list->early != nullptr) {
    void* arguments[] = {&list->table, &list->jobs, &list->blocks_of_job, &sink};
    const novaphy_status status =
        launch_function(stream, list->early, int64_t{list->blocks_of_job} * list->job_count,
                        novaphy_list::kEarlyThreads, arguments, "list", error);
    if (status != NOVAPHY_OK) return status;
  }
  const auto blocks = static_cast<unsigned>(list->blocks);
  return check(stream->device,
               list->together ? d.launch_together(list->function, blocks, 1, 1, list->threads, 1, 1,
                                                  list->shared_bytes, stream->stream, pointers)
                              : d.launch(list->function, blocks, 1, 1, list->threads, 1, 1,
                                         list->shared_bytes, stream->stream, pointers, nullptr),
               "list", error);
}

void list_destroy(novaphy_list* list) {
  if (!list->device->lost) {
    const Use use(list->device);
    if (list->module != nullptr) driver().module_unload(list->module);
    if (list->table != 0) driver().free(list->table);
    if (list->early_memory != 0) driver().free(list->early_memory);
  }
  delete list;
}

}  // namespace novaphy::gpu
