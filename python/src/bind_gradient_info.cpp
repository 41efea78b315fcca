#include <string>
#include <utility>

#include "convert.h"
#include "doc_gradient_info.h"
#include "gradient_info.h"

namespace novaphy::python {

namespace {

py::object there(double x) { return x == x ? py::object(py::float_(x)) : py::none(); }
py::list rows_of(const MotionEvents& events) {
  static constexpr const char* kKinds[] = {"bounce", "landing", "spring", "limit"};
  static constexpr const char* kFriction[] = {"none", "sticks", "slides", "turns"};
  py::list rows;
  for (const auto& e : events)
    rows.append(py::dict("step"_a = e->step, "time"_a = e->time, "world"_a = e->world,
                         "shape0"_a = e->shape0, "shape1"_a = e->shape1, "particle"_a = e->particle,
                         "joint"_a = e->joint, "kind"_a = kKinds[static_cast<size_t>(e->kind)],
                         "approach"_a = e->approach, "phase"_a = e->phase,
                         "friction"_a = kFriction[static_cast<size_t>(e->friction)],
                         "h_before"_a = there(e->h_before), "h_after"_a = there(e->h_after)));
  return rows;
}

}  // namespace

GradientInfoFields to_fields(const GradientInfo& i, const py::dict& more) {
  py::dict fields(
      "label"_a = i.label, "reason"_a = i.reason, "steps"_a = i.steps,
      "exact_steps"_a = i.exact_steps, "frozen_steps"_a = i.frozen_steps,
      "surrogate_steps"_a = i.surrogate_steps, "events"_a = i.events, "began"_a = i.began,
      "ended"_a = i.ended, "turned"_a = i.turned, "several"_a = i.several,
      "one_sided"_a = i.one_sided, "ramp_steps"_a = i.ramp_steps, "landings"_a = i.landings,
      "phased"_a = i.phased, "searched"_a = i.searched, "lost_events"_a = i.lost_events,
      "least_approach"_a = i.least_approach, "least_separation"_a = i.least_separation,
      "steps_per_contact"_a = i.steps_per_contact,
      "event_list"_a = rows_of(i.event_list), "residual"_a = i.residual,
      "h_drift"_a = there(i.h_drift),
      "h_step"_a = i.h_drift == i.h_drift ? py::object(py::int_(i.h_step)) : py::none(),
      "h_skipped"_a = i.h_skipped);
  for (const auto& [name, value] : more) fields[name] = value;
  return {fields};
}

diff::DerivativeOf to_contact_gradient(const char* user, const std::string& name) {
  if (name == "auto") return diff::DerivativeOf::Auto;
  if (name == "code") return diff::DerivativeOf::Code;
  require(name == "motion", ErrorKind::Value, user,
          ": contact_gradient: expected \"auto\", \"code\" or \"motion\", got \"", name, "\"");
  return diff::DerivativeOf::Motion;
}

const char* contact_gradient_name(diff::DerivativeOf of) {
  constexpr const char* kNames[] = {"auto", "code", "motion"};
  return kNames[static_cast<size_t>(of)];
}

namespace {

// The fields that GradientInfo has for every solver, with their docstrings.
constexpr std::pair<const char*, const char*> kFields[] = {
    {"label",
     "The worst label of the steps: \"exact of the motion\", \"exact of the code\", \"implicit\", "
     "\"frozen\" or \"surrogate\"."},
    {"reason", "A sentence with the cause of the label and its consequence, with step and pair."},
    {"steps", "The number of steps."},
    {"exact_steps", "The number of steps that are exact of the code, or implicit."},
    {"frozen_steps",
     "The number of steps with active contacts whose points or normals are frozen."},
    {"surrogate_steps",
     "The number of steps whose contact solve has a large residual, or whose contact law jumps."},
    {"events", "The number of events: began + ended + turned."},
    {"began", "The number of contacts that began to push from one step to the next."},
    {"ended", "The number of contacts that ceased to push from one step to the next."},
    {"turned", "The number of contacts that changed between sticking and slipping."},
    {"several",
     "With gradients of the motion: the number of steps in which several pairs, or several points "
     "of a pair, hit at once. With penalty contacts: the number of short touches of several "
     "contacts at once."},
    {"one_sided",
     "With gradients of the motion: the number of events that last beyond the final step, and of "
     "events of articulations in the final three steps. With penalty contacts: the number of short "
     "touches whose begin or end is outside of the steps, or that a written state or another dt "
     "interrupts."},
    {"ramp_steps",
     "With gradients of the motion and penalty contacts: the number of steps in which a "
     "contact is at most half a step from its begin or end."},
    {"landings",
     "With gradients of the motion: the number of contacts of articulations that begin without "
     "a bounce."},
    {"phased",
     "The number of landings whose friction changes its direction. The states after such a landing "
     "depend on the time within the step at which the contact begins."},
    {"searched",
     "With gradients of the motion: the number of steps in which contacts of curved shapes land or "
     "rest. The normal of such a contact comes from an iterative search, with an error that 1 / dt "
     "amplifies."},
    {"lost_events", "The number of events that did not fit into the memory on a device; 0 on the "
                    "CPU."},
    {"least_approach",
     "The smallest approach speed of the events in event_list (m/s, rad/s); inf without an event."},
    {"least_separation",
     "The smallest number of steps between two events of the same articulation or body; inf "
     "without two events."},
    {"steps_per_contact",
     "The number of steps for which the stiffest contact of DiffSemiImplicitSolver pushes: pi / "
     "(dt sqrt(stiffness / mass)). inf without a pushing contact, on a device, and with "
     "checkpoints or enable_static_contacts."},
    {"event_list",
     "With gradients of the motion: a dict for each contact or joint limit that begins, in the "
     "last consecutive steps or on a tape, by time. docs/conventions.md lists the keys."},
    {"residual", "The largest residual of the contact law, relative to the largest impulse (1)."},
    {"h_drift",
     "With gradients of the motion of articulations, after backward: a check of the gradient. H is "
     "the gradient by the state times the rate of the state, which steps without events conserve. "
     "The drift is the largest change of H in such a step, relative to the largest |H| (1). None: "
     "backward has not run. docs/conventions.md has the law."},
    {"h_step", "The index of the step with h_drift; None without h_drift."},
    {"h_skipped",
     "The number of steps that h_drift leaves out: steps that have not converged, and steps before "
     "a change of the state or of dt."}};

constexpr const char* kDoc = doc::kGradientInfo;

}  // namespace

void bind_gradient_info(py::module_& solvers) {
  using Info = GradientInfoFields;
  const auto find = [](const Info& info, const std::string& name, PyObject* error) {
    if (info.fields.contains(name)) return py::object(info.fields[name.c_str()]);
    std::string names;
    for (const auto& [known, value] : info.fields)
      names += (names.empty() ? "" : ", ") + py::cast<std::string>(known);
    PyErr_SetString(error, ("GradientInfo has no field '" + name + "', only " + names).c_str());
    throw py::error_already_set();
  };
  py::class_<Info> type(solvers, "GradientInfo", kDoc);
  for (const auto& [field, doc] : kFields)
    type.def_property_readonly(
        field,
        [find, name = std::string(field)](const Info& i) {
          return find(i, name, PyExc_AttributeError);
        },
        doc);
  type.def("__getattr__",
           [find](const Info& i, const std::string& name) {
             return find(i, name, PyExc_AttributeError);
           })
      .def("__getitem__",
           [find](const Info& i, const std::string& name) { return find(i, name, PyExc_KeyError); })
      .def("__contains__",
           [](const Info& i, const std::string& name) { return i.fields.contains(name); })
      .def("__len__", [](const Info& i) { return i.fields.size(); })
      .def("__iter__", [](const Info& i) { return py::iter(i.fields); })
      .def(
          "keys", [](const Info& i) { return i.fields.attr("keys")(); },
          "Returns the names of the fields.")
      .def(
          "items", [](const Info& i) { return i.fields.attr("items")(); },
          "Returns the names and values of the fields.")
      .def("__dir__",
           [](const Info& i) {
             return py::list(i.fields) +
                    py::list(py::type::of<Info>().attr("__dict__").attr("keys")());
           })
      .def(
          "__eq__", [](const Info& i, const Info& other) { return i.fields.equal(other.fields); },
          py::is_operator())
      .def("__repr__", [](const Info& i) {
        std::string text;
        for (const auto& [name, value] : i.fields)
          text += (text.empty() ? "" : ", ") + py::cast<std::string>(name) + "=" +
                  py::cast<std::string>(py::repr(value));
        return "GradientInfo(" + text + ")";
      });
}

}  // namespace novaphy::python
