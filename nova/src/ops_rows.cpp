// Functions that read parts of a tensor and join parts: slice, gather, concat. All of them move
// 32-bit words, so the same code serves int32 tensors, without a gradient.
#include <algorithm>
#include <array>
#include <string>

#include "checks.h"
#include "engine_kernels.h"
#include "novaphy/nova/incidence.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "ops_impl.h"

namespace nova {

using detail::Along;
using detail::Gradients;
using detail::InputGradients;
using detail::int_param;
using novaphy::fail;
using novaphy::require;

namespace {

// A map between the entries of a dimension. Entry k of the target is entry (k * times + plus) /
// over of the source, if that is an integer in range. A slice is such a map, and its adjoint is the
// inverse map.
struct EntryMap {
  int64_t times = 1, plus = 0, over = 1;
};

// Copies mapped entries; other entries of the target stay unchanged. Parameters: number of words of
// the inner dimensions; numbers of words from the mapped dimension on, in the target and in the
// source; number of entries of the source; the numbers of the map.
const Kernel& copy_entries_kernel() {
  static const Kernel kernel = make_kernel(
      "copy_entries",
      {{"source", DType::F32, 1, Access::Indexed}, {"before", DType::F32, 1, Access::Direct}},
      {{"out", 1}}, [](TraceContext& c) {
        const Int inner = c.param_i32(0), block = c.param_i32(1), source_block = c.param_i32(2);
        const Int i = c.index(), mapped = i % block / inner * c.param_i32(4) + c.param_i32(5);
        const Int entry = mapped / c.param_i32(6);
        const Bool there =
            both(both(Int(0) <= mapped, entry < c.param_i32(3)), entry * c.param_i32(6) == mapped);
        const Int row = i / block * source_block + entry * inner + i % inner;
        return std::vector{select(there, c.f32(0, select(there, row, Int(-1)), 0), c.f32(1))};
      });
  return kernel;
}

const Kernel& gather_kernel() {
  static const Kernel kernel = make_kernel(
      "gather", {{"index", DType::I32, 1, Access::Indexed}, {"x", DType::F32, 1, Access::Indexed}},
      {{"out", 1}}, [](TraceContext& c) {
        const Int width = c.param_i32(0), i = c.index(), row = c.i32(0, i / width, 0);
        const Bool there = both(Int(0) <= row, row < c.param_i32(1));
        const Int past_the_end = INT32_MAX;  // an index out of range fails the launch
        return std::vector{c.f32(1, select(there, row * width + i % width, past_the_end), 0)};
      });
  return kernel;
}

Operand words_of(const Tensor& x) {
  Operand words = x.flat_operand();
  words.type = ir::Type::F32;
  return words;
}

// Source and target have the same shape except for the mapped dimension.
void copy_entries(const char* call, const Tensor& source, const Tensor& target, const Along& along,
                  const EntryMap& map) {
  const int64_t entries = source.dim(along.axis);
  const Param params[] = {int_param(call, along.inner),
                          int_param(call, target.dim(along.axis) * along.inner),
                          int_param(call, entries * along.inner),
                          int_param(call, entries),
                          int_param(call, map.times),
                          int_param(call, map.plus),
                          int_param(call, map.over)};
  const Operand in[] = {words_of(source), words_of(target)};
  const NoGrad no_grad;
  copy_entries_kernel().launch(target.size(), in, {&in[1], 1}, {.params = params});
}

void check_words(const char* call, const char* name, const Tensor& x) {
  require(x.defined() && x.dtype() != DType::U8, ErrorKind::Type, call, ", ", name,
          ": expected float32 or int32, got ",
          x.defined() ? dtype_name(x.dtype()) : "an undefined tensor");
}

}  // namespace

void detail::add_row_kernels(EngineKernels& list) {
  list.push_back({copy_entries_kernel(), {}});
  list.push_back({gather_kernel(), {}});
}

Tensor slice(const Tensor& x, int64_t axis, int64_t start, int64_t count, int64_t step) {
  check_words("slice", "x", x);
  const Along along = detail::along("slice", x.shape(), axis);
  require(count >= 0 && step != 0, ErrorKind::Value,
          "slice: expected count >= 0 and step != 0, got ", count, " and ", step);
  const auto there = [&](int64_t entry) { return entry >= 0 && entry < along.count; };
  require(count == 0 || (there(start) && there(start + (count - 1) * step)), ErrorKind::Index,
          "slice: expected entries 0 to ", along.count - 1, " along axis ", along.axis, ", got ",
          start, " to ", start + (count - 1) * step);
  Shape shape = x.shape();
  shape[along.axis] = count;
  const Tensor out(shape, x.dtype(), x.device());
  const auto forward = [=] {
    copy_entries("slice", x, out, along, {.times = step, .plus = start});
  };
  forward();
  if (x.dtype() != DType::F32) return out;
  const EntryMap inverse = step > 0 ? EntryMap{1, -start, step} : EntryMap{-1, start, -step};
  detail::record(
      "slice", {x}, out, forward,
      [=, shape = x.shape()](Gradients g, InputGradients to) {
        const Tensor back(shape, DType::F32, g[0].device());
        copy_entries("slice", g[0], back, along, inverse);
        to[0].put(back);
      },
      [=](std::span<const Tensor> t) { return slice(t[0], axis, start, count, step); });
  return out;
}

namespace {

// Returns the first entry out of range, for the error message. In a capture, where the host may not
// read, the result is empty.
std::string wrong_entry(const Tensor& index, int64_t rows) {
  if (current_capture()) return "";
  const std::vector<int32_t> entries = index.to_host_i32();
  for (size_t k = 0; k < entries.size(); ++k)
    if (entries[k] < 0 || entries[k] >= rows)
      return ", got " + std::to_string(entries[k]) + " at entry " + std::to_string(k);
  return "";
}

}  // namespace

Tensor gather(const Tensor& x, const Tensor& index) {
  check_words("gather", "x", x);
  require(index.defined() && index.dtype() == DType::I32, ErrorKind::Type,
          "gather, index: expected int32, got ",
          index.defined() ? dtype_name(index.dtype()) : "an undefined tensor");
  require(x.ndim() > 0, ErrorKind::Value, "gather, x: expected at least one dimension");
  Shape shape = index.shape();
  shape.insert(shape.end(), x.shape().begin() + 1, x.shape().end());
  const Tensor out(shape, x.dtype(), x.device());
  const int32_t width = x.row_width();
  const std::array params = {Param(width), int_param("gather", x.rows())};
  const std::array in = {index.flat_operand(), words_of(x)};
  const auto forward = [=] {
    const NoGrad no_grad;
    gather_kernel().launch(out.size(), in, words_of(out), {.params = params});
  };
  const Tape* tape = Tape::active();
  const bool followed =
      tape != nullptr && x.dtype() == DType::F32 && tape->must_record({&in[1], 1});
  Incidence incidence;
  try {
    forward();
    if (followed) incidence = cached_incidence(in[0], x.rows());
  } catch (const novaphy::Error& error) {
    if (error.kind() != ErrorKind::Index) throw;
    fail(ErrorKind::Index, "gather, index: expected rows 0 to ", x.rows() - 1, " of x",
         wrong_entry(index, x.rows()));
  }
  if (OpList* graph = current_capture()) graph->freeze(index.range());
  if (x.dtype() != DType::F32) return out;
  detail::record(
      "gather", {x}, out, forward,
      [=, entries = in[0].rows, shape = x.shape()](Gradients g, InputGradients to) {
        const Tensor back(shape, DType::F32, g[0].device());
        row_sum({g[0].range(), entries, width}, *incidence, nullptr, back.operand());
        to[0].put(back);
      },
      [index](std::span<const Tensor> t) { return gather(t[0], index); }, {index});
  return out;
}

Tensor concat(std::span<const Tensor> parts, int64_t axis) {
  require(!parts.empty(), ErrorKind::Value, "concat, parts: expected at least one tensor");
  check_words("concat", "parts[0]", parts[0]);
  Along along = detail::along("concat", parts[0].shape(), axis);
  constexpr size_t kMost = 64;  // largest number of inputs of an operation on a tape
  if (parts.size() > kMost) {
    std::vector<Tensor> joined;
    for (size_t k = 0; k < parts.size(); k += kMost)
      joined.push_back(concat(parts.subspan(k, std::min(kMost, parts.size() - k)), axis));
    return concat(joined, axis);
  }
  Shape shape = parts[0].shape();
  shape[along.axis] = 0;
  for (size_t k = 0; k < parts.size(); ++k) {
    const Tensor& part = parts[k];
    const std::string name = "parts[" + std::to_string(k) + "]";
    check_words("concat", name.c_str(), part);
    Shape other = part.shape();
    if (other.size() == shape.size()) other[along.axis] = shape[along.axis];
    require(
        other == shape && part.dtype() == parts[0].dtype() && part.device() == parts[0].device(),
        ErrorKind::Value, "concat, ", name, ": expected ", shape_str(parts[0].shape()),
        " but for axis ", along.axis, ", ", dtype_name(parts[0].dtype()), " on ",
        parts[0].device().str(), ", got ", shape_str(part.shape()), " ", dtype_name(part.dtype()),
        " on ", part.device().str());
    shape[along.axis] += part.dim(along.axis);
  }
  const Tensor out(shape, parts[0].dtype(), parts[0].device());
  std::vector<int64_t> first{0};  // first entry of each part, and the end
  for (const Tensor& part : parts) first.push_back(first.back() + part.dim(along.axis));
  const std::vector<Tensor> inputs(parts.begin(), parts.end());
  const auto forward = [=] {
    for (size_t k = 0; k < inputs.size(); ++k)
      copy_entries("concat", inputs[k], out, along, {.plus = -first[k]});
  };
  forward();
  if (out.dtype() != DType::F32) return out;
  const auto vjp = [along, first](Gradients g, InputGradients to) {
    for (size_t k = 0; k < to.size(); ++k)
      if (to[k].wanted())
        to[k].put(slice(g[0], static_cast<int64_t>(along.axis), first[k], first[k + 1] - first[k]));
  };
  const auto tangent = [axis, inputs](std::span<const Tensor> t) {
    std::vector<Tensor> all(t.begin(), t.end());
    for (size_t k = 0; k < all.size(); ++k)
      if (!all[k].defined()) all[k] = Tensor(inputs[k].shape(), DType::F32, inputs[k].device());
    return concat(all, axis);
  };
  detail::record("concat", inputs, out, forward, vjp, tangent);
  return out;
}

Tensor stack(std::span<const Tensor> parts, int64_t axis) {
  require(!parts.empty(), ErrorKind::Value, "stack, parts: expected at least one tensor");
  check_words("stack", "parts[0]", parts[0]);
  const Shape& shape = parts[0].shape();
  const auto ndim = static_cast<int64_t>(shape.size());
  require(axis >= -ndim - 1 && axis <= ndim, ErrorKind::Index, "stack, axis: expected ", -ndim - 1,
          " to ", ndim, " for tensors of shape ", shape_str(shape), ", got ", axis);
  if (axis < 0) axis += ndim + 1;
  Shape with_one = shape;
  with_one.insert(with_one.begin() + axis, 1);
  std::vector<Tensor> rows;
  for (size_t k = 0; k < parts.size(); ++k) {
    require(parts[k].defined() && parts[k].shape() == shape, ErrorKind::Value, "stack, parts[", k,
            "]: expected the shape of parts[0], ", shape_str(shape), ", got ",
            parts[k].defined() ? shape_str(parts[k].shape()) : "an undefined tensor");
    rows.push_back(parts[k].reshape(with_one));
  }
  return concat(rows, axis);
}

Tensor transpose(const Tensor& x, std::span<const int64_t> axes) {
  check_words("transpose", "x", x);
  const size_t ndim = x.ndim();
  std::vector<size_t> from(ndim, ndim);  // dimension of x that becomes dimension k
  require(axes.empty() || axes.size() == ndim, ErrorKind::Value, "transpose, axes: expected ", ndim,
          " for shape ", shape_str(x.shape()), ", got ", axes.size());
  for (size_t k = 0; k < ndim; ++k)
    from[k] = axes.empty() ? ndim - 1 - k : detail::along("transpose", x.shape(), axes[k]).axis;
  for (size_t d = 0; d < ndim; ++d)
    require(std::count(from.begin(), from.end(), d) == 1, ErrorKind::Value,
            "transpose, axes: expected every dimension once, got dimension ", d, " ",
            std::count(from.begin(), from.end(), d), " times");
  if (ndim < 2) return x;
  Shape shape;
  std::vector<int64_t> stride(ndim), inner(ndim, 1);
  for (size_t d = ndim - 1; d > 0; --d) inner[d - 1] = inner[d] * x.dim(d);
  for (size_t k = 0; k < ndim; ++k) {
    shape.push_back(x.dim(from[k]));
    stride[k] = inner[from[k]];
  }
  if (x.size() == 0) return Tensor(shape, x.dtype(), x.device());
  (void)int_param("transpose", x.size());
  std::vector<int32_t> entries(static_cast<size_t>(x.size()));
  std::vector<int64_t> at(ndim, 0);  // index of an entry of the result
  for (int32_t& entry : entries) {
    int64_t place = 0;
    for (size_t k = 0; k < ndim; ++k) place += at[k] * stride[k];
    entry = static_cast<int32_t>(place);
    for (size_t k = ndim; k > 0 && ++at[k - 1] == shape[k - 1]; --k) at[k - 1] = 0;
  }
  const Tensor index = [&] {
    const novaphy::UntrackedScope fresh;  // a capture does not know this memory yet
    return Tensor::from_host(entries, shape, x.device());
  }();
  return gather(x.reshape({x.size()}), index);
}

}  // namespace nova
