#include "novaphy/core/sim/trajectory.h"

#include <algorithm>
#include <utility>

#include "novaphy/core/error.h"

namespace novaphy {

namespace {

// Returns the rows [k*n, (k + 1)*n) of an array as a view.
Array part(const Array& whole, size_t k, size_t n) {
  const size_t bytes = n * whole.width() * dtype_info(whole.dtype()).bytes;
  return {whole.dtype(), n, whole.width(), whole.range()->storage().range(k * bytes, bytes)};
}

int32_t stored_states(int32_t steps, int32_t interval) {
  return steps / interval + 1 + (steps % interval != 0 ? 1 : 0);
}
int32_t shared_states(int32_t steps, int32_t interval) {
  return steps == 0 ? 0 : std::min(interval, steps) - 1;
}

// Calls f(a, b) for each pair of arrays of two states that have the given role.
template <class F>
void for_each_pair(FieldRole role, const StateFields& a, StateFields& b, F&& f) {
  const auto from = detail::const_fields(a);
  const auto to = detail::mutable_fields(b);
  for (size_t k = 0; k < from.size(); ++k)
    if (from[k].info.role == role) f(*from[k].array, *to[k].array);
}

// Returns the versions of the arrays with FieldRole::Carried.
std::vector<uint64_t> versions(const StateFields& fields) {
  std::vector<uint64_t> found;
  for (const auto& [info, array] : detail::const_fields(fields))
    if (info.role == FieldRole::Carried)
      found.push_back(array->bytes() == 0 ? 0 : array->range()->version());
  return found;
}

bool same_bits(const Array& a, const Array& b) {
  std::vector<unsigned char> x(a.bytes()), y(b.bytes());
  a.copy_to_host(x.data(), x.size());
  b.copy_to_host(y.data(), y.size());
  return x == y;
}

}  // namespace

Trajectory::Trajectory(std::shared_ptr<const Model> model, int32_t steps, bool requires_grad,
                       int32_t checkpoint_interval)
    : model_(std::move(model)), steps_(steps), interval_(checkpoint_interval) {
  require(model_ != nullptr, ErrorKind::Value, "Trajectory, model: expected a model, got none");
  require(steps >= 0 && steps < INT32_MAX, ErrorKind::Value,
          "Trajectory, steps: expected 0 to 2147483646, got ", steps);
  require(interval_ >= 1, ErrorKind::Value,
          "Trajectory, checkpoint: expected an interval >= 1, got ", interval_);
  applied_.allocate(model_->counts(), model_->device());
  kept_ = make_states(stored_states(steps, interval_));
  between_ = make_states(shared_states(steps, interval_));
  for (States* part : {&kept_, &between_})
    for (SimState& state : part->states) state.requires_grad = requires_grad;
  for_each_pair(FieldRole::Applied, applied_, kept_.states[0],
                [](const Array& shared, Array& first) { first = shared; });
  const SimState initial = model_->state();
  for_each_pair(FieldRole::Carried, initial, kept_.states[0],
                [](const Array& from, Array& to) { to.assign(from); });
}

Trajectory::States Trajectory::make_states(int32_t count) const {
  const auto n = static_cast<size_t>(count);
  const std::vector<size_t> rows = StateFields::expected_rows(model_->counts());
  States made;
  made.whole = applied_;
  const auto wholes = detail::mutable_fields(made.whole);
  try {
    for (size_t k = 0; k < wholes.size(); ++k)
      if (wholes[k].info.role == FieldRole::Carried)
        *wholes[k].array =
            Array(wholes[k].info.dtype, n * rows[k], model_->device(), wholes[k].info.width);
  } catch (const Error& error) {
    fail(error.kind(), "Trajectory, steps: no memory for ", n, " states (", error.what(),
         "); a checkpoint interval keeps fewer states");
  }
  for (size_t t = 0; t < n; ++t) {
    StateFields fields = made.whole;
    const auto parts = detail::mutable_fields(fields);
    for (size_t k = 0; k < parts.size(); ++k)
      *parts[k].array = parts[k].info.role == FieldRole::Carried
                            ? part(*wholes[k].array, t, rows[k])
                            : parts[k].array->read_only(
                                  "the states of a Trajectory share their force, which is written "
                                  "through state 0 and acts in every step; for forces that change "
                                  "over time pass forces to rollout");
    made.states.emplace_back(*model_, std::move(fields));
  }
  return made;
}

std::vector<std::vector<Array>> make_scratch(const std::vector<ScratchSpec>& specs, int32_t count,
                                             Device device) {
  std::vector<std::vector<Array>> sets(static_cast<size_t>(count));
  for (const ScratchSpec& spec : specs) {
    const Array whole(spec.dtype, sets.size() * spec.rows, device, spec.width);
    for (size_t t = 0; t < sets.size(); ++t) sets[t].push_back(part(whole, t, spec.rows));
  }
  return sets;
}

void Trajectory::reserve_scratch(const std::vector<ScratchSpec>& specs) {
  if (specs == scratch_.specs && !scratch_.sets.empty()) return;
  const int32_t count = interval_ == 1 ? steps_ : std::min(interval_, steps_);
  scratch_ = {specs, make_scratch(specs, count, model_->device())};
}

void Trajectory::set_last_rollout(int32_t start, int32_t stop, StepFn step) {
  ran_from_ = start;
  ran_to_ = stop;
  step_ = std::move(step);
}

SimState& Trajectory::any_state(int32_t t) {
  if (!keeps(t)) return between_.states[static_cast<size_t>(t % interval_) - 1];
  return t == steps_ ? kept_.states.back() : kept_.states[static_cast<size_t>(t / interval_)];
}

std::string Trajectory::stored_text() const {
  const std::string last = std::to_string(steps_);
  if (interval_ >= steps_) return "0 and " + last;
  if (2 * int64_t{interval_} >= steps_) return "0, " + std::to_string(interval_) + " and " + last;
  return "0, " + std::to_string(interval_) + ", " + std::to_string(2 * interval_) + ", ... and " +
         last;
}

SimState& Trajectory::state(int32_t t) {
  require(t >= 0 && t <= steps(), ErrorKind::Index, "Trajectory: expected 0 <= t <= ", steps(),
          ", got ", t);
  if (!keeps(t)) [[unlikely]]
    fail(ErrorKind::Runtime, "Trajectory: state ", t,
         " is not kept, but those of t = ", stored_text(), " are (checkpoint interval ", interval_,
         "); recompute(", t, ") gives it");
  return any_state(t);
}
const SimState& Trajectory::state(int32_t t) const {
  return const_cast<Trajectory*>(this)->state(t);
}

SimState Trajectory::recompute(int32_t t) const {
  require(t >= 0 && t <= steps(), ErrorKind::Index,
          "Trajectory.recompute: expected 0 <= t <= ", steps(), ", got ", t);
  if (ArrayObserver* observer = array_observer()) observer->host_read("Trajectory.recompute");
  const UntrackedScope untracked;
  if (keeps(t)) return state(t).clone();
  require(static_cast<bool>(step_), ErrorKind::Runtime,
          "Trajectory.recompute: there was no rollout yet");
  const int32_t first = t / interval_ * interval_, last = std::min(first + interval_, steps_);
  require(first >= ran_from_ && last <= ran_to_, ErrorKind::Runtime, "Trajectory.recompute: state ",
          t, " was not computed by the last rollout, which ran the steps from state ", ran_from_,
          " to state ", ran_to_);
  // The states begin with zeros, as the states of a rollout do: rows that steps do not write are 0.
  const SimState start = state(first).clone();
  SimState now = start.clone(), next = start.clone(), wanted = start.clone();
  for (SimState* made : {&now, &next})
    for_each_pair(FieldRole::Carried, start, *made,
                  [](const Array&, Array& array) { array.zero(); });
  const std::vector<uint64_t> untouched = versions(next);
  std::vector<uint64_t> touched;  // versions after the first step
  for (int32_t k = first; k < last; ++k) {
    step_(k, k == first ? start : now, next);
    std::swap(now, next);
    if (k == first) touched = versions(now);
    if (k + 1 == t) wanted.assign(now);
  }
  size_t field = 0;
  for_each_pair(FieldRole::Carried, state(last), now, [&](const Array& kept, const Array& again) {
    const bool written = touched[field] != untouched[field];
    ++field;
    require(!written || same_bits(kept, again), ErrorKind::Runtime,
            "Trajectory.recompute: running from state ", first, " does not lead to the kept state ",
            last,
            " again; the states, or what the rollout read (model, contacts, control, forces), were "
            "changed");
  });
  return wanted;
}

int32_t checkpoint_interval_for(const Model& model, int32_t steps, uint64_t bytes) {
  require(steps >= 0, ErrorKind::Value, "Trajectory, steps: expected >= 0, got ", steps);
  uint64_t state_bytes = 0;
  const std::vector<size_t> rows = StateFields::expected_rows(model.counts());
  size_t k = 0;
  for (const FieldInfo& info : field_infos<SimState>()) {
    const size_t n = rows[k++];
    if (info.role == FieldRole::Carried)
      state_bytes += uint64_t{n} * info.width * dtype_info(info.dtype).bytes;
  }
  uint64_t least = UINT64_MAX;
  for (int32_t interval = 1; interval <= std::max(1, steps); ++interval) {
    const auto states =
        static_cast<uint64_t>(stored_states(steps, interval) + shared_states(steps, interval));
    least = std::min(least, states * state_bytes);
    if (states * state_bytes <= bytes) return interval;
  }
  fail(ErrorKind::Value, "Trajectory, checkpoint: the states need at least ", least,
       " bytes, allowed are ", bytes);
}

}  // namespace novaphy
