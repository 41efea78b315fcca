#include "novaphy/nova/incidence.h"

#include <algorithm>
#include <map>
#include <mutex>
#include <tuple>

#include "fusion.h"
#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"
#include "novaphy/nova/op_list.h"

namespace nova {

using novaphy::DeviceContext;
using novaphy::ErrorKind;
using novaphy::require;

namespace {

// A builtin of the backend, made once per device.
novaphy_kernel* builtin(const DeviceContext& context, const std::string& name) {
  struct Made {
    novaphy_module* module = nullptr;
    novaphy_kernel* kernel = nullptr;
  };
  static std::mutex mutex;
  // Never destroyed: tensors of static lifetime may still use it at exit.
  static auto& all = *new std::map<std::pair<const DeviceContext*, std::string>, Made>;
  std::lock_guard lock(mutex);
  Made& made = all[{&context, name}];
  if (!made.kernel) {
    novaphy_error error = novaphy::make_error();
    novaphy::check(context.api->module_create(context.device, NOVAPHY_CODE_BUILTIN, name.c_str(),
                                              name.size(), &made.module, &error),
                   error, name.c_str());
    novaphy::check(context.api->kernel_get(made.module, "main", &made.kernel, &error), error,
                   name.c_str());
  }
  return made.kernel;
}

uint64_t word(const void* p) { return reinterpret_cast<uint64_t>(p); }

// How the arguments of a row sum depend on the row. Kept for good: recordings refer to it.
const detail::RowLayout* row_sum_layout(uint32_t row_bytes, int64_t stride, bool by_offsets,
                                        bool has_init) {
  static std::mutex mutex;
  static auto& known = *new std::map<std::tuple<uint32_t, int64_t, bool>, detail::RowLayout>;
  const std::lock_guard lock(mutex);
  const auto [at, is_new] = known.try_emplace({row_bytes, by_offsets ? -1 : stride, has_init});
  detail::RowLayout& layout = at->second;
  if (!is_new) return &layout;
  layout.row_local = true;
  layout.operations = row_bytes;  // those of a few items
  if (by_offsets) {
    layout.tables.push_back({1, 4});
  } else {
    layout.inputs.push_back({0, static_cast<uint32_t>(stride) * row_bytes});
  }
  if (has_init) layout.inputs.push_back({3, row_bytes});
  layout.outputs.push_back({4, row_bytes});
  return &layout;
}

void run_row_sum(const Operand& source, const void* offsets, const void* items, int64_t rows,
                 int64_t stride, const Operand* init, const Operand& out) {
  require(out.width == source.width && out.rows >= rows, ErrorKind::Value, "row_sum: expected ",
          rows, " rows of width ", source.width, ", got ", out.rows, " of width ", out.width);
  const DeviceContext& context = novaphy::device_context(out.range->storage().device());
  static thread_local const DeviceContext* known_context = nullptr;
  static thread_local novaphy_kernel* known = nullptr;
  if (known_context != &context) {
    known = builtin(context, "row_sum_f32");
    known_context = &context;
  }
  const uint64_t words[] = {word(source.range->data()),
                            word(offsets),
                            word(items),
                            init ? word(init->range->data()) : 0,
                            word(out.range->data()),
                            static_cast<uint64_t>(source.width),
                            static_cast<uint64_t>(stride)};
  const auto row_bytes = static_cast<uint64_t>(out.width) * 4;
  const auto row_count = static_cast<uint64_t>(rows);
  const detail::MemoryAccess accesses[] = {
      {words[0], static_cast<uint64_t>(source.rows) * row_bytes},
      {words[3], init ? row_count * row_bytes : 0, static_cast<uint32_t>(row_bytes)},
      {words[4], row_count * row_bytes, static_cast<uint32_t>(row_bytes), true}};
  const detail::RowLayout* layout = current_capture() == nullptr
                                        ? nullptr
                                        : row_sum_layout(static_cast<uint32_t>(row_bytes), stride,
                                                         offsets != nullptr, init != nullptr);
  submit_launch(context, known, "row_sum", rows, words, layout, accesses);
  note_write(out.range);
  for (const Operand* operand : {&source, init, &out})
    if (operand) hold_in_capture(operand->range);
}

}  // namespace

Incidence make_incidence(const Operand& table, int64_t rows) {
  require(table.type == ir::Type::I32, ErrorKind::Type,
          "incidence: expected an int32 table, got float32");
  if (OpList* graph = current_capture()) graph->freeze(table.range);
  const novaphy::Device device = table.range->storage().device();
  const DeviceContext& context = novaphy::device_context(device);
  auto made = std::make_shared<IncidenceData>();
  made->table = table;
  made->table.rows = table.rows * table.width;
  made->table.width = 1;
  made->version = table.range->version();
  made->has_checksum = table.range->writable_export();
  made->checksum = made->has_checksum ? table.range->checksum() : 0;
  made->rows = rows;
  const auto slots = made->table.rows;
  made->offsets = novaphy::Storage::allocate(static_cast<size_t>(rows + 1) * 4, device)->range();
  made->items = novaphy::Storage::allocate(static_cast<size_t>(slots) * 4, device)->range();
  const uint64_t words[] = {word(table.range->data()), static_cast<uint64_t>(slots),
                            word(made->offsets->data()), word(made->items->data())};
  launch_now(context, builtin(context, "incidence_i32"), "incidence", rows, words);
  return made;
}

bool is_current(const IncidenceData& incidence, const Range& table) {
  if (incidence.version != table.version()) return false;
  if (!table.writable_export()) return true;
  return table.checksum() ==
         (incidence.has_checksum ? incidence.checksum : table.exported_checksum());
}

Incidence cached_incidence(const Operand& table, int64_t rows) {
  static std::mutex mutex;
  std::lock_guard lock(mutex);
  auto& known = grad_info(*table.range).incidences;
  std::erase_if(known, [&](const Incidence& i) { return !is_current(*i, *table.range); });
  auto found =
      std::find_if(known.begin(), known.end(), [&](const Incidence& i) { return i->rows == rows; });
  if (found == known.end()) {
    IncidenceData data = *make_incidence(table, rows);
    data.table.range = nullptr;  // the table owns this entry; the other way round would be a cycle
    known.push_back(std::make_shared<const IncidenceData>(std::move(data)));
    found = known.end() - 1;
  }
  if (OpList* graph = current_capture()) graph->freeze(table.range);
  IncidenceData result = **found;
  result.table.range = table.range;
  return std::make_shared<const IncidenceData>(std::move(result));
}

void row_sum(const Operand& source, const IncidenceData& rows, const Operand* init,
             const Operand& out) {
  run_row_sum(source, rows.offsets->data(), rows.items->data(), rows.rows, 0, init, out);
  hold_in_capture(rows.offsets);
  hold_in_capture(rows.items);
}
void row_sum(const Operand& source, int64_t rows, int64_t stride, const Operand* init,
             const Operand& out) {
  require(source.rows >= rows * stride, ErrorKind::Value, "row_sum: ", rows, " rows of ", stride,
          " items need more than ", source.rows);
  run_row_sum(source, nullptr, nullptr, rows, stride, init, out);
}

}  // namespace nova
