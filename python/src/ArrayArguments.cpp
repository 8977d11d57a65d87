//===- ArrayArguments.cpp - Arrays that kernels are called with -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Tensors say what they hold by a C function of their type, where it has the
// table of DLPack, else by their attributes, each of which costs as much as a
// launch. Whatever is out of the ordinary is left to Python, which says what is
// wrong with it.
//
//===----------------------------------------------------------------------===//

#include "ArrayArguments.h"
#include "DLPack.h"

#include <algorithm>
#include <array>
#include <cstring>

using namespace taipy;

namespace {

/// The class `ti.ndarray` makes.
PyTypeObject *ndarrayType = nullptr;

/// A name that is made once.
struct Name {
  explicit Name(const char *text) : text(PyUnicode_InternFromString(text)) {}
  operator PyObject *() const { return text; }
  PyObject *text;
};

PyObject *get(PyObject *object, const Name &name) {
  PyObject *found = PyObject_GetAttr(object, name);
  if (!found)
    PyErr_Clear();
  return found;
}

py::object take(PyObject *object) {
  return py::reinterpret_steal<py::object>(object);
}

/// NumPy calls int64 'l' and it may also be 'q'.
char normal(char format) {
  return format == 'l' ? 'q' : format == 'L' ? 'Q' : format;
}

/// Of a buffer, without a byte-order mark.
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

//===----------------------------------------------------------------------===//
// Tensors
//===----------------------------------------------------------------------===//

struct KnownType {
  PyTypeObject *type;
  bool isTensor;
  const dlpack::ExchangeTable *table; // or null
};

constexpr int kMostDimensions = 8;

struct View {
  uint64_t address = 0;
  int32_t deviceType = 0, deviceNumber = 0;
  int rank = 0;
  std::array<int64_t, kMostDimensions> shape{};
  char format = 0;
  int itemBytes = 0;

  int64_t bytes() const {
    int64_t all = itemBytes;
    for (int d = 0; d < rank; ++d)
      all *= shape[d];
    return all;
  }
};

const dlpack::ExchangeTable *findTable(PyTypeObject *type) {
  static const Name name("__dlpack_c_exchange_api__");
  PyObject *capsule = get(reinterpret_cast<PyObject *>(type), name);
  if (!capsule)
    return nullptr;
  const dlpack::ExchangeTable *table = nullptr;
  if (PyCapsule_IsValid(capsule, dlpack::kTableName)) {
    // It stays for as long as the process.
    table = static_cast<const dlpack::ExchangeTable *>(
        PyCapsule_GetPointer(capsule, dlpack::kTableName));
    if (table->major != 1 || !table->view || !table->currentStream)
      table = nullptr;
  }
  Py_DECREF(capsule);
  return table;
}

/// What is known of the type of an object, found out once.
KnownType typeOf(PyObject *object) {
  static std::vector<KnownType> known;
  PyTypeObject *type = Py_TYPE(object);
  for (const KnownType &entry : known)
    if (entry.type == type)
      return entry;
  auto *owner = reinterpret_cast<PyObject *>(type);
  KnownType entry{type, false, nullptr};
  constexpr size_t most = 32;
  if (known.size() >= most)
    return entry;
  entry.isTensor = PyObject_HasAttrString(owner, "data_ptr") &&
                   PyObject_HasAttrString(owner, "is_contiguous");
  if (entry.isTensor)
    entry.table = findTable(type);
  Py_INCREF(type);
  known.push_back(entry);
  return entry;
}

/// As NumPy has it; 0 for what kernels do not know.
char formatOf(const dlpack::Tensor &tensor) {
  if (tensor.lanes != 1)
    return 0;
  auto choose = [&](const char *formats) -> char {
    switch (tensor.bits) {
    case 8:
      return formats[0];
    case 16:
      return formats[1];
    case 32:
      return formats[2];
    case 64:
      return formats[3];
    }
    return 0;
  };
  switch (tensor.code) {
  case 0:
    return choose("bhiq");
  case 1:
    return choose("BHIQ");
  case 2:
    return choose("\0efd");
  case 6:
    return tensor.bits == 8 ? '?' : 0;
  }
  return 0;
}

/// False for what is not contiguous, too.
bool readByTable(const dlpack::ExchangeTable &table, PyObject *object,
                 View &view) {
  dlpack::Tensor tensor;
  if (table.view(object, &tensor) != 0) {
    PyErr_Clear();
    return false;
  }
  if (tensor.rank > kMostDimensions)
    return false;
  view.address = reinterpret_cast<uint64_t>(tensor.data) + tensor.byteOffset;
  view.deviceType = tensor.deviceType;
  view.deviceNumber = tensor.deviceNumber;
  view.rank = tensor.rank;
  view.format = formatOf(tensor);
  view.itemBytes = tensor.bits / 8;
  int64_t step = 1;
  bool isDense = true;
  for (int d = tensor.rank; d-- > 0;) {
    view.shape[d] = tensor.shape[d];
    isDense &=
        !tensor.strides || tensor.shape[d] <= 1 || tensor.strides[d] == step;
    step *= tensor.shape[d];
  }
  return isDense || step == 0;
}

/// NumPy's name of a type of numbers; kept by the type. Null where it has none.
const char *readFormat(PyObject *dtype, int &itemBytes) {
  static PyObject *formats = PyDict_New();
  PyObject *found = PyDict_GetItemWithError(formats, dtype);
  if (!found) {
    PyErr_Clear();
    try {
      py::object type = py::module_::import("tai._interop")
                            .attr("numpy_type")(py::handle(dtype));
      py::tuple made = py::make_tuple(type.attr("char"), type.attr("itemsize"));
      PyDict_SetItem(formats, dtype, made.ptr());
      found = made.ptr(); // which the dictionary keeps
    } catch (py::error_already_set &) {
      return nullptr;
    }
  }
  itemBytes = static_cast<int>(PyLong_AsLong(PyTuple_GET_ITEM(found, 1)));
  return PyUnicode_AsUTF8(PyTuple_GET_ITEM(found, 0));
}

bool readByAttributes(PyObject *object, View &view) {
  static const Name isCuda("is_cuda"), device("device"), index("index"),
      dtype("dtype"), shape("shape"), dataPtr("data_ptr"),
      isContiguous("is_contiguous");
  py::object onGpu = take(get(object, isCuda));
  if (!onGpu)
    return false;
  view.deviceType = onGpu.is(py::bool_(true)) ? dlpack::kCuda : dlpack::kCpu;
  if (view.deviceType == dlpack::kCuda) {
    py::object place = take(get(object, device));
    py::object number = place ? take(get(place.ptr(), index)) : place;
    if (!number)
      return false;
    view.deviceNumber = number.is_none() ? 0 : number.cast<int>();
  }
  py::object type = take(get(object, dtype));
  const char *format = type ? readFormat(type.ptr(), view.itemBytes) : nullptr;
  py::object extents = take(get(object, shape));
  if (!format || !extents || !PyTuple_Check(extents.ptr()) ||
      PyTuple_GET_SIZE(extents.ptr()) > kMostDimensions)
    return false;
  view.format = *format;
  view.rank = static_cast<int>(PyTuple_GET_SIZE(extents.ptr()));
  for (int d = 0; d < view.rank; ++d)
    view.shape[d] = PyLong_AsLongLong(PyTuple_GET_ITEM(extents.ptr(), d));
  py::object dense = take(PyObject_CallMethodNoArgs(object, isContiguous));
  py::object address = take(PyObject_CallMethodNoArgs(object, dataPtr));
  if (!dense || !address || PyErr_Occurred()) {
    PyErr_Clear();
    return false;
  }
  view.address = PyLong_AsUnsignedLongLong(address.ptr());
  return dense.is(py::bool_(true));
}

bool read(const KnownType &type, PyObject *object, View &view) {
  return type.table ? readByTable(*type.table, object, view)
                    : readByAttributes(object, view);
}

/// Where the library of a tensor works now. False and a Python error if it does
/// not say.
bool findStream(const KnownType &type, uint64_t &stream) {
  if (type.table) {
    void *found = nullptr;
    if (type.table->currentStream(dlpack::kCuda, 0, &found) != 0)
      return false;
    stream = reinterpret_cast<uint64_t>(found);
    return true;
  }
  try {
    stream = py::module_::import("tai._interop")
                 .attr("_stream_number")(py::none())
                 .cast<uint64_t>();
    return true;
  } catch (py::error_already_set &error) {
    error.restore();
    return false;
  }
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

Match HeldArrays::pack(const ArrayArg &arg, PyObject *object, Slots &slots) {
  size_t first = slots.size();
  Match match;
  if (ndarrayType && PyObject_TypeCheck(object, ndarrayType))
    match = packNdarray(arg, object, slots);
  else if (!arg.isElementFixed && !arg.element.empty())
    return Match::No;
  else if (!PyObject_CheckBuffer(object))
    match = packTensor(arg, object, slots);
  else
    match = arg.hasGradient ? Match::No : packBuffer(arg, object, slots);
  if (match == Match::Yes && grad)
    addRange(arg, slots, first);
  return match;
}

Match HeldArrays::packBuffer(const ArrayArg &arg, PyObject *object,
                             Slots &slots) {
  Py_buffer view;
  if (PyObject_GetBuffer(object, &view,
                         PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | PyBUF_WRITABLE) !=
      0) {
    PyErr_Clear();
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

/// A tensor gets a gradient of zeros. Null and a Python error if it cannot.
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

/// The gradient behind an array: where the kernel only runs forward it does not
/// look at it, and the array stands for it.
template <typename Packer>
Match HeldArrays::packGradient(PyObject *owner, PyObject *name, Slots &slots,
                               size_t first, Packer pack) {
  size_t count = slots.size() - first;
  if (!grad) {
    for (size_t i = 0; i < count; ++i)
      slots.push_back(slots[first + i]);
    return Match::Yes;
  }
  PyObject *gradient = PyObject_GetAttr(owner, name);
  if (gradient == Py_None) {
    Py_DECREF(gradient);
    gradient = makeGradient(owner, name);
  }
  if (!gradient) {
    PyErr_Clear();
    return Match::No;
  }
  objects.push_back(gradient);
  Match match = pack(gradient);
  if (match != Match::Yes)
    return match;
  // Of the same shape.
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
                             Slots &slots) {
  auto packOne = [&](const KnownType &type, PyObject *tensor) {
    View view;
    if (!read(type, tensor, view) || arg.format.size() != 1 ||
        normal(arg.format[0]) != normal(view.format) ||
        !hasElement(arg, view.rank, view.shape.data()))
      return Match::No;
    if (view.deviceType == dlpack::kCuda) {
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
  KnownType type = typeOf(object);
  if (!type.isTensor)
    return Match::No;
  if (isFloat(arg.format[0])) {
    static const Name requiresGrad("requires_grad");
    py::object wants = take(get(object, requiresGrad));
    if (!wants || wants.is(py::bool_(true)) != arg.hasGradient)
      return Match::No;
  }
  size_t first = slots.size();
  Match match = packOne(type, object);
  if (match != Match::Yes || !arg.hasGradient)
    return match;
  static const Name gradient("grad");
  return packGradient(object, gradient, slots, first, [&](PyObject *tensor) {
    // That of a parameter of a network is a plain tensor.
    KnownType type = typeOf(tensor);
    return type.isTensor ? packOne(type, tensor) : Match::No;
  });
}

void HeldArrays::addRange(const ArrayArg &arg, const Slots &slots,
                          size_t first) {
  uint64_t bytes = arg.format.empty()                             ? 1
                   : std::strchr("bB?", arg.format[0]) != nullptr ? 1
                   : std::strchr("hHe", arg.format[0]) != nullptr ? 2
                   : std::strchr("iIf", arg.format[0]) != nullptr ? 4
                                                                  : 8;
  for (int d = 0; d < arg.rank; ++d)
    bytes *= slots[first + 1 + static_cast<size_t>(d)];
  ranges.push_back({slots[first], slots[first] + bytes, arg.hasGradient});
}

Match HeldArrays::finish(Slots &slots) {
  for (size_t i = 0; i < ranges.size(); ++i)
    for (size_t j = 0; j < i; ++j)
      if ((ranges[i].hasGradient || ranges[j].hasGradient) &&
          ranges[i].begin < ranges[j].end && ranges[j].begin < ranges[i].end)
        return Match::No;
  slots.append(adjoints);
  return Match::Yes;
}

bool HeldArrays::orderBefore() {
  for (uint64_t stream : streams)
    if (TaiStatus status = taiContextWaitForStream(context.handle, stream)) {
      setError(context.handle, status);
      return false;
    }
  return true;
}

bool HeldArrays::orderAfter() {
  for (uint64_t stream : streams)
    if (TaiStatus status = taiContextLetStreamWait(context.handle, stream)) {
      if (!PyErr_Occurred())
        setError(context.handle, status);
      return false;
    }
  return true;
}

void taipy::bindArrayArguments(py::module_ &module) {
  module.def("set_ndarray_type", [](const py::object &type) {
    ndarrayType = reinterpret_cast<PyTypeObject *>(type.inc_ref().ptr());
  });
}
