//===- Launcher.cpp - Calling kernels from Python -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `Launcher` is the base class of kernels in Python. A call finds the
// specialisation for its arguments, packs the arguments and launches, without
// running Python code. If no specialisation fits, it calls the method
// `_launch_slow(args, kwargs)`, which compiles one, adds it with `_add`, and
// launches again.
//
//===----------------------------------------------------------------------===//

#include "Launcher.h"
#include "Constants.h"
#include "WatchedViews.h"

#include <algorithm>
#include <cstring>
#include <new>
#include <optional>
#include <structmember.h>
#include <unordered_set>
#include <vector>

using namespace taipy;

namespace {

/// Specialisations of an older generation belong to a context that `ti.init`
/// or `ti.reset` has replaced.
uint64_t generation = 1;

/// The number of threads that record a tape, and a flag that tells whether this
/// thread does.
int recordingThreads = 0;
thread_local bool isRecordingHere = false;
inline bool isRecording() {
  return __builtin_expect(recordingThreads != 0, false) && isRecordingHere;
}

/// The class of numbers that have a gradient or a tangent.
PyObject *trackedType = nullptr;

/// The class of fields and arrays. float() reads one without dimensions, but
/// none is an argument of a number: its gradient would be lost.
PyObject *elementsType = nullptr;

bool isOfType(PyObject *object, PyObject *type) {
  return type &&
         PyObject_TypeCheck(object, reinterpret_cast<PyTypeObject *>(type));
}

/// The number of threads that launch kernels with their tangents, whether this
/// thread does, and how many kernels it has launched with tangents.
int forwardThreads = 0;
thread_local bool isForwardHere = false;
thread_local uint64_t forwardLaunches = 0;
inline bool isForward() {
  return __builtin_expect(forwardThreads != 0, false) && isForwardHere;
}

/// While values with a history exist, Python code checks once each place that
/// launches with plain numbers: the number of threads with such values, whether
/// this thread has some, and the places that have been checked.
int watchingThreads = 0;
thread_local bool watchesNumbersHere = false;
inline bool watchesNumbers() {
  return __builtin_expect(watchingThreads != 0, false) && watchesNumbersHere;
}
std::unordered_set<uint64_t> knownSites;
/// Numbers that this thread has read from fields with a history, which Python
/// keeps alive, and the places where a launch with one of them was reported.
thread_local std::unordered_set<const PyObject *> readNumbers;
std::unordered_set<uint64_t> reportedSites;
/// True if other libraries may have views of the memory of fields.
bool fieldsAreViewed = false;
/// Places where Python code has checked a launch that cuts a graph of torch.
std::unordered_set<uint64_t> knownGraphSites;

/// The launcher of the current call.
const PyObject *calledLauncher = nullptr;

/// Sets the flag of a thread, and counts the threads whose flag is set.
void setFlag(bool &flag, int &threads, bool on) {
  threads += on - flag;
  flag = on;
}

uint64_t siteOf(PyCodeObject *code, int line, const PyObject *launcher) {
  constexpr uint64_t odd = 0x9e3779b97f4a7c15;
  uint64_t site = reinterpret_cast<uint64_t>(code) * odd;
  site = (site ^ reinterpret_cast<uint64_t>(launcher)) * odd;
  return site + static_cast<uint64_t>(line);
}

bool isKnownSite(const std::unordered_set<uint64_t> &known) {
  PyFrameObject *frame = PyEval_GetFrame(); // borrowed
  if (!frame)
    return true;
  PyCodeObject *code = PyFrame_GetCode(frame);
  uint64_t site = siteOf(code, PyFrame_GetLineNumber(frame), calledLauncher);
  bool isKnown = known.count(site) != 0;
  Py_DECREF(code);
  return isKnown;
}

/// Whether Python code has yet to look at a launch from this place with the
/// number, which is no whole number.
bool mustLookAt(const PyObject *number) {
  if (PyLong_Check(number))
    return false;
  bool isRead = !readNumbers.empty() && readNumbers.count(number);
  return !isKnownSite(isRead ? reportedSites : knownSites);
}

/// True if torch records the current computations.
bool isTorchRecording() {
  static PyObject *isGradEnabled = nullptr;
  if (!isGradEnabled) {
    PyObject *module = PyImport_GetModule(py::str("torch").ptr());
    if (!module)
      return false;
    isGradEnabled = PyObject_GetAttrString(module, "is_grad_enabled");
    Py_DECREF(module);
  }
  py::object on = py::reinterpret_steal<py::object>(
      isGradEnabled ? PyObject_CallNoArgs(isGradEnabled) : nullptr);
  if (!on)
    forgetError();
  return on && on.is(py::bool_(true));
}

enum class ArgKind : char {
  F32 = 'f',
  F64 = 'd',
  Integer = 'i', // any integer of up to 64 bits; see `bits`
  Bool = 'b',
  Constant = 'c', // part of the specialisation; takes no slot
  Array = 'a'     // a buffer, as pointer and extents
};

struct Arg {
  ArgKind kind;
  int bits = 0; // Integer: width
  bool isUnsigned = false;
  py::object constant; // Constant: the `Constant`, as the Python object
  const taipy::Constant *value = nullptr; // Constant: its C++ object
  ArrayArg array;                         // Array: the parameter
};

struct Result {
  char kind = 0; // 0 none, 'f', 'd', 'i', 'u', 'b', 'h' (f16)
  int bits = 0;
  int count = 0;   // slots
  py::object wrap; // turns a tuple of numbers into a matrix, or none
};

struct Specialization {
  // The generation for which this launcher's data is valid. Each launch
  // compares it with the global `generation`.
  uint64_t generation = 0;
  /// The number of calls that use this specialisation: other threads, and
  /// Python code of the arguments, may run during a call, and must not drop it.
  int users = 0;
  TaiKernel handle = nullptr;
  std::vector<Arg> args;
  /// Attributes of Python objects on which the code depends, besides the
  /// arguments.
  Reads reads;
  bool grad = false;
  /// The parts of a launch that a tape must record.
  enum class Tracking {
    None,   // no more than its slots
    Arrays, // its arrays
    Python  // Python says where adjoints are
  } tracking = Tracking::None;
  Result result;
  /// True if the kernel takes several arrays and writes to one of them, so that
  /// they may overlap.
  bool arraysMayAlias = false;
  std::shared_ptr<Kernel> kernel;

  void setKernel(std::shared_ptr<Kernel> given) {
    kernel = std::move(given);
    handle = kernel->handle;
  }
};

/// Prevents that a specialisation is dropped while it is used.
struct InUse {
  explicit InUse(Specialization &spec) : spec(spec) { ++spec.users; }
  ~InUse() { --spec.users; }
  InUse(const InUse &) = delete;
  InUse &operator=(const InUse &) = delete;
  Specialization &spec;
};

using Specializations = std::vector<std::unique_ptr<Specialization>>;

/// Drops unused specialisations. Their destructors may call Python, which must
/// find a consistent list.
template <typename Predicate>
void drop(Specializations &all, Predicate isDropped) {
  Specializations gone;
  for (auto &one : all)
    if (!one->users && isDropped(*one))
      gone.push_back(std::move(one));
  all.erase(std::remove(all.begin(), all.end(), nullptr), all.end());
}

struct Launcher {
  PyObject_HEAD vectorcallfunc vectorcall;
  PyObject *dict;
  PyObject *weakrefs;
  Specializations *specializations;
};

Match packInteger(const Arg &arg, PyObject *object, uint64_t &slot) {
  if (!PyLong_Check(object) && !PyIndex_Check(object))
    return Match::No;
  int overflow = 0;
  long long number;
  if (PyLong_CheckExact(object)) {
    number = PyLong_AsLongLongAndOverflow(object, &overflow);
  } else {
    PyObject *whole = PyNumber_Index(object);
    if (!whole) {
      // An array of several dimensions: the slow path reports it.
      if (!PyErr_ExceptionMatches(PyExc_TypeError))
        return Match::Error;
      PyErr_Clear();
      return Match::No;
    }
    number = PyLong_AsLongLongAndOverflow(whole, &overflow);
    Py_DECREF(whole);
  }
  if (overflow || (arg.isUnsigned && number < 0) ||
      (arg.bits < 64 && arg.isUnsigned && number >> arg.bits) ||
      (arg.bits < 64 && !arg.isUnsigned &&
       (number >> (arg.bits - 1)) != (number < 0 ? -1 : 0)))
    return Match::No; // the slow path reports the error
  slot = static_cast<uint64_t>(number);
  return Match::Yes;
}

Match packArg(const Specialization &spec, size_t number, PyObject *object,
              const Beside *beside, Slots &slots,
              std::optional<HeldArrays> &held) {
  const Arg &arg = spec.args[number];
  uint64_t slot = 0;
  switch (arg.kind) {
  case ArgKind::Constant:
    return arg.value->matches(object) ? Match::Yes : Match::No;
  case ArgKind::Array:
    if (arg.array.cutsGraph && !spec.grad && !isRecording() &&
        isTorchRecording() && !isKnownSite(knownGraphSites))
      return Match::No;
    if (!held)
      held.emplace(*spec.kernel,
                   isRecording() ? ArrayUse::Recorded
                   : spec.grad   ? ArrayUse::Gradient
                                 : ArrayUse::Forward,
                   spec.arraysMayAlias, fieldsAreViewed || watchesNumbers());
    return held->pack(arg.array, object, beside, number, slots);
  case ArgKind::F32:
  case ArgKind::F64: {
    double number;
    if (watchesNumbers() && mustLookAt(object))
      return Match::No;
    if (PyFloat_CheckExact(object)) {
      number = PyFloat_AS_DOUBLE(object);
    } else {
      if (PyUnicode_Check(object) || PyBytes_Check(object) ||
          isOfType(object, elementsType) ||
          ((isRecording() || isForward()) && isOfType(object, trackedType)))
        return Match::No;
      number = PyFloat_AsDouble(object);
      if (number == -1.0 && PyErr_Occurred()) {
        forgetError();
        return Match::No;
      }
    }
    if (arg.kind == ArgKind::F32) {
      float single = static_cast<float>(number);
      std::memcpy(&slot, &single, sizeof single);
    } else {
      std::memcpy(&slot, &number, sizeof number);
    }
    break;
  }
  case ArgKind::Integer: {
    Match match = packInteger(arg, object, slot);
    if (match != Match::Yes)
      return match;
    break;
  }
  case ArgKind::Bool: {
    if (!PyBool_Check(object) && !PyLong_Check(object))
      return Match::No;
    slot = PyObject_IsTrue(object) == 1;
    break;
  }
  }
  slots.push_back(slot);
  return Match::Yes;
}

PyObject *toPython(const Result &result, uint64_t slot) {
  switch (result.kind) {
  case 'f': {
    float number;
    std::memcpy(&number, &slot, sizeof number);
    return PyFloat_FromDouble(number);
  }
  case 'd': {
    double number;
    std::memcpy(&number, &slot, sizeof number);
    return PyFloat_FromDouble(number);
  }
  case 'b':
    return PyBool_FromLong(static_cast<long>(slot & 1));
  case 'u':
    if (result.bits < 64)
      slot &= (uint64_t(1) << result.bits) - 1;
    return PyLong_FromUnsignedLongLong(slot);
  default:
    // The value fills the low bits of its slot, and its sign is extended.
    return PyLong_FromLongLong(
        static_cast<int64_t>(slot << (64 - result.bits)) >> (64 - result.bits));
  }
}

PyObject *launch(Specialization &spec, const uint64_t *slots, size_t numSlots) {
  if (isForward())
    ++forwardLaunches;
  int64_t count = static_cast<int64_t>(numSlots);
  bool hasResults = !spec.grad && spec.result.count;
  // Results up to a matrix of 4x4 need no memory allocation.
  constexpr int mostFew = 16;
  uint64_t few[mostFew];
  std::vector<uint64_t> many;
  uint64_t *results = few;
  if (hasResults && spec.result.count > mostFew) {
    many.resize(spec.result.count);
    results = many.data();
  } else if (hasResults) {
    std::memset(few, 0, sizeof few);
  }
  TaiStatus status = spec.grad
                         ? taiKernelLaunchGrad(spec.handle, slots, count)
                         : taiKernelLaunch(spec.handle, slots, count,
                                           hasResults ? results : nullptr);
  if (!afterCall())
    return nullptr;
  if (status != TAI_OK) {
    setError(spec.kernel->context->handle, status);
    return nullptr;
  }
  if (isRecording() && !renewViews())
    return nullptr;
  if (!hasResults)
    Py_RETURN_NONE;
  if (spec.result.wrap.is_none())
    return toPython(spec.result, results[0]);
  PyObject *numbers = PyTuple_New(spec.result.count);
  if (!numbers)
    return nullptr;
  for (int i = 0; i < spec.result.count; ++i)
    PyTuple_SET_ITEM(numbers, i, toPython(spec.result, results[i]));
  PyObject *wrapped =
      PyErr_Occurred() ? nullptr
                       : PyObject_CallOneArg(spec.result.wrap.ptr(), numbers);
  Py_DECREF(numbers);
  return wrapped;
}

/// Tries one specialisation. Yes: `answer` is the result or null on error.
///
/// \p gradients: one for each argument; null where the arrays have their
/// gradients themselves.
Match tryLaunch(Launcher *self, Specialization &spec, PyObject *const *args,
                const Beside *gradients, size_t count, PyObject *&answer) {
  if (spec.generation != generation || spec.args.size() != count ||
      (isRecording() &&
       (spec.tracking == Specialization::Tracking::Python ||
        (spec.tracking == Specialization::Tracking::Arrays && spec.grad))) ||
      (isForward() && spec.tracking == Specialization::Tracking::Python))
    return Match::No;
  if (isRecording()) {
    Changed changed = haveViewsChanged();
    if (changed == Changed::Error)
      answer = nullptr;
    if (changed != Changed::No)
      return changed == Changed::Error ? Match::Yes : Match::No;
  }
  InUse inUse(spec);
  Slots slots;
  std::optional<HeldArrays> held;
  for (size_t i = 0; i < count; ++i) {
    Match match = packArg(spec, i, args[i], gradients ? &gradients[i] : nullptr,
                          slots, held);
    if (match != Match::Yes)
      return match;
  }
  if (!spec.reads.hold())
    return Match::No;
  if (held) {
    auto *launcher = reinterpret_cast<PyObject *>(self);
    if (Match match = held->finish(launcher, slots); match != Match::Yes)
      return match;
  }
  if (held && !held->orderBefore())
    return Match::Error;
  answer = launch(spec, slots.data(), slots.size());
  if (held && !held->orderAfter())
    Py_CLEAR(answer);
  return Match::Yes;
}

PyObject *callSlow(Launcher *self, PyObject *const *args, size_t count,
                   PyObject *names) {
  if (!afterCall())
    return nullptr;
  PyObject *positional = PyTuple_New(static_cast<Py_ssize_t>(count));
  if (!positional)
    return nullptr;
  for (size_t i = 0; i < count; ++i)
    PyTuple_SET_ITEM(positional, i, Py_NewRef(args[i]));
  PyObject *keywords = PyDict_New();
  if (keywords && names)
    for (Py_ssize_t i = 0; i < PyTuple_GET_SIZE(names); ++i)
      PyDict_SetItem(keywords, PyTuple_GET_ITEM(names, i), args[count + i]);
  PyObject *answer = nullptr;
  if (keywords)
    answer = PyObject_CallMethod(reinterpret_cast<PyObject *>(self),
                                 "_launch_slow", "OO", positional, keywords);
  Py_XDECREF(keywords);
  Py_DECREF(positional);
  return answer;
}

/// Launches the specialisation that fits. No: none does. Yes: `answer` is the
/// result or null on error.
Match launchKnown(Launcher *self, PyObject *const *args,
                  const Beside *gradients, size_t count, PyObject *&answer) {
  calledLauncher = reinterpret_cast<PyObject *>(self);
  auto &all = *self->specializations;
  for (size_t i = all.size(); i-- > 0;) {
    Specialization *spec = all[i].get();
    Match match = tryLaunch(self, *spec, args, gradients, count, answer);
    if (match == Match::Error) {
      answer = nullptr;
      return Match::Yes;
    }
    if (match == Match::No) {
      // Python code of the arguments may have dropped some specialisations.
      i = std::min(i, all.size());
      continue;
    }
    // The specialisation that was used last is moved to the end of the list,
    // unless other threads have moved it.
    if (i + 1 < all.size() && all[i].get() == spec)
      std::swap(all[i], all.back());
    return Match::Yes;
  }
  return Match::No;
}

PyObject *callAny(PyObject *object, PyObject *const *args, size_t flags,
                  PyObject *names) {
  auto *self = reinterpret_cast<Launcher *>(object);
  size_t count = static_cast<size_t>(PyVectorcall_NARGS(flags));
  PyObject *answer = nullptr;
  if (!names && launchKnown(self, args, nullptr, count, answer) == Match::Yes)
    return answer;
  return callSlow(self, args, count, names);
}

PyObject *call(PyObject *object, PyObject *const *args, size_t flags,
               PyObject *names) noexcept {
  return runForPython([&] { return callAny(object, args, flags, names); });
}

PyObject *launcherNew(PyTypeObject *type, PyObject *, PyObject *) {
  auto *self = reinterpret_cast<Launcher *>(type->tp_alloc(type, 0));
  if (!self)
    return nullptr;
  // Classes made in Python do not inherit the flags by which calls make no
  // tuples (before 3.12) and calls of methods make no bound methods.
  unsigned long flags = type->tp_flags;
  if (type->tp_call == PyVectorcall_Call)
    flags |= Py_TPFLAGS_HAVE_VECTORCALL;
  if (type->tp_call == PyVectorcall_Call && type->tp_descr_get)
    flags |= Py_TPFLAGS_METHOD_DESCRIPTOR;
  if (flags != type->tp_flags) {
    type->tp_flags = flags;
    PyType_Modified(type);
  }
  self->vectorcall = call;
  self->specializations = new (std::nothrow) Specializations;
  if (!self->specializations) {
    Py_DECREF(self);
    return PyErr_NoMemory();
  }
  return reinterpret_cast<PyObject *>(self);
}

int launcherTraverse(PyObject *object, visitproc visit, void *arg) {
  auto *self = reinterpret_cast<Launcher *>(object);
  Py_VISIT(Py_TYPE(object));
  Py_VISIT(self->dict);
  if (!self->specializations)
    return 0;
  for (auto &spec : *self->specializations) {
    for (Arg &constant : spec->args)
      Py_VISIT(constant.constant.ptr());
    if (int stop = spec->reads.traverse(visit, arg))
      return stop;
  }
  return 0;
}

int launcherClear(PyObject *object) {
  auto *self = reinterpret_cast<Launcher *>(object);
  Py_CLEAR(self->dict);
  Specializations all;
  if (self->specializations)
    all.swap(*self->specializations);
  return 0;
}

void launcherDealloc(PyObject *object) {
  auto *self = reinterpret_cast<Launcher *>(object);
  PyObject_GC_UnTrack(object);
  if (self->weakrefs)
    PyObject_ClearWeakRefs(object);
  launcherClear(object);
  delete self->specializations;
  PyTypeObject *type = Py_TYPE(object);
  type->tp_free(object);
  Py_DECREF(type);
}

Arg parseArg(const py::tuple &description) {
  Arg arg;
  arg.kind = static_cast<ArgKind>(description[0].cast<std::string>().at(0));
  arg.constant = py::none();
  if (arg.kind == ArgKind::Integer) {
    arg.bits = description[1].cast<int>();
    arg.isUnsigned = description[2].cast<bool>();
  } else if (arg.kind == ArgKind::Constant) {
    arg.constant = description[1];
    arg.value = &description[1].cast<const Constant &>();
  } else if (arg.kind == ArgKind::Array) {
    ArrayArg &array = arg.array;
    array.format = description[1].cast<std::string>();
    array.element = description[3].cast<std::vector<int64_t>>();
    array.rank =
        description[2].cast<int>() + static_cast<int>(array.element.size());
    array.hasGradient = description[4].cast<bool>();
    array.isElementFixed = description[5].cast<bool>();
    array.isWritten = description[6].cast<bool>();
    array.cutsGraph = description[7].cast<bool>();
  }
  return arg;
}

Launcher *toLauncher(const py::object &object) {
  return reinterpret_cast<Launcher *>(object.ptr());
}

PyMemberDef members[] = {
    {"__dictoffset__", T_PYSSIZET, offsetof(Launcher, dict), READONLY, nullptr},
    {"__weaklistoffset__", T_PYSSIZET, offsetof(Launcher, weakrefs), READONLY,
     nullptr},
    {"__vectorcalloffset__", T_PYSSIZET, offsetof(Launcher, vectorcall),
     READONLY, nullptr},
    {nullptr, 0, 0, 0, nullptr}};

PyType_Slot slots[] = {
    {Py_tp_new, reinterpret_cast<void *>(launcherNew)},
    {Py_tp_dealloc, reinterpret_cast<void *>(launcherDealloc)},
    {Py_tp_traverse, reinterpret_cast<void *>(launcherTraverse)},
    {Py_tp_clear, reinterpret_cast<void *>(launcherClear)},
    {Py_tp_call, reinterpret_cast<void *>(PyVectorcall_Call)},
    {Py_tp_members, members},
    {0, nullptr}};

PyType_Spec spec = {"tai._core.Launcher", sizeof(Launcher), 0,
                    Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE |
                        Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_HAVE_VECTORCALL,
                    slots};

} // namespace

Match taipy::launchBeside(PyObject *launcher, PyObject *const *args,
                          const Beside *gradients, size_t count) {
  PyObject *answer = nullptr;
  Match match = launchKnown(reinterpret_cast<Launcher *>(launcher), args,
                            gradients, count, answer);
  if (match == Match::Yes && !answer)
    return Match::Error;
  Py_XDECREF(answer);
  return match;
}

void taipy::bindLauncher(py::module_ &module) {
  auto type = py::reinterpret_steal<py::object>(PyType_FromSpec(&spec));
  if (!type)
    throw py::error_already_set();
  module.attr("Launcher") = type;
  bindArrayArguments(module);
  bindTapedArrays(module);
  bindConstants(module);
  bindWatchedViews(module);

  module.def("set_tape", [](const py::object &tape) {
    setFlag(isRecordingHere, recordingThreads, !tape.is_none());
    setArrayTape(tape.is_none() ? nullptr : tape.ptr());
  });
  module.def("set_tracked_type", [](const py::object &type) {
    trackedType = type.inc_ref().ptr();
  });
  module.def("set_elements_type", [](const py::object &type) {
    elementsType = type.inc_ref().ptr();
  });
  module.def("watch_numbers",
             [](bool on) { setFlag(watchesNumbersHere, watchingThreads, on); });
  module.def("note_views_of_fields", [](bool on) { fieldsAreViewed = on; });
  module.def("forget_sites", [] {
    knownSites.clear();
    knownGraphSites.clear();
    reportedSites.clear();
  });
  module.def("note_number", [](const py::object &number) {
    readNumbers.insert(number.ptr());
  });
  module.def("forget_numbers", [] { readNumbers.clear(); });
  // The caller keeps the code object alive, so that its address identifies it.
  module.def("note_site", [](const py::object &code, int line,
                             const py::object &launcher) {
    knownSites.insert(siteOf(reinterpret_cast<PyCodeObject *>(code.ptr()), line,
                             launcher.ptr()));
  });
  module.def("note_reported_site", [](const py::object &code, int line,
                                      const py::object &launcher) {
    reportedSites.insert(siteOf(reinterpret_cast<PyCodeObject *>(code.ptr()),
                                line, launcher.ptr()));
  });
  module.def("note_graph_site", [](const py::object &code, int line,
                                   const py::object &launcher) {
    knownGraphSites.insert(siteOf(reinterpret_cast<PyCodeObject *>(code.ptr()),
                                  line, launcher.ptr()));
  });
  module.def("set_forward_mode", [](bool on) {
    setFlag(isForwardHere, forwardThreads, on);
    forwardLaunches = 0;
  });
  module.def("forward_launches", [] { return forwardLaunches; });
  module.def("next_generation", [] { return ++generation; });
  module.def("add_specialization",
             [](const py::object &launcher, std::shared_ptr<Kernel> kernel,
                bool grad, const std::vector<py::tuple> &args,
                const py::tuple &result, int tracking,
                const std::vector<py::tuple> &reads) {
               auto made = std::make_unique<Specialization>();
               made->setKernel(std::move(kernel));
               made->generation = generation;
               made->grad = grad;
               made->tracking = static_cast<Specialization::Tracking>(tracking);
               int arrays = 0, written = 0;
               for (const py::tuple &arg : args) {
                 made->args.push_back(parseArg(arg));
                 const Arg &last = made->args.back();
                 arrays += last.kind == ArgKind::Array;
                 written += last.kind == ArgKind::Array && last.array.isWritten;
               }
               for (const py::tuple &read : reads)
                 made->reads.add(read);
               made->arraysMayAlias = arrays > 1 && written > 0;
               if (!result.empty()) {
                 made->result.kind = result[0].cast<std::string>().at(0);
                 made->result.bits = result[1].cast<int>();
                 made->result.count = result[2].cast<int>();
                 made->result.wrap = result[3];
               }
               auto &all = *toLauncher(launcher)->specializations;
               // Specialisations of a replaced context never match again.
               auto isOld = [](const Specialization &one) {
                 return one.generation != generation;
               };
               drop(all, isOld);
               all.push_back(std::move(made));
             });
  // Does launches whose slots the caller has packed: with vectors, matrices or
  // copies.
  module.def("launch_slots",
             [](const std::shared_ptr<Kernel> &kernel, bool grad,
                const std::vector<uint64_t> &slots, const py::tuple &result) {
               Specialization one;
               one.setKernel(kernel);
               one.grad = grad;
               one.result.wrap = py::none();
               if (!result.empty()) {
                 one.result.kind = result[0].cast<std::string>().at(0);
                 one.result.bits = result[1].cast<int>();
                 one.result.count = result[2].cast<int>();
                 one.result.wrap = result[3];
               }
               PyObject *answer = launch(one, slots.data(), slots.size());
               if (!answer)
                 throw py::error_already_set();
               return py::reinterpret_steal<py::object>(answer);
             });
  // Drops the specialisations of one compiled kernel.
  module.def("drop_specialization", [](const py::object &launcher,
                                       const std::shared_ptr<Kernel> &kernel) {
    auto &all = *toLauncher(launcher)->specializations;
    for (auto &one : all)
      if (one->kernel == kernel)
        one->generation = 0; // matches never again
    drop(all, [&](const Specialization &one) { return one.kernel == kernel; });
  });
  // Drops the specialisations of a launcher.
  module.def("clear_specializations", [](const py::object &launcher) {
    auto &all = *toLauncher(launcher)->specializations;
    for (auto &one : all)
      one->generation = 0; // matches never again
    drop(all, [](const Specialization &) { return true; });
  });
}
