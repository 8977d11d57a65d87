//===- OperatorCalls.cpp - Kernels as operators of torch ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The calls of `tai.torch` for plain tensors: makes the results and gradients,
// and launches, without running Python code of the package. Each function
// answers None where no code for such tensors has been compiled, and leaves the
// call to Python, which compiles it and reports errors.
//
//===----------------------------------------------------------------------===//

#include "Launcher.h"
#include "TensorView.h"

#include <algorithm>
#include <cstring>
#include <iterator>
#include <memory>
#include <utility>
#include <vector>

using namespace taipy;

namespace {

/// The most parameters of an operator; others are left to Python.
constexpr size_t mostParameters = 32;
/// The largest tensor that is cleared here; larger ones are cleared by torch,
/// with its threads.
constexpr int64_t mostBytesToClear = 1 << 18;
/// The bytes of adjoints of outputs that are copied to the stack.
constexpr size_t mostBytesOfSeeds = 4096;

/// Returns a single object itself, and several objects as a tuple.
PyObject *pack(py::object *objects, size_t count) {
  if (count == 1)
    return objects[0].release().ptr();
  PyObject *all = PyTuple_New(static_cast<Py_ssize_t>(count));
  for (size_t i = 0; all && i < count; ++i)
    PyTuple_SET_ITEM(all, i, objects[i].release().ptr());
  return all;
}

/// The data of an operator that its calls use.
struct OperatorCalls {
  struct Parameter {
    bool isInput;
    size_t number; // among the inputs or the outputs
  };

  py::object launcher, gradientLauncher;
  std::vector<Parameter> parameters;
  size_t numInputs = 0, numOutputs = 0;
  std::vector<char> isTensor; // of the inputs
  /// For each output, the input for which `emptyLike` makes it; empty if Python
  /// code makes the outputs.
  std::vector<size_t> likes;
  py::object emptyLike;
  std::vector<PyObject *> plainTypes;
  /// For each launch that Python code has checked: the number type and the
  /// number of dimensions of each input tensor.
  std::vector<std::vector<PyObject *>> known;

  bool isLarge() const { return parameters.size() > mostParameters; }
  bool isKnown(PyObject *const *inputs) const;
  bool makeZeros(PyObject *like, py::object &made) const;
  PyObject *runForward(PyObject *const *inputs);
  PyObject *runGradient(PyObject *inputs, PyObject *bars, PyObject *needs);
  int classify(PyObject *const *inputs) const;
};

bool OperatorCalls::isKnown(PyObject *const *inputs) const {
  static const Name name("dtype"), ndim("ndim");
  PyObject *types[2 * mostParameters];
  size_t count = 0;
  for (size_t i = 0; i < numInputs; ++i) {
    if (!isTensor[i])
      continue;
    // Torch never frees a dtype, so the address identifies it.
    types[count] = take(get(inputs[i], name)).ptr();
    if (!types[count++])
      return false;
    // Python keeps one object for each small integer.
    types[count] = take(get(inputs[i], ndim)).ptr();
    if (!types[count++])
      return false;
  }
  return std::any_of(known.begin(), known.end(), [&](const auto &one) {
    return std::equal(one.begin(), one.end(), types, types + count);
  });
}

/// Makes a tensor of zeros like `like`, outside of its autograd graph. False
/// and a Python error on failure.
bool OperatorCalls::makeZeros(PyObject *like, py::object &made) const {
  made = take(PyObject_CallOneArg(emptyLike.ptr(), like));
  if (!made)
    return false;
  TensorView view;
  if (readTensor(findTensorType(made.ptr()), made.ptr(), view) &&
      view.deviceType == dlpack::kCpu && view.bytes() <= mostBytesToClear) {
    if (view.bytes())
      std::memset(reinterpret_cast<void *>(view.address), 0,
                  static_cast<size_t>(view.bytes()));
    return true;
  }
  static const Name zero("zero_");
  return bool(take(PyObject_CallMethodNoArgs(made.ptr(), zero)));
}

/// Runs the operator forward; returns its outputs: one tensor, a tuple, or
/// None.
PyObject *OperatorCalls::runForward(PyObject *const *inputs) {
  if (likes.empty() || isLarge() || !isKnown(inputs))
    Py_RETURN_NONE;
  py::object made[mostParameters];
  for (size_t i = 0; i < numOutputs; ++i)
    if (!makeZeros(inputs[likes[i]], made[i]))
      return nullptr;
  PyObject *args[mostParameters];
  Beside gradients[mostParameters];
  for (size_t i = 0; i < parameters.size(); ++i) {
    const Parameter &one = parameters[i];
    args[i] = one.isInput ? inputs[one.number] : made[one.number].ptr();
    gradients[i] = {Py_None};
  }
  Match match =
      launchBeside(launcher.ptr(), args, gradients, parameters.size());
  if (match == Match::Error)
    return nullptr;
  if (match == Match::No)
    Py_RETURN_NONE;
  return pack(made, numOutputs);
}

/// The gradients with respect to the inputs for which `needs` has True, and
/// None for other inputs: one object, or a tuple. Returns None if Python code
/// must handle the call.
PyObject *OperatorCalls::runGradient(PyObject *inputs, PyObject *bars,
                                     PyObject *needs) {
  if (isLarge() || !PyTuple_Check(inputs) || !PyTuple_Check(bars) ||
      !PyTuple_Check(needs) ||
      PyTuple_GET_SIZE(inputs) != static_cast<Py_ssize_t>(numInputs) ||
      PyTuple_GET_SIZE(bars) != static_cast<Py_ssize_t>(numOutputs) ||
      PyTuple_GET_SIZE(needs) != static_cast<Py_ssize_t>(numInputs))
    Py_RETURN_NONE;
  // The sweep overwrites the adjoints of outputs, so it gets copies. It does
  // not read the values of outputs, for which the copies stand, too.
  alignas(64) char memory[mostBytesOfSeeds];
  size_t used = 0;
  py::object seeds[mostParameters];
  Beside besideOutputs[mostParameters];
  for (size_t i = 0; i < numOutputs; ++i) {
    PyObject *bar = PyTuple_GET_ITEM(bars, i);
    TensorType type = findTensorType(bar);
    if (!type.isTensor)
      Py_RETURN_NONE;
    TensorView view;
    if (readTensor(type, bar, view) && view.deviceType == dlpack::kCpu &&
        static_cast<size_t>(view.bytes()) <= sizeof memory - used) {
      std::memcpy(memory + used, reinterpret_cast<const void *>(view.address),
                  static_cast<size_t>(view.bytes()));
      seeds[i] = py::reinterpret_borrow<py::object>(bar);
      besideOutputs[i] = {Py_None, reinterpret_cast<uint64_t>(memory + used)};
      used =
          std::min(sizeof memory,
                   (used + static_cast<size_t>(view.bytes()) + 63) / 64 * 64);
      continue;
    }
    static const Name clone("clone");
    seeds[i] = take(PyObject_CallMethodNoArgs(bar, clone));
    if (!seeds[i])
      return nullptr;
    besideOutputs[i] = {seeds[i].ptr()};
  }
  py::object found[mostParameters];
  for (size_t i = 0; i < numInputs; ++i) {
    if (PyTuple_GET_ITEM(needs, i) != Py_True)
      found[i] = py::none();
    else if (!makeZeros(PyTuple_GET_ITEM(inputs, i), found[i]))
      return nullptr;
  }
  PyObject *args[mostParameters];
  Beside gradients[mostParameters];
  for (size_t i = 0; i < parameters.size(); ++i) {
    const Parameter &one = parameters[i];
    args[i] = one.isInput ? PyTuple_GET_ITEM(inputs, one.number)
                          : seeds[one.number].ptr();
    gradients[i] = one.isInput ? Beside{found[one.number].ptr()}
                               : besideOutputs[one.number];
  }
  Match match =
      launchBeside(gradientLauncher.ptr(), args, gradients, parameters.size());
  if (match == Match::Error)
    return nullptr;
  if (match == Match::No)
    Py_RETURN_NONE;
  return pack(found, numInputs);
}

/// Returns 0 if Python code must look at the inputs, 1 if they are plain
/// tensors and numbers, and 2 if torch also differentiates one of them.
int OperatorCalls::classify(PyObject *const *inputs) const {
  static const Name requiresGrad("requires_grad");
  int answer = 1;
  for (size_t i = 0; i < numInputs; ++i) {
    auto *type = reinterpret_cast<PyObject *>(Py_TYPE(inputs[i]));
    bool isPlain = std::find(plainTypes.begin(), plainTypes.end(), type) !=
                   plainTypes.end();
    bool isNumber =
        PyFloat_CheckExact(inputs[i]) || PyLong_CheckExact(inputs[i]);
    if (isTensor[i] ? !isPlain
                    : !isNumber && findTensorType(inputs[i]).isTensor)
      return 0;
    if (!isTensor[i])
      continue;
    if (take(get(inputs[i], requiresGrad)).is(py::bool_(true)))
      answer = 2;
  }
  return answer;
}

// Functions for Python, whose `self` is a capsule with the OperatorCalls.

OperatorCalls &callsOf(PyObject *self) {
  return *static_cast<OperatorCalls *>(PyCapsule_GetPointer(self, nullptr));
}

PyObject *forward(PyObject *self, PyObject *const *inputs, Py_ssize_t count) {
  return runForPython([&]() -> PyObject * {
    OperatorCalls &calls = callsOf(self);
    if (static_cast<size_t>(count) != calls.numInputs)
      Py_RETURN_NONE;
    return calls.runForward(inputs);
  });
}

PyObject *gradient(PyObject *self, PyObject *const *given, Py_ssize_t count) {
  return runForPython([&]() -> PyObject * {
    if (count != 3)
      Py_RETURN_NONE;
    return callsOf(self).runGradient(given[0], given[1], given[2]);
  });
}

PyObject *classify(PyObject *self, PyObject *const *inputs, Py_ssize_t count) {
  return runForPython([&]() -> PyObject * {
    OperatorCalls &calls = callsOf(self);
    bool isWhole = static_cast<size_t>(count) == calls.numInputs;
    return PyLong_FromLong(isWhole ? calls.classify(inputs) : 0);
  });
}

/// Notes that a launch with these types of numbers was checked.
PyObject *note(PyObject *self, PyObject *types) {
  return runForPython([&]() -> PyObject * {
    std::vector<PyObject *> all;
    for (py::handle type : py::reinterpret_borrow<py::tuple>(types))
      all.push_back(type.inc_ref().ptr());
    callsOf(self).known.push_back(std::move(all));
    Py_RETURN_NONE;
  });
}

template <typename Function> PyCFunction plain(Function function) {
  return reinterpret_cast<PyCFunction>(reinterpret_cast<void *>(function));
}

PyMethodDef functions[] = {
    {"forward", plain(&forward), METH_FASTCALL, nullptr},
    {"gradient", plain(&gradient), METH_FASTCALL, nullptr},
    {"classify", plain(&classify), METH_FASTCALL, nullptr},
    {"note", &note, METH_O, nullptr}};

} // namespace

void taipy::bindOperatorCalls(py::module_ &module) {
  module.def("operator_calls",
             [](const py::object &launcher, const py::object &gradientLauncher,
                const std::vector<std::pair<bool, size_t>> &places,
                const std::vector<bool> &isTensor,
                const std::vector<size_t> &likes, const py::tuple &plainTypes,
                const py::object &emptyLike) -> py::tuple {
               auto calls = std::make_unique<OperatorCalls>();
               calls->launcher = launcher;
               calls->gradientLauncher = gradientLauncher;
               for (auto [isInput, number] : places)
                 calls->parameters.push_back({isInput, number});
               calls->isTensor.assign(isTensor.begin(), isTensor.end());
               calls->numInputs = isTensor.size();
               calls->numOutputs = places.size() - isTensor.size();
               calls->likes = likes;
               calls->emptyLike = emptyLike;
               for (py::handle type : plainTypes)
                 calls->plainTypes.push_back(type.inc_ref().ptr());
               py::capsule self(calls.release(), [](void *calls) {
                 delete static_cast<OperatorCalls *>(calls);
               });
               py::tuple made(std::size(functions));
               for (size_t i = 0; i < std::size(functions); ++i)
                 made[i] = take(PyCFunction_New(&functions[i], self.ptr()));
               return made;
             });
}
