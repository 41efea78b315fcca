// Converts a Program to the flat list of instructions that the interpreter on the device runs.
#include <algorithm>

#include "interpreter.h"

namespace novaphy::gpu {
namespace {

namespace ir = nova::ir;
using ir::Op;

size_t at(int32_t k) { return static_cast<size_t>(k); }
InterpreterInstruction make(InterpreterOp op) { return {static_cast<int32_t>(op)}; }

// Values are the instructions of the Program, followed by the accumulators of its sums.
class Encoder {
 public:
  explicit Encoder(const ir::Program& program)
      : p_(program), next_(static_cast<int32_t>(program.instrs.size())) {
    for (const ir::Loop& loop : p_.loops) {
      accumulators_.push_back(next_);
      next_ += static_cast<int32_t>(loop.sums.size());
    }
    lives_.resize(at(next_));
  }

  InterpreterCode run() {
    const std::vector<ir::Step> steps = ir::schedule(p_);
    std::vector<int32_t> first_of_step;  // first instruction of each step
    std::vector<std::pair<size_t, int32_t>> skips;
    for (const ir::Step& step : steps) {
      first_of_step.push_back(here());
      switch (step.kind) {
        case ir::Step::Kind::Compute:
          compute(step.value);
          break;
        case ir::Step::Kind::SkipIfNone: {
          InterpreterInstruction skip = make(InterpreterOp::SKIP);
          skip.b = step.polarity ? 1 : 0;
          skips.emplace_back(out_.instructions.size(), step.target);
          add(skip, {step.value}, ir::kNone);
          break;
        }
        case ir::Step::Kind::LoopBegin:
          loop_begin(step.value);
          break;
        case ir::Step::Kind::LoopEnd:
          loop_end(step.value);
          break;
      }
    }
    first_of_step.push_back(here());
    for (const auto& [k, target] : skips) out_.instructions[k].c = first_of_step[at(target)];
    stores();
    add(make(InterpreterOp::END), {}, ir::kNone);
    place();
    return std::move(out_);
  }

 private:
  struct Life {
    int32_t first = -1, last = -1;  // first and last instruction that uses the value
  };
  struct Operands {
    int32_t d = ir::kNone, used[3] = {ir::kNone, ir::kNone, ir::kNone};
  };

  int32_t here() const { return static_cast<int32_t>(out_.instructions.size()); }

  // Appends an instruction. `used` are those of the operands a, b and c that are values.
  void add(InterpreterInstruction in, std::initializer_list<ir::Value> used, ir::Value made) {
    Operands operands;
    operands.d = made;
    std::copy(used.begin(), used.end(), operands.used);
    out_.instructions.push_back(in);
    operands_.push_back(operands);
  }

  void compute(ir::Value v) {
    const ir::Instr& in = p_.instrs[at(v)];
    InterpreterInstruction out{static_cast<int32_t>(in.op)};
    switch (in.op) {
      case Op::CONST_F:
      case Op::CONST_I:
      case Op::CONST_B:
        out.a = in.a;
        return add(out, {}, v);
      case Op::PARAM_F:
      case Op::PARAM_I:
        out.a = static_cast<int32_t>(p_.param_argument(at(in.a)));
        return add(out, {}, v);
      case Op::INDEX:
      case Op::REDUCE_INDEX:
      case Op::SLOT:
        return add(out, {}, v);
      case Op::SUM:
        return add(make(InterpreterOp::MOVE), {accumulators_[at(in.a)] + in.b}, v);
      case Op::F_BITS:
      case Op::BITS_F:
        return add(make(InterpreterOp::MOVE), {in.a}, v);
      case Op::LOAD_F:
      case Op::LOAD_I: {
        const bool own = p_.instrs[at(in.b)].op == Op::INDEX;
        out = make(own ? InterpreterOp::LOAD_OWN : InterpreterOp::LOAD);
        out.a = in.a;
        out.c = in.c;
        out.e = p_.sources[at(in.a)].width;
        return add(out, {ir::kNone, own ? ir::kNone : in.b}, v);
      }
      case Op::SELECT_F:
      case Op::SELECT_I:
      case Op::SELECT_B:
        return add(make(InterpreterOp::SELECT), {in.a, in.b, in.c}, v);
      default: {
        ir::Value used[3] = {ir::kNone, ir::kNone, ir::kNone};
        size_t count = 0;
        ir::for_each_operand(in, [&](ir::Value o) { used[count++] = o; });
        return add(out, {used[0], used[1], used[2]}, v);
      }
    }
  }

  void loop_begin(int32_t l) {
    const ir::Loop& loop = p_.loops[at(l)];
    for (size_t s = 0; s < loop.sums.size(); ++s)
      add(make(InterpreterOp::MOVE), {loop.sums[s].init},
          accumulators_[at(l)] + static_cast<int32_t>(s));
    InterpreterInstruction in = make(InterpreterOp::LOOP);
    in.b = loop.kind == ir::LoopKind::Csr ? 1 : 0;
    in.a = static_cast<int32_t>(in.b != 0 ? p_.loop_argument(at(l))
                                          : p_.param_argument(at(loop.extent_param)));
    begin_ = here();
    add(in, {}, ir::kNone);
  }

  void loop_end(int32_t l) {
    const ir::Loop& loop = p_.loops[at(l)];
    for (size_t s = 0; s < loop.sums.size(); ++s) {
      const ir::Value sum = accumulators_[at(l)] + static_cast<int32_t>(s);
      add({static_cast<int32_t>(Op::ADD)}, {sum, loop.sums[s].term}, sum);
    }
    InterpreterInstruction in = make(InterpreterOp::AGAIN);
    in.c = begin_ + 1;
    loops_.emplace_back(begin_, here());
    add(in, {}, ir::kNone);
    out_.instructions[at(begin_)].c = here();
  }

  void stores() {
    for (size_t o = 0; o < p_.outputs.size(); ++o)
      for (size_t column = 0; column < p_.outputs[o].values.size(); ++column) {
        InterpreterInstruction in = make(InterpreterOp::STORE);
        in.a = static_cast<int32_t>(p_.output_argument(o));
        in.c = static_cast<int32_t>(column);
        in.e = static_cast<int32_t>(p_.outputs[o].values.size());
        add(in, {ir::kNone, p_.outputs[o].values[column]}, ir::kNone);
      }
  }

  // A value is live from the instruction that first defines it to its last use. A value from before
  // a loop is used in every iteration.
  void find_lives() {
    for (int32_t k = 0; k < here(); ++k) {
      const Operands& operands = operands_[at(k)];
      for (const ir::Value v : operands.used) {
        if (v == ir::kNone) continue;
        int32_t last = k;
        for (const auto& [begin, end] : loops_)
          if (k > begin && k < end && lives_[at(v)].first < begin) last = end;
        lives_[at(v)].last = std::max(lives_[at(v)].last, last);
      }
      if (operands.d == ir::kNone) continue;
      Life& life = lives_[at(operands.d)];
      if (life.first < 0) life.first = k;
      life.last = std::max(life.last, k);
    }
  }

  // Assigns a word to each value. An instruction reads its operands before it writes its result, so
  // the result may take the word of an operand.
  void place() {
    find_lives();
    std::vector<std::vector<ir::Value>> dying(out_.instructions.size());
    for (int32_t v = 0; v < next_; ++v)
      if (lives_[at(v)].first >= 0) dying[at(lives_[at(v)].last)].push_back(v);
    std::vector<int32_t> word(at(next_), -1), free;
    for (int32_t k = 0; k < here(); ++k) {
      InterpreterInstruction& in = out_.instructions[at(k)];
      const Operands& operands = operands_[at(k)];
      int32_t* const places[3] = {&in.a, &in.b, &in.c};
      for (size_t j = 0; j < 3; ++j)
        if (operands.used[j] != ir::kNone) *places[j] = word[at(operands.used[j])];
      for (const ir::Value v : dying[at(k)])
        if (word[at(v)] >= 0) free.push_back(word[at(v)]);
      if (operands.d == ir::kNone) continue;
      int32_t& mine = word[at(operands.d)];
      if (mine < 0) {
        if (free.empty()) free.push_back(out_.values++);
        mine = free.back();
        free.pop_back();
        if (lives_[at(operands.d)].last == k) free.push_back(mine);  // the result is never used
      }
      in.d = mine;
    }
  }

  const ir::Program& p_;
  int32_t next_;
  std::vector<int32_t> accumulators_;  // first accumulator of each loop
  InterpreterCode out_;
  std::vector<Operands> operands_;                  // operands of each instruction
  std::vector<Life> lives_;                         // lifetime of each value
  std::vector<std::pair<int32_t, int32_t>> loops_;  // instructions LOOP and AGAIN of each loop
  int32_t begin_ = 0;
};

}  // namespace

InterpreterCode interpreter_code(const ir::Program& program) { return Encoder(program).run(); }

}  // namespace novaphy::gpu
