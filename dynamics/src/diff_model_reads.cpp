#include "novaphy/dynamics/diff_model_reads.h"

#include "novaphy/dynamics/diff_operators.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {
namespace {

template <class Rule>
const nova::Kernel& rule_kernel() {
  static const nova::Kernel kernel = nova::make_kernel(
      Rule::name, {{"source", nova::DType::F32, Rule::source_width, nova::Access::Direct}},
      {{"derived", Rule::derived_width}}, [](nova::TraceContext& c) {
        std::vector<nova::Real> source, derived(static_cast<size_t>(Rule::derived_width));
        for (int32_t k = 0; k < Rule::source_width; ++k) source.push_back(c.f32(0, k));
        Rule{}(source.data(), derived.data());
        return derived;
      });
  return kernel;
}

// Runs outside of any tape: the kernels that read a derived array pass its gradient to the source
// array.
template <class Rule>
void launch(const Rule&, const Array& source, const Array& derived) {
  const nova::NoGrad no_grad;
  const nova::Operand in = nova::operand_of(source), out = nova::operand_of(derived);
  rule_kernel<Rule>().launch(in.rows, in, out);
}

// Throws if a derived array is a leaf, because its gradient would stay 0.
void check_leaves(const Model& model) {
  const auto check = [](const Array& derived, const char* name, const char* source) {
    const nova::GradInfo* info =
        derived.rows() != 0 ? nova::find_grad_info(*derived.range()) : nullptr;
    require(info == nullptr || !info->requires_grad, ErrorKind::NotImplemented, "model.", name,
            ": it follows model.", source, ", and so does its gradient; set requires_grad there");
  };
#define NOVAPHY_CHECK_LEAF(derived, source, rule) check(model.derived, #derived, #source);
  NOVAPHY_DERIVED_MODEL_FIELDS(NOVAPHY_CHECK_LEAF)
#undef NOVAPHY_CHECK_LEAF
}

void update_derived(const Model& model) {
  model.update_derived([](const auto& rule, const Array& source, const Array& derived) {
    launch(rule, source, derived);
    return nova::current_capture() == nullptr;
  });
}

}  // namespace

void detail::add_derived_kernels(std::vector<nova::EngineKernel>& list) {
#define NOVAPHY_ADD_RULE(derived, source, rule) list.push_back({rule_kernel<rule>(), {}});
  NOVAPHY_DERIVED_MODEL_FIELDS(NOVAPHY_ADD_RULE)
#undef NOVAPHY_ADD_RULE
}

void begin_model_reads(const Model& model, const char* function) {
  model.check_numbers(function);
  model.check_structure(function);
  if (nova::Tape::active() != nullptr) check_leaves(model);
  update_derived(model);
  model.depend_on_numbers();
  if (nova::OpList* list = nova::current_capture())
    list->before_launch(model.shared_from_this(), [&model] { update_derived(model); });
}

void check_no_gradient(const char* solver, std::initializer_list<NamedArray> arrays,
                       const char* owner) {
  const nova::Tape* const tape = nova::Tape::active();
  if (tape == nullptr) return;
  for (const NamedArray& a : arrays)
    require(a.array.rows() == 0 || !tape->carries_gradient(*a.array.range()),
            ErrorKind::NotImplemented, solver, ": ", owner, a.name,
            ": expected requires_grad False, because no gradient reaches it, got True");
}

void check_other_gradients(const char* solver, const Model& model, const Control* control,
                           const Contacts* contacts,
                           const std::function<bool(std::string_view)>& has_gradient) {
  const nova::Tape* const tape = nova::Tape::active();
  if (tape == nullptr) return;
  const auto check = [&](const char* owner, const auto& object, auto... passed_over) {
    for_each_field(object, [&](const FieldInfo& info, const Array& array) {
      if (array.rows() == 0 || !tape->carries_gradient(*array.range())) return;
      const bool is_passed_over = ((info.name == passed_over) || ...);
      require(is_passed_over || has_gradient(info.name), ErrorKind::NotImplemented, solver, ": ",
              owner, info.name,
              ": expected requires_grad False, because no gradient reaches it, got True");
    });
  };
  check("model.", model, "particle_q", "particle_qd", "body_q", "body_qd", "joint_q", "joint_qd",
        "act");
  if (control != nullptr) check("control.", *control);
  if (contacts != nullptr) check("contacts.", *contacts);
}

void update_inverse_mass(Model& model) {
  launch(InverseOrZero{}, model.particle_mass, model.particle_inv_mass);
}

}  // namespace novaphy::diff
