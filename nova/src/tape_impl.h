// Internal: the data of a tape.
#pragma once

#include <bit>
#include <deque>
#include <functional>
#include <string>
#include <unordered_map>
#include <vector>

#include "kernel_impl.h"
#include "novaphy/core/exclusive_use.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace nova {

namespace detail {
// Computes into += from for all values.
void accumulate(const Operand& into, const Operand& from);
}  // namespace detail

struct Tape::Impl {
  static uint64_t capture_id() {
    const OpList* graph = current_capture();
    return graph ? graph->id() : 0;
  }
  // One input or output of an operation.
  struct Use {
    Operand operand;
    uint64_t version = 0;
    uint64_t capture = 0;  // id of the capture that recorded it, or 0
    uint64_t checksum = 0;
    bool has_checksum = false;  // for memory with a writable export
    bool carries = false;       // whether a gradient flows through it
    int32_t producer = -1;      // in a group: index of the use that writes the value; -1: none
    bool overwritten = false;   // in a group: a later operation overwrites the output
    bool read = false;          // whether the adjoint of a custom operation reads it
  };
  struct Op {
    std::shared_ptr<detail::KernelImpl>
        kernel;  // null: a custom or hand-written operation, or the rebuild of `csr`
    int64_t dim = 0;
    uint32_t first_use = 0, inputs = 0, outputs = 0;
    uint32_t first_param = 0, params = 0;
    int32_t extent = 0;
    int32_t custom = -1;
    int32_t hand_written = -1;
    int32_t group = -1;               // group of recomputed operations; -1: none
    uint64_t capture = capture_id();  // id of the capture that records it, or 0
    int32_t step = -1;                // step of the rollout; -1: none
    bool replayed = false;            // in a group: another operation of the group reads its output
    bool constant = false;            // in a group: no gradient flows through it
    bool has_active = false;  // the use of `active` follows those of the outputs, see active_use
    Incidence csr;            // the uses of its arrays follow those of the outputs, see csr_use
  };
  enum CsrUse : uint32_t { kOffsets, kItems, kTable };
  // marks a table to whose version the rows do not belong
  static constexpr uint64_t kOutdated = UINT64_MAX;
  // The launch of a hand-written kernel in a recomputed group.
  struct HandWritten {
    const novaphy::DeviceContext* context;
    novaphy_kernel* kernel;
    const char* name;
    int64_t n;
    std::vector<uint64_t> words;
    std::vector<detail::MemoryAccess> accesses;
  };
  struct Group {
    uint32_t first = 0, last = 0;  // operations [first, last)
  };
  // The tape's data of one range.
  struct Node {
    std::shared_ptr<Range> range;
    int32_t writer = -1;            // last operation that wrote the range; -1: none
    int32_t group = -1;             // group of that operation
    int32_t written_use = -1;       // in a group: the use that wrote it
    uint64_t written_version = 0;   // version after that write
    uint64_t capture = 0;           // id of the capture that recorded the write, or 0
    uint64_t written_checksum = 0;  // checksum after that write, with a writable export
    bool has_checksum = false;
    bool ever_written = false;        // an operation of this tape wrote it, so it is not a leaf
    bool carries = false;             // a gradient flows through its present value
    uint64_t untracked_version = 0;   // version of a value that the tape did not record
    const char* untracked = nullptr;  // reason why that value may not be an input
    bool set = false;                 // in backward: its gradient has a contribution
    const std::shared_ptr<Range>* place = nullptr;  // in backward: the memory of its gradient
    uint32_t unread = 0;       // in backward: columns of the gradient that no adjoint reads, as
                               // bits
    int32_t unread_width = 0;  // in backward: number of columns that `unread` refers to
    uint64_t read_version =
        0;  // in backward: version of the leaf's value at the first contribution
  };
  // The nodes in the order of their creation, with an open-addressing index keyed by range.
  class NodeTable {
   public:
    Node* find(const Range& range) {
      if (index_.empty()) return nullptr;
      for (size_t at = slot(range);; at = (at + 1) & (index_.size() - 1)) {
        if (index_[at] == 0) return nullptr;
        if (nodes_[index_[at] - 1].range.get() == &range) return &nodes_[index_[at] - 1];
      }
    }
    Node& find_or_add(const std::shared_ptr<Range>& range) {
      if (Node* known = find(*range)) return *known;
      nodes_.push_back({range});
      if (nodes_.size() * 2 > index_.size()) {
        index_.assign(std::bit_ceil(nodes_.size() * 4), 0);
        for (size_t k = 0; k < nodes_.size(); ++k) insert(k);
      } else {
        insert(nodes_.size() - 1);
      }
      return nodes_.back();
    }
    void clear() {
      nodes_.clear();
      std::fill(index_.begin(), index_.end(), 0u);
    }
    auto begin() { return nodes_.begin(); }
    auto end() { return nodes_.end(); }
    size_t size() const { return nodes_.size(); }

   private:
    size_t slot(const Range& range) const {
      const auto key = reinterpret_cast<uintptr_t>(&range);
      return ((key * 0x9E3779B97F4A7C15u) >> 20) & (index_.size() - 1);
    }
    void insert(size_t k) {
      size_t at = slot(*nodes_[k].range);
      while (index_[at] != 0) at = (at + 1) & (index_.size() - 1);
      index_[at] = static_cast<uint32_t>(k + 1);
    }
    std::vector<Node> nodes_;
    std::vector<uint32_t> index_;  // position + 1; 0: free
  };
  struct Value {
    uint64_t version = UINT64_MAX, checksum = 0;
  };
  // One operation of the backward pass. All steps are planned before the first step runs.
  struct Step {
    const Op* op;  // null: the step recomputes a group
    detail::AdjointKey key;
    const detail::CompiledPlan* plan;
    size_t first_place;         // index in `places`: gradients of the outputs, then of the inputs
    int64_t gradient_rows = 0;  // rows of the gradients of the outputs
    int32_t group = -1;
  };
  // Memory for gradients that are not kept, reused after they were read. The pool belongs to one
  // backward pass, because a captured pass keeps its memory.
  class GradientPool {
   public:
    const std::shared_ptr<Range>* take(const Range& like);
    void give_back(const std::shared_ptr<Range>* place);
    void clear();

   private:
    std::deque<std::shared_ptr<Range>> all_;
    std::vector<const std::shared_ptr<Range>*> free_;
  };

  std::vector<Op> ops;
  std::vector<Use> uses;
  std::vector<Param> params;
  std::vector<CustomOp> customs;
  std::vector<HandWritten> hand_written;
  std::vector<Group> groups;
  bool in_group = false;  // whether the last group is still open
  std::vector<std::shared_ptr<const Witness>> witnesses;
  int64_t passes = 0;    // calls of backward
  int32_t of_step = -1;  // see Tape::StepScope
  novaphy::ExclusiveUses group_memory;
  NodeTable nodes;
  // Checksums of values with a writable export: `values` for versions recorded since the last
  // backward, `present` for the versions during backward.
  std::unordered_map<const Range*, Value> values;
  std::unordered_map<const Range*, uint64_t> present;
  bool leaves_only = false;  // KeepGradients::Leaves
  // For the tape of the body of a scan. Its operations are launched again with other values, so the
  // scan, not the versions, says that values are those of the step.
  struct LeafGradient {
    std::shared_ptr<Range> memory;  // the memory of the gradient
    bool held = false;              // whether the memory holds a gradient before the pass
    bool reached = false;           // whether the pass contributes to it
  };
  Tape* outer = nullptr;      // the tape on which the scan is recorded; null: not a body
  bool records_body = false;  // this is the tape of a body that is being recorded
  void check_no_body(const char* call) const {
    novaphy::require(!records_body, novaphy::ErrorKind::NotImplemented, call,
                     ": not supported for the tape of the body of a scan");
  }
  std::unordered_map<const Range*, LeafGradient> leaf_gradients;
  // Data of the last backward pass, kept to reuse its memory.
  std::vector<Step> steps;
  std::vector<const std::shared_ptr<Range>*> places;
  std::vector<GradState> before;  // state of the gradient of every node before the call
  GradientPool pool;
  ScratchMemory scratch;          // scratch of the adjoints
  std::vector<Operand> operands;  // operands of a recomputed operation
  // Ranges that a recomputed group has rewritten with the same bits: the recorded version and the
  // version after that write.
  struct WrittenAgain {
    uint64_t recorded, now;
  };
  std::unordered_map<const Range*, WrittenAgain> written_again;
  // Returns the version under which the tape records the present value of a range.
  uint64_t version_of(const Range& range) const {
    const uint64_t now = range.version();
    if (written_again.empty()) return now;
    const auto at = written_again.find(&range);
    return at != written_again.end() && at->second.now == now ? at->second.recorded : now;
  }

  Node* find(const Range& range) { return nodes.find(range); }
  Node& node(const std::shared_ptr<Range>& range) { return nodes.find_or_add(range); }
  const Use& input(const Op& op, uint32_t k) const { return uses[op.first_use + k]; }
  const Operand& output(const Op& op, uint32_t k) const {
    return uses[op.first_use + op.inputs + k].operand;
  }
  const Use& csr_use(const Op& op, CsrUse k) const {
    return uses[op.first_use + op.inputs + op.outputs + k];
  }
  const Use& active_use(const Op& op) const { return uses[op.first_use + op.inputs + op.outputs]; }
  const Operand* active(const Op& op) const {
    return op.has_active ? &active_use(op).operand : nullptr;
  }
  std::string op_name(const Op& op) const {
    if (op.kernel) return op.kernel->name;
    if (op.custom >= 0) return customs[static_cast<size_t>(op.custom)].name;
    return op.csr ? "rebuild" : hand_written[static_cast<size_t>(op.hand_written)].name;
  }
  std::string input_name(const Op& op, uint32_t k) const;

  bool carries(const Range& range);
  Use& add_use(const Op& op, const Operand& operand);
  // Adds an input to the operation that is being recorded. append() ends the operation.
  Use& add_input(const Op& op, const Operand& operand);
  void append(Op op, bool recorded);
  static void refuse_export_in_capture();
  static uint64_t checksum_now(const Range& range);
  // Computes the checksum of a value with a writable export. Returns false for a value without one,
  // and in a capture, whose launches all read the value at launch time.
  bool note_value(const Range& range, uint64_t capture, uint64_t& checksum) {
    return range.was_exported() && capture == 0 && note_exported_value(range, checksum);
  }
  bool note_exported_value(const Range& range, uint64_t& checksum);
  bool was_written_outside(const Node& n);
  void check_not_overwritten(const Operand& in, const std::string& op, const std::string& input);
  // Returns whether another living tape recorded the value of the range.
  bool is_of_another(const Range& range) const {
    const GradInfo* info = find_grad_info(range);
    return info && info->last_tape && !is_within(info->last_tape) &&
           info->recorded_version == range.version();
  }
  // Returns whether this tape is the tape `impl`, or belongs to a scan on it.
  bool is_within(const void* impl) const {
    return impl == this || (outer && outer->impl_->is_within(impl));
  }
  void check_not_of_another(const Range& range, const std::string& op, const std::string& input);
  // Returns whether the value of an input differs from the recorded one.
  bool was_modified(const Use& use) {
    const Range& range = *use.operand.range;
    if (outer) return false;
    return version_of(range) != use.version ||
           ((use.has_checksum || range.was_exported()) && was_modified_outside(use));
  }
  bool was_modified_outside(const Use& use);
  void check_value(const Use& use, const Op& op, uint32_t input);
  void add_csr(const Op& op);
  static Operand words_of(const std::shared_ptr<Range>& range) {
    return {range, static_cast<int64_t>(range->bytes() / 4), 1, ir::Type::I32};
  }
  void mark_output(const std::shared_ptr<Range>& range, int32_t op);
  void mark_constant(const Range& range);
  void forget();

  // Functions that tape_backward.cpp defines.
  void backward(Node& loss, const Tensor& seed);
  void plan_steps();
  // `loss_gradient` may be null: the gradients from which the pass starts are in their places then.
  // `stop`, if given, is called after every step and ends the pass if it returns true. Steps are
  // then not deferred.
  void run_steps(const std::shared_ptr<Range>& loss_gradient, const Tensor& seed,
                 const std::function<bool(const Step&)>& stop = nullptr);
  using Copies = std::vector<std::pair<std::shared_ptr<Range>, std::shared_ptr<Range>>>;
  // Called after a backward pass on the CPU. `earlier` has copies of the leaf gradients to which
  // the pass added.
  static bool is_finite_where_read(const Range& gradient, const Node& n);
  void report_not_finite(const std::shared_ptr<Range>& loss_gradient, const Tensor& seed,
                         const Copies& earlier);
  const std::shared_ptr<Range>* output_gradient(const Step& step, uint32_t o) const {
    return places[step.first_place + o];
  }
  const std::shared_ptr<Range>* input_gradient(const Step& step, uint32_t s) const {
    return places[step.first_place + step.op->outputs + s];
  }
  bool overwritten_in_group(const Use& use) const {
    return uses[static_cast<size_t>(use.producer)].overwritten;
  }
  void check_csr(const Op& op, std::initializer_list<CsrUse> needed);
  void check_needed(const Use& use, const Op& op, uint32_t input);
  void check_needed(const Op& op, const detail::CompiledPlan& plan);
  void check_group(const Group& group);
  void plan_group(int32_t group);
  void run_group(const Group& group, DeferredScope& deferred);
  void run_again(const Op& op, DeferredScope& deferred);
  std::vector<const Use*> last_written(const Group& group) const;
  bool begin_contribution(Node& n);
  bool begin_in_body(Node& n);  // scan_derivatives.cpp
  int32_t summed_through(size_t k, uint32_t s);
  uint32_t unread_columns(size_t k, const Operand& in);
  bool bound_before(const Op& op, uint32_t s) const;
  void run_kernel(const Step& step);

  // Functions that custom_op.cpp defines.
  void check_read_values(const Op& op);
  void run_custom(const Step& step, DeferredScope& deferred);
  void run_custom_forward(const CustomOp& op, DeferredScope& deferred);
  void run_custom_tangent(const CustomOp& op, std::span<const Tensor> inputs,
                          std::span<const Tensor> outputs);

  class Forward;  // tape_jvp.cpp

  novaphy::ExclusiveUse in_use;  // guards the data of a backward pass
};

}  // namespace nova
