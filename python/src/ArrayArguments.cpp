//===- ArrayArguments.cpp - Array arguments of kernels --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Uncommon cases are left to Python code, which also reports errors.
//
//===----------------------------------------------------------------------===//

#include "ArrayArguments.h"
#include "Safepoint.h"
#include "TensorView.h"

#include <algorithm>
#include <cstring>

using namespace taipy;

namespace {

/// The class of the arrays that `ti.ndarray` makes.
PyTypeObject *ndarrayType = nullptr;

/// The format of a buffer, without a byte-order mark.
const char *formatOf(const Py_buffer &view) {
  const char *format = view.format ? view.format : "B";
  if (*format == '@' || *format == '=' || *format == '<')
    ++format;
  return format;
}

bool isSameFormat(const std::string &wanted, const char *given) {
  if (wanted.size() == 1 && given[0] && !given[1])
    return normal(wanted[0]) == normal(given[0]);
  return wanted == given;
}

bool hasElement(const ArrayArg &arg, int rank, const int64_t *shape) {
  if (rank != arg.rank)
    return false;
  size_t outer = arg.rank - arg.element.size();
  return std::equal(arg.element.begin(), arg.element.end(), shape + outer);
}

bool isFloat(char format) {
  return format == 'e' || format == 'f' || format == 'd';
}

} // namespace

//===----------------------------------------------------------------------===//
// HeldArrays
//===----------------------------------------------------------------------===//

HeldArrays::~HeldArrays() {
  for (Py_buffer &buffer : buffers)
    PyBuffer_Release(&buffer);
  for (PyObject *object : objects)
    Py_DECREF(object);
}

Match HeldArrays::pack(const ArrayArg &arg, PyObject *object,
                       const Beside *beside, size_t number, Slots &slots) {
  size_t first = slots.size();
  Match match;
  isOnDevice = false;
  if (beside)
    match = arg.element.empty() ? packTensor(arg, object, beside, slots)
                                : Match::No;
  else if (ndarrayType && PyObject_TypeCheck(object, ndarrayType))
    match = packNdarray(arg, object, slots);
  else if (!arg.isElementFixed && !arg.element.empty())
    return Match::No;
  else if (!PyObject_CheckBuffer(object))
    match = packTensor(arg, object, nullptr, slots);
  else if (PyType_HasFeature(Py_TYPE(object), Py_TPFLAGS_HEAPTYPE))
    // A subclass of np.ndarray, such as a masked array, is looked at in Python.
    return Match::No;
  else
    match = arg.hasGradient ? Match::No : packBuffer(arg, object, slots);
  if (match != Match::Yes || (use == ArrayUse::Forward && !mayAlias))
    return match;
  const Range &range = addRange(arg, slots, first);
  return use == ArrayUse::Recorded
             ? matchTaped(range, object, number, slots, first)
             : Match::Yes;
}

/// A launch that only reads an array which earlier launches of the tape have
/// used needs no new copy of the array. If the launch's adjoint reads the
/// array, the array must be unchanged since the earlier launches; the launch
/// reads their copy of it, if there is one.
Match HeldArrays::matchTaped(const Range &range, PyObject *object,
                             size_t number, Slots &slots, size_t first) {
  const ArrayArg &arg = *range.arg;
  const TapedArray *found = findTaped(object);
  if (arg.isWritten || !found)
    return matchTensor(
        range, object, number, found,
        arg.hasGradient ? slots[first + 1 + static_cast<size_t>(arg.rank)] : 0,
        first);
  // The entry is copied, because other threads may change it while the adjoint
  // is planned.
  const TapedArray known = *found;
  if (known.begin != range.begin || known.end != range.end)
    return Match::No;
  if (arg.hasGradient &&
      known.gradient != slots[first + 1 + static_cast<size_t>(arg.rank)])
    return Match::No;
  if (known.version < 0) {
    uint64_t begin = known.begin, bytes = known.end - known.begin;
    if (known.hasSample && sample(begin, bytes) != known.sample)
      return Match::No;
    bool isRead =
        taiKernelReadsInReverse(kernel.handle, static_cast<int64_t>(first));
    if (!afterCall())
      return Match::Error;
    if (!isRead)
      return Match::Yes;
    if (known.hasDigest)
      return digest(begin, bytes) == known.digest ? Match::Yes : Match::No;
    if (!known.frozen ||
        std::memcmp(reinterpret_cast<const void *>(begin),
                    reinterpret_cast<const void *>(known.frozen), bytes) != 0)
      return Match::No;
    slots[first] = known.frozen;
    return Match::Yes;
  }
  static const Name version("_version");
  py::object now = take(get(object, version));
  return now && PyLong_Check(now.ptr()) &&
                 PyLong_AsLongLong(now.ptr()) == known.version
             ? Match::Yes
             : Match::No;
}

/// A launch may use a tensor for the first time, or write to one, if nothing
/// else of the tape shares the memory. A tensor that earlier launches have used
/// must be unchanged since.
Match HeldArrays::matchTensor(const Range &range, PyObject *object,
                              size_t number, const TapedArray *found,
                              uint64_t gradient, size_t first) {
  static const Name version("_version"), grad("grad");
  const ArrayArg &arg = *range.arg;
  if (!canNoteTensors() || !findTensorType(object).isTensor)
    return Match::No;
  py::object now = take(get(object, version));
  if (!now || !PyLong_Check(now.ptr()))
    return Match::No;
  UsedTensor tensor{object,      nullptr,
                    range.begin, range.end,
                    gradient,    0,
                    number,      arg.isWritten,
                    isOnDevice,  found != nullptr && arg.isWritten};
  tensor.version = PyLong_AsLongLong(now.ptr());
  if (found &&
      (found->begin != range.begin || found->end != range.end ||
       found->version != tensor.version || found->gradient != gradient))
    return Match::No;
  if (tensor.overwrites &&
      (isOnDevice || range.end - range.begin > mostSavedBytes))
    return Match::No;
  if (arg.hasGradient) {
    py::object adjoint = take(get(object, grad));
    if (!adjoint || adjoint.is_none())
      return Match::No;
    tensor.gradient = adjoint.ptr(); // which `objects` keeps
  } else if (isFloat(arg.format[0])) {
    bool ends =
        arg.isWritten &&
        taiKernelEndsGradients(kernel.handle, static_cast<int64_t>(first));
    if (!afterCall())
      return Match::Error;
    if (ends || watches)
      return Match::No;
  }
  if (overlapsOthers(object, range.begin, range.end))
    return Match::No;
  used.push_back(tensor);
  return Match::Yes;
}

Match HeldArrays::packBuffer(const ArrayArg &arg, PyObject *object,
                             Slots &slots) {
  Py_buffer view;
  int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT;
  if (arg.isWritten || arg.hasGradient)
    flags |= PyBUF_WRITABLE;
  if (PyObject_GetBuffer(object, &view, flags) != 0) {
    forgetError();
    return Match::No;
  }
  buffers.push_back(view);
  static_assert(sizeof(Py_ssize_t) == sizeof(int64_t));
  if (!isSameFormat(arg.format, formatOf(view)) ||
      !hasElement(arg, view.ndim,
                  reinterpret_cast<const int64_t *>(view.shape)))
    return Match::No;
  slots.push_back(reinterpret_cast<uint64_t>(view.buf));
  for (int d = 0; d < view.ndim; ++d)
    slots.push_back(static_cast<uint64_t>(view.shape[d]));
  return Match::Yes;
}

/// Gives a tensor a gradient of zeros. Null and a Python error on failure.
static PyObject *makeGradient(PyObject *tensor, PyObject *name) {
  static const Name shape("shape"), newZeros("new_zeros");
  py::object extents = take(PyObject_GetAttr(tensor, shape));
  if (!extents)
    return nullptr;
  PyObject *made = PyObject_CallMethodOneArg(tensor, newZeros, extents.ptr());
  if (made && PyObject_SetAttr(tensor, name, made) != 0)
    Py_CLEAR(made);
  return made;
}

/// Adds the slots of an array's gradient after the slots of the array. A kernel
/// that only runs forward does not read the gradient, so the slots of the array
/// are repeated.
template <typename Packer>
Match HeldArrays::packGradient(PyObject *owner, PyObject *name, Slots &slots,
                               size_t first, Packer pack) {
  if (use == ArrayUse::Forward) {
    size_t count = slots.size() - first;
    for (size_t i = 0; i < count; ++i)
      slots.push_back(slots[first + i]);
    return Match::Yes;
  }
  PyObject *gradient = PyObject_GetAttr(owner, name);
  if (gradient == Py_None && use == ArrayUse::Gradient) {
    Py_DECREF(gradient);
    gradient = makeGradient(owner, name);
  }
  if (!gradient) {
    forgetError();
    return Match::No;
  }
  objects.push_back(gradient);
  return addGradient(pack(gradient), slots, first);
}

/// Notes the slots of a gradient as slots of an adjoint. They follow the slots
/// of the array, which begin at \p first. \p match: whether the gradient was
/// packed.
Match HeldArrays::addGradient(Match match, Slots &slots, size_t first) {
  if (match != Match::Yes)
    return match;
  size_t count = (slots.size() - first) / 2;
  // The gradient must have the shape of the array.
  if (slots.size() != first + 2 * count ||
      !std::equal(slots.begin() + static_cast<ptrdiff_t>(first + 1),
                  slots.begin() + static_cast<ptrdiff_t>(first + count),
                  slots.begin() + static_cast<ptrdiff_t>(first + count + 1)))
    return Match::No;
  adjoints.insert(adjoints.end(),
                  slots.begin() + static_cast<ptrdiff_t>(first + count),
                  slots.end());
  return Match::Yes;
}

Match HeldArrays::packNdarray(const ArrayArg &arg, PyObject *object,
                              Slots &slots) {
  static const Name array("array"), gradient("_grad"), element("element_shape");
  PyObject *memory = get(object, array);
  if (!memory)
    return Match::No;
  objects.push_back(memory);
  py::object inner = take(get(object, element));
  py::object adjoint = take(get(object, gradient));
  if (!inner || !adjoint || !PyTuple_Check(inner.ptr()) ||
      static_cast<size_t>(PyTuple_GET_SIZE(inner.ptr())) !=
          arg.element.size() ||
      adjoint.is_none() == arg.hasGradient)
    return Match::No;
  size_t first = slots.size();
  Match match = packBuffer(arg, memory, slots);
  if (match != Match::Yes || !arg.hasGradient)
    return match;
  return packGradient(
      adjoint.ptr(), array, slots, first,
      [&](PyObject *gradient) { return packBuffer(arg, gradient, slots); });
}

bool HeldArrays::isUsable(uint64_t address) const {
  return taiContextIsOnGpu(context.handle) ||
         taiContextIsOnDevice(context.handle,
                              reinterpret_cast<const void *>(address));
}

Match HeldArrays::packTensor(const ArrayArg &arg, PyObject *object,
                             const Beside *beside, Slots &slots) {
  auto packOne = [&](const TensorType &type, PyObject *tensor) {
    TensorView view;
    if (!readTensor(type, tensor, view) || arg.format.size() != 1 ||
        normal(arg.format[0]) != normal(view.format) ||
        !hasElement(arg, view.rank, view.shape.data()))
      return Match::No;
    isOnDevice = view.deviceType == dlpack::kCuda;
    if (isOnDevice) {
      if (view.deviceNumber != 0 ||
          (view.bytes() != 0 && !isUsable(view.address)))
        return Match::No;
      uint64_t stream = 0;
      if (!findStream(type, stream))
        return Match::Error;
      if (std::find(streams.begin(), streams.end(), stream) == streams.end())
        streams.push_back(stream);
    } else if (view.deviceType != dlpack::kCpu) {
      return Match::No;
    }
    slots.push_back(view.address);
    for (int d = 0; d < view.rank; ++d)
      slots.push_back(static_cast<uint64_t>(view.shape[d]));
    return Match::Yes;
  };
  TensorType type = findTensorType(object);
  if (!type.isTensor)
    return Match::No;
  if (beside) {
    bool isNone = !beside->copy && beside->gradient == Py_None;
    if (isFloat(arg.format[0]) && isNone == arg.hasGradient)
      return Match::No;
  } else if (isFloat(arg.format[0])) {
    static const Name requiresGrad("requires_grad");
    py::object wants = take(get(object, requiresGrad));
    if (!wants || wants.is(py::bool_(true)) != arg.hasGradient)
      return Match::No;
  }
  size_t first = slots.size();
  Match match = packOne(type, object);
  bool isCopied = beside && beside->copy;
  if (match == Match::Yes && isCopied)
    slots[first] = beside->copy;
  if (match != Match::Yes || !arg.hasGradient)
    return match;
  if (isCopied) {
    for (size_t i = first, end = slots.size(); i < end; ++i)
      slots.push_back(slots[i]);
    return addGradient(Match::Yes, slots, first);
  }
  auto packPlain = [&](PyObject *tensor) {
    TensorType type = findTensorType(tensor);
    return type.isTensor ? packOne(type, tensor) : Match::No;
  };
  if (beside)
    return addGradient(packPlain(beside->gradient), slots, first);
  static const Name gradient("grad"), isLeaf("is_leaf");
  if (use != ArrayUse::Forward) {
    // A tensor that torch computed cannot be used; Python code reports the
    // error.
    py::object leaf = take(get(object, isLeaf));
    if (leaf && leaf.is(py::bool_(false)))
      return Match::No;
  }
  // The gradient of a parameter of a network is a plain tensor.
  return packGradient(object, gradient, slots, first, packPlain);
}

const HeldArrays::Range &
HeldArrays::addRange(const ArrayArg &arg, const Slots &slots, size_t first) {
  uint64_t bytes = arg.format.empty()                             ? 1
                   : std::strchr("bB?", arg.format[0]) != nullptr ? 1
                   : std::strchr("hHe", arg.format[0]) != nullptr ? 2
                   : std::strchr("iIf", arg.format[0]) != nullptr ? 4
                                                                  : 8;
  for (int d = 0; d < arg.rank; ++d)
    bytes *= slots[first + 1 + static_cast<size_t>(d)];
  constexpr size_t inPlace = sizeof few / sizeof *few;
  if (numRanges >= inPlace) {
    if (many.empty())
      many.assign(few, few + inPlace);
    many.push_back({});
    ranges = many.data();
  }
  Range &added = ranges[numRanges++];
  added = {slots[first], slots[first] + bytes, &arg};
  return added;
}

bool HeldArrays::mustNotOverlap(const Range &one, const Range &other) const {
  bool isRecorded = use != ArrayUse::Forward;
  if (isRecorded && (one.arg->hasGradient || other.arg->hasGradient))
    return true;
  // A launch that only runs forward may get one array twice, and changes it in
  // place.
  return (one.arg->isWritten || other.arg->isWritten) &&
         (isRecorded || !one.isSame(other));
}

Match HeldArrays::finish(PyObject *launcher, Slots &slots) {
  for (size_t i = 0; i < numRanges; ++i)
    for (size_t j = 0; j < i; ++j)
      if (ranges[i].overlaps(ranges[j]) && mustNotOverlap(ranges[i], ranges[j]))
        return Match::No;
  slots.append(adjoints);
  return used.empty() || noteTensors(used, launcher) ? Match::Yes
                                                     : Match::Error;
}

bool HeldArrays::orderStreams(TaiStatus (*order)(TaiContext, uint64_t)) {
  for (uint64_t stream : streams) {
    TaiStatus status = order(context.handle, stream);
    if (!afterCall())
      return false;
    if (status) {
      if (!PyErr_Occurred())
        setError(context.handle, status);
      return false;
    }
  }
  return true;
}

bool HeldArrays::orderBefore() {
  return orderStreams(&taiContextWaitForStream);
}

bool HeldArrays::orderAfter() { return orderStreams(&taiContextLetStreamWait); }

void taipy::bindArrayArguments(py::module_ &module) {
  module.def("set_ndarray_type", [](const py::object &type) {
    ndarrayType = reinterpret_cast<PyTypeObject *>(type.inc_ref().ptr());
  });
}
