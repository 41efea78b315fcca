// Internal: compiled Programs and the implementation of a kernel.
#pragma once

#include <array>
#include <atomic>
#include <map>
#include <mutex>

#include "fusion.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/tangent.h"

namespace nova::detail {

// A Program with its compiled kernel for each device.
class Executable {
 public:
  explicit Executable(ir::Program p)
      : program(std::move(p)),
        layout(row_layout(program)),
        argument_count(program.argument_count()) {}
  ~Executable();
  novaphy_kernel* get(const novaphy::DeviceContext& context);
  void describe(std::vector<KernelInfo>& list);  // adds one entry per device

  ir::Program program;
  RowLayout layout;
  uint32_t argument_count;

 private:
  struct Compiled {
    const novaphy::DeviceContext* context;
    novaphy_module* module;
    novaphy_kernel* kernel;
  };
  std::atomic<const Compiled*> first_{nullptr};
  std::mutex mutex_;
  std::vector<std::unique_ptr<Compiled>> all_;
};

// Add a Program to, and remove it from, the list of Programs for kernel_info().
void remember_executable(Executable* executable);
void forget_executable(Executable* executable);

// AdjointMask with one bit per source or output.
struct AdjointKey {
  uint64_t wrt = 0, accumulate = 0;
  uint32_t seeded = 0;
  int32_t table = -1;  // these members are as in AdjointMask
  int32_t narrowed = -1;
  uint32_t unread = 0;
  bool gated = false;
  auto operator<=>(const AdjointKey&) const = default;
};
AdjointKey key_of(const AdjointMask& mask);

struct CompiledPlan {
  AdjointKey key;
  AdjointPlan plan;
  std::unique_ptr<Executable> rows, items;
  uint64_t reached = 0;  // sources with a gradient; other gradients are zero
};

struct CompiledTangent {
  explicit CompiledTangent(TangentPlan made) : plan(std::move(made)), code(plan.program) {}
  TangentPlan plan;
  Executable code;
};

struct KernelImpl {
  std::string name;
  std::vector<SourceSpec> sources;
  std::vector<OutputSpec> outputs;
  std::vector<int> param_types;
  ir::Program traced;
  std::unique_ptr<Executable> forward;
  uint64_t hash = 0;
  bool has_fixed_loop = false, has_csr_loop = false;
  int32_t summed_source = -1;  // see ir::Program in ir.h
  bool is_copy = false;        // the kernel only copies its source
  // Sets of gradients that are compiled ahead of time (see with_gradients).
  std::vector<AdjointMask> gradients;
  std::vector<AdjointKey> gradient_keys;

  const CompiledPlan& adjoint(const AdjointKey& key);
  // Returns the plan of the smallest declared set (with_gradients) that has all requested
  // gradients, if one exists. The caller provides zeros and scratch memory for the other gradients
  // of the plan.
  const CompiledPlan& declared_adjoint(const AdjointKey& wanted);
  CompiledTangent& tangent(uint64_t wrt);  // wrt: sources with a tangent, as bits
  // Returns, as bits, the columns of an output's gradient that are not read if the gradients of the
  // sources `wrt` are requested.
  uint32_t unread_columns(uint32_t output, uint64_t wrt);

 private:
  AdjointMask mask_of(const AdjointKey& key) const;
  AdjointKey declared_key(const AdjointKey& wanted) const;

  std::mutex mutex_;
  std::map<AdjointKey, std::unique_ptr<CompiledPlan>> plans_;
  struct Declared {
    AdjointKey wanted;
    const CompiledPlan* plan = nullptr;
  };
  std::map<AdjointKey, Declared> declared_;  // one per requested key
  std::map<uint64_t, std::unique_ptr<CompiledTangent>> tangents_;
  std::map<std::pair<uint64_t, uint32_t>, uint32_t> unread_;  // keyed by wrt and output
  std::atomic<const Declared*> last_{nullptr};  // the last result, since rollouts repeat the same
                                                // request
};

// The argument words of one launch, in the order of <novaphy/abi/program.h>.
class Words {
 public:
  explicit Words(uint32_t count) : count_(count) {
    if (count > kInline) heap_.resize(count);
    data_ = count > kInline ? heap_.data() : inline_;
  }
  void pointer(const void* p) { data_[used_++] = reinterpret_cast<uint64_t>(p); }
  void word(uint64_t w) { data_[used_++] = w; }
  std::span<const uint64_t> span() const { return {data_, used_}; }

 private:
  static constexpr uint32_t kInline = 96;
  uint32_t count_, used_ = 0;
  uint64_t inline_[kInline];
  uint64_t* data_;
  std::vector<uint64_t> heap_;
};

// Returns the accesses of a launch with a CSR loop to offsets and items.
std::array<MemoryAccess, 2> table_accesses(const IncidenceData& csr);

// Runs or captures a kernel with checked operands, and raises the versions of the outputs.
void run_forward(KernelImpl& kernel, int64_t dim, std::span<const Operand> inputs,
                 std::span<const Operand> outputs, std::span<const Param> params,
                 const IncidenceData* csr, int32_t extent, const Operand* active = nullptr);

// Returns the address of the number of rows that a launch with `active` computes.
inline const int32_t* active_count(const Operand* active) {
  return active ? static_cast<const int32_t*>(active->range->data()) : nullptr;
}
// Accesses of a launch besides its sources: CSR rows and the number of active rows.
class ExtraReads {
 public:
  void add(const IncidenceData& csr) {
    for (const MemoryAccess& access : table_accesses(csr)) reads_[count_++] = access;
  }
  void add(const int32_t* active) {
    if (active) reads_[count_++] = {reinterpret_cast<uint64_t>(active), sizeof(int32_t)};
  }
  std::span<const MemoryAccess> span() const { return {reads_.data(), count_}; }

 private:
  std::array<MemoryAccess, 3> reads_;
  size_t count_ = 0;
};

}  // namespace nova::detail
