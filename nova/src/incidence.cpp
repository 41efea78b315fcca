#include "novaphy/nova/incidence.h"

#include <algorithm>
#include <array>
#include <map>
#include <mutex>
#include <span>
#include <tuple>
#include <vector>

#include "fusion.h"
#include "kernel_impl.h"
#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace nova {

using novaphy::DeviceContext;
using novaphy::ErrorKind;
using novaphy::require;

namespace {

// Returns a builtin kernel of the backend, made once per device. With `may_lack`, null means that
// the device lacks it.
novaphy_kernel* builtin(const DeviceContext& context, const std::string& name,
                        bool may_lack = false) {
  struct Made {
    novaphy_module* module = nullptr;
    novaphy_kernel* kernel = nullptr;
    bool lacks = false;
  };
  static std::mutex mutex;
  // Never destroyed, because tensors with static lifetime may use the kernels at exit.
  static auto& all = *new std::map<std::pair<const DeviceContext*, std::string>, Made>;
  std::lock_guard lock(mutex);
  Made& made = all[{&context, name}];
  if (!made.kernel && !made.lacks) {
    novaphy_error error = novaphy::make_error();
    const novaphy_status status = context.api->module_create(
        context.device, NOVAPHY_CODE_BUILTIN, name.c_str(), name.size(), &made.module, &error);
    made.lacks = may_lack && status == NOVAPHY_INVALID_ARGUMENT;
    if (made.lacks) return nullptr;
    novaphy::check(status, error, name.c_str());
    novaphy::check(context.api->kernel_get(made.module, "main", &made.kernel, &error), error,
                   name.c_str());
  }
  return made.kernel;
}

uint64_t word(const void* p) { return reinterpret_cast<uint64_t>(p); }

// Returns the row layout of a row sum. Layouts are kept forever, because recordings refer to them.
// `init`: whether each sum has an initial value.
const detail::RowLayout* row_sum_layout(uint32_t row_bytes, int64_t stride, bool by_offsets,
                                        std::span<const bool> init) {
  static std::mutex mutex;
  static auto& known =
      *new std::map<std::tuple<uint32_t, int64_t, std::vector<bool>>, detail::RowLayout>;
  const std::lock_guard lock(mutex);
  const auto [at, is_new] = known.try_emplace(
      {row_bytes, by_offsets ? -1 : stride, std::vector<bool>(init.begin(), init.end())});
  detail::RowLayout& layout = at->second;
  if (!is_new) return &layout;
  layout.row_local = layout.of_builtin = true;
  // an estimate for rows of a few items
  layout.operations = row_bytes * static_cast<uint32_t>(init.size());
  if (by_offsets) {
    layout.tables.push_back({1, 4});
  } else {
    layout.inputs.push_back({0, static_cast<uint32_t>(stride) * row_bytes});
  }
  constexpr uint32_t kInit[] = {3, 8}, kOut[] = {4, 9};
  for (size_t k = 0; k < init.size(); ++k) {
    if (init[k]) layout.inputs.push_back({kInit[k], row_bytes});
    layout.outputs.push_back({kOut[k], row_bytes});
  }
  return &layout;
}

// Runs one row sum, or two row sums over the same items.
void run_row_sums(std::span<const RowSumTerm> terms, const IncidenceData* csr, int64_t rows,
                  int64_t stride) {
  const Operand& first = *terms[0].out;
  for (const RowSumTerm& term : terms)
    require(term.out->width == term.source->width && term.out->width == first.width &&
                term.out->rows >= rows,
            ErrorKind::Value, "row_sum: expected ", rows, " rows of width ", term.source->width,
            ", got ", term.out->rows, " of width ", term.out->width);
  const DeviceContext& context = novaphy::device_context(first.range->storage().device());
  struct Known {
    const DeviceContext* context = nullptr;
    novaphy_kernel* one = nullptr;
    novaphy_kernel* pair = nullptr;  // null: the device has no such builtin
  };
  static thread_local Known known;
  if (known.context != &context)
    known = {&context, builtin(context, "row_sum_f32"), builtin(context, "row_sum_pair_f32", true)};
  if (terms.size() > 1 && !known.pair) {
    for (const RowSumTerm& term : terms) run_row_sums({&term, 1}, csr, rows, stride);
    return;
  }
  const auto row_bytes = static_cast<uint64_t>(first.width) * 4;
  const auto row_count = static_cast<uint64_t>(rows);
  std::array<uint64_t, 10> words = {
      0, csr ? word(csr->offsets->data()) : 0, csr ? word(csr->items->data()) : 0, 0,
      0, static_cast<uint64_t>(first.width),   static_cast<uint64_t>(stride)};
  std::array<detail::MemoryAccess, 8> accesses;
  std::array<bool, 2> has_init{};
  constexpr size_t kWords[2][3] = {{0, 3, 4}, {7, 8, 9}};  // argument words of source, init and out
  for (size_t k = 0; k < terms.size(); ++k) {
    const auto& [source, init, out] = terms[k];
    has_init[k] = init != nullptr;
    const auto [s, i, o] = kWords[k];
    words[s] = word(source->range->data());
    words[i] = init ? word(init->range->data()) : 0;
    words[o] = word(out->range->data());
    const auto bytes = static_cast<uint32_t>(row_bytes);
    accesses[3 * k] = {words[s], static_cast<uint64_t>(source->rows) * row_bytes};
    accesses[3 * k + 1] = {words[i], init ? row_count * row_bytes : 0, bytes};
    accesses[3 * k + 2] = {words[o], row_count * row_bytes, bytes, true};
  }
  const auto tables = std::span(accesses).subspan(3 * terms.size(), csr ? 2 : 0);
  if (csr) std::ranges::copy(detail::table_accesses(*csr), tables.begin());
  const detail::RowLayout* layout =
      current_capture() == nullptr
          ? nullptr
          : row_sum_layout(static_cast<uint32_t>(row_bytes), stride, csr != nullptr,
                           std::span(has_init.data(), terms.size()));
  const bool pair = terms.size() > 1;
  submit_launch(context, pair ? known.pair : known.one, "row_sum", rows,
                std::span(words.data(), pair ? 10 : 7), layout,
                std::span(accesses.data(), 3 * terms.size() + tables.size()));
  for (const RowSumTerm& term : terms) {
    note_write(term.out->range);
    for (const Operand* operand : {term.source, term.init, term.out})
      if (operand) hold_in_capture(operand->range);
  }
}

void run_row_sums(std::span<const RowSumTerm> terms, const IncidenceData& csr) {
  run_row_sums(terms, &csr, csr.rows, 0);
  hold_in_capture(csr.offsets);
  hold_in_capture(csr.items);
}

}  // namespace

std::array<detail::MemoryAccess, 2> detail::table_accesses(const IncidenceData& csr) {
  return {{{word(csr.offsets->data()), csr.offsets->bytes()},
           {word(csr.items->data()), csr.items->bytes()}}};
}

namespace {

// Records the value of the table from which the arrays were built.
void note_value(IncidenceData& made, const Range& table, uint64_t capture) {
  made.version = table.version();
  made.capture = capture;
  made.has_checksum = capture == 0 && table.was_exported();
  made.checksum = made.has_checksum ? table.checksum() : 0;
}

struct Build {
  explicit Build(const IncidenceData& i)
      : context(novaphy::device_context(i.table.range->storage().device())),
        kernel(builtin(context, "incidence_i32")),
        words{word(i.table.range->data()), static_cast<uint64_t>(i.table.rows),
              word(i.offsets->data()), word(i.items->data())} {}
  const DeviceContext& context;
  novaphy_kernel* kernel;
  std::array<uint64_t, 4> words;
};

void submit_build(IncidenceData& made) {
  const Build build(made);
  const auto [offsets, items] = detail::table_accesses(made);
  const detail::MemoryAccess accesses[] = {
      {build.words[0], static_cast<uint64_t>(made.table.rows) * 4},
      {offsets.begin, offsets.bytes, 0, true},
      {items.begin, items.bytes, 0, true}};
  submit_launch(build.context, build.kernel, "incidence", made.rows, build.words, nullptr,
                accesses);
  for (const auto* range : {&made.offsets, &made.items}) {
    note_write(*range);
    hold_in_capture(*range);
  }
  hold_in_capture(made.table.range);
  const OpList* graph = current_capture();
  note_value(made, *made.table.range, graph ? graph->id() : 0);
}

}  // namespace

Incidence make_incidence(const Operand& table, int64_t rows) {
  require(table.type == ir::Type::I32, ErrorKind::Type,
          "incidence: expected an int32 table, got float32");
  const novaphy::Device device = table.range->storage().device();
  auto made = std::make_shared<IncidenceData>();
  made->table = table;
  made->table.rows = table.rows * table.width;
  made->table.width = 1;
  made->rows = rows;
  const auto slots = made->table.rows;
  made->offsets = novaphy::Storage::allocate(static_cast<size_t>(rows + 1) * 4, device)->range();
  made->items = novaphy::Storage::allocate(static_cast<size_t>(slots) * 4, device)->range();
  OpList* graph = current_capture();
  if (graph == nullptr || graph->writes_to(*table.range)) {
    submit_build(*made);
    return made;
  }
  graph->freeze(table.range);
  const Build build(*made);
  launch_now(build.context, build.kernel, "incidence", rows, build.words);
  note_value(*made, *table.range, 0);
  return made;
}

void rebuild(const Incidence& incidence) {
  submit_build(*incidence);
  if (Tape* tape = Tape::active()) tape->record_rebuild(incidence);
}

bool is_current(const IncidenceData& incidence, const Range& table) {
  if (incidence.version != table.version()) return false;
  const OpList* graph = current_capture();
  if (incidence.capture != 0) return graph != nullptr && incidence.capture == graph->id();
  if (!table.was_exported()) return true;
  return table.checksum() ==
         (incidence.has_checksum ? incidence.checksum : table.exported_checksum());
}

Incidence cached_incidence(const Operand& table, int64_t rows) {
  static std::mutex mutex;
  std::lock_guard lock(mutex);
  auto& known = grad_info(*table.range).incidences;
  std::erase_if(known, [&](const auto& i) { return !is_current(*i, *table.range); });
  auto found =
      std::find_if(known.begin(), known.end(), [&](const auto& i) { return i->rows == rows; });
  if (found == known.end()) {
    IncidenceData data = *make_incidence(table, rows);
    data.table.range = nullptr;  // the table owns this entry, and a reference back would be a cycle
    known.push_back(std::make_shared<const IncidenceData>(std::move(data)));
    found = known.end() - 1;
  }
  IncidenceData result = **found;
  result.table.range = table.range;
  if (OpList* graph = current_capture(); graph && result.capture == 0) graph->freeze(table.range);
  return std::make_shared<IncidenceData>(std::move(result));
}

void row_sum(const Operand& source, const IncidenceData& rows, const Operand* init,
             const Operand& out) {
  const RowSumTerm term{&source, init, &out};
  run_row_sums({&term, 1}, rows);
}
void row_sums(const RowSumTerm& first, const RowSumTerm& second, const IncidenceData& rows) {
  const RowSumTerm terms[] = {first, second};
  run_row_sums(terms, rows);
}
void row_sum(const Operand& source, int64_t rows, int64_t stride, const Operand* init,
             const Operand& out) {
  require(source.rows >= rows * stride, ErrorKind::Value, "row_sum: ", rows, " rows of ", stride,
          " items need more than ", source.rows);
  const RowSumTerm term{&source, init, &out};
  run_row_sums({&term, 1}, nullptr, rows, stride);
}

}  // namespace nova
