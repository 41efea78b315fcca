// Internal: the recorded body of a scan, its launches over all steps, and those of its derivatives.
#pragma once

#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "novaphy/nova/custom_op.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/scan.h"
#include "tape_impl.h"

namespace nova {

class Tape::ScanBody : public std::enable_shared_from_this<Tape::ScanBody> {
 public:
  // Records the body. On an active tape, the operations of the body are recorded on a tape of their
  // own, as one group of recomputed operations, which records constants too.
  ScanBody(const ScanFn& body, const std::vector<Tensor>& carry, const std::vector<Tensor>& xs,
           int64_t steps);
  // Runs all steps, and records the scan on the tape.
  ScanResult run();

 private:
  // The recorded launches of one step of the backward pass.
  struct Pass {
    std::shared_ptr<OpList> list;
    uint64_t reached = 0;  // leaves to which the step contributes, as bits
  };

  void record(const ScanFn& body);
  void check_carry(const ScanResult& result) const;
  void own(std::vector<Tensor>& results) const;
  void check_writes() const;
  // Finds the values from outside that the recorded operations read.
  void find_reads();
  void add_read(const Impl::Use& use);
  bool is_argument(const Range& range) const;
  void separate_inputs();
  CustomOp custom_op();

  void forward();
  void clear_gradients() const;
  void load(int64_t step) const;  // writes the arguments of a step; throws if interrupted

  // These functions are in scan_derivatives.cpp.
  void backward(std::span<const Tensor> outputs, std::span<const InputGradient> inputs);
  void store_row_gradients(const Pass& pass, std::span<const InputGradient> inputs, int64_t step);
  void store_gradients(std::span<const InputGradient> inputs, uint64_t held) const;
  const Pass& pass(uint32_t seeded, uint64_t held);
  void tangent(std::span<const Tensor> inputs, std::span<const Tensor> outputs);
  void record_tangent();

  size_t rows_of(size_t leaf) const { return leaf - carry_.size(); }  // index in moving_rows_

  const int64_t steps_;
  std::vector<Tensor> init_, xs_;    // arguments of the scan
  std::vector<Tensor> carry_, x_;    // arguments of the body
  std::vector<Tensor> next_, y_;     // results of the body
  std::vector<Tensor> last_, ys_;    // results of the scan
  std::vector<Tensor> history_;      // the carry before each step, if a tape records the scan
  std::shared_ptr<OpList> list_;     // the launches of a step
  std::unique_ptr<Tape> tape_;       // null: no tape records the scan
  std::vector<size_t> moving_rows_;  // the xs that carry a gradient
  std::vector<Tensor> outside_;      // values from outside that carry a gradient
  std::vector<Tensor> constants_;    // other values from outside
  // The leaves are the carry, the rows of moving_rows_, and outside_. The inputs of the operation
  // are in the same order.
  std::vector<Tensor> leaves_;
  std::vector<Tensor> places_;         // the gradient or tangent of each leaf in a step
  std::vector<Tensor> seeds_;          // the gradient of each result of the body
  std::vector<Tensor> row_gradients_;  // of each of moving_rows_, if it adds to another gradient
  std::map<std::pair<uint32_t, uint64_t>, Pass> passes_;
  std::shared_ptr<OpList> tangent_list_;
  std::vector<Tensor> next_tangents_;  // of the results of the body; undefined: zero
};

namespace detail {
// Submits a copy of row `from_row` to row `to_row`, where a row has the size of the tensor `row`.
void copy_row(const Tensor& row, const Tensor& to, int64_t to_row, const Tensor& from,
              int64_t from_row);
}  // namespace detail

}  // namespace nova
